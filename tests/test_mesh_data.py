"""What a file's vertices carry reaches the shader; what does not is named."""

import json
import warnings
from pathlib import Path

import MaterialX as mx
import numpy as np
import pytest
from gltf_writer import SQUARE, data_uri, gltf_of, write_chunks, write_glb

from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.render import BACKENDS, Camera, load_mesh, plane
from mrm_nodes.render.meshfile import mesh_files
from mrm_nodes.shadergen import generate_shader

CASES = Path(__file__).resolve().parents[2] / "shared" / "cases"
FRONT = Camera((0.5, 0.5, 3.0), (0.5, 0.5, 0.0))
"""Sees the unit square of SQUARE in the middle of the picture."""


@pytest.fixture(scope="module", params=BACKENDS)
def renderer(request):
    from test_render_gl import renderer_of

    return renderer_of(request.param)


@pytest.fixture
def file(tmp_path):
    return tmp_path / "m.glb"


def quietly(path):
    """A mesh that is read without a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return load_mesh(path)


def shown(nodes, kind):
    """A shader that shows node n."""
    document = mx.createDocument()
    output = f'<output name="out" type="{kind}" nodename="n"/>'
    mx.readFromXmlString(
        document, f'<?xml version="1.0"?><materialx version="1.39">{nodes}{output}</materialx>'
    )
    return generate_shader(document, element="out")


def seen(renderer, mesh, nodes, kind):
    """What node n is in the middle of the square: alpha is shown as red."""
    if kind == "color4":
        nodes += '<extract name="a" type="float"><input name="in" type="color4" nodename="n"/>'
        nodes += '<input name="index" type="integer" value="3"/></extract>'
        nodes = nodes.replace('name="n"', 'name="c"').replace('nodename="n"', 'nodename="c"')
        nodes = nodes.replace('name="a"', 'name="n"')
        kind = "float"
    picture = renderer.render(shown(nodes, kind), mesh, FRONT, size=(9, 9))
    assert picture.mask[4, 4]
    return picture.image[4, 4]


def geomcolor(kind, index=0):
    return (
        f'<geomcolor name="n" type="{kind}"><input name="index" type="integer" value="{index}"/></geomcolor>'
    )


def texcoord(index):
    return (
        f'<texcoord name="n" type="vector2"><input name="index" type="integer" value="{index}"/></texcoord>'
    )


def geomprop(name, kind):
    named = f'<input name="geomprop" type="string" value="{name}"/>'
    return f'<geompropvalue name="n" type="{kind}">{named}</geompropvalue>'


# Vertex colours ---------------------------------------------------------------------------------------

COLORS = {
    "float vec4": ([(1.0, 0.4, 0.2, 0.6)] * 4, (1.0, 0.4, 0.2, 0.6)),
    "float vec3": ([(1.0, 0.4, 0.2)] * 4, (1.0, 0.4, 0.2, 1.0)),
    "u8 vec4": (np.array([(255, 102, 51, 153)] * 4, "u1"), (1.0, 0.4, 0.2, 0.6)),
    "u8 vec3": (np.array([(255, 102, 51)] * 4, "u1"), (1.0, 0.4, 0.2, 1.0)),
    "u16 vec4": (np.array([(65535, 26214, 13107, 39321)] * 4, "<u2"), (1.0, 0.4, 0.2, 0.6)),
    "u16 vec3": (np.array([(65535, 26214, 13107)] * 4, "<u2"), (1.0, 0.4, 0.2, 1.0)),
}


@pytest.mark.parametrize("name", COLORS)
def test_vertex_colours_reach_geomcolor_in_every_format(renderer, file, name):
    given, expected = COLORS[name]
    write_glb(file, [[SQUARE | {"COLOR_0": given}]])
    mesh = quietly(file)
    np.testing.assert_allclose(seen(renderer, mesh, geomcolor("color3"), "color3"), expected[:3], atol=1e-6)
    np.testing.assert_allclose(seen(renderer, mesh, geomcolor("float"), "float"), expected[0], atol=1e-6)
    np.testing.assert_allclose(seen(renderer, mesh, geomcolor("color4"), "color4"), expected[3], atol=1e-6)


def test_a_second_set_of_colours_has_index_1(renderer, file):
    write_glb(file, [[SQUARE | {"COLOR_0": [(1, 1, 1)] * 4, "COLOR_1": [(0.2, 0.4, 0.6)] * 4}]])
    image = seen(renderer, quietly(file), geomcolor("color3", 1), "color3")
    np.testing.assert_allclose(image, (0.2, 0.4, 0.6), atol=1e-6)


def test_a_primitive_without_colours_is_white_beside_one_that_has_them(file):
    write_glb(file, [[SQUARE | {"COLOR_0": [(1, 0, 0)] * 4}, SQUARE]])
    np.testing.assert_array_equal(quietly(file).colors, [(1, 0, 0, 1)] * 4 + [(1, 1, 1, 1)] * 4)


@pytest.mark.parametrize(
    ("vertex", "expected"),
    [
        ("v {} {} 0 0.2 0.4 0.6", (0.2, 0.4, 0.6, 1.0)),
        ("v {} {} 0 0.2 0.4 0.6 0.8", (0.2, 0.4, 0.6, 0.8)),
        ("v {} {} 0 1.0", None),
    ],
)
def test_vertex_colours_of_an_obj_are_read(tmp_path, vertex, expected):
    places = [(0, 0), (1, 0), (1, 1), (0, 1)]
    lines = [vertex.format(*place) for place in places] + [f"vt {u} {v}" for u, v in places]
    (tmp_path / "m.obj").write_text("\n".join([*lines, "vn 0 0 1", "f 1/1/1 2/2/1 3/3/1 4/4/1"]))
    mesh = quietly(tmp_path / "m.obj")
    if expected is None:
        assert mesh.colors is None
    else:
        np.testing.assert_allclose(mesh.colors, np.tile(expected, (4, 1)), atol=1e-7)


def test_colours_that_a_mesh_does_not_have_are_named(renderer):
    for _ in range(2):
        with pytest.warns(MrmWarning, match="mesh plane has no vertex colours .* white"):
            picture = renderer.render(shown(geomcolor("color3"), "color3"), plane(), size=(5, 5))
        assert (picture.image[2, 2] == 1.0).all()


# Further sets of texture coordinates, and other attributes ---------------------------------------------


def test_a_second_set_of_texture_coordinates_has_index_1(renderer, file):
    write_glb(file, [[SQUARE | {"TEXCOORD_1": [(0.75, 0.25)] * 4}]])
    mesh = quietly(file)
    for nodes in (texcoord(1), geomprop("UV1", "vector2")):
        np.testing.assert_allclose(seen(renderer, mesh, nodes, "vector2")[:2], (0.75, 0.75), atol=1e-6)
    for nodes in (texcoord(0), geomprop("UV0", "vector2"), geomprop("st", "vector2")):
        np.testing.assert_allclose(seen(renderer, mesh, nodes, "vector2")[:2], (0.5, 0.5), atol=0.06)


def test_a_set_that_part_of_the_mesh_lacks_is_named(file):
    write_glb(file, [[SQUARE | {"TEXCOORD_1": [(0.75, 0.25)] * 4}, SQUARE]])
    with pytest.warns(MrmWarning, match=r"m\.glb: part of the mesh has no texcoord_1"):
        mesh = load_mesh(file)
    np.testing.assert_array_equal(mesh.sets["texcoord_1"][4:], 0.0)


def test_a_set_that_the_mesh_lacks_is_a_line(renderer, file):
    write_glb(file, [[SQUARE]])
    with pytest.raises(MrmError, match="has no vertex data texcoord_1"):
        seen(renderer, quietly(file), texcoord(1), "vector2")


def test_attributes_of_an_application_are_geometric_properties(renderer, file):
    write_glb(file, [[SQUARE | {"_WEAR": [(0.3, 0.6, 0.9)] * 4}]])
    mesh = quietly(file)
    for name in ("_WEAR", "WEAR"):
        image = seen(renderer, mesh, geomprop(name, "vector3"), "vector3")
        np.testing.assert_allclose(image, (0.3, 0.6, 0.9), atol=1e-6)


def test_an_attribute_that_is_not_read_is_named(file):
    write_glb(file, [[SQUARE | {"FEATURE_ID_0": [(1, 2)] * 4}]])
    with pytest.warns(MrmWarning, match=r"m\.glb: its vertex attribute FEATURE_ID_0 is not read"):
        load_mesh(file)


# Tangents and bitangents ------------------------------------------------------------------------------

BITANGENT = {
    "world": '<bitangent name="n" type="vector3"><input name="space" type="string" value="world"/></bitangent>',
    "object": '<bitangent name="n" type="vector3"><input name="space" type="string" value="object"/></bitangent>',
    "normalmap": """
      <constant name="c" type="vector3"><input name="value" type="vector3" value="0.5, 1, 0.5"/></constant>
      <normalmap name="n" type="vector3"><input name="in" type="vector3" nodename="c"/></normalmap>""",
}
MIRRORED = {"TEXCOORD_0": [(1, 1), (0, 1), (0, 0), (1, 0)]}
UPRIGHT = {"TEXCOORD_0": [(0, 1), (1, 1), (1, 0), (0, 0)]}


@pytest.mark.parametrize("name", BITANGENT)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_tangent_w_turns_the_bitangent(renderer, file, name, sign):
    write_glb(file, [[SQUARE | UPRIGHT | {"TANGENT": [(1, 0, 0, sign)] * 4}]])
    image = seen(renderer, quietly(file), BITANGENT[name], "vector3")
    np.testing.assert_allclose(image, (0, sign, 0), atol=1e-6)


@pytest.mark.parametrize("scale", [(-1, 1, 1), (1, -2, 1), (1, 1, -3), (-1, -1, -1), (2, 3, 4)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_mirroring_node_keeps_the_bitangent_on_its_side(file, scale, sign):
    square = SQUARE | UPRIGHT | {"TANGENT": [(0.6, 0.8, 0, sign)] * 4}
    write_glb(file, [[square]], [{"mesh": 0, "scale": scale}])
    mesh = quietly(file)
    scale = np.array(scale, float)
    # The bitangent of the file, moved as a direction on the surface.
    expected = sign * np.cross((0, 0, 1), (0.6, 0.8, 0)) * scale
    signs = 1.0 if mesh.bitangent_signs is None else mesh.bitangent_signs
    made = np.cross(mesh.normals, mesh.tangents) * signs
    assert (np.sum(made * expected, axis=1) > 0).all()
    np.testing.assert_allclose(mesh.normals, np.tile((0, 0, np.sign(scale[2])), (4, 1)), atol=1e-6)
    a, b, c = np.moveaxis(mesh.positions[mesh.indices], 1, 0)
    assert (np.sum(np.cross(b - a, c - a) * mesh.normals[0], axis=1) > 0).all()


def test_normals_are_perpendicular_after_a_scale_that_differs_by_axis(file):
    slope = {
        "POSITION": [(0, 0, 0), (1, 0, 1), (1, 1, 1), (0, 1, 0)],
        "NORMAL": [(-(0.5**0.5), 0, 0.5**0.5)] * 4,
        "TANGENT": [(0.5**0.5, 0, 0.5**0.5, 1)] * 4,
    }
    write_glb(file, [[SQUARE | slope]], [{"mesh": 0, "scale": [1, 1, 5], "rotation": [0, 0, 1, 0]}])
    mesh = quietly(file)
    a, b, c = mesh.positions[mesh.indices[0]].astype(float)
    flat = np.cross(b - a, c - a)
    np.testing.assert_allclose(mesh.normals, np.tile(flat / np.linalg.norm(flat), (4, 1)), atol=1e-6)
    along = (b - a) / np.linalg.norm(b - a)
    np.testing.assert_allclose(mesh.tangents, np.tile(along, (4, 1)), atol=1e-6)


@pytest.mark.parametrize(("uv", "tangent", "up"), [(UPRIGHT, (1, 0, 0), 1.0), (MIRRORED, (-1, 0, 0), 1.0)])
def test_without_tangents_the_bitangent_follows_the_texture(renderer, file, uv, tangent, up):
    write_glb(file, [[SQUARE | uv]])
    mesh = quietly(file)
    np.testing.assert_allclose(mesh.tangents, np.tile(tangent, (4, 1)), atol=1e-6)
    np.testing.assert_allclose(seen(renderer, mesh, BITANGENT["normalmap"], "vector3"), (0, up, 0), atol=1e-6)


def test_a_seam_between_a_texture_and_its_mirror_image_has_both_tangents(file):
    positions = [(-1, 0, 0), (0, 0, 0), (1, 0, 0), (-1, 1, 0), (0, 1, 0), (1, 1, 0)]
    uv = [(1, 1), (0, 1), (1, 1), (1, 0), (0, 0), (1, 0)]
    half = {"POSITION": positions, "NORMAL": [(0, 0, 1)] * 6, "TEXCOORD_0": uv}
    write_glb(file, [[half | {"indices": [0, 1, 4, 0, 4, 3, 1, 2, 5, 1, 5, 4]}]])
    mesh = quietly(file)
    middles = mesh.positions[mesh.indices].mean(axis=1)
    for middle, triangle in zip(middles, mesh.indices, strict=True):
        side = np.sign(middle[0])
        np.testing.assert_allclose(mesh.tangents[triangle], np.tile((side, 0, 0), (3, 1)), atol=1e-6)
        np.testing.assert_array_equal(mesh.bitangent_signs[triangle], side)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 0.0])
def test_spoilt_tangents_and_normals_are_made_as_missing_ones_are(file, bad):
    good = SQUARE | UPRIGHT
    spoilt = [(bad, bad, bad, 1)] + [(1, 0, 0, 1)] * 3
    write_glb(file, [[good | {"TANGENT": spoilt}]])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore" if bad else "error")
        mesh = load_mesh(file)
    np.testing.assert_allclose(mesh.tangents, np.tile((1, 0, 0), (4, 1)), atol=1e-6)
    write_glb(file, [[good | {"NORMAL": [(0, 0, 1)] * 3 + [(bad, bad, bad)]}]])
    with pytest.warns(MrmWarning, match="part of the mesh has no normals; made some"):
        mesh = load_mesh(file)
    np.testing.assert_allclose(mesh.normals, np.tile((0, 0, 1), (len(mesh.positions), 1)), atol=1e-6)


def test_faces_of_an_obj_without_normals_or_texture_coordinates_get_some(tmp_path):
    (tmp_path / "m.obj").write_text(
        "v -1 1 1\nv 1 1 1\nv -1 1 -1\nv -1 -1 1\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\nf 3 4 1\n"
    )
    with pytest.warns(MrmWarning) as caught:
        mesh = load_mesh(tmp_path / "m.obj")
    texts = [str(each.message).rpartition(": ")[2] for each in caught]
    assert texts == [
        "the mesh has no normals; made some",
        "part of the mesh has no texture coordinates; made some",
    ]
    a, b, c = np.moveaxis(mesh.positions[mesh.indices].astype(float), 1, 0)
    flat = np.cross(b - a, c - a)
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    for corner in range(3):
        np.testing.assert_allclose(mesh.normals[mesh.indices[:, corner]], flat, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(mesh.tangents, axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(mesh.tangents[mesh.indices[0]], np.tile((1, 0, 0), (3, 1)), atol=1e-6)


# Triangles --------------------------------------------------------------------------------------------

LADDER = [(0, 0, 0), (0, 1, 0), (1, 0, 0), (1, 1, 0), (2, 0, 0), (2, 1, 0)]
FAN = [(0, 0, 0), (2, 0, 0), (2, 1, 0), (1, 1.5, 0), (0, 1, 0)]


@pytest.mark.parametrize(
    ("mode", "positions", "area"),
    [(5, [(x, y, 0) for x, y, _ in LADDER], 2.0), (6, FAN, 2.5)],
)
@pytest.mark.parametrize("indices", [None, "u1", "<u2", "<u4"])
def test_strips_and_fans_are_drawn_beside_triangles(file, mode, positions, area, indices):
    count = len(positions)
    if mode == 5:
        # A strip turns the other way: its corners run downwards first.
        positions = [(x, 1 - y, z) for x, y, z in positions]
    primitive = {
        "POSITION": positions,
        "NORMAL": [(0, 0, 1)] * count,
        "TEXCOORD_0": [(x, y) for x, y, _ in positions],
        "mode": mode,
    }
    if indices:
        primitive["indices"] = np.arange(count).astype(indices)
    write_glb(file, [[SQUARE, primitive]])
    mesh = quietly(file)
    assert len(mesh.indices) == 2 + count - 2
    a, b, c = np.moveaxis(mesh.positions[mesh.indices].astype(float), 1, 0)
    areas = np.cross(b - a, c - a)[:, 2] / 2.0
    assert (areas > 0).all() and areas[2:].sum() == pytest.approx(area)


@pytest.mark.parametrize("mode", [0, 1, 2, 3])
def test_points_and_lines_are_named(file, mode):
    write_glb(file, [[SQUARE, SQUARE | {"mode": mode}]])
    with pytest.warns(MrmWarning, match=r"m\.glb: its points and lines are not drawn"):
        assert len(load_mesh(file).indices) == 2


def test_skins_morph_targets_and_other_scenes_are_named(file):
    rigged = SQUARE | {"JOINTS_0": np.zeros((4, 4), "u1"), "WEIGHTS_0": [(1, 0, 0, 0)] * 4}
    gltf, data = gltf_of([[rigged | {"targets": [{"POSITION": 0}]}], [SQUARE]])
    gltf["nodes"][0]["skin"] = 0
    gltf |= {"scenes": [{"nodes": [1]}, {"nodes": [0]}], "scene": 1}
    write_chunks(file, gltf, data)
    with pytest.warns(MrmWarning) as caught:
        assert len(load_mesh(file).positions) == 4
    assert {str(each.message).rpartition("m.glb: ")[2] for each in caught} == {
        "has 2 scenes; scene 1 is drawn",
        "its skin (JOINTS_0, WEIGHTS_0) is not applied",
        "its morph targets are not applied",
    }


# How a file stores it ---------------------------------------------------------------------------------


def test_interleaved_attributes_are_read(file):
    gltf, _ = gltf_of([[SQUARE]])
    rows = np.zeros(4, [("p", "<f4", 3), ("n", "<f4", 3), ("uv", "<f4", 2)])
    rows["p"], rows["n"], rows["uv"] = SQUARE["POSITION"], SQUARE["NORMAL"], SQUARE["TEXCOORD_0"]
    data = rows.tobytes() + np.array(SQUARE["indices"], "<u2").tobytes()
    gltf["bufferViews"] = [
        {"buffer": 0, "byteLength": 128, "byteStride": 32},
        {"buffer": 0, "byteOffset": 128, "byteLength": 12},
    ]
    by_name = gltf["meshes"][0]["primitives"][0]["attributes"]
    for name, offset in (("POSITION", 0), ("NORMAL", 12), ("TEXCOORD_0", 24)):
        gltf["accessors"][by_name[name]] |= {"bufferView": 0, "byteOffset": offset}
    gltf["accessors"][gltf["meshes"][0]["primitives"][0]["indices"]]["bufferView"] = 1
    gltf["buffers"] = [{"byteLength": len(data)}]
    write_chunks(file, gltf, data)
    np.testing.assert_array_equal(quietly(file).positions, SQUARE["POSITION"])


@pytest.mark.parametrize("based", [True, False])
def test_sparse_accessors_are_read(file, based):
    gltf, data = gltf_of([[SQUARE]])
    place = np.array([2], "<u2").tobytes() + b"\0\0"
    new = np.array([(3, 3, 0)], "<f4").tobytes()
    gltf["bufferViews"] += [
        {"buffer": 0, "byteOffset": len(data), "byteLength": 2},
        {"buffer": 0, "byteOffset": len(data) + 4, "byteLength": 12},
    ]
    position = gltf["accessors"][gltf["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    views = len(gltf["bufferViews"])
    position["sparse"] = {
        "count": 1,
        "indices": {"bufferView": views - 2, "componentType": 5123},
        "values": {"bufferView": views - 1},
    }
    if not based:
        del position["bufferView"]
    gltf["buffers"] = [{"byteLength": len(data + place + new)}]
    write_chunks(file, gltf, data + place + new)
    expected = np.array(SQUARE["POSITION"], float) * based
    expected[2] = (3, 3, 0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        np.testing.assert_array_equal(load_mesh(file).positions, expected)


def test_quantized_vertices_are_read(file):
    """KHR_mesh_quantization."""
    quantized = SQUARE | {"TEXCOORD_0": np.array([(0, 0), (255, 0), (255, 255), (0, 255)], "u1")}
    quantized["NORMAL"] = np.array([(0, 0, 127)] * 4, "i1")
    quantized["POSITION"] = np.array(np.array(SQUARE["POSITION"]) * 1000, "<i2")
    gltf, data = gltf_of([[quantized]], extensionsRequired=["KHR_mesh_quantization"])
    del gltf["accessors"][gltf["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]["normalized"]
    gltf["nodes"] = [{"mesh": 0, "scale": [0.001] * 3}]
    write_chunks(file, gltf, data)
    mesh = quietly(file)
    np.testing.assert_allclose(mesh.positions, SQUARE["POSITION"], atol=1e-6)
    np.testing.assert_allclose(mesh.texcoords, np.array(SQUARE["TEXCOORD_0"]) * (1, -1) + (0, 1), atol=1e-6)


@pytest.mark.parametrize("stored", ["data URI", "file", "escaped name"])
def test_a_gltf_is_read_with_its_buffers(tmp_path, stored):
    gltf, data = gltf_of([[SQUARE]])
    name = {"file": "m.bin", "escaped name": "sub/a b.bin"}.get(stored)
    if name:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(data)
        gltf["buffers"][0]["uri"] = name.replace(" ", "%20")
    else:
        gltf["buffers"][0]["uri"] = data_uri(data)
    (tmp_path / "m.gltf").write_text("\ufeff" + json.dumps(gltf), encoding="utf-8")
    np.testing.assert_array_equal(quietly(tmp_path / "m.gltf").positions, SQUARE["POSITION"])
    assert mesh_files(tmp_path / "m.gltf") == [tmp_path / "m.gltf", *([tmp_path / name] if name else [])]


@pytest.mark.parametrize("uri", ["../m.bin", "/dev/zero", "%2e%2e/m.bin", "link.bin", "http://host/m.bin"])
def test_buffers_outside_of_the_folder_are_refused(tmp_path, uri):
    gltf, data = gltf_of([[SQUARE]])
    (tmp_path / "m.bin").write_bytes(data)
    inner = tmp_path / "inner"
    inner.mkdir()
    (inner / "link.bin").symlink_to(tmp_path / "m.bin")
    gltf["buffers"][0]["uri"] = uri
    (inner / "m.gltf").write_text(json.dumps(gltf))
    with pytest.raises(MrmError, match=r"m\.gltf: its data, .*, lies outside of its folder"):
        load_mesh(inner / "m.gltf")


@pytest.mark.parametrize("extension", ["KHR_draco_mesh_compression", "EXT_meshopt_compression"])
@pytest.mark.parametrize("required", [True, False])
def test_compressed_geometry_is_refused_by_name(file, extension, required):
    gltf, data = gltf_of([[SQUARE]], extensionsUsed=[extension])
    if required:
        gltf["extensionsRequired"] = [extension]
    if "draco" in extension:
        gltf["meshes"][0]["primitives"][0]["extensions"] = {extension: {"bufferView": 0, "attributes": {}}}
        for accessor in gltf["accessors"]:
            del accessor["bufferView"]
    else:
        gltf["bufferViews"][0]["extensions"] = {extension: {"buffer": 0}}
    write_chunks(file, gltf, data)
    with pytest.raises(MrmError, match=rf"m\.glb: uses {extension}"):
        load_mesh(file)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"nodes": [{"children": [0], "mesh": 0}]}, "node 0 hangs in its tree twice"),
        ({"nodes": [{"mesh": 0, "matrix": [float("nan")] * 16}]}, "transformation of node 0 is NaN"),
        ({"nodes": [{"mesh": 7}]}, "not a well-formed"),
        ({"nodes": [{"mesh": 0, "scale": [1]}, {}]}, None),
        ({"scene": 4}, "not a well-formed"),
        ({"scene": -1}, "not a well-formed"),
        ({"extensionsRequired": ["EXT_other"]}, "requires EXT_other, which is not applied"),
    ],
)
def test_an_odd_gltf_is_explained(file, changes, message):
    write_glb(file, [[SQUARE]], **changes)
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            load_mesh(file)
        text = str(caught[0].message) if caught else ""
    except MrmError as error:
        text = str(error)
    assert message is None or message in text


@pytest.mark.parametrize("name", ["POSITION", "NORMAL", "TANGENT", "TEXCOORD_0", "TEXCOORD_1", "COLOR_0"])
def test_an_attribute_of_another_width_is_refused(file, name):
    write_glb(file, [[SQUARE | {name: np.ones((4, 1))}]])
    with pytest.raises(MrmError, match=rf"m\.glb: {name} has 1 numbers for a vertex"):
        load_mesh(file)


def test_an_accessor_that_claims_more_than_fits_is_refused(file):
    gltf, data = gltf_of([[SQUARE]])
    for accessor in gltf["accessors"]:
        accessor["count"] = 1 << 40
        del accessor["bufferView"]
    write_chunks(file, gltf, data)
    with pytest.raises(MrmError, match="claims 1099511627776 values"):
        load_mesh(file)


def test_meshes_that_come_to_more_than_fits_are_refused(file):
    gltf, data = gltf_of([[SQUARE]])
    gltf["accessors"].append({"componentType": 5126, "type": "VEC3", "count": 1 << 24})
    # Each is read when it is placed.
    gltf["meshes"] = [{"primitives": [{"attributes": {"POSITION": len(gltf["accessors"]) - 1}}]}]
    gltf["nodes"] = [{"mesh": 0}] * 100
    gltf["scenes"] = [{"nodes": [*range(100)]}]
    write_chunks(file, gltf, data)
    with pytest.raises(
        MrmError, match="claims 16777216 values; all that is drawn may have 134217728 numbers"
    ):
        load_mesh(file)


# .obj -------------------------------------------------------------------------------------------------

SQUARE_OBJ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\nf 1/1/1 2/2/1 3/3/1 4/4/1\n"


@pytest.mark.parametrize(
    "content",
    [
        "\ufeff" + SQUARE_OBJ,
        SQUARE_OBJ.replace("2/2/1 3", "2/2/1 \\\n 3"),
        SQUARE_OBJ.replace("2/2/1 3", "2/2/1 \\\n 3").replace("\n", "\r\n"),
        SQUARE_OBJ.replace("\n", "\r"),
        SQUARE_OBJ.replace("v 1 1 0", "v 1 \\\n1 \\\n0"),
        SQUARE_OBJ.replace("1/1/1 2/2/1 3/3/1 4/4/1", "-4/-4/-1 -3/-3/-1 -2/-2/-1 -1/-1/-1"),
        "# café\n" + SQUARE_OBJ.replace("v 1 1 0", "v\t1  1 0 # corner") + "g a\no b\ns 1\nusemtl c\n",
        SQUARE_OBJ.rstrip("\n") + " \\",
        "mtllib /dev/zero\nmtllib ../nothing.mtl\nmaplib /dev/zero\n" + SQUARE_OBJ,
        SQUARE_OBJ + "v 1e30 0 0\n",
    ],
)
def test_an_obj_is_read_as_other_programs_write_it(tmp_path, content):
    (tmp_path / "m.obj").write_bytes(content.encode())
    mesh = quietly(tmp_path / "m.obj")
    assert mesh.indices.tolist() == [[0, 1, 2], [0, 2, 3]]
    np.testing.assert_array_equal(mesh.positions, SQUARE["POSITION"])
    np.testing.assert_array_equal(mesh.texcoords, SQUARE["TEXCOORD_0"])


def test_what_an_obj_has_and_is_not_drawn_is_named(tmp_path):
    (tmp_path / "m.obj").write_text("#MRGB ffff0000\n" + SQUARE_OBJ + "l 1 2\np 1\n")
    with pytest.warns(MrmWarning) as caught:
        load_mesh(tmp_path / "m.obj")
    assert {str(each.message).rpartition("m.obj: ")[2] for each in caught} == {
        "its lines are not drawn",
        "its points are not drawn",
        "its vertex colours in comments (#MRGB) are not read",
    }


POLYGONS = {
    "arrow": [(0, 0), (2, 1), (0, 2), (0.5, 1)],
    "L": [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)],
    "comb": [(0, 0), (5, 0), (5, 3), (4, 3), (4, 1), (3, 1), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)],
    "flat corner": [(0, 0), (1, 0), (2, 0), (2, 2), (0, 2)],
    "hole by a bridge": [
        *[(0, 0), (4, 0), (4, 4), (0, 4), (0, 0)],
        *[(1, 1), (1, 3), (3, 3), (3, 1), (1, 1)],
    ],
}


@pytest.mark.parametrize("name", POLYGONS)
@pytest.mark.parametrize("turned", [False, True])
def test_concave_polygons_are_cut_inside_themselves(tmp_path, name, turned):
    points = np.array(POLYGONS[name], float)
    for first in range(len(points)):
        polygon = np.roll(points, first, axis=0)[:: -1 if turned else 1]
        # In a plane of its own.
        space = polygon @ np.array([(0.6, 0.0, 0.8), (0.0, 1.0, 0.0)])
        lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in space]
        lines.append("f " + " ".join(str(index + 1) for index in range(len(polygon))))
        (tmp_path / "m.obj").write_text("\n".join(lines))
        with pytest.warns(MrmWarning):
            mesh = load_mesh(tmp_path / "m.obj")
        a, b, c = np.moveaxis(mesh.positions[mesh.indices].astype(float), 1, 0)
        areas = np.cross(b - a, c - a) @ np.array([-0.8, 0.0, 0.6]) / 2.0
        x, y = polygon.T
        area = np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) / 2.0
        # All turn the same way, and together they are the polygon: none lies outside, none on another.
        assert (areas * np.sign(area) > -1e-6).all()
        assert areas.sum() == pytest.approx(area, abs=1e-5)


@pytest.mark.skipif(not CASES.is_dir(), reason="the shared cases are not here")
@pytest.mark.parametrize(
    "name",
    [
        *("vertex_color.glb", "vertex_color_u8.glb", "alphamask_vcol.glb", "vcol.obj", "two_uv.glb"),
        *(
            "strip.glb",
            "normal_mirror.glb",
            "tangent_w_pos.glb",
            "nan_tangent.obj",
            "bom.obj",
            "contline.obj",
        ),
        "robust/mtllib.obj",
    ],
)
def test_the_shared_cases_are_read(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MrmWarning)
        mesh = load_mesh(CASES / name)
    assert (mesh.colors is not None) == ("col" in name)
    assert ("texcoord_1" in mesh.sets) == ("two_uv" in name)
    assert (mesh.bitangent_signs is not None) == ("mirror" in name)
