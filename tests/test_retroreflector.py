"""The layered retroreflector: its document, as MaterialX means it, is what its evaluator says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import MaterialX as mx
import numpy as np
import pytest
from test_material_case import case_of, judged

from mrm_nodes import reference as ref
from mrm_nodes.documents import read_document
from mrm_nodes.errors import MrmError
from mrm_nodes.library import host
from mrm_nodes.photometry.retroreflector import ClearTop, Retroreflector, SecondWidth
from mrm_nodes.regression.run.worker import Worker
from mrm_nodes.regression.truth import physics
from mrm_nodes.regression.truth.closure import Driven, Port, closure_of
from mrm_nodes.render import probe_backends

BARE = Retroreflector(0.0435, 0.211)
GRAY = Retroreflector(
    0.017, 0.306, falloff=4.88, film=0.19, top=ClearTop(0.167, 0.223, 0.8)
)  # the gray tape of the fits
KINDS = {
    "bare": BARE,
    "falloff": replace(BARE, falloff=2.5),
    "widening": replace(BARE, widening=1.59),
    "film": replace(BARE, film=(0.7, 0.42, 0.012)),
    "top": replace(BARE, top=ClearTop(0.0143, 0.031)),
    "gray": GRAY,
    "everything": Retroreflector(
        0.0064,
        (0.15, 0.09, 0.02),
        falloff=3.45,
        widening=0.8,
        film=(0.5, 0.2, 0.02),
        top=ClearTop(0.15, (0.04, 0.05, 0.06), 0.9),
        second=SecondWidth(0.05, 0.3),
        f82=(0.9, 0.8, 1.0),
        f90=0.4,
        exponent=2.0,
        retroreflectivity=0.8,
        distribution="beckmann",
    ),
    "beside": replace(GRAY, f0=1.0, cover=0.26, widening=1.58),
    "beside bare": Retroreflector(0.02, (1.0, 0.6, 0.2), falloff=2.0, top=ClearTop(0.1, 0.1), cover=0.3),
    "schlick": Retroreflector(0.0435, 0.211, f90=0.0, exponent=0.872),
    "paper": Retroreflector(0.0529, 0.19, f82=0.0, f90=1.0),
}


def directions(count: int) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Views, and lights of which half are near where the views come from; lights are what float32 holds."""
    rng = np.random.default_rng(7)
    v, light = (rng.normal(size=(count, 3)) for _ in range(2))
    v[:, 2], light[:, 2] = abs(v[:, 2]) + 0.05, abs(light[:, 2]) + 0.05
    v /= np.linalg.norm(v, axis=-1, keepdims=True)
    light[::2] = v[::2] + rng.normal(scale=0.03, size=light[::2].shape)
    light = (light / np.linalg.norm(light, axis=-1, keepdims=True)).astype(np.float32).astype(np.float64)
    seen = light[:, 2] > 0.01
    return v[seen], light[seen] / np.linalg.norm(light[seen], axis=-1, keepdims=True)


def graph_value(port: mx.Element, v: np.ndarray[Any, Any]) -> Any:
    """What an input or output of a graph is, with the normal +z: MaterialX's definitions, in float64."""
    if port.hasAttribute("interfacename"):
        return graph_value(port.getInterfaceInput(), v)
    node = port.getConnectedNode() if port.hasAttribute("nodename") else None
    if node is None:
        value = port.getValue()
        return value if isinstance(value, float) else np.array([value[i] for i in range(3)])
    given = {each.getName(): graph_value(each, v) for each in node.getInputs() if each.getName() != "space"}
    match node.getCategory():
        case "normal":
            return np.array([0.0, 0.0, 1.0])
        case "viewdirection":
            return -v
        case "dotproduct":
            return (given["in1"] * given["in2"]).sum(axis=-1)
        case "absval":
            return np.abs(given["in"])
        case "power":
            return given["in1"] ** given["in2"]
        case "multiply":
            return given["in1"] * given["in2"][..., None]
        case "divide":
            return given["in1"] / given["in2"]
        case "max":
            return np.maximum(given["in1"], given["in2"])
        case "min":
            return np.minimum(given["in1"], given["in2"])
        case "convert":
            return np.stack([given["in"], given["in"]], axis=-1)
    raise AssertionError(node.getCategory())


def evaluated(document: mx.Document, name: str, v: Any, light: Any) -> Any:
    """f of a document's material by the closure evaluator of the regression."""
    closure = closure_of(document, name)

    def resolve(port: Port) -> Any:
        driven = isinstance(port, Driven)
        return graph_value(closure.document.getDescendant(port.element), v) if driven else port

    n, x = np.zeros_like(v), np.zeros_like(v)
    n[:, 2] = x[:, 0] = 1.0
    points = physics.Points(-v, n, x, (0.0, 0.0, 0.0))
    lamp = {"type": 1, "direction": -light, "color": (1.0, 1.0, 1.0), "intensity": 1.0}
    radiance, _ = physics.shade_tree(closure.tree, points, [lamp], resolve)
    return radiance / light[:, 2:]


@pytest.mark.parametrize("kind", KINDS)
def test_the_document_evaluates_to_the_evaluator(kind: str, tmp_path: Path):
    bsdf = KINDS[kind]
    v, light = directions(120)
    expected = bsdf.eval(v, light)
    assert expected.shape == v.shape and (expected >= 0).all() and expected.mean() > 0.1
    path = tmp_path / "a.mtlx"
    path.write_text(bsdf.markup("tape"))
    for document in (read_document(path), bsdf.document("tape")):
        assert document.validate()[0], document.validate()[1]
        np.testing.assert_allclose(evaluated(document, "tape", v, light), expected, rtol=1e-5, atol=1e-9)


def test_the_parts_lie_on_each_other_as_written_down_here():
    """The gray tape from single lobes: nothing of the class but its parameters."""
    v, light = directions(50)
    kept = abs(v[:, 2:]) ** 4.88
    common = {"energy_compensation": host().compensation}
    beads = ref.GeneralizedSchlick(
        0.306 * kept * np.ones(3),
        color90=0.306 * kept * np.ones(3),
        alpha=0.017,
        retroreflectivity=1.0,
        **common,
    )
    top = ref.GeneralizedSchlick(0.223, color90=0.8, alpha=0.167, **common)
    film = 0.19 / np.pi
    through_top, through_beads = (ref.Leaf(each).throughput(v, light) for each in (top, beads))
    expected = top.eval(v, light) + through_top * (beads.eval(v, light) + through_beads * film)
    np.testing.assert_allclose(GRAY.eval(v, light), expected, rtol=1e-12)


def test_the_falloff_is_the_only_part_that_is_not_reciprocal():
    v, light = directions(50)
    # The layers and MaterialX's compensation are not either, by themselves.
    lobe = replace(BARE, alpha=0.005, f0=0.01)
    ratio = replace(lobe, falloff=4.9).eval(v, light) / replace(lobe, falloff=4.9).eval(light, v)
    expected = (v[:, 2] / light[:, 2]) ** 4.9
    np.testing.assert_allclose(ratio, expected[:, None] * np.ones(3), rtol=1e-3)


def test_parameters_broadcast_with_directions():
    v, light = directions(20)
    alphas = np.array([[0.01], [0.02]])
    many = replace(GRAY, alpha=alphas, falloff=np.array([[2.0], [3.0]]), widening=0.5).eval(v, light)
    assert many.shape == (2, len(v), 3)
    one = replace(GRAY, alpha=0.02, falloff=3.0, widening=0.5).eval(v, light)
    np.testing.assert_array_equal(many[1], one)


def test_edge_on_views_stay_finite():
    v = np.array([[1.0, 0.0, 0.0], [np.sqrt(1 - 1e-12), 0.0, 1e-6], [0.6, 0.0, -0.8]])
    light = np.array([0.0, 0.6, 0.8])
    assert np.isfinite(KINDS["everything"].eval(v, light)).all()


def test_the_document_says_what_it_is_and_how_to_change_it():
    text = GRAY.markup("gray tape", 'fit of "gray" & <more>')
    document = mx.createDocument()
    mx.readFromXmlString(document, text)
    material = document.getNode("gray_tape")
    assert material.getDocString() == 'fit of "gray" & <more>'
    assert document.getColorSpace() == "lin_rec709"
    graph = document.getNodeGraph("NG_gray_tape")
    assert graph.getInput("falloff").getValue() == pytest.approx(4.88)
    assert all(each.getAttribute("uiname") and each.getAttribute("doc") for each in graph.getInputs())


@pytest.mark.parametrize(
    ("bsdf", "message"),
    [
        (replace(BARE, alpha=0.0), "alpha"),
        (replace(BARE, alpha=np.array([0.1, 0.2])), "alpha has shape"),
        (replace(GRAY, top=ClearTop(0.1, np.zeros((2, 3)))), "f0 has shape"),
        (replace(BARE, film=1.5), "albedo"),
        (replace(BARE, distribution="gxx"), "distribution"),
        (replace(BARE, f0=float("nan")), "color0"),
    ],
)
def test_what_makes_no_sense_becomes_no_document(bsdf: Retroreflector, message: str):
    with pytest.raises(MrmError, match=message):
        bsdf.document()


@pytest.fixture(scope="module")
def worker() -> Worker:
    working = [probe.backend for probe in probe_backends() if probe.works]
    return Worker(working[0]) if working else pytest.skip("no backend works")


# Each is a shader of its own to compile; what the others have, these have together.
@pytest.mark.parametrize("kind", ["everything", "gray", "beside bare", "paper"])
def test_glsl_shows_what_the_evaluator_says(kind: str, worker: Worker, tmp_path: Path):
    (tmp_path / "a.mtlx").write_text(KINDS[kind].markup("tape", "A tape."))
    outcome = judged(worker, case_of(tmp_path / "a.mtlx"), tmp_path / "report")
    assert (outcome.truth, outcome.verdict) == ("physics", "pass")
    assert outcome.figures is not None and outcome.figures.lit > 2000


def test_a_reciprocal_falloff_is_reciprocal_and_the_same_where_light_goes_back():
    """One degree about a direction of 60 degrees, where a power of |n.v| is 16 % off."""
    angle = np.radians([60.0, 61.0])
    v, light = (np.array([np.sin(each), 0.0, np.cos(each)]) for each in angle)
    graph = Retroreflector(0.02, 0.3, falloff=4.9)
    ours = replace(graph, reciprocal=True)

    def asymmetry(bsdf: Retroreflector) -> float:
        return float((bsdf.eval(v, light) / bsdf.eval(light, v) - 1)[0])

    # What is left is the energy compensation, a function of the view alone, as without a falloff.
    plain = asymmetry(replace(graph, falloff=None))
    assert abs(asymmetry(ours)) <= abs(plain) < 1e-3
    assert 0.14 < asymmetry(graph) < 0.18
    np.testing.assert_allclose(ours.eval(v, v), graph.eval(v, v), rtol=1e-12)
    with pytest.raises(MrmError, match="no node has a reciprocal falloff"):
        ours.markup()
