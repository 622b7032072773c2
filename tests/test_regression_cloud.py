"""The cloud's configurations are what it says they are."""

import numpy as np
import pytest

from mrm_nodes.regression.cases.cloud import (
    DECADES,
    GRAZING,
    LOBE,
    MAP_ALPHAS,
    MAP_ANGLES,
    MOST_USED,
    SAME,
    SPHERE,
    Cloud,
    attributes_of,
    place,
    random_directions,
    random_inputs,
    run_cloud,
    tally,
)
from mrm_nodes.regression.truth import material
from mrm_nodes.regression.truth.reference_image import evaluator, shading_frame

N = 20_000


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.mark.parametrize("node", material.NODES)
def test_every_varying_input_is_random_and_exact_in_float32(node):
    values = random_inputs(node, rng(), N)
    assert set(values) == set(attributes_of(node))
    for value in values.values():
        assert len(np.unique(value)) > 1000
        assert (value == value.astype(np.float32)).all()


def test_alpha_is_even_over_the_decades_and_half_anisotropic():
    roughness = random_inputs("mrm_conductor_bsdf", rng(), N)["roughness"]
    counts, _ = np.histogram(roughness.min(-1), [0.0000999, 0.001, 0.01, 0.1, 1.0])
    assert counts / N == pytest.approx([1 / 4] * 4, abs=0.02)
    assert np.mean(roughness[:, 0] == roughness[:, 1]) == pytest.approx(0.5, abs=0.03)
    assert roughness.max() <= 1.0


def test_weights_are_often_zero_and_one():
    weight = random_inputs("mrm_conductor_bsdf", rng(), N)["retroreflectivity"]
    assert np.mean(weight == 0) == pytest.approx(1 / 3, abs=0.02)
    assert np.mean(weight == 1) == pytest.approx(1 / 3, abs=0.02)


def test_lights_come_from_the_lobe_from_anywhere_and_from_the_viewer():
    values = material.complete("mrm_conductor_bsdf", {"roughness": (0.05, 0.05), "retroreflectivity": 1.0})
    v, light, kind = random_directions(evaluator("mrm_conductor_bsdf", values), rng(), N)
    assert [np.mean(kind == each) for each in (LOBE, SPHERE, SAME)] == pytest.approx(
        [0.5, 0.4, 0.1], abs=0.02
    )
    for cosine in (v[:, 2], np.abs(light[:, 2])):
        assert cosine.min() >= GRAZING
        counts, _ = np.histogram(cosine, [GRAZING, 1e-4, 1e-3, 1e-2, 1e-1])
        assert (counts > 0.03 * N).all()
    # A retroreflective lobe of this width keeps close to the view.
    assert np.median(np.sum(v * light, -1)[kind == LOBE]) > 0.98
    assert np.mean(light[kind == SPHERE][:, 2] < 0) == pytest.approx(0.5, abs=0.02)
    assert (light[kind == SAME] == v[kind == SAME]).all()


def test_placed_points_see_viewer_and_light_as_wanted():
    v, light = (each / np.linalg.norm(each, axis=-1, keepdims=True) for each in rng(1).normal(size=(2, N, 3)))
    v[:, 2] = np.abs(v[:, 2])
    light[::10] = v[::10]
    to_light, eye = np.array([0.48, -0.6, 0.64]), np.array([0.5, -0.25, 1.0])
    placed = place(v, light, to_light, eye, rng(2))
    view, frame = shading_frame(placed["position"], placed["normal"], placed["tangent"], eye)
    clear = v[:, 2] > 1e-5
    assert np.abs(np.einsum("nij,nj->ni", frame, view) - v)[clear].max() < 2e-6
    assert np.abs(np.einsum("nij,j->ni", frame, to_light) - light)[clear].max() < 2e-6
    facing = np.sum(placed["normal"] * view, -1) > 0
    assert np.mean(facing) == pytest.approx(0.5, abs=0.02)


class FakeRenderer:
    """Draws what the evaluator says, with an error."""

    def __init__(self, node, error):
        self.node, self.error = node, error

    def draw_points(self, shader, attributes, camera_position, lights, uniforms):
        from mrm_nodes.regression.truth.reference_image import shade
        from mrm_nodes.render.scene import Camera

        inputs = material.inputs_of(self.node)
        chosen = {
            name: inputs[name].choices[uniforms[f"bsdf_{name}"]] for name in ("distribution", "masking")
        }
        values = {
            **material.complete(self.node, chosen),
            **{n: attributes[n] for n in attributes_of(self.node)},
        }
        points = [attributes[name] for name in ("position", "normal", "tangent")]
        view, frame = shading_frame(*points, camera_position)
        data = [light.data(Camera(position=camera_position, target=(9.0, 9.0, 9.0))) for light in lights]
        bsdf = evaluator(self.node, values)
        image = shade(bsdf, attributes["weight"], view, frame, attributes["position"], data)
        return {
            "image": (image * (1.0 + self.error)).astype(np.float32),
            **{name: attributes[name] for name in ("position", "normal", "tangent")},
        }


@pytest.mark.parametrize(("error", "verdict"), [(0.0, "pass"), (0.1, "fail"), (np.nan, "fail")])
def test_a_cloud_passes_or_fails_with_figures_by_decade(error, verdict):
    cloud = Cloud("mrm_generalized_schlick_bsdf", configurations=5000)
    result = run_cloud(cloud, FakeRenderer(cloud.node, error), None)
    assert result.verdict == verdict
    assert sum(decade["configurations"] for decade in result.decades) == 5000
    assert {tuple(decade["alpha"]) for decade in result.decades} == set(DECADES)
    if error == 0.1:
        assert result.figures.max_rel == pytest.approx(0.1, rel=1e-4)


def test_a_cloud_is_the_same_every_time():
    cloud = Cloud("mrm_conductor_bsdf", configurations=500)
    first, second = (run_cloud(cloud, FakeRenderer(cloud.node, 0.01), None) for _ in range(2))
    assert first.worst == second.worst
    assert first.maps == second.maps


def degrees(direction):
    return np.degrees(np.arccos(np.clip(direction[2], -1.0, 1.0)))


def test_the_maps_have_the_worst_of_each_cell_and_the_worst_configurations_their_place():
    cloud = Cloud("mrm_conductor_bsdf", configurations=3000)
    result = run_cloud(cloud, FakeRenderer(cloud.node, 0.01), None)
    used = [each["used"] for each in result.worst]
    assert used == sorted(used, reverse=True) and used[0] > used[-1] > 0
    cells = {(each["angle"], each["film"]): each["used"] for each in result.maps}
    assert set(cells) == {(angle, film) for angle in ("view", "light") for film in (False, True)}
    for rows in cells.values():
        assert [len(row) for row in rows] == [MAP_ALPHAS] * MAP_ANGLES
    for each in result.worst:
        film = each["inputs"]["thinfilm_thickness"] > 0
        column = int((np.log10(min(each["inputs"]["roughness"])) + 4) / 4 * MAP_ALPHAS)
        for angle in ("view", "light"):
            row = min(int(degrees(each[angle]) / 90 * MAP_ANGLES), MAP_ANGLES - 1)
            assert cells[angle, film][row][column] >= 0.94 * each["used"]
    for angle in ("view", "light"):
        most = max(
            used for film in (False, True) for row in cells[angle, film] for used in row if used is not None
        )
        assert most == pytest.approx(used[0], rel=0.06)


def test_maps_tell_an_error_that_is_not_finite_from_a_cell_that_is_empty():
    cloud = Cloud("mrm_conductor_bsdf", configurations=40)
    values = {
        used
        for each in run_cloud(cloud, FakeRenderer(cloud.node, np.nan), None).maps
        for row in each["used"]
        for used in row
    }
    assert values == {None, MOST_USED}


@pytest.mark.parametrize(("error", "over", "not_finite"), [(0.0, 0, 0), (0.1, 1, 0), (np.nan, 1, 1)])
def test_a_tally_counts_each_configuration_in_its_decades(error, over, not_finite):
    cloud = Cloud("mrm_conductor_bsdf", configurations=2000)
    found = tally(cloud, FakeRenderer(cloud.node, error), None)
    for axis in ("alpha", "n.v"):
        decades = [decade for (each, _), decade in found.items() if each == axis]
        assert sum(decade.configurations for decade in decades) == 2000
        assert all((decade.over > 0) == over and (decade.not_finite > 0) == not_finite for decade in decades)
    above = sum(decade.configurations for (axis, _), decade in found.items() if axis == "n.l")
    assert 800 < above < 1900
