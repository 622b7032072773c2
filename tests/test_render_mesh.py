"""Meshes: the built-in shapes, the user's files, and what is refused."""

import dataclasses
import warnings
from pathlib import Path

import numpy as np
import pytest
from gltf_writer import SQUARE, write_glb

from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.render import BUILT_IN, Mesh, load_mesh, plane, sphere

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


def triangle_normals(mesh):
    a, b, c = np.moveaxis(mesh.positions[mesh.indices].astype(np.float64), 1, 0)
    return np.cross(b - a, c - a)


@pytest.mark.parametrize("name", BUILT_IN)
def test_built_in_shapes_are_well_formed(name):
    mesh = load_mesh(name)
    assert mesh is load_mesh(name)
    for vectors in (mesh.normals, mesh.tangents):
        np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1.0, atol=1e-6)
    assert np.abs(np.sum(mesh.normals * mesh.tangents, axis=1)).max() < 1e-5
    assert mesh.texcoords.min() >= -1e-6 and mesh.texcoords.max() <= 1 + 1e-6
    # Counter-clockwise from outside, and no triangle without an area.
    flat = triangle_normals(mesh)
    assert (np.linalg.norm(flat, axis=1) > 1e-12).all()
    assert (np.sum(flat * mesh.normals[mesh.indices].mean(axis=1), axis=1) > 0).all()


@pytest.mark.parametrize("name", BUILT_IN)
def test_tangents_follow_u(name):
    mesh = load_mesh(name)
    corners, texcoords = mesh.positions[mesh.indices], mesh.texcoords[mesh.indices]
    edges = corners[:, [1, 2]] - corners[:, [0]]
    (du1, dv1), (du2, dv2) = np.moveaxis(texcoords[:, [1, 2]] - texcoords[:, [0]], 0, -1)
    along_u = (edges[:, 0].T * dv2 - edges[:, 1].T * dv1) * np.sign(du1 * dv2 - du2 * dv1)
    cosine = np.sum(along_u.T * mesh.tangents[mesh.indices].mean(axis=1), axis=1)
    length = np.linalg.norm(along_u, axis=0)
    seen = length > 1e-9
    assert (cosine[seen] / length[seen]).min() > 0.8


def test_the_sphere_is_the_unit_sphere():
    np.testing.assert_allclose(np.linalg.norm(sphere().positions, axis=1), 1.0, atol=1e-6)
    np.testing.assert_array_equal(sphere().positions, sphere().normals)
    middle = np.abs(sphere().texcoords - 0.5).sum(axis=1).argmin()
    np.testing.assert_allclose(sphere().positions[middle], (0, 0, 1), atol=1e-6)


def test_the_baluster_is_curved_and_creased():
    mesh = load_mesh("baluster")
    places = {}
    for position, normal in zip(mesh.positions.round(5).tolist(), mesh.normals, strict=True):
        places.setdefault(tuple(position), []).append(normal)
    spreads = [min(float(a @ b) for a in normals for b in normals) for normals in places.values()]
    assert sum(spread < 0.5 for spread in spreads) > 500  # creases
    assert sum(spread > 0.999 for spread in spreads) > 5000  # curved surfaces


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"indices": np.zeros((0, 3))}, "mesh plane: it is empty: 4 vertices, 0 triangles"),
        ({"indices": [[0, 1, 4]]}, "refers to vertex 4, but there are 4"),
        ({"indices": [[0, 1, -1]]}, "refers to vertex -1"),
        ({"normals": np.zeros((3, 3))}, r"normals have shape \(3, 3\), not \(4, 3\)"),
        ({"texcoords": np.zeros((4, 3))}, r"texcoords have shape \(4, 3\), not \(4, 2\)"),
        ({"positions": np.full((4, 3), np.nan)}, "positions of vertex 0 are NaN or infinite"),
        ({"geomprops": {"wear": np.zeros(5)}}, r"wear have shape \(5, 1\), not \(4, k\)"),
    ],
)
def test_a_mesh_checks_its_arrays(change, message):
    with pytest.raises(MrmError, match=message):
        dataclasses.replace(plane(), **change)


def test_meshes_are_read_only():
    with pytest.raises(ValueError):
        plane().positions[0] = 1.0


# Files ------------------------------------------------------------------------------------------------

SQUARE_OBJ = """
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
vn 0 0 1
f 1/1/1 2/2/1 3/3/1 4/4/1
"""


def without(*names):
    return {name: array for name, array in SQUARE.items() if name not in names}


@pytest.fixture
def write(tmp_path):
    def write_text(text, name="mesh.obj"):
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return write_text


def test_an_obj_is_read_without_a_warning(write):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mesh = load_mesh(write(SQUARE_OBJ))
    assert len(mesh.indices) == 2
    assert {tuple(p) for p in mesh.positions.tolist()} == {(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)}
    np.testing.assert_array_equal(mesh.texcoords, mesh.positions[:, :2])
    np.testing.assert_array_equal(mesh.normals, np.tile((0, 0, 1), (4, 1)))
    np.testing.assert_allclose(mesh.tangents, np.tile((1, 0, 0), (4, 1)), atol=1e-6)


def test_indices_may_count_backwards(write):
    relative = SQUARE_OBJ.replace("1/1/1 2/2/1 3/3/1 4/4/1", "-4/-4/-1 -3/-3/-1 -2/-2/-1 -1/-1/-1")
    np.testing.assert_array_equal(
        load_mesh(write(relative)).positions, load_mesh(write(SQUARE_OBJ)).positions
    )


@pytest.mark.parametrize(
    ("face", "message"),
    [
        ("1/1 2/2 3/3 4/4", "the mesh has no normals; made some"),
        ("1//1 2//1 3//1 4//1", "the mesh has no texture coordinates; made some"),
        ("1 2 3 4", "the mesh has no normals and no texture coordinates; made some"),
    ],
)
def test_what_an_obj_lacks_is_made_with_a_warning(write, face, message):
    file = write(SQUARE_OBJ.replace("1/1/1 2/2/1 3/3/1 4/4/1", face))
    with pytest.warns(MrmWarning, match=message):
        mesh = load_mesh(file)
    np.testing.assert_array_equal(mesh.normals, np.tile((0, 0, 1), (len(mesh.positions), 1)))
    assert np.abs(np.linalg.norm(mesh.tangents, axis=1) - 1).max() < 1e-6
    assert np.isfinite(mesh.texcoords).all() and len(np.unique(mesh.texcoords, axis=0)) > 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the mesh is empty: 0 vertices, 0 faces"),
        ("hello\n", "the mesh is empty"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "the mesh is empty: 3 vertices, 0 faces"),
        (SQUARE_OBJ + "f 1 2 9\n", r"mesh\.obj, line 12: the face refers to v 9, but 4 are there so far"),
        (SQUARE_OBJ + "f 1 2 -5\n", "line 12: the face refers to v -5"),
        (SQUARE_OBJ + "f 1 2 0\n", "line 12: the face refers to v 0"),
        (SQUARE_OBJ + "f 1/5 2/1 3/1\n", "the face refers to vt 5"),
        (SQUARE_OBJ + "f 1//2 2//1 3//1\n", "the face refers to vn 2"),
        (SQUARE_OBJ + "f 1 2\n", "a face needs three vertices or more"),
        (SQUARE_OBJ + "f 1 2 x\n", "not a vertex of a face: x"),
        (SQUARE_OBJ + "f 1/1/1/1 2 3\n", "not a vertex of a face"),
        (SQUARE_OBJ.replace("v 1 1 0", "v 1 nan 0"), "line 4: NaN or infinite: v 1 nan 0"),
        (SQUARE_OBJ.replace("v 1 1 0", "v 1 one 0"), "line 4: not numbers"),
        (SQUARE_OBJ.replace("v 1 1 0", "v 1 1"), "line 4: v needs 3 numbers"),
    ],
)
def test_a_wrong_obj_is_explained(write, text, message):
    with pytest.raises(MrmError, match=message):
        load_mesh(write(text))


def test_a_glb_is_read_without_a_warning(tmp_path):
    write_glb(tmp_path / "m.glb", [[SQUARE]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mesh = load_mesh(tmp_path / "m.glb")
    np.testing.assert_array_equal(mesh.positions, SQUARE["POSITION"])
    # glTF's v grows downwards, MaterialX's upwards.
    np.testing.assert_array_equal(mesh.texcoords, np.array(SQUARE["TEXCOORD_0"]) * (1, -1) + (0, 1))
    np.testing.assert_array_equal(mesh.indices, np.reshape(SQUARE["indices"], (2, 3)))


def test_meshes_and_primitives_of_a_glb_become_one_in_their_places(tmp_path):
    nodes = [
        {"mesh": 0, "translation": [5, 0, 0], "children": [1]},
        {"mesh": 1, "translation": [0, 7, 0]},
    ]
    write_glb(tmp_path / "m.glb", [[SQUARE, SQUARE], [SQUARE]], nodes)
    mesh = load_mesh(tmp_path / "m.glb")
    assert len(mesh.positions) == 12 and len(mesh.indices) == 6
    corners = {tuple(mesh.positions[triangle].min(axis=0)) for triangle in mesh.indices}
    assert corners == {(5, 0, 0), (5, 7, 0)}


def test_a_glb_without_indices_is_read(tmp_path):
    triangle = {name: array[:3] for name, array in without("indices").items()}
    write_glb(tmp_path / "m.glb", [[triangle]])
    assert load_mesh(tmp_path / "m.glb").indices.tolist() == [[0, 1, 2]]


@pytest.mark.parametrize(
    ("lacking", "message"),
    [
        (("NORMAL",), "the mesh has no normals; made some"),
        (("TEXCOORD_0",), "the mesh has no texture coordinates; made some"),
        (("NORMAL", "TEXCOORD_0"), "the mesh has no normals and no texture coordinates"),
    ],
)
def test_what_a_glb_lacks_is_made_with_a_warning(tmp_path, lacking, message):
    write_glb(tmp_path / "m.glb", [[without(*lacking)]])
    with pytest.warns(MrmWarning, match=message):
        mesh = load_mesh(tmp_path / "m.glb")
    np.testing.assert_allclose(mesh.normals, np.tile((0, 0, 1), (len(mesh.positions), 1)), atol=1e-6)
    assert np.abs(np.linalg.norm(mesh.tangents, axis=1) - 1).max() < 1e-6


@pytest.mark.parametrize(
    ("primitive", "changes", "message"),
    [
        (SQUARE | {"indices": [0, 1, 9]}, {}, "a triangle refers to vertex 9, but there are 4"),
        (SQUARE | {"mode": 1}, {}, "the mesh is empty: it has no triangles"),
        (SQUARE | {"indices": []}, {}, "the mesh is empty: it has no triangles"),
        (SQUARE | {"POSITION": np.full((4, 3), np.nan)}, {}, "a position is NaN or infinite"),
        (SQUARE | {"NORMAL": [(0, 0, 1)]}, {}, "NORMAL has 1 values for 4 vertices"),
        (SQUARE, {"meshes": []}, "the mesh is empty"),
        (SQUARE, {"meshes": 3}, "not a well-formed .glb"),
        (SQUARE, {"accessors": []}, "not a well-formed .glb"),
        (
            SQUARE,
            {"bufferViews": [{"buffer": 0, "byteOffset": 99, "byteLength": 99}] * 4},
            "outside its buffer",
        ),
        (SQUARE, {"buffers": [{"byteLength": 1 << 20}]}, "truncated: .* of 1048576 bytes of data are there"),
        (
            SQUARE,
            {"buffers": [{"byteLength": 8, "uri": "b.bin"}]},
            "its data, .*b.bin, is missing or is no file",
        ),
        (SQUARE, {"extensionsRequired": ["KHR_draco_mesh_compression"]}, "uses KHR_draco_mesh_compression"),
    ],
)
def test_a_wrong_glb_is_explained(tmp_path, primitive, changes, message):
    write_glb(tmp_path / "m.glb", [[primitive]], **changes)
    with pytest.raises(MrmError, match=message):
        load_mesh(tmp_path / "m.glb")


def test_a_glb_may_be_cut_off_anywhere(tmp_path):
    write_glb(tmp_path / "whole.glb", [[SQUARE]])
    whole = (tmp_path / "whole.glb").read_bytes()
    for length in (0, 3, 11, 19, 40, len(whole) // 2, len(whole) - 1):
        (tmp_path / "cut.glb").write_bytes(whole[:length])
        with pytest.raises(MrmError, match=r"cut\.glb: "):
            load_mesh(tmp_path / "cut.glb")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nowhere.obj", r"nowhere\.obj: no such mesh file"),
        (
            "mesh.fbx",
            r"mesh\.fbx: unknown mesh; give an \.obj, \.gltf or \.glb file, or one of sphere, plane",
        ),
        ("cube", "cube: unknown mesh"),
    ],
)
def test_an_unknown_mesh_is_explained(name, message):
    with pytest.raises(MrmError, match=message):
        load_mesh(name)


@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared data is not here")
@pytest.mark.parametrize(("name", "triangles"), [("shaderball.glb", 88264), ("sphere.obj", 7080)])
def test_real_files_are_read(name, triangles):
    mesh = load_mesh(SHARED / name)
    assert isinstance(mesh, Mesh) and len(mesh.indices) == triangles
    outward = np.sum(triangle_normals(mesh) * mesh.normals[mesh.indices].mean(axis=1), axis=1)
    assert (outward > 0).mean() > 0.99
