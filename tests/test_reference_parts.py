"""The bundles of formulas that lobes are made of: what one lacks is an error that names it, and no two are taken for
one another where their machine code is kept."""

from __future__ import annotations

import copy
import dataclasses
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mrm_nodes import reference as ref
from mrm_nodes.reference import block, checks, fresnel, kernels, lobe, masking, microsurface, parts
from mrm_nodes.reference.compiled import KERNELS, inlined, named, run

V = np.array([0.48, 0.36, 0.8])
L = np.array([-0.6, 0.0, 0.8])
U = np.array([0.3, 0.6, 0.9])


@pytest.fixture
def half_implemented(monkeypatch: pytest.MonkeyPatch) -> None:
    """A distribution that has its normals, and nothing that Smith's masking asks for."""
    known = microsurface.microsurface

    def find(distribution: str, is_sheared: bool = False) -> microsurface.Microsurface:
        if distribution != "half":
            return known(distribution, is_sheared)
        whole = known("ggx", is_sheared)
        return dataclasses.replace(whole, name="half", seen=None, visible_normal=None)

    monkeypatch.setattr(lobe, "microsurface", find)
    monkeypatch.setitem(checks.DISTRIBUTIONS, "half", "half")
    lobe.facets.cache_clear()
    yield
    lobe.facets.cache_clear()


@pytest.mark.parametrize("question", ["eval", "pdf", "sample", "albedo"])
def test_a_distribution_that_is_half_implemented(half_implemented: None, question: str):
    asked = {"sample": (V, U), "albedo": (V,)}.get(question, (V, L))
    for scatter in ("R", "RT"):
        half = ref.Dielectric(1.5, 0.3, distribution="half", scatter_mode=scatter)
        with pytest.raises(NotImplementedError, match=r"half: there is no .*which Smith's masking asks for"):
            getattr(half, question)(*asked)


def test_what_needs_nothing_that_is_missing_is_answered(half_implemented: None):
    half = ref.Conductor(0.2, 3.0, 0.3, distribution="half", masking="vcavity")
    whole = ref.Conductor(0.2, 3.0, 0.3, masking="vcavity")
    assert half.eval(V, L).tolist() == whole.eval(V, L).tolist()


@pytest.mark.parametrize(
    ("make", "missing"),
    [
        (lambda: microsurface.microsurface("phong").wanted("seen"), "phong: there is no projected area"),
        (
            lambda: microsurface.microsurface("phong").wanted("visible_normal"),
            "phong: there is no way to draw",
        ),
        (lambda: microsurface.microsurface("phong", True), "phong: there is no way to shear its slopes"),
        (lambda: microsurface.microsurface("cauchy"), "cauchy: there is no distribution of that name"),
        (lambda: masking.masking_of("cauchy", "height"), "cauchy: there is no masking of that name"),
        (
            lambda: masking.masking_of("smith", "cauchy"),
            "smith, cauchy: there is no correlation of that name",
        ),
        (
            lambda: lobe.refraction(lobe.facets("ggx", "kelemen", "height", False)),
            "ggx straight, kelemen: there is no G2 of v and l on opposite sides",
        ),
    ],
)
def test_what_a_bundle_lacks_is_named(make, missing: str):
    with pytest.raises(NotImplementedError, match=missing):
        make()


def test_a_kernel_refuses_a_part_that_it_was_not_given():
    modes = block.Modes(kind=fresnel.CONDUCTOR, compensation=0, scatter=block.REFLECT, retro_transmission=0)
    whole = ref.Conductor(0.2, 3.0, 0.3)
    inputs = [V, L, *whole._parameters]
    with pytest.raises(NotImplementedError, match="a part that was not asked for"):
        run(kernels.EVALUATE, inputs, modes, [3], [whole._table])


def test_no_two_that_are_compiled_have_one_name():
    made = [
        parts.part(name, lobe.facets(distribution, mask, correlation, is_sheared))
        for distribution in ("ggx", "beckmann", "beckmann-rational")
        for mask in ("smith", "vcavity")
        for correlation in checks.CORRELATIONS
        for is_sheared in (False, True)
        for name in parts.names_of("sample", block.BOTH) + parts.names_of("albedo", block.BOTH)
    ]
    different = set(map(id, made))
    # V-cavities know no correlation, and normals are drawn whatever the correlation is.
    assert len({each.name for each in made}) <= len(different)
    names = [each.name for each in KERNELS]
    assert len(set(names)) == len(names)


def test_a_name_says_of_what_a_formula_is_made():
    @inlined
    @named("ggx straight", "smith height")
    def density(x: float) -> float:
        return x

    assert density.__name__ == "density_ggx_straight_smith_height"


_ASK = """
import sys
from mrm_nodes import reference as ref
for name in sys.argv[1:]:
    lobe = ref.Conductor(0.2, 3.0, 0.3, 0.4, distribution=name, correlation="separable")
    print(name, lobe.eval((0.48, 0.36, 0.8), (-0.6, 0.0, 0.8)).tolist())
"""


def test_a_second_process_compiles_nothing_and_reads_what_the_first_one_kept(tmp_path: Path, monkeypatch):
    """In another order than that in which two others compiled, and none is taken for another."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))

    def ask(*names: str) -> list[str]:
        asked = [sys.executable, "-c", _ASK, *names]
        return subprocess.run(asked, capture_output=True, text=True, check=True).stdout.splitlines()

    alone = ask("ggx") + ask("beckmann")
    kept = {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.nb?")}
    assert len(kept) >= 8
    assert ask("beckmann", "ggx") == alone[::-1]
    assert {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.nb?")} == kept


def test_a_distribution_is_found_by_its_name():
    kinds = {
        "ggx": ref.GGX,
        "beckmann": ref.Beckmann,
        "beckmann-rational": ref.BeckmannRational,
        "phong": ref.Phong,
    }
    assert set(kinds) == set(checks.DISTRIBUTIONS)
    for name, kind in kinds.items():
        assert type(ref.distribution(name, 0.3)) is kind
        assert ref.distribution(name, 0.3, 0.2).D(V) == kind(0.3, 0.2).D(V)
    assert ref.distribution("ggx", 0.3, 0.2, 0.4, 0.1).D(V) == ref.GGX(0.3, 0.2, 0.4, 0.1).D(V)
    for name, slopes in (("cauchy", ()), ("phong", (0.4,))):
        with pytest.raises(ValueError, match=r"must be"):
            ref.distribution(name, 0.3, 0.3, *slopes)


def test_a_distribution_that_has_no_class_of_its_own_is_one_by_its_name(monkeypatch):
    monkeypatch.setitem(microsurface.DISTRIBUTIONS, "other", microsurface.DISTRIBUTIONS["beckmann"])
    monkeypatch.setitem(checks.DISTRIBUTIONS, "other", "other")
    found = ref.distribution("other", 0.3, 0.2)
    assert repr(found) == "distribution('other', ax=0.3, ay=0.2)"
    assert found.D(V) == ref.Beckmann(0.3, 0.2).D(V)
    lobe_of = ref.Conductor(0.2, 3.0, 0.3, distribution="other", energy_compensation="materialx-1.39.5")
    assert np.all(
        lobe_of.eval(V, L)
        == ref.Conductor(0.2, 3.0, 0.3, distribution="beckmann", energy_compensation="materialx-1.39.5").eval(
            V, L
        )
    )


def test_a_lobe_that_was_asked_can_be_copied_and_sent_to_another_process():
    asked = ref.Conductor(0.2, 3.0, 0.3, 0.4)
    value = asked.eval(V, L)
    for copied in (pickle.loads(pickle.dumps(asked)), copy.deepcopy(asked)):
        assert np.array_equal(copied.eval(V, L), value)
