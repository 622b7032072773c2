"""The test vectors: what they say, their schema, their page, and the examples that read them."""

import copy
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mrm_nodes import reference as ref
from mrm_nodes.cli import main
from mrm_nodes.library import root_path
from mrm_nodes.reference import vectors
from mrm_nodes.render import probe_backends

DOCS = root_path() / "docs"
BACKENDS = [probe.backend for probe in probe_backends() if probe.works]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return vectors.write_vectors(tmp_path_factory.mktemp("vectors") / "vectors.json", DOCS)


def test_vectors_can_be_read_back_and_say_what_the_evaluator_says(written):
    target, schema = written[:2]
    content = json.loads(target.read_text())
    assert content["version"] == json.loads(schema.read_text())["properties"]["version"]["const"]
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


def test_vectors_cover_every_lobe_distribution_weight_and_side(written):
    cases = json.loads(written[0].read_text())["cases"]
    seen = {
        (c["lobe"], *(c["parameters"][name] for name in ("distribution", "masking", "retroreflectivity")))
        for c in cases
    }
    assert seen >= {
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


def test_the_rule_comes_first(written):
    text = written[0].read_text()
    assert next(iter(json.loads(text))) == "rule"
    page = written[2].read_text()
    for part in ("2 (n·v) n − v", "`D`, `G`, `F` and `pdf`"):
        assert part in page[:400]
    for part in ("2 (n.v) n - v", "D, G, F and pdf"):
        assert part in vectors.RULE


def test_the_command_says_the_rule(capsys):
    with pytest.raises(SystemExit):
        main(["vectors", "--help"])
    assert "v' = 2 (n.v) n - v" in " ".join(capsys.readouterr().out.split())


def test_what_the_written_page_links_to_lies_beside_it(written):
    page = written[2]
    links = re.findall(r"\]\(([\w.-]+/[\w.-]+)\)", page.read_text("utf-8"))
    assert {Path(link).name for link in links} >= {
        "check.py",
        "check.cpp",
        "check.js",
        "mrm.glsl",
        "check_glsl.py",
    }
    assert all((page.parent / link).is_file() for link in links)


def sample_of(content):
    """A case of each lobe, with a point each: everything that the schema tells apart."""
    first = {case["lobe"]: case for case in reversed(content["cases"])}
    return content | {"cases": [case | {"points": case["points"][:1]} for case in first.values()]}


def keys_of(tree, path=()):
    """The path of each key, at any depth."""
    children = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in children:
        if isinstance(tree, dict):
            yield (*path, key)
        yield from keys_of(value, (*path, key))


def parent_of(tree, path):
    for key in path[:-1]:
        tree = tree[key]
    return tree


def test_the_schema_rejects_each_missing_key_and_each_foreign_one(written):
    jsonschema = pytest.importorskip("jsonschema")
    content, schema = (json.loads(path.read_text()) for path in written[:2])
    validator = jsonschema.Draft202012Validator(schema)
    validator.validate(content)
    small = sample_of(content)
    assert {case["lobe"] for case in small["cases"]} == set(vectors.CLASSES) and validator.is_valid(small)
    paths = list(keys_of(small))
    assert len(paths) > 250
    for path in paths:
        broken = copy.deepcopy(small)
        del parent_of(broken, path)[path[-1]]
        assert not validator.is_valid(broken), path
        parent_of(broken, path)[f"{path[-1]} "] = parent_of(small, path)[path[-1]]
        assert not validator.is_valid(broken), path


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("alpha", 0.3),
        ("alpha", [0.0, 0.3]),
        ("masking", "smyth"),
        ("retroreflectivity", 1.1),
        ("tint", [1, 1]),
    ],
)
def test_the_schema_rejects_what_is_no_value(written, name, value):
    jsonschema = pytest.importorskip("jsonschema")
    small = copy.deepcopy(sample_of(json.loads(written[0].read_text())))
    case = next(each for each in small["cases"] if name in each["parameters"])
    case["parameters"][name] = value
    assert not jsonschema.Draft202012Validator(json.loads(written[1].read_text())).is_valid(small)


def test_every_parameter_of_every_case_has_a_unit_and_its_default(written):
    content = json.loads(written[0].read_text())
    for case in content["cases"]:
        described = content["lobes"][case["lobe"]]
        assert list(case["parameters"]) == list(described)
        given = {name: case["parameters"][name] for name, each in described.items() if each["required"]}
        defaults = {name: each["default"] for name, each in described.items() if not each["required"]}
        point = case["points"][0]
        # A default means what leaving it out means.
        left_out = {n: v for n, v in case["parameters"].items() if n in given or v != defaults[n]}
        assert ref.__dict__[case["lobe"]](**left_out).eval(point["v"], point["l"]).tolist() == point["eval"]


def test_the_page_has_the_table_of_parameters_and_every_convention():
    page = (DOCS / "vectors.md").read_text("utf-8")
    for lobe in vectors.lobes().values():
        for name, described in lobe.items():
            row = next(line for line in page.splitlines() if line.startswith(f"| `{name}` |"))
            default = "required" if described["required"] else f"`{json.dumps(described['default'])}`"
            assert default in row and described["unit"] in row and described["meaning"] in row
    for name, meaning in vectors.CONVENTIONS.items():
        assert f"- **{name}**: {meaning}" in page


def numpy_of_the_page():
    return (DOCS / "vectors.md").read_text("utf-8").split("```python\n")[1].split("```")[0]


def test_the_numpy_of_the_page_has_thirty_lines_and_is_the_examples():
    source = numpy_of_the_page()
    assert source == (DOCS / "examples/vectors/mrm.py").read_text("utf-8")
    lines = [
        line for line in source.splitlines() if line.strip() and not line.startswith(("#", "import", "from"))
    ]
    assert len(lines) <= 30


def is_in_thirty_lines(parameters, point):
    """What the page says of its NumPy: reflection from outside, without what only some renderers have."""
    plain = {
        "correlation": "height",
        "energy_compensation": None,
        "thinfilm_thickness": 0.0,
        "slope_correlation": 0.0,
    }
    reflected = point["v"][2] > 0.0 and point["l"][2] > 0.0
    return reflected and all(parameters[name] == value for name, value in plain.items())


def test_the_numpy_of_the_page_agrees_with_the_vectors_to_1e_14(written):
    """Relative, or of 1e-4: exp(-600) rounds with its argument, on either side."""
    names = {}
    exec(numpy_of_the_page(), names)
    met, weights = set(), set()
    for case in json.loads(written[0].read_text())["cases"]:
        p = case["parameters"]
        for point in case["points"]:
            if not is_in_thirty_lines(p, point):
                continue
            f, pdf = names["mrm"](p, np.array(point["v"]), np.array(point["l"]))
            for found, expected in ((f, np.array(point["eval"])), (pdf, point["pdf"])):
                assert np.all(abs(found - expected) <= 1e-14 * np.maximum(expected, 1e-4)), case["name"]
            met.add((case["lobe"], p["distribution"], p["masking"]))
            weights.add(p["retroreflectivity"])
    assert met == {(lobe, *pair) for lobe in vectors.CLASSES for pair in vectors.PAIRS}
    assert weights >= {0.0, 0.3, 1.0}


# The examples. Each is run as it is, and with faults that people make.

MIRROR_LEFT_OUT, SQUARED_TWICE = "the mirrored direction left out", "alpha squared twice"
FAULTS = {
    "mrm.py": {
        MIRROR_LEFT_OUT: ("2 * (n @ v) * n - v", "v"),
        SQUARED_TWICE: ('= p["alpha"]', '= np.square(p["alpha"])'),
    },
    "check.cpp": {
        MIRROR_LEFT_OUT: ("{-v[0], -v[1], v[2]}", "v"),
        SQUARED_TWICE: ("double c =", "for (double& a : alpha) a *= a; double c ="),
    },
    "mrm.glsl": {
        MIRROR_LEFT_OUT: ("2.0 * dot(n, v) * n - v", "v"),
        SQUARED_TWICE: ("vec3 h = v + l;", "vec3 h = v + l; alpha *= alpha;"),
    },
    "check.js": {
        MIRROR_LEFT_OUT: ("[-v[0], -v[1], v[2]]", "v"),
        SQUARED_TWICE: ("const h =", "alpha = alpha.map(square); const h ="),
    },
}


def required(name, reason):
    """Skip; a failure where MRM_REQUIRE_COMPILERS has the name."""
    assert name not in os.environ.get("MRM_REQUIRE_COMPILERS", "").split(","), reason
    pytest.skip(reason)


def program(*names, needed_by):
    """A program by one of its names; C++ comes with `cc`, JavaScript with `essl`, which is a browser's too."""
    found = next(filter(None, map(shutil.which, names)), None)
    return found or required(needed_by, f"{' or '.join(names)} is not installed")


def command_of(source, folder):
    """What runs an example, compiled first where that has to be."""
    if source == "check.js":
        return [program("node", needed_by="essl"), "check.js"]
    if source == "check.cpp":
        compiler = program("g++", "clang++", needed_by="cc")
        header = [compiler, "-E", "-include", "nlohmann/json.hpp", "-x", "c++", os.devnull]
        if subprocess.run(header, capture_output=True, check=False).returncode:
            required("cc", "nlohmann/json is not installed")
        subprocess.run([compiler, "-std=c++17", "check.cpp", "-o", "check"], cwd=folder, check=True)
        return ["./check"]
    if source == "mrm.glsl":
        if not BACKENDS:
            pytest.skip("no backend works")
        return [sys.executable, "check_glsl.py"]
    return [sys.executable, "check.py"]


def run(source, folder, file, *arguments):
    command = [*command_of(source, folder), str(file), *arguments]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300, check=False
    )
    assert not done.stderr, done.stderr
    return done.returncode, done.stdout


def copy_of(written, folder):
    return shutil.copytree(written[0].with_name("vectors-examples"), folder / "examples")


@pytest.mark.parametrize("source", FAULTS)
def test_an_example_agrees_with_the_vectors(written, tmp_path, source):
    folder = copy_of(written, tmp_path)
    for backend in BACKENDS if source == "mrm.glsl" else [None]:
        status, said = run(source, folder, written[0], *filter(None, [backend]))
        points = int(said.split(" of ")[-1].split()[0])
        assert (status, said) == (0, f"{points} of {points} points agree\n") and points >= 48


@pytest.mark.parametrize("fault", [MIRROR_LEFT_OUT, SQUARED_TWICE])
@pytest.mark.parametrize("source", FAULTS)
def test_an_example_names_a_fault(written, tmp_path, source, fault):
    folder = copy_of(written, tmp_path)
    right, wrong = FAULTS[source][fault]
    text = (folder / source).read_text("utf-8")
    assert text.count(right) == 1
    (folder / source).write_text(text.replace(right, wrong), "utf-8")
    status, said = run(source, folder, written[0])
    assert status == 1 and "Conductor: ior" in said
    # Where nothing is retroreflective, leaving the mirror out is no fault.
    assert ("retroreflectivity 0.0" in said) is (fault == SQUARED_TWICE)
