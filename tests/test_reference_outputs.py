"""What the evaluator writes and how it is run: vectors, figures, threads, and memory."""

import json
import math
import os
import shutil
import subprocess

import numpy as np
import pytest

from mrm_nodes import reference as ref
from mrm_nodes.reference import bench, compiled, figures, vectors


def test_vectors_can_be_read_back_and_say_what_the_evaluator_says(written):
    target, schema, page = written
    content = json.loads(target.read_text())
    assert content["version"] == json.loads(schema.read_text())["properties"]["version"]["const"]
    assert target.name in page.read_text()
    seen = set()
    for case in content["cases"]:
        lobe = getattr(ref, case["lobe"])(**case["parameters"])
        seen.add((case["lobe"], case["parameters"].get("distribution", "ggx")))
        for point in case["points"]:
            v, l = np.array(point["v"]), np.array(point["l"])  # noqa: E741
            np.testing.assert_allclose(lobe.eval(v, l), point["eval"], rtol=1e-12, atol=1e-300)
            assert lobe.pdf(v, l) == pytest.approx(point["pdf"], rel=1e-12)
            drawn = lobe.sample(v, point["u"])
            np.testing.assert_allclose(drawn.l, point["sample"]["l"], rtol=1e-12)
            assert bool(drawn.delta) is point["sample"]["delta"]
    assert len(seen) == 9
    # Half of the lights lie on the lobe: the file is not a list of zeros.
    assert (
        sum(max(p["eval"]) > 0.1 for c in content["cases"] for p in c["points"]) > len(content["cases"]) / 2
    )


#: A conductor as someone else would write it, for the examples to check: GGX with Smith's height-correlated term.
C_CONDUCTOR = """
#include <array>
#include <cmath>
#include <complex>
#include <cstdlib>
typedef std::array<double, 3> Three;
double fresnel(double c, double n, double k) {
    std::complex<double> e(n, k), g = std::sqrt(e * e - 1.0 + c * c);
    double wrong = std::getenv("WRONG") ? 1.002 : 1.0;
    return wrong * 0.5 * (std::norm((c - g) / (c + g)) + std::norm((e * e * c - g) / (e * e * c + g)));
}
double area(Three w, std::array<double, 2> a) {
    return 0.5 * (w[2] + std::sqrt(w[2] * w[2] + a[0] * a[0] * w[0] * w[0] + a[1] * a[1] * w[1] * w[1]));
}
Three lobe(Three n, Three k, std::array<double, 2> a, Three v, Three l) {
    double x = v[0] + l[0], y = v[1] + l[1], z = v[2] + l[2], c = 0.5 * std::sqrt(x * x + y * y + z * z);
    double q = std::pow(x / a[0], 2) + std::pow(y / a[1], 2) + z * z, av = area(v, a), al = area(l, a);
    double d = 16 * c * c * c * c / (M_PI * a[0] * a[1] * q * q) / (4 * (av * l[2] + al * v[2] - v[2] * l[2]));
    return {d * fresnel(c, n[0], k[0]), d * fresnel(c, n[1], k[1]), d * fresnel(c, n[2], k[2])};
}
Three my_conductor(Three n, Three k, std::array<double, 2> a, double retro, Three v, Three l) {
    Three f = lobe(n, k, a, v, l), g = lobe(n, k, a, {-v[0], -v[1], v[2]}, l);
    for (int i = 0; i < 3; ++i) f[i] = (1 - retro) * f[i] + retro * g[i];
    return f;
}
"""
JS_CONDUCTOR = """
const sq = (x) => x * x, wrong = process.env.WRONG ? 1.002 : 1;
function fresnel(c, n, k) {
  const s = 1 - c * c, t = n * n - k * k - s, m = Math.hypot(t, 2 * n * k), a = Math.sqrt((m + t) / 2);
  const rs = (m + c * c - 2 * a * c) / (m + c * c + 2 * a * c);
  return wrong * rs * (1 + (c * c * m + s * s - 2 * a * c * s) / (c * c * m + s * s + 2 * a * c * s)) / 2;
}
const area = (w, a) => (w[2] + Math.sqrt(sq(w[2]) + sq(a[0] * w[0]) + sq(a[1] * w[1]))) / 2;
function lobe(n, k, a, v, l) {
  const [x, y, z] = v.map((e, i) => e + l[i]), c = Math.sqrt(x * x + y * y + z * z) / 2;
  const q = sq(x / a[0]) + sq(y / a[1]) + z * z, g = area(v, a) * l[2] + area(l, a) * v[2] - v[2] * l[2];
  return n.map((e, i) => 4 * c ** 4 / (Math.PI * a[0] * a[1] * q * q * g) * fresnel(c, e, k[i]));
}
function my_conductor(n, k, a, retro, v, l) {
  const g = lobe(n, k, a, [-v[0], -v[1], v[2]], l);
  return lobe(n, k, a, v, l).map((e, i) => (1 - retro) * e + retro * g[i]);
}
"""


def example(page, language):
    """A program of the page."""
    return page.read_text().split(f"```{language}\n")[1].split("```")[0]


def program(name):
    found = shutil.which(name)
    return found or pytest.skip(f"{name} is not installed")


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return vectors.write_vectors(tmp_path_factory.mktemp("vectors") / "vectors.json", points=2)


def said_by(command, folder):
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    return run.stdout


def test_the_cpp_example_accepts_a_right_conductor_and_names_what_is_wrong(written):
    compiler, (target, _, page) = program("g++"), written
    if subprocess.run([compiler, "-E", "-include", "nlohmann/json.hpp", "-x", "c++", os.devnull],
                      capture_output=True, check=False).returncode:  # fmt: skip
        pytest.skip("nlohmann/json is not installed")
    target.with_name("check.cpp").write_text(C_CONDUCTOR + example(page, "cpp"))
    said_by([compiler, "-std=c++17", "-o", "check", "check.cpp"], target.parent)
    assert said_by(["./check"], target.parent) == ""
    assert "Conductor: ior" in said_by(["env", "WRONG=1", "./check"], target.parent)


def test_the_javascript_example_accepts_a_right_conductor_and_names_what_is_wrong(written):
    node, (target, _, page) = program("node"), written
    target.with_name("check.js").write_text(JS_CONDUCTOR + example(page, "js"))
    assert said_by([node, "check.js"], target.parent) == ""
    assert "Conductor: ior" in said_by(["env", "WRONG=1", node, "check.js"], target.parent)


def test_the_glsl_example_compiles(written):
    compiler, (target, _, page) = program("glslangValidator"), written
    stub = "vec3 my_mrm_eval(vec3 v, vec3 l, vec2 alpha, float retroreflectivity) { return v + l; }\nvoid main() {"
    source = target.with_name("check.frag")
    source.write_text(example(page, "glsl").replace("void main() {", stub))
    said_by([compiler, source.name], target.parent)


def test_vectors_cover_every_lobe_distribution_weight_and_side(written):
    cases = json.loads(written[0].read_text())["cases"]
    seen = {
        (c["lobe"], p["distribution"], p["masking"], p["retroreflectivity"])
        for c in cases
        if {"distribution", "masking", "retroreflectivity"} <= (p := c["parameters"]).keys()
    }
    assert seen == {
        (lobe, *pair, share)
        for lobe in vectors.CLASSES
        for pair in vectors.PAIRS
        for share in (0.0, 0.3, 1.0)
    }
    sides = {(c["lobe"], p["v"][2] > 0.0, p["l"][2] > 0.0) for c in cases for p in c["points"]}
    through = {
        (lobe, up, lit) for lobe in ("Dielectric", "GeneralizedSchlick") for up in (0, 1) for lit in (0, 1)
    }
    assert sides == {("Conductor", True, True)} | through


def test_vectors_follow_their_schema(written):
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.validate(json.loads(written[0].read_text()), json.loads(written[1].read_text()))


def test_figure_2_has_its_features():
    """Both lobes have one shape, peaks mirror each other, and Lambert is 1/π (001, "BRDF comparison")."""
    for panel in figures.figure_2():
        curves = {curve.label: curve for curve in panel.curves}
        x = curves["Lambert"].x
        # Where the sine is not 0 at the horizon: the view is above the surface.
        assert curves["Lambert"].y[len(x) // 2] == pytest.approx(1.0 / math.pi)
        if "φ = 0°" in panel.title:
            retro, forward = (curves[f"{name}, roughness 0.1"].y for name in ("MRM", "GGX"))
            np.testing.assert_allclose(retro, forward[::-1], rtol=1e-9)
            theta_i = float(panel.title.split("= ")[1].split("°")[0])
            assert x[np.argmax(retro)] == pytest.approx(theta_i, abs=1.0)


def test_heitzs_table_3_is_reproduced():
    assert [physical for _, _, physical in figures.heitz_table_3()] == [True, True, False, False, False]


def test_figures_are_drawn(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(figures, "FIGURES", {"heitz_figure_12": figures.heitz_figure_12})
    names = {path.name for path in figures.write_figures(tmp_path)}
    assert names == {
        f"heitz_{what}.{kind}" for what in ("figure_12", "table_3") for kind in ("png", "svg", "csv")
    }
    assert all((tmp_path / name).stat().st_size > 0 for name in names)


def test_the_bench_measures_every_question():
    rows = list(bench.measure(count=1 << 9, repeats=1))
    assert {row.question for row in rows} == {"eval", "pdf", "sample", "albedo", "table"}
    assert all(row.rate > 0.0 for row in rows)
    assert any(row.subject.startswith("NumPy") for row in rows)


def test_the_first_draft_in_numpy_agrees():
    rng = np.random.default_rng(2)
    v, l = bench._directions(rng, 200), bench._directions(rng, 200)  # noqa: E741
    lobe = ref.Conductor(bench.IOR, bench.EXTINCTION, 0.3, correlation="separable")
    np.testing.assert_allclose(bench.numpy_conductor(v, l, 0.3), lobe.eval(v, l), rtol=1e-11)


def test_results_do_not_depend_on_the_number_of_threads():
    rng = np.random.default_rng(3)
    v, l = bench._directions(rng, 50_001), bench._directions(rng, 50_001)  # noqa: E741
    lobe = ref.Conductor(0.2, 3.9, 0.3, 0.5)
    whole = lobe.eval(v, l)
    compiled.set_thread_count(1)
    try:
        np.testing.assert_array_equal(lobe.eval(v, l), whole)
    finally:
        compiled.set_thread_count(None)
    # Lanes that pad a block change nothing either.
    np.testing.assert_array_equal(lobe.eval(v[7:20], l[7:20]), whole[7:20])


def test_inputs_are_neither_copied_nor_changed():
    """A view with any strides is read as it lies, and float32 is only widened."""
    rng = np.random.default_rng(4)
    planes = np.ascontiguousarray(bench._directions(rng, 4096).T)
    v = planes.T
    v.flags.writeable = False
    before = planes.copy()
    lobe = ref.Dielectric(1.5, 0.3, retroreflectivity=0.5)
    strided = lobe.eval(v, v[::-1])
    np.testing.assert_array_equal(planes, before)
    np.testing.assert_array_equal(strided, lobe.eval(np.ascontiguousarray(v), np.ascontiguousarray(v[::-1])))
