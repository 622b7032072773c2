"""What is registered and not implemented is an error wherever it is asked for, and never another's answer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mrm_nodes import reference as ref
from mrm_nodes.reference import checks, image_light
from mrm_nodes.reference.energy import white_albedo_table
from mrm_nodes.reference.image_light import EXACT, Map

V = np.array([0.48, 0.36, 0.8])
L = np.array([-0.6, 0.0, 0.8])
BELOW = np.array([-0.6, 0.0, -0.8])
U = np.array([0.3, 0.6, 0.9])
REGISTERED = "registered"
FIELDS = {"distribution": "DISTRIBUTIONS", "masking": "MASKINGS", "correlation": "CORRELATIONS"}


class Registered(ref.GGX):
    """A distribution of which there is no more than its name."""

    _distribution = REGISTERED


@pytest.fixture(autouse=True)
def _registered(monkeypatch: pytest.MonkeyPatch) -> None:
    for names in FIELDS.values():
        monkeypatch.setitem(getattr(checks, names), "registered", REGISTERED)


def lobes(**given: Any) -> list[ref.Lobe]:
    """Reflecting, and what reflects and transmits where that has a meaning."""
    made: list[ref.Lobe] = [
        ref.Conductor((0.2, 0.9, 1.1), 3.0, 0.3, **given),
        ref.GeneralizedSchlick(0.5, alpha=(0.3, 0.2), retroreflectivity=0.5, **given),
    ]
    if "masking" not in given:
        made.append(ref.Dielectric(1.5, 0.3, scatter_mode="RT", **given))
    return made


QUESTIONS: dict[str, Callable[[Any], Any]] = {
    "eval": lambda lobe: lobe.eval(V, L),
    "eval across": lambda lobe: lobe.eval(V, BELOW),
    "pdf": lambda lobe: lobe.pdf(V, L),
    "sample": lambda lobe: lobe.sample(V, U),
    "albedo": lambda lobe: lobe.albedo(V),
    "many at once": lambda lobe: lobe.eval(np.tile(V, (200, 1)), np.tile(L, (200, 1))),
}


@pytest.mark.parametrize("question", QUESTIONS)
def test_a_lobe_of_a_distribution_that_is_only_registered(question: str):
    for masking in ("smith", "vcavity"):
        # With a masking nothing transmits here.
        for lobe in lobes(distribution="registered") + lobes(distribution="registered", masking=masking):
            with pytest.raises(NotImplementedError, match=r"registered, .*: there is no "):
                QUESTIONS[question](lobe)


@pytest.mark.parametrize("field", ["masking", "correlation"])
@pytest.mark.parametrize("question", ["eval", "sample", "albedo", "many at once"])
def test_a_lobe_of_a_masking_that_is_only_registered(field: str, question: str):
    for lobe in lobes(**{field: "registered"}):
        with pytest.raises(NotImplementedError, match=r"registered.*: there is no "):
            QUESTIONS[question](lobe)


@pytest.mark.parametrize("scheme", ["materialx-1.39.5", "turquin", "kulla-conty"])
def test_a_compensation_of_what_is_only_registered(scheme: str):
    lobe = ref.Conductor(0.2, 3.0, 0.3, distribution="registered", energy_compensation=scheme)
    with pytest.raises(NotImplementedError, match="there is no "):
        lobe.eval(V, L)
    with pytest.raises(NotImplementedError):
        white_albedo_table(REGISTERED, "smith", "height")


def test_a_layer_of_what_is_only_registered():
    with pytest.raises(NotImplementedError, match="registered: there is no fit of its albedo"):
        ref.Leaf(ref.Dielectric(1.5, 0.3, distribution="registered")).throughput(V, L)


@pytest.mark.parametrize("method", ["D", "Lambda", "G1", "G2", "sample_visible", "pdf_visible"])
def test_a_distribution_that_is_only_registered(method: str):
    asked = {"D": (V,), "Lambda": (V,), "G1": (V, L), "G2": (V, L, L), "sample_visible": (V, U[:2])}
    with pytest.raises(NotImplementedError, match="Registered: there is no "):
        getattr(Registered(0.3), method)(*asked.get(method, (V, L)))


def test_maskings_of_a_known_distribution_that_are_only_registered():
    with pytest.raises(NotImplementedError, match=r"GGX: there is no G1: .*registered: there is no masking"):
        ref.GGX(0.3).G1(V, L, "registered")
    for cls in (ref.GGX, ref.Phong):
        with pytest.raises(NotImplementedError, match="registered: there is no correlation"):
            cls(0.3).G2(V, L, L, correlation="registered")


def test_image_light_of_what_is_only_registered():
    around = Map(np.ones((2, 3)), np.array([[0.0, 1.0, 2.0]]))
    lobe = ref.Conductor(0.2, 3.0, 0.3, distribution="registered")
    with pytest.raises(NotImplementedError):
        image_light.filtered_samples(lobe, V[None], np.eye(3)[None], around, 4, 1, EXACT)
