"""The renderer on real OpenGL: what it draws, the geometry it hands back, and how it complains."""

import dataclasses
import os
import subprocess
import sys
import textwrap

import MaterialX as mx
import numpy as np
import pytest

import mrm_nodes
from mrm_nodes.documents import read_document
from mrm_nodes.errors import MrmError
from mrm_nodes.render import (
    BACKENDS,
    BackendReport,
    Camera,
    CameraLight,
    DirectionalLight,
    Framing,
    Mesh,
    PointLight,
    Renderer,
    SpotLight,
    baluster,
    get_context,
    plane,
    probe_backends,
    render,
    sphere,
    write_png,
)
from mrm_nodes.render.gbuffer import sheet_stages
from mrm_nodes.shadergen import generate_shader

REQUIRED = [name for name in os.environ.get("MRM_REQUIRE_BACKENDS", "").split(",") if name]

LAMBERT = """
  <oren_nayar_diffuse_bsdf name="b" type="BSDF">
    <input name="color" type="color3" value="0.8, 0.4, 0.2"/>
    <input name="roughness" type="float" value="0"/>
  </oren_nayar_diffuse_bsdf>"""
CONDUCTOR = """
  <conductor_bsdf name="b" type="BSDF">
    <input name="roughness" type="vector2" value="0.3, 0.3"/>
  </conductor_bsdf>"""


def material(bsdf):
    """A shader of one BSDF, named b."""
    return shader_of(
        bsdf
        + """
  <surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="b"/></surface>
  <surfacematerial name="m" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="s"/>
  </surfacematerial>"""
    )


def pattern(nodes, type_="color3"):
    """A shader that shows a node, named n, as it is."""
    graph = f'<nodegraph name="g">{nodes}<output name="out" type="{type_}" nodename="n"/></nodegraph>'
    return shader_of(graph, element="g/out")


def shader_of(xml, element=None):
    document = mx.createDocument()
    mx.readFromXmlString(document, f'<?xml version="1.0"?><materialx version="1.39">{xml}</materialx>')
    return generate_shader(document, element=element)


def renderer_of(backend):
    try:
        return Renderer(backend)
    except MrmError as error:
        if backend in REQUIRED or (backend == "auto" and REQUIRED):
            raise
        pytest.skip(str(error))


@pytest.fixture(scope="module", params=BACKENDS)
def each_renderer(request):
    return renderer_of(request.param)


@pytest.fixture(scope="module")
def renderer():
    return renderer_of("auto")


@pytest.fixture(scope="module")
def lambert():
    return material(LAMBERT)


@pytest.fixture(scope="module")
def conductor():
    return material(CONDUCTOR)


def pixel_centers(position, camera, aspect):
    """Where a camera sees points (n, 3), in normalised device coordinates (n, 2)."""
    matrix = camera.projection_matrix(aspect, 0.1, 10.0) @ camera.view_matrix()
    clip = np.c_[position, np.ones(len(position))] @ matrix.T
    return clip[:, :2] / clip[:, 3:]


@pytest.mark.parametrize(
    "camera", [Framing((0.4, 0.5, 1.0)), Framing((0.4, 0.5, 1.0), orthographic=True), Camera((0, 0, 2.5))]
)
def test_each_position_lies_on_the_sphere_and_on_the_ray_through_its_pixel(each_renderer, lambert, camera):
    drawn = each_renderer.render(lambert, sphere(), camera, size=(90, 60))
    rows, columns = np.nonzero(drawn.mask)
    assert len(rows) > 1000
    position = drawn.position[drawn.mask]
    assert np.abs(np.linalg.norm(position, axis=1) - 1.0).max() < 2e-3
    seen = pixel_centers(position, drawn.camera, 1.5)
    expected = np.stack([(columns + 0.5) / 45.0 - 1.0, 1.0 - (rows + 0.5) / 30.0], axis=1)
    assert np.abs(seen - expected).max() < 2e-5


def test_normals_and_tangents_are_those_of_the_sphere(each_renderer, lambert):
    drawn = each_renderer.render(lambert, sphere(), size=(64, 64))
    position, normal, tangent = (
        getattr(drawn, name)[drawn.mask] for name in ("position", "normal", "tangent")
    )
    assert np.abs(np.linalg.norm(normal, axis=1) - 1.0).max() < 2e-3
    assert np.abs(normal - position).max() < 5e-3
    assert np.abs(np.sum(normal * tangent, axis=1)).max() < 5e-2
    east = np.stack([position[:, 2], 0.0 * position[:, 0], -position[:, 0]], axis=1)
    assert (np.sum(east * tangent, axis=1) > 0.0).all()


def test_both_backends_draw_the_same():
    first, second = (renderer_of(name) for name in BACKENDS)
    shader = material(CONDUCTOR)
    lights = [DirectionalLight((-1, -2, -3)), CameraLight()]
    a, b = (r.render(shader, sphere(), Framing((1, 1, 2)), lights, (80, 80)) for r in (first, second))
    assert (a.mask == b.mask).all()
    for name in ("image", "position", "normal", "tangent", "texcoord"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("direction", [(0, 0.3, 1), (1, 2, 0), (0.2, -1, 0.3), (-1, 0.1, -0.7)])
def test_the_baluster_is_closed_all_around(renderer, lambert, direction):
    drawn = renderer.render(lambert, baluster(), Framing(direction), size=(128, 128))
    view = drawn.camera.position - drawn.position[drawn.mask]
    # Silhouettes of a coarse mesh may show an interpolated normal that looks away; an inside would be more.
    assert (np.sum(view * drawn.normal[drawn.mask], axis=1) < 0.0).mean() < 0.003


def test_a_material_that_uses_no_geometry_still_has_its_geometry_drawn(each_renderer):
    shader = pattern(
        '<constant name="n" type="color3"><input name="value" type="color3" value="1, 2, 3"/></constant>'
    )
    drawn = each_renderer.render(shader, plane(), size=(32, 32))
    assert (drawn.image[drawn.mask] == (1, 2, 3)).all()
    assert (drawn.normal[drawn.mask] == (0, 0, 1)).all()
    assert (drawn.tangent[drawn.mask] == (1, 0, 0)).all()
    x, y, z = drawn.position[drawn.mask].T
    assert x.min() < -0.5 < 0.5 < x.max() and y.min() < -0.5 < 0.5 < y.max() and (z == 0).all()
    np.testing.assert_allclose(drawn.texcoord[drawn.mask], np.stack([x, y], axis=1) / 2 + 0.5, atol=1e-5)


def test_without_a_light_everything_is_black(renderer, conductor):
    drawn = renderer.render(conductor, sphere(), size=(32, 32))
    assert drawn.mask.any() and (drawn.image == 0.0).all()


def test_the_uncovered_pixels_are_zero(renderer, lambert):
    drawn = renderer.render(lambert, sphere(), lights=[CameraLight()], size=(32, 32))
    assert not drawn.mask[0, 0] and drawn.mask[16, 16]
    for name in ("image", "position", "normal", "tangent"):
        array = getattr(drawn, name)
        assert array.dtype == np.float32 and array.shape == (32, 32, 3)
        assert (array[~drawn.mask] == 0.0).all()


COLOR = np.array([0.8, 0.4, 0.2])


def lambert_image(drawn, direction, irradiance):
    """Lambert's law at each pixel: `direction` and `irradiance` are functions of position (n, 3)."""
    position, normal = drawn.position[drawn.mask], drawn.normal[drawn.mask]
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    cosine = np.sum(normal * direction(position), axis=1)
    # A material turns its normal to the viewer, also at a silhouette where the interpolated one looks away.
    view = np.sum(normal * towards(np.array(drawn.camera.position))(position), axis=1)
    cosine = np.maximum(np.where(view < 0.0, -cosine, cosine), 0.0)
    return (cosine * irradiance(position))[:, None] * COLOR / np.pi


def towards(point):
    return lambda position: (point - position) / np.linalg.norm(point - position, axis=1, keepdims=True)


def test_a_directional_light_shines_along_its_direction_at_unit_length(each_renderer, lambert):
    light = DirectionalLight((0.0, -4.0, -3.0), intensity=2.0)
    assert light.direction == (0.0, -0.8, -0.6)
    drawn = each_renderer.render(lambert, sphere(), lights=[light], size=(48, 48))
    expected = lambert_image(drawn, lambda p: np.array([0.0, 0.8, 0.6]), lambda p: 2.0)
    np.testing.assert_allclose(drawn.image[drawn.mask], expected, atol=2e-5)


def test_a_point_light_decays_as_materialx_says(renderer, lambert):
    light = PointLight((1.0, 2.0, 3.0), decay_rate=2.0, intensity=5.0)
    drawn = renderer.render(lambert, sphere(), lights=[light], size=(48, 48))
    point = np.array([1.0, 2.0, 3.0])
    expected = lambert_image(
        drawn, towards(point), lambda p: 5.0 / (1.0 + np.linalg.norm(point - p, axis=1)) ** 2
    )
    np.testing.assert_allclose(drawn.image[drawn.mask], expected, atol=2e-5)


def test_a_spot_light_ends_at_its_outer_cone(renderer, lambert):
    light = SpotLight((0, 0, 3), (0, 0, -1), decay_rate=0.0, inner_angle=0.98, outer_angle=0.95)
    drawn = renderer.render(lambert, plane(), lights=[light], size=(64, 64))
    cosine = towards(np.array([0.0, 0.0, 3.0]))(drawn.position[drawn.mask])[:, 2]
    brightness = drawn.image[drawn.mask][:, 0]
    assert (brightness[cosine < 0.95] == 0.0).all() and (cosine < 0.95).any()
    np.testing.assert_allclose(brightness[cosine > 0.98], 0.8 * cosine[cosine > 0.98] / np.pi, atol=1e-5)


@pytest.mark.parametrize("orthographic", [False, True])
def test_with_the_light_at_the_camera_light_and_view_agree(renderer, lambert, orthographic):
    framing = Framing((1, 0.5, 2), orthographic=orthographic)
    drawn = renderer.render(lambert, sphere(), framing, [CameraLight()], size=(48, 48))
    expected = lambert_image(drawn, towards(np.array(drawn.camera.position)), lambda p: 1.0)
    np.testing.assert_allclose(drawn.image[drawn.mask], expected, atol=2e-5)


def test_lights_add_up_and_too_many_are_refused(renderer, lambert):
    lights = [DirectionalLight((0, 0, -1)), PointLight((1, 1, 3))]
    both = renderer.render(lambert, sphere(), None, lights, (24, 24)).image
    each = [renderer.render(lambert, sphere(), None, [light], (24, 24)).image for light in lights]
    np.testing.assert_allclose(both, each[0] + each[1], atol=1e-6)
    with pytest.raises(MrmError, match="5 lights, but the shader was generated for 4"):
        renderer.render(lambert, sphere(), None, [CameraLight()] * 5, (24, 24))


def test_back_faces_are_shaded(renderer, lambert):
    drawn = renderer.render(lambert, plane(), Camera((0, 0, -3)), [CameraLight()], (24, 24))
    assert drawn.mask[12, 12] and (drawn.image[drawn.mask] > 0.05).all()


def test_nearer_surfaces_hide_farther_ones(renderer, lambert):
    quads = [np.add(plane().positions, (0, 0, z)) for z in (0.5, -0.5)]
    two = Mesh(
        "two",
        np.concatenate(quads),
        np.concatenate([plane().normals] * 2),
        np.concatenate([plane().tangents] * 2),
        np.concatenate([plane().texcoords] * 2),
        np.concatenate([plane().indices, plane().indices + 4]),
    )
    front = renderer.render(lambert, two, Camera((0, 0, 4)), size=(24, 24))
    back = renderer.render(lambert, two, Camera((0, 0, -4)), size=(24, 24))
    assert (front.position[8:16, 8:16, 2] == 0.5).all() and (back.position[8:16, 8:16, 2] == -0.5).all()


# Uniforms ------------------------------------------------------------------------------------------


def test_cases_that_differ_only_in_values_share_one_program(each_renderer):
    red, green = (material(LAMBERT.replace("0.8, 0.4, 0.2", color)) for color in ("0.7, 0, 0", "0, 0.6, 0"))
    images = [
        each_renderer.render(shader, plane(), None, [CameraLight()], (16, 16)) for shader in (red, green)
    ]
    assert images[1].seconds["compile"] == 0.0
    assert images[0].image[8, 8, 0] > 0.1 and images[0].image[8, 8, 1] == 0.0
    assert images[1].image[8, 8, 1] > 0.1 and images[1].image[8, 8, 0] == 0.0


@pytest.mark.parametrize("name", ["b/color", "b_color"])
def test_a_value_can_be_given_by_path_or_name_and_is_forgotten_afterwards(renderer, lambert, name):
    def red(uniforms=None):
        return renderer.render(lambert, plane(), None, [CameraLight()], (16, 16), uniforms).image[8, 8, 0]

    before = red()
    assert red({name: (0.4, 0.1, 0.1)}) == pytest.approx(before / 2, rel=1e-5)
    assert red() == before


def test_an_enum_takes_the_name_of_its_value(renderer):
    sheen = material('<sheen_bsdf name="b" type="BSDF"/>')

    def image(**uniforms):
        values = {f"b/{name}": value for name, value in uniforms.items()}
        return renderer.render(sheen, sphere(), None, [CameraLight()], (16, 16), values).image

    assert (image(mode="zeltner") == image(mode=1)).all() and (image(mode="zeltner") != image()).any()
    with pytest.raises(MrmError, match=r"b/mode: 'velvet' is no value of it; known: conty_kulla, zeltner"):
        image(mode="velvet")


@pytest.mark.parametrize(
    ("uniforms", "message"),
    [
        ({"b/colour": (1, 1, 1)}, "no uniform b/colour; did you mean b/color"),
        ({"b/color": (1, np.nan, 1)}, "b/color: .* is NaN or infinite"),
        ({"b/color": (1, 1)}, "b/color: 2 numbers for type color3, which has 3"),
        ({"b/color": "red"}, "b/color: 'red' is no value of it; it takes numbers"),
        ({"b/color": {}}, "b/color: .* is not a value of type color3"),
    ],
)
def test_a_wrong_value_is_refused(renderer, lambert, uniforms, message):
    with pytest.raises(MrmError, match=message):
        renderer.render(lambert, plane(), size=(8, 8), uniforms=uniforms)


# Images in materials -------------------------------------------------------------------------------

IMAGE = """<image name="n" type="color3">
  <input name="file" type="filename" value="{file}"/>
  <input name="filtertype" type="string" value="closest"/>
  <input name="uaddressmode" type="string" value="{mode}"/>
  <input name="vaddressmode" type="string" value="{mode}"/>
  <input name="default" type="color3" value="0.25, 0.5, 0.75"/>
  {texcoord}
</image>"""
SCALED = """<texcoord name="t" type="vector2"/>
<multiply name="u" type="vector2">
  <input name="in1" type="vector2" nodename="t"/><input name="in2" type="vector2" value="2, 2"/>
</multiply>"""


@pytest.fixture
def corners(tmp_path):
    """A 2 × 2 image: red and green above blue and white."""
    file = tmp_path / "corners.png"
    write_png(file, np.array([[(1, 0, 0), (0, 1, 0)], [(0, 0, 1), (1, 1, 1)]], float))
    return file


def test_an_image_stands_the_right_way_up(each_renderer, corners):
    shader = pattern(IMAGE.format(file=corners, mode="periodic", texcoord=""))
    image = each_renderer.render(shader, plane(), size=(32, 32)).image
    assert image[12, 12].tolist() == [1, 0, 0] and image[12, 20].tolist() == [0, 1, 0]
    assert image[20, 12].tolist() == [0, 0, 1] and image[20, 20].tolist() == [1, 1, 1]


def test_it_does_so_too_where_the_shader_does_not_flip_it(renderer, corners):
    shader = pattern(IMAGE.format(file=corners, mode="periodic", texcoord=""))
    flipped = "return vec2(uv.x, 1.0 - uv.y);"
    assert shader.pixel.count(flipped) == 1
    unflipped = dataclasses.replace(shader, pixel=shader.pixel.replace(flipped, "return uv;"))
    image = renderer.render(unflipped, plane(), size=(32, 32)).image
    assert image[12, 12].tolist() == [1, 0, 0] and image[20, 12].tolist() == [0, 0, 1]


@pytest.mark.parametrize(
    ("mode", "expected"),
    # The image takes the lower left quarter; these are the middles of its texels, then those to the right.
    [
        ("periodic", [(0, 0, 1), (1, 1, 1), (0, 0, 1), (1, 1, 1)]),
        ("clamp", [(0, 0, 1), (1, 1, 1), (1, 1, 1), (1, 1, 1)]),
        ("mirror", [(0, 0, 1), (1, 1, 1), (1, 1, 1), (0, 0, 1)]),
        ("constant", [(0, 0, 1), (1, 1, 1), (0.25, 0.5, 0.75), (0.25, 0.5, 0.75)]),
    ],
)
def test_address_modes_are_materialx_s(each_renderer, corners, mode, expected):
    texcoord = '<input name="texcoord" type="vector2" nodename="u"/>'
    shader = pattern(SCALED + IMAGE.format(file=corners, mode=mode, texcoord=texcoord))
    drawn = each_renderer.render(shader, plane(), size=(64, 64))
    for i, color in enumerate(expected):
        nearest = np.abs(drawn.texcoord - ((2 * i + 1) / 8, 1 / 8)).sum(axis=-1) + 9.0 * ~drawn.mask
        assert drawn.image[np.unravel_index(nearest.argmin(), nearest.shape)].tolist() == list(color)


def test_an_image_of_one_pixel_is_an_image(renderer, tmp_path):
    write_png(tmp_path / "one.png", np.ones((1, 1, 3)))
    shader = pattern(IMAGE.format(file=tmp_path / "one.png", mode="periodic", texcoord=""))
    assert (renderer.render(shader, plane(), size=(8, 8)).image[4, 4] == 1.0).all()


def test_an_image_is_found_beside_the_material(renderer, corners):
    material_file = corners.with_name("m.mtlx")
    node = IMAGE.format(file="corners.png", mode="periodic", texcoord="")
    material_file.write_text(
        f'<?xml version="1.0"?><materialx version="1.39"><nodegraph name="g">{node}'
        '<output name="out" type="color3" nodename="n"/></nodegraph></materialx>'
    )
    shader = generate_shader(material_file, element="g/out")
    assert renderer.render(shader, plane(), size=(32, 32)).image[12, 12].tolist() == [1, 0, 0]


def test_a_missing_or_damaged_image_is_named(renderer, corners, tmp_path):
    missing = pattern(IMAGE.format(file="nowhere.png", mode="clamp", texcoord=""))
    with pytest.raises(MrmError, match=r"nowhere\.png: no such image \(input g/n/file\)"):
        renderer.render(missing, plane(), size=(8, 8))
    damaged = tmp_path / "damaged.png"
    damaged.write_bytes(corners.read_bytes()[:50])
    with pytest.raises(MrmError, match=r"damaged\.png"):
        renderer.render(pattern(IMAGE.format(file=damaged, mode="clamp", texcoord="")), plane(), size=(8, 8))


# Vertex data ---------------------------------------------------------------------------------------

GEOMPROP = """<geompropvalue name="n" type="color3">
  <input name="geomprop" type="string" value="hue"/>
</geompropvalue>"""


def test_a_mesh_brings_its_own_vertex_data(renderer):
    shader = pattern(GEOMPROP)
    hues = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)], float)
    square = dataclasses.replace(plane(), geomprops={"hue": hues})
    drawn = renderer.render(shader, square, size=(32, 32))
    np.testing.assert_allclose(drawn.image[drawn.mask][:, :2], drawn.texcoord[drawn.mask], atol=1e-5)
    with pytest.raises(MrmError, match="mesh plane has no vertex data hue"):
        renderer.render(shader, plane(), size=(8, 8))


def test_a_mesh_without_colors_is_white(renderer):
    shader = pattern('<geomcolor name="n" type="color3"/>')
    assert (renderer.render(shader, plane(), size=(8, 8)).image[4, 4] == 1.0).all()
    blue = dataclasses.replace(plane(), colors=np.tile((0, 0, 1, 1), (4, 1)))
    assert renderer.render(shader, blue, size=(8, 8)).image[4, 4].tolist() == [0, 0, 1]


def test_many_meshes_come_and_go(renderer, lambert):
    meshes = [dataclasses.replace(plane(), positions=np.add(plane().positions, (0, 0, z))) for z in range(20)]
    for z in [*range(20), 0, 19]:
        drawn = renderer.render(lambert, meshes[z], size=(8, 8))
        assert drawn.position[4, 4, 2] == pytest.approx(z, abs=1e-5)


# Points --------------------------------------------------------------------------------------------


def random_points(count):
    rng = np.random.default_rng(count)
    normal = rng.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    tangent = np.cross(normal, rng.normal(size=(count, 3)))
    return {"position": rng.normal(size=(count, 3)), "normal": normal, "tangent": tangent}


@pytest.mark.parametrize("count", [1, 2, 1000])
def test_each_point_is_shaded_with_its_own_data_in_order(each_renderer, count):
    points = random_points(count)
    hue = np.random.default_rng(1).random((count, 3)).astype(np.float32)
    drawn = each_renderer.draw_points(pattern(GEOMPROP), {**points, "hue": hue}, (0, 0, 5))
    assert (drawn["image"] == hue).all()
    assert (drawn["position"] == points["position"].astype(np.float32)).all()
    np.testing.assert_allclose(drawn["normal"], points["normal"], atol=2e-7)
    unit = points["tangent"] / np.linalg.norm(points["tangent"], axis=1, keepdims=True)
    np.testing.assert_allclose(drawn["tangent"], unit, atol=2e-7)


def test_more_points_than_one_draw_holds_are_drawn_in_turns(renderer, monkeypatch):
    monkeypatch.setattr(sys.modules["mrm_nodes.render.renderer"], "POINTS_PER_DRAW", 1000)
    hue = np.random.default_rng(2).random((2500, 3)).astype(np.float32)
    drawn = renderer.draw_points(pattern(GEOMPROP), {**random_points(2500), "hue": hue}, (0, 0, 5))
    assert (drawn["image"] == hue).all()


def test_points_shade_as_the_pixels_of_a_mesh_do(each_renderer, conductor):
    lights = [DirectionalLight((-1, -1, -2)), PointLight((2, 1, 4))]
    drawn = each_renderer.render(conductor, sphere(), Camera((0, 0, 3)), lights, (64, 64))
    points = {name: getattr(drawn, name)[drawn.mask] for name in ("position", "normal", "tangent")}
    again = each_renderer.draw_points(conductor, points, (0, 0, 3), lights)
    np.testing.assert_allclose(again["image"], drawn.image[drawn.mask], rtol=2e-4, atol=1e-6)


def test_shading_points_together_changes_no_bit(each_renderer, conductor, monkeypatch):
    assert sheet_stages(conductor.vertex, conductor.pixel) is not None
    lights, points = [DirectionalLight((-1, -1, -2))], random_points(5000)
    together = each_renderer.draw_points(conductor, points, (0, 0, 5), lights)
    monkeypatch.setattr(sys.modules["mrm_nodes.render.renderer"], "sheet_stages", lambda *stages: None)
    one_by_one = each_renderer.draw_points(conductor, points, (0, 0, 5), lights)
    for name, array in together.items():
        assert np.array_equal(array, one_by_one[name]), name


@pytest.mark.parametrize(
    ("graph", "type_", "expected"),
    [
        (
            '<input name="d" type="color3" value="0.25, 0.5, 0.75"/><image name="n" type="color3">'
            '<input name="default" type="color3" interfacename="d"/>',
            "color3",
            [0.25, 0.5, 0.75],
        ),
        (
            '<image name="n" type="float">'
            '<input name="default" type="float" value="50" unit="centimeter" unittype="distance"/>',
            "float",
            [0.5, 0.5, 0.5],
        ),
    ],
)
def test_without_a_file_the_default_counts_by_an_interface_and_in_a_unit_too(
    each_renderer, graph, type_, expected
):
    shader = pattern(graph + '<input name="file" type="filename" value=""/></image>', type_)
    np.testing.assert_allclose(each_renderer.render(shader, plane(), size=(8, 8)).image[4, 4], expected, 1e-6)


def test_points_can_read_an_image(renderer, corners):
    shader = pattern(IMAGE.format(file=corners, mode="clamp", texcoord=""))
    texcoord = np.array([(0.25, 0.75), (0.75, 0.75), (0.25, 0.25)])
    drawn = renderer.draw_points(shader, {**random_points(3), "texcoord_0": texcoord}, (0, 0, 5))
    assert drawn["image"].tolist() == [[1, 0, 0], [0, 1, 0], [0, 0, 1]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"hue": None}, "needs the attribute hue"),
        ({"position": None}, "the attribute position is missing"),
        ({"huge": np.zeros((4, 3))}, "has no attribute huge; known: .*hue"),
        ({"hue": np.zeros((4, 2))}, r"hue has shape \(4, 2\), not \(4, 3\)"),
        ({"hue": np.zeros((3, 3))}, r"hue has shape \(3, 3\), not \(4, 3\)"),
        ({"hue": np.full((4, 3), np.nan)}, "hue has values that are NaN or infinite"),
    ],
)
def test_wrong_point_data_is_refused(renderer, change, message):
    points = {**random_points(4), "hue": np.zeros((4, 3))} | change
    points = {name: data for name, data in points.items() if data is not None}
    with pytest.raises(MrmError, match=message):
        renderer.draw_points(pattern(GEOMPROP), points, (0, 0, 5))


# Errors --------------------------------------------------------------------------------------------


def test_a_compile_error_shows_the_message_and_the_line(each_renderer, lambert):
    broken = dataclasses.replace(lambert, pixel=lambert.pixel.replace("s_out.color +=", "s_out.colour +="))
    with pytest.raises(MrmError) as error:
        each_renderer.render(broken, plane(), size=(8, 8))
    text = str(error.value)
    assert "the pixel shader does not compile" in text and "`s_out.colour += " in text and "\n" not in text
    broken = dataclasses.replace(lambert, vertex=lambert.vertex.replace("u_worldMatrix *", "u_nothing *"))
    with pytest.raises(MrmError, match=r"the vertex shader does not compile: .*u_nothing.*in line \d+: `"):
        each_renderer.render(broken, plane(), size=(8, 8))


def test_a_link_error_is_told(renderer, lambert):
    broken = dataclasses.replace(
        lambert, vertex=lambert.vertex.replace("vec3 normalWorld;", "vec2 normalWorld;")
    )
    broken = dataclasses.replace(
        broken, vertex=broken.vertex.replace("vd.normalWorld = normalize(", "vd.normalWorld = vec2(")
    )
    with pytest.raises(MrmError, match=r"(?s)the shaders do not link: .*normalWorld|VertexData"):
        renderer.render(broken, plane(), size=(8, 8))


def test_another_target_is_refused(renderer, lambert):
    essl = dataclasses.replace(lambert, pixel="float nothing;")
    with pytest.raises(MrmError, match="generate it with target glsl"):
        renderer.render(essl, plane(), size=(8, 8))


@pytest.mark.parametrize("size", [(0, 10), (10, -1), (1 << 20, 10), (16384, 16384), (10,), "ab"])
def test_a_size_that_cannot_be_drawn_is_refused(renderer, lambert, size):
    with pytest.raises(MrmError, match="size"):
        renderer.render(lambert, plane(), size=size)


# The whole -----------------------------------------------------------------------------------------


def test_render_takes_names_and_texts(tmp_path):
    renderer_of("auto")
    file = tmp_path / "m.mtlx"
    file.write_text(f'<?xml version="1.0"?><materialx version="1.39">{LAMBERT}</materialx>')
    document = read_document(file)
    assert document.getNode("b") is not None
    drawn = render(
        material(LAMBERT),
        mesh="baluster",
        camera="frame:1,1,2",
        lights=["camera", "point:0,3,0"],
        size=(40, 60),
    )
    assert drawn.image.shape == (60, 40, 3) and drawn.image.max() > 0.1
    assert mrm_nodes.render(material(LAMBERT), lights="camera", size=(8, 8)).mask.any()


def test_the_probe_tells_what_works():
    reports = probe_backends()
    assert [report.backend for report in reports] == list(BACKENDS)
    for report in reports:
        if report.works:
            assert report.renderer and report.version and not report.reason
            assert get_context(report.backend).renderer == report.renderer
        else:
            assert report.backend not in REQUIRED, report
            assert report.reason and "apt-get install" in report.hint


def test_only_what_a_request_hangs_on_is_probed(monkeypatch):
    module = sys.modules["mrm_nodes.render.context"]
    probed = []

    def probe(backend, working):
        probed.append(backend)
        return BackendReport(backend, backend in working)

    for request, working, expected in (
        ("auto", "egl osmesa", ["egl"]),
        ("auto", "osmesa", ["egl", "osmesa"]),
        ("osmesa", "egl osmesa", ["osmesa"]),
        ("all", "egl osmesa", ["egl", "osmesa"]),
        ("glx", "egl osmesa", []),
    ):
        probed.clear()
        monkeypatch.setattr(module, "_probe", lambda backend, working=working: probe(backend, working))
        assert [each.backend for each in probe_backends(request)] == expected
        assert sorted(probed) == expected


def run_python(code, **environment):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)} | environment
    command = [sys.executable, "-c", textwrap.dedent(code)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)


def test_a_machine_without_egl_is_told_what_to_install():
    child = run_python(
        """
        from mrm_nodes.render.context import get_context, probe_backends
        from mrm_nodes.errors import MrmError
        report = probe_backends()[0]
        assert not report.works and report.reason and "libegl1" in report.hint, report
        try:
            get_context("egl")
        except MrmError as error:
            assert "libegl1 libgl1-mesa-dri" in str(error) and "\\n" not in str(error)
            print("told")
        """,
        __EGL_VENDOR_LIBRARY_FILENAMES="/nonexistent",
        GLCONTEXT_LINUX_LIBEGL="libNoSuchEGL.so.1",
    )
    assert child.stdout.strip() == "told", child.stderr


def test_auto_takes_the_first_backend_that_works(monkeypatch):
    works = get_context(renderer_of("auto").backend)
    module = sys.modules["mrm_nodes.render.context"]
    found = {"egl": "EGL lists no device", "osmesa": works}
    monkeypatch.setattr(module, "_cached", found.get)
    assert get_context("auto") is works
    found["osmesa"] = "libOSMesa is not installed"
    with pytest.raises(MrmError) as error:
        get_context("auto")
    text = str(error.value)
    assert "\n" not in text
    for part in ("no device", "libegl1 libgl1-mesa-dri", "libOSMesa is not installed", "libosmesa6"):
        assert part in text


def test_a_driver_that_crashes_is_reported():
    child = run_python(
        """
        import sys
        from mrm_nodes.render import context
        # A stand-in for the interpreter of the probe that dies as a driver does.
        context.sys.executable = "/bin/false"
        for report in context.probe_backends():
            assert not report.works and "ended the probe with status 1" in report.reason, report
        context.sys.executable = "/nonexistent/python"
        for report in context.probe_backends():
            assert not report.works and "could not run" in report.reason, report
        print("reported")
        """
    )
    assert child.stdout.strip() == "reported", child.stderr


def test_an_unknown_backend_is_refused():
    with pytest.raises(MrmError, match="unknown backend vulkan; known: auto, egl, osmesa"):
        get_context("vulkan")


def test_the_limits_are_known_whichever_context_is_current() -> None:
    renderer_of("auto")
    program = """
        from mrm_nodes.render import Renderer, get_context
        backend = get_context("auto").backend
        get_context(backend).run(lambda: None)
        print(Renderer(backend)._gl.ctx.info["GL_MAX_TEXTURE_SIZE"])
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True)
    assert int(done.stdout) > 0, done.stderr
