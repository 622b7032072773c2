"""Nothing that was drawn, uploaded or configured before changes a bit of what is drawn next."""

import dataclasses
import gc
import os
import random
import re

import MaterialX as mx
import numpy as np
import pytest

from mrm_nodes.bench.shader import bench_shaders
from mrm_nodes.errors import MrmError
from mrm_nodes.render import (
    BACKENDS,
    CameraLight,
    DirectionalLight,
    Mesh,
    PointLight,
    Renderer,
    plane,
    sphere,
    write_png,
)
from mrm_nodes.render.commonnames import common_names
from mrm_nodes.render.context import GLContext
from mrm_nodes.render.environment import Environment, find_environment
from mrm_nodes.render.gbuffer import Stages
from mrm_nodes.shadergen import generate_shader

REQUIRED = [name for name in os.environ.get("MRM_REQUIRE_BACKENDS", "").split(",") if name]


@pytest.fixture(params=BACKENDS)
def backend(request):
    try:
        Renderer(request.param)
    except MrmError as error:
        if request.param in REQUIRED:
            raise
        pytest.skip(str(error))
    return request.param


def shader_of(xml, **options):
    document = mx.createDocument()
    mx.readFromXmlString(document, f'<?xml version="1.0"?><materialx version="1.39">{xml}</materialx>')
    return generate_shader(document, **options)


def textured(file, surface="standard_surface", node="image", filter_="linear", more=""):
    """A surface whose colour is an image file; reduced, as drivers compile far less of it."""
    xml = f"""
  <{node} name="i" type="color3">
    <input name="file" type="filename" value="{file}"/>
    <input name="filtertype" type="string" value="{filter_}"/>
    <input name="default" type="color3" value="0.3, 0.6, 0.9"/>{more}
  </{node}>
  <{surface} name="s" type="surfaceshader"><input name="base_color" type="color3" nodename="i"/></{surface}>
  <surfacematerial name="m" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="s"/>
  </surfacematerial>"""
    return shader_of(xml, interface="reduced")


def picture(file, size=16, seed=0):
    """A picture of noise that is nowhere dark: light that comes from it is seen."""
    write_png(file, np.random.default_rng(seed).uniform(0.5, 1.0, (size, size, 3)))
    return file


def bits(drawn):
    """What a draw gave, to compare by its bits."""
    arrays = (
        drawn
        if isinstance(drawn, dict)
        else {
            name: getattr(drawn, name)
            for name in ("image", "position", "normal", "tangent", "texcoord", "mask")
        }
    )
    return {name: np.ascontiguousarray(array).tobytes() for name, array in arrays.items()}


@pytest.fixture
def subjects(tmp_path):
    """Draws of every kind, by name: each takes a renderer."""
    a, b = picture(tmp_path / "a.png", 16, 1), picture(tmp_path / "b.png", 8, 2)
    plain = shader_of("""
  <conductor_bsdf name="b" type="BSDF">
    <input name="roughness" type="vector2" value="0.3, 0.3"/>
  </conductor_bsdf>
  <surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="b"/></surface>
  <surfacematerial name="m" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="s"/>
  </surfacematerial>""")
    clamped = '<input name="uaddressmode" type="string" value="clamp"/>'
    by_a, by_b = textured(a), textured(b, filter_="closest", more=clamped)
    mrm = textured(a, "mrm_standard_surface", "tiledimage")
    shown = shader_of(
        f'<image name="n" type="color3"><input name="file" type="filename" value="{a}"/></image>'
        '<output name="o" type="color3" nodename="n"/>',
        element="o",
    )
    sky, studio = find_environment("sky", samples=4), find_environment("studio", samples=4)
    three = [DirectionalLight((-1, -2, -3)), CameraLight(), PointLight((2, 2, 2))]
    rng = np.random.default_rng(3)
    normal = rng.normal(size=(300, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    points = {"position": rng.normal(size=(300, 3)), "normal": normal, "tangent": normal[:, [1, 2, 0]]}
    mapped = {**points, "texcoord_0": rng.random((300, 2))}
    assert "uniform float b_weight" in plain.pixel
    eye, size = (0.0, 0.0, 5.0), (24, 24)
    return {
        "unlit, textured": lambda r: r.render(by_a, sphere(), size=size),
        "unlit, another texture": lambda r: r.render(by_b, sphere(), size=size),
        "unlit, our surface": lambda r: r.render(mrm, sphere(), size=size),
        "lit from behind": lambda r: r.render(by_a, plane(), None, [DirectionalLight((0, 0, 1))], size),
        "one light": lambda r: r.render(by_a, plane(), None, [CameraLight()], size),
        "three lights": lambda r: r.render(by_a, sphere(), None, three, size),
        "another size": lambda r: r.render(mrm, sphere(), None, three, (40, 17)),
        "a value": lambda r: r.render(plain, sphere(), None, three, size, {"b_weight": 0.25}),
        "sky": lambda r: r.render(by_b, sphere(), None, three, size, None, sky),
        "studio": lambda r: r.render(by_a, sphere(), None, (), size, None, studio),
        "untextured": lambda r: r.render(plain, sphere(), None, three, size),
        "untextured, sky": lambda r: r.render(plain, plane(), None, (), size, None, sky),
        "points": lambda r: r.draw_points(plain, points, eye, three),
        "points, sky": lambda r: r.draw_points(plain, points, eye, (), None, sky),
        "points, textured": lambda r: r.draw_points(by_a, mapped, eye, three),
        "points, textured, unlit": lambda r: r.draw_points(by_b, mapped, eye),
        "points, an image": lambda r: r.draw_points(shown, mapped, eye),
    }


def test_without_light_a_texture_is_black_the_first_time_too(backend, tmp_path):
    for surface in ("standard_surface", "mrm_standard_surface"):
        shader = textured(picture(tmp_path / f"{surface}.png"), surface)
        renderer = Renderer(backend)
        # MaterialX's own light from behind is not quite 0.
        for lights, most in (((), 0.0), ((), 0.0), ([DirectionalLight((0, 0, 1))], 1e-7)):
            drawn = renderer.render(shader, plane(), lights=lights, size=(16, 16))
            assert drawn.mask.any() and drawn.image.max() <= most
        assert renderer.render(shader, plane(), lights=[CameraLight()], size=(16, 16)).image.max() > 0.02


def test_a_draw_has_the_same_bits_alone_and_after_any_other(backend, subjects):
    alone = {name: bits(draw(Renderer(backend))) for name, draw in subjects.items()}
    for name in ("one light", "sky", "points", "points, textured", "points, an image"):
        assert any(alone[name]["image"])
    rng, renderer = random.Random(1), Renderer(backend)
    order = [name for _ in range(6) for name in rng.sample(sorted(subjects), len(subjects))]
    for before, name in zip(["nothing", *order], order, strict=False):
        assert bits(subjects[name](renderer)) == alone[name], f"{name}, after {before}"


def test_draws_of_two_renderers_and_backends_do_not_disturb_each_other(subjects):
    try:
        renderers = [Renderer(name) for name in (*BACKENDS, *BACKENDS)]
    except MrmError as error:
        if set(REQUIRED) >= set(BACKENDS):
            raise
        pytest.skip(str(error))
    alone = {
        (name, backend): bits(draw(Renderer(backend)))
        for name, draw in subjects.items()
        for backend in BACKENDS
    }
    rng = random.Random(2)
    for name in rng.sample(sorted(subjects), len(subjects)):
        for renderer in rng.sample(renderers, len(renderers)):
            assert bits(subjects[name](renderer)) == alone[name, renderer.backend], name


def test_what_others_left_in_the_context_changes_nothing(backend, subjects):
    renderer = Renderer(backend)
    alone = {name: bits(draw(renderer)) for name, draw in subjects.items()}
    gl = renderer._gl

    def spoil():
        ctx = gl.ctx
        bright = ctx.texture((2, 2), 4, np.ones(16, np.float32), dtype="f4")
        for unit in range(ctx.max_texture_units):
            bright.use(unit)
        other = ctx.framebuffer([bright])
        other.scissor = (0, 0, 1, 1)
        other.use()
        ctx.enable_only(ctx.BLEND | ctx.CULL_FACE)
        ctx.blend_func = ctx.ONE, ctx.ONE
        ctx.wireframe = True
        ctx.front_face = "cw"
        ctx.depth_func = ">"
        ctx.point_size = 7.0
        ctx.polygon_offset = 3.0, 3.0
        return other, bright

    for name, draw in subjects.items():
        left = gl.run(spoil)
        assert bits(draw(renderer)) == alone[name], name
        gl.run(lambda left=left: [item.release() for item in left])


def test_a_changed_image_is_read_anew_although_its_times_are_the_same(backend, tmp_path):
    file, renderer = tmp_path / "a.ppm", Renderer(backend)
    shader = shader_of(
        f'<image name="n" type="color3"><input name="file" type="filename" value="{file}"/></image>'
        '<output name="o" type="color3" nodename="n"/>',
        element="o",
    )
    for color in ((255, 0, 0), (0, 255, 0), (255, 0, 0)):
        file.write_bytes(b"P6 2 2 255\n" + bytes(color) * 4)
        os.utime(file, ns=(0, 0))
        drawn = renderer.render(shader, plane(), size=(8, 8))
        assert (drawn.image[4, 4] * 255 == color).all()


def test_environments_and_meshes_that_come_and_go_are_not_taken_for_each_other(backend):
    renderer = Renderer(backend)
    shader = shader_of("""
  <oren_nayar_diffuse_bsdf name="b" type="BSDF">
    <input name="color" type="color3" value="1, 1, 1"/>
  </oren_nayar_diffuse_bsdf>
  <surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="b"/></surface>
  <surfacematerial name="m" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="s"/>
  </surfacematerial>""")
    for i in range(12):
        around = Environment(np.full((4, 8, 3), 0.25 * (i % 5), np.float32), samples=1)
        mesh: Mesh = dataclasses.replace(plane(), positions=plane().positions + np.float32([0, 0, i % 3]))
        drawn = renderer.render(shader, mesh, size=(8, 8), environment=around)
        np.testing.assert_allclose(drawn.image[4, 4], 0.25 * (i % 5), rtol=1e-3)
        assert drawn.position[4, 4, 2] == i % 3
        del around, mesh, drawn
        gc.collect()


def test_the_check_before_each_draw_sees_a_texture_on_the_wrong_unit(backend, tmp_path, monkeypatch):
    shader, renderer = textured(picture(tmp_path / "a.png")), Renderer(backend)
    renderer.render(shader, plane(), size=(8, 8))
    bind = GLContext.bind

    def bind_and_upload(gl, samplers, program):
        bind(gl, samplers, program)
        gl.ctx.texture((1, 1), 4, bytes(4)).use(0)

    monkeypatch.setattr(GLContext, "bind", bind_and_upload)
    with pytest.raises(AssertionError, match=r"before a draw: \w+ is \(\d+,\), not"):
        renderer.render(shader, plane(), size=(8, 8))


def test_the_check_before_each_draw_sees_state_that_is_left_on(backend, tmp_path, monkeypatch):
    shader, renderer = textured(picture(tmp_path / "a.png")), Renderer(backend)
    bind = GLContext.bind

    def bind_and_blend(gl, samplers, program):
        bind(gl, samplers, program)
        gl.ctx.enable(gl.ctx.BLEND)

    monkeypatch.setattr(GLContext, "bind", bind_and_blend)
    with pytest.raises(AssertionError, match=r"GL_BLEND is \(1,\), not \(0,\)"):
        renderer.render(shader, plane(), size=(8, 8))


def test_the_check_before_each_draw_sees_that_a_call_before_it_failed(backend, tmp_path):
    """What moderngl does where the bound framebuffer was released: it binds it again."""
    shader, renderer = textured(picture(tmp_path / "a.png")), Renderer(backend)
    gl = renderer._gl

    def spoil():
        target = gl.ctx.framebuffer([gl.ctx.texture((4, 4), 4, dtype="f4")])
        target.use()
        target.release()

    gl.run(spoil)
    with pytest.raises(AssertionError, match="an earlier call to OpenGL failed"):
        renderer.render(shader, plane(), size=(8, 8))
    renderer.render(shader, plane(), size=(8, 8))


def test_the_bench_leaves_nothing_in_the_context(backend, tmp_path):
    rows = bench_shaders(
        backend, 8, 1, ["mrm_conductor_bsdf"], ["direct"], interfaces=["reduced"], films=[False]
    )
    assert list(rows)
    renderer = Renderer(backend)
    renderer.render(textured(picture(tmp_path / "a.png")), plane(), size=(8, 8))


def test_more_images_than_the_driver_reads_are_refused(backend, tmp_path):
    renderer = Renderer(backend)
    count = renderer._gl.upload_unit + 1
    nodes = "".join(
        f'<image name="i{i}" type="color3"><input name="file" type="filename" '
        f'value="{picture(tmp_path / f"{i}.png", 2, i)}"/></image>'
        for i in range(count)
    )
    sums = "".join(
        f'<add name="a{i}" type="color3"><input name="in1" type="color3" nodename="{f"a{i - 1}" if i else "i0"}"/>'
        f'<input name="in2" type="color3" nodename="i{i}"/></add>'
        for i in range(count)
    )
    shader = shader_of(f'{nodes}{sums}<output name="o" type="color3" nodename="a{count - 1}"/>', element="o")
    with pytest.raises(MrmError, match=rf"{count} images, but this driver reads {count - 1} at once"):
        renderer.render(shader, plane(), size=(8, 8))


def exported(suffix, blue=0.3, between=()):
    """A material as an exporter writes one from a template: names of its own, and a value."""
    chain = [f"color_{suffix}", *between]
    nodes = "".join(
        f'''
  <multiply name="{name}" type="color3">
    <input name="in1" type="color3" {f'nodename="{before}"' if before else f'value="0.8, 0.5, {blue}"'}/>
    <input name="in2" type="float" value="0.9"/>
  </multiply>'''
        for before, name in zip(["", *chain], chain, strict=False)
    )
    return shader_of(f"""{nodes}
  <oren_nayar_diffuse_bsdf name="BSDF_{suffix}" type="BSDF">
    <input name="color" type="color3" nodename="{chain[-1]}"/>
  </oren_nayar_diffuse_bsdf>
  <surface name="SR_{suffix}" type="surfaceshader">
    <input name="bsdf" type="BSDF" nodename="BSDF_{suffix}"/>
  </surface>
  <surfacematerial name="{suffix}" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="SR_{suffix}"/>
  </surfacematerial>""")


def test_materials_that_differ_in_names_and_values_share_a_program(backend):
    light = [DirectionalLight(direction=(0.1, -0.2, -1.0))]
    with Renderer(backend) as shared:
        for number, name in enumerate(["a", "b", "mrm_conductor_bsdf_00001"]):
            shader = exported(name, blue=0.1 * number)
            drawn = shared.render(shader, sphere(), lights=light, size=(24, 24))
            with Renderer(backend) as alone:
                assert bits(alone.render(shader, sphere(), lights=light, size=(24, 24))) == bits(drawn)
        # The values are found by the names of each document.
        by_path, by_name = (
            shared.render(exported("b"), sphere(), lights=light, size=(24, 24), uniforms={name: 0.7})
            for name in ("BSDF_b/roughness", "BSDF_b_roughness")
        )
        assert bits(by_path) == bits(by_name) != bits(drawn)
        assert len(list(shared._kept.programs)) == 1


def test_common_names_change_no_bit(monkeypatch):
    """Nor do names of GLSL's and MaterialX's own, of ours, and those that stand in their place."""
    names = [
        "vd",
        "BSDF_a_out",
        "mx_square",
        "color",
        "N",
        "V",
        "u_time",
        "mrm_position",
        "out1",
        "fd",
        "lightShader",
    ]
    light = [DirectionalLight(direction=(0.1, -0.2, -1.0))]
    for shader in (exported("a", between=names), exported("a", between=[*names, "mrm_name_0"])):
        with Renderer("auto") as renderer:
            drawn = renderer.render(shader, sphere(), lights=light, size=(8, 8))
        with monkeypatch.context() as unchanged, Renderer("auto") as renderer:
            unchanged.setattr("mrm_nodes.render.renderer.common_names", lambda stages: (stages, {}))
            assert bits(renderer.render(shader, sphere(), lights=light, size=(8, 8))) == bits(drawn)
        assert drawn.image.max() > 0.01


def test_only_names_of_main_alone_are_replaced():
    text = """uniform float read_in1;
uniform float own_in1;
float other() { return read_in1; }
void mrm_materialx_main()
{
    {
        float other = 0.5;
    }
    float other_out = own_in1 * other() * read_in1;
    out1 = vec4(vd.own_in1, other_out, 0.0, 1.0);
}
"""
    stages, names = common_names(Stages("void main() { }", text))
    own = {"own_in1": "mrm_name_0", "other_out": "mrm_name_1"}
    assert names == {common: name for name, common in own.items()}
    for name, common in own.items():
        text = re.sub(rf"(?<![.\w]){name}\b", common, text)
    assert stages.pixel == text


def test_a_compiler_complains_of_the_documents_names():
    shader = exported("a")
    wrong = dataclasses.replace(shader, pixel=shader.pixel.replace("= SR_a_out;", "= SR_a_out.colour;"))
    with Renderer("auto") as renderer, pytest.raises(MrmError, match=r"= SR_a_out\.colour;`"):
        renderer.render(wrong, sphere())
