"""The coefficients of the standards: worked examples, closed forms, and a goniometer simulated point by point."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mrm_nodes import photometry
from mrm_nodes import reference as ref
from mrm_nodes.errors import MrmError

Array = NDArray[np.float64]


def bead(alpha: float, f0: float = 0.04) -> ref.GeneralizedSchlick:
    """A retroreflective lobe whose Fresnel factor is the same at all angles."""
    return ref.GeneralizedSchlick(f0, color90=f0, alpha=alpha, retroreflectivity=1.0)


@pytest.mark.parametrize(
    ("angles", "v", "l"),
    [
        ((0.2, -4.0), (0.0, 0.07324, 0.99731), (0.0, 0.06976, 0.99756)),
        ((0.2, 0.0, 30.0), (-0.5, 0.00349, 0.86602), (-0.5, 0.0, 0.86603)),
        ((0.5, 20.0, 20.0, 90.0), (-0.33381, 0.32240, 0.88579), (-0.34202, 0.32139, 0.88302)),
        ((1.05, 88.76), (0.0, -0.99920, 0.03996), (0.0, -0.99977, 0.02164)),
    ],
)
def test_directions_are_those_of_the_worked_examples(angles: Any, v: Any, l: Any):  # noqa: E741
    found = photometry.directions(*angles)
    for direction, worked in zip(found, (v, l), strict=True):
        np.testing.assert_allclose(direction, worked, atol=5.1e-6)
        assert np.linalg.norm(direction) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize(
    ("angles", "worked"),
    [((0.2, -4.0), 101.17), ((0.2, 0.0, 30.0), 94.222), ((0.5, 20.0, 20.0, 90.0), 36.201)],
)
def test_R_A_is_that_of_the_worked_examples(angles: Any, worked: float):
    digits = len(f"{worked:g}".partition(".")[2])
    found = photometry.retroreflection(bead(0.005), *angles)
    assert found.shape == (3,)
    assert np.round(found, digits).tolist() == [worked] * 3


def test_a_road_is_seen_from_above_the_lamp():
    """With the other sign of beta1 the eye would be below it, and the paint two and a half times as bright."""
    assert photometry.luminance_coefficient(bead(0.2))[1] * 1e3 == pytest.approx(275.61, abs=0.005)
    below = photometry.luminance_coefficient(bead(0.2), beta1=-88.76)[1] * 1e3
    assert below == pytest.approx(686.67, abs=0.005)


def test_R_L_is_R_A_over_the_receiver_s_cosine():
    v, _ = photometry.directions(1.05, 88.76)
    lobe = bead(0.2)
    expected = photometry.retroreflection(lobe, 1.05, 88.76) / v[2]
    np.testing.assert_allclose(photometry.luminance_coefficient(lobe), expected, rtol=1e-14)


@pytest.mark.parametrize("across", [False, True], ids=["along", "across"])
def test_R_A_is_its_closed_form(across: bool):
    """F / (4 pi alpha²) ((1 + t²) / (1 + (t / alpha)²))², t the slope of the half vector: tan(observation / 2) in the
    plane of incidence. What is left is the masking.
    """
    alpha, f0 = 0.005, 0.04
    observation, beta = np.meshgrid(np.linspace(0.0, 2.0, 41), np.linspace(0.0, 60.0, 31))
    found = photometry.retroreflection(
        bead(alpha, f0), observation, 0.0 if across else beta, beta if across else 0.0
    )
    t, b = np.tan(np.radians(observation) / 2.0), np.radians(beta)
    if across:
        t = t * np.sqrt(1.0 + (t * np.sin(b)) ** 2) / np.cos(b)
    closed = f0 / (4.0 * math.pi * alpha**2) * ((1.0 + t**2) / (1.0 + (t / alpha) ** 2)) ** 2
    np.testing.assert_allclose(found[..., 1], closed, rtol=4e-5)


@dataclass(frozen=True)
class Goniometer:
    """A source and a receiver of some size about a sheet of some size, in metres: the definition, point by point."""

    observation: float
    beta1: float
    beta2: float
    rotation: float
    radius: float
    """Of all three discs."""
    distance: float = 15.0

    def measure(self, bsdf: Any) -> float:
        """Illuminance at the receiver times distance², by area and by illuminance on a plane that faces the source."""
        alpha, b1, b2, epsilon = np.radians([self.observation, self.beta1, self.beta2, self.rotation])
        x_turn = _matrix(np.array([1.0, 0.0, 0.0]), -b1)
        y_turn = _matrix(np.array([0.0, 1.0, 0.0]), b2)
        z_turn = _matrix(np.array([0.0, 0.0, 1.0]), epsilon)
        sheet = x_turn @ y_turn @ z_turn
        towards_receiver = np.array([0.0, math.sin(alpha), math.cos(alpha)])
        disc, weight = _disc(self.radius)
        points = disc @ sheet.T
        sources = disc + np.array([0.0, 0.0, self.distance])
        receivers = disc @ _matrix(np.array([1.0, 0.0, 0.0]), -alpha).T + towards_receiver * self.distance
        p, s, r = (each.ravel() for each in np.meshgrid(*[np.arange(len(disc))] * 3, indexing="ij"))
        to_source, to_receiver = sources[s] - points[p], receivers[r] - points[p]
        far_s, far_r = (np.linalg.norm(each, axis=-1) for each in (to_source, to_receiver))
        l, v = (to_source / far_s[:, None]) @ sheet, (to_receiver / far_r[:, None]) @ sheet  # noqa: E741
        luminance = bsdf.eval(v, l)[:, 1] * l[:, 2] / far_s**2
        lit = luminance * v[:, 2] / far_r**2
        return float(np.sum(lit * weight[p] * weight[s] * weight[r]) * self.distance**4)


def _matrix(axis: Array, angle: float) -> Array:
    """A turn about an axis, by Rodrigues' formula."""
    k = -np.cross(np.eye(3), axis).T
    return np.eye(3) + math.sin(angle) * k + (1.0 - math.cos(angle)) * (k @ k)


def _disc(radius: float) -> tuple[Array, Array]:
    """Points of a disc across z, and their shares of its area."""
    t, w = np.polynomial.legendre.leggauss(4)
    across, share = radius * np.sqrt(0.5 * (t + 1.0)), 0.5 * w
    azimuth = 2.0 * math.pi * (np.arange(8) + 0.25) / 8.0
    r, phi = (each.ravel() for each in np.meshgrid(across, azimuth, indexing="ij"))
    return np.stack([r * np.cos(phi), r * np.sin(phi), 0.0 * r], axis=-1), np.repeat(share, 8) / 8.0


@pytest.mark.parametrize(
    "angles",
    [(0.2, -4.0, 0.0, 0.0), (0.3333, 30.0, 0.0, 0.0), (1.0, 10.0, 35.0, 60.0), (1.5, -50.0, 5.0, 0.0)],
)
def test_R_A_is_what_a_goniometer_measures(angles: tuple[float, float, float, float]):
    """Of smaller and smaller discs: what is left of the difference is theirs."""
    sheet = ref.GeneralizedSchlick(
        0.1, color90=0.3, alpha=(0.004, 0.009), retroreflectivity=1.0, exponent=2.0
    )
    coarse, fine = (Goniometer(*angles, radius).measure(sheet) for radius in (0.006, 0.003))
    found = photometry.retroreflection(sheet, *angles)[1]
    own_error = abs(coarse - fine)
    assert own_error < 0.01 * found
    assert abs(fine - found) < own_error


def test_angles_broadcast():
    value = photometry.retroreflection(bead(0.01), [[0.2], [1.0]], [5.0, 20.0, 40.0])
    assert value.shape == (2, 3, 3)
    assert value[1, 2].tolist() == photometry.retroreflection(bead(0.01), 1.0, 40.0).tolist()


def test_a_table_of_one_channel_is_measured_too():
    class Table:
        def eval(self, v: Array, l: Array) -> Array:  # noqa: E741
            return np.full(np.broadcast_shapes(v.shape, l.shape)[:-1], 0.5)

    value = photometry.retroreflection(Table(), [0.2, 0.3, 0.4], 5.0)
    np.testing.assert_allclose(value, 0.5 * np.cos(np.radians(5)) ** 2 * np.ones((3, 3)), rtol=2e-3)


@pytest.mark.parametrize(
    ("angles", "said"),
    [
        ((0.2, 95.0), "the source does not see the front"),
        ((0.2, 90.0), "the source does not see the front"),
        ((1.05, -89.5), "the receiver does not see the front"),
        ((0.2, 60.0, 120.0), "the source does not see the front"),
        ((math.nan, 5.0), "observation is an angle of at most 360 degrees, not nan"),
        ((0.2, 400.0), "beta1 is an angle of at most 360 degrees, not 400"),
    ],
)
def test_a_geometry_behind_the_sheet_is_refused(angles: Any, said: str):
    with pytest.raises(MrmError, match=said):
        photometry.retroreflection(bead(0.01), *angles)


def test_R_T_is_its_closed_form():
    """All of F comes back, and within an angle F X² / (1 + X²), X = tan(angle / 2) / alpha."""
    for alpha in (0.001, 0.005, 0.02):
        x = math.tan(math.radians(4.0) / 2.0) / alpha
        found = photometry.total_retroreflectance(bead(alpha), 4.0)
        np.testing.assert_allclose(found, 0.04 * x**2 / (1.0 + x**2), rtol=3e-4)
    np.testing.assert_allclose(photometry.total_retroreflectance(ref.Lambert(0.7), 90.0), 0.7, rtol=1e-6)
    aslant = photometry.total_retroreflectance(ref.Lambert(0.7), 180.0, beta1=40.0, beta2=20.0)
    np.testing.assert_allclose(aslant, 0.7, rtol=2e-3)


def test_half_width_is_its_closed_form():
    alpha = 0.005
    closed = 2.0 * math.degrees(math.atan(alpha * math.sqrt(math.sqrt(2.0) - 1.0)))
    assert photometry.half_width(bead(alpha)) == pytest.approx(closed, rel=1e-4)
    assert math.isnan(photometry.half_width(ref.Lambert(0.5)))
    assert math.isnan(photometry.half_width(bead(alpha, 0.0)))


def test_Q_d_is_the_albedo_over_pi():
    assert photometry.diffuse_luminance(ref.Lambert(0.6))[1] * 1e3 == pytest.approx(191.0, abs=0.05)
    assert photometry.luminance_coefficient(ref.Lambert(0.6))[1] * 1e3 == pytest.approx(4.1, abs=0.05)
    for elevation in (2.29, 20.0, 90.0):
        angle = math.radians(elevation)
        v = np.array([0.0, math.cos(angle), math.sin(angle)])
        for retro in (0.0, 0.3, 1.0):
            for alpha in (0.001, 0.05, 0.5):
                lobe = ref.GeneralizedSchlick(0.1, alpha=alpha, retroreflectivity=retro)
                found = photometry.diffuse_luminance(lobe, elevation)
                np.testing.assert_allclose(found, lobe.albedo(v) / math.pi, rtol=5e-4)


@pytest.mark.parametrize("elevation", [0.0, -1.0, 91.0, math.nan])
def test_an_eye_that_is_not_above_the_road_is_refused(elevation: float):
    with pytest.raises(MrmError, match="the eye's elevation"):
        photometry.diffuse_luminance(ref.Lambert(0.5), elevation)


@pytest.mark.parametrize("angle", [0.0, 181.0, math.nan])
def test_a_cone_that_is_none_is_refused(angle: float):
    with pytest.raises(MrmError, match="largest observation angle"):
        photometry.total_retroreflectance(ref.Lambert(0.5), angle)


def test_luminance_is_by_the_illuminant_s_row():
    assert photometry.luminance([1.0, 1.0, 1.0]) == pytest.approx(1.0, abs=1e-12)
    assert photometry.luminance([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]).tolist() == [0.3311, 0.63]
    assert photometry.luminance([0.0, 0.0, 1.0], "D65") == pytest.approx(0.0722)
    with pytest.raises(MrmError, match="unknown illuminant D56; did you mean D65"):
        photometry.luminance([1.0, 1.0, 1.0], "D56")  # type: ignore[arg-type]


def test_colours_by_night():
    """White is illuminant A itself; the adaptation is the one that others print to seven digits (Lindbloom)."""
    np.testing.assert_allclose(photometry.night_chromaticity([1.0, 1.0, 1.0]), [0.4476, 0.4074], atol=5e-5)
    bradford = np.array(
        [
            [1.2164557, 0.1109905, -0.1549325],
            [0.1533326, 0.9152313, -0.0559953],
            [-0.0239469, 0.0358984, 0.3147529],
        ]
    )
    srgb = np.array(
        [
            [0.4124564, 0.3575761, 0.1804375],
            [0.2126729, 0.7151522, 0.0721750],
            [0.0193339, 0.1191920, 0.9503041],
        ]
    )
    colours = np.array([[0.7, 0.4, 0.01], [0.6, 0.05, 0.02], [0.02, 0.06, 0.4], [0.03, 0.3, 0.1]])
    xyz = colours @ (bradford @ srgb).T
    expected = xyz[:, :2] / xyz.sum(axis=-1, keepdims=True)
    np.testing.assert_allclose(photometry.night_chromaticity(colours), expected, atol=2e-4)
    assert np.isnan(photometry.night_chromaticity([0.0, 0.0, 0.0])).all()


@pytest.mark.parametrize("channels", [("a", "b"), ("R", "G", "B", "IR"), tuple("abcdefgh")])
def test_a_table_of_other_channels_has_no_coefficients(channels: tuple[str, ...]):
    from mrm_nodes.measured import Measurement

    up = np.array([[0.0, 0.0, 1.0]])
    table = Measurement(up, up, np.ones((1, len(channels))), channels)
    for ask in (photometry.retroreflection, photometry.luminance_coefficient):
        with pytest.raises(MrmError, match=f"^{len(channels)} channels .* take one or three of them"):
            ask(table, 0.2, 5.0)
    assert photometry.luminance(photometry.retroreflection(table.pick(channels[:1]), 0.2, 5.0)) > 0.9
