"""Test vectors for those who put MRM into another renderer: inputs and results in one JSON file.

The file begins with the rule and with what each number means. Each case is self-contained: the lobe's class and all
of its parameters, and for each configuration v, l, eval and pdf, then u with the direction, weight and density that
`sample` gives, and the directional albedo."""

import inspect
import json
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .bsdf import Conductor, Dielectric, GeneralizedSchlick, Lobe
from .checks import COMPENSATIONS, CORRELATIONS, DISTRIBUTIONS, PAIRS, SCATTER_MODES
from .compiled import Array

SCHEMA = "https://json-schema.org/draft/2020-12/schema"
#: Raised when a reader of the file would have to change.
VERSION = 2

CLASSES: dict[str, type[Lobe]] = {
    "Conductor": Conductor,
    "Dielectric": Dielectric,
    "GeneralizedSchlick": GeneralizedSchlick,
}

RULE = (
    "A retroreflective lobe is the forward lobe seen from v' = 2 (n.v) n - v: D, G, F and pdf are those of v' and l. "
    "With r the retroreflectivity, f = (1 - r) f(v, l) + r f(v', l), and the pdf likewise. "
    "A transmitted lobe follows it only where retro_transmission is true."
)

CONVENTIONS = {
    "frame": "normal n = +z, tangent +x; v and l are unit vectors away from the surface: v' = (-v.x, -v.y, v.z)",
    "eval": "f in 1/sr, RGB, without the cosine; v.z < 0 is seen from inside, where the index is ior; "
    "l on the other side of the surface than v is transmitted radiance",
    "pdf": "1/sr, of the l that sample draws for v",
    "alpha": "microfacet width along the tangent and across, no unit; a perceptual roughness r has alpha r * r",
    "sample": "of u, three uniforms in [0, 1); weight is f |l.z| / pdf, RGB, no unit; a rejected sample has weight 0 "
    "and pdf 0; where delta is true, pdf is a probability",
    "albedo": "energy reflected and transmitted for v, RGB, no unit, by quadrature to 3e-4",
    "precision": "eval and pdf are float64 and hold to 1e-12; compare a float32 renderer to 5e-6 / alpha",
}

_NUMBER = {"type": "number"}
_POSITIVE = {"type": "number", "exclusiveMinimum": 0}
_NOT_NEGATIVE = {"type": "number", "minimum": 0}


def _array(item: dict[str, Any], length: int) -> dict[str, Any]:
    return {"type": "array", "items": item, "minItems": length, "maxItems": length}


class _Parameter(NamedTuple):
    """What a parameter of a lobe is: its JSON schema, unit and meaning."""

    schema: dict[str, Any]
    unit: str
    meaning: str


_VECTOR = _array(_NUMBER, 3)
_COLOUR = _array(_NOT_NEGATIVE, 3)
_PARAMETERS: dict[str, _Parameter] = {
    "ior": _Parameter(
        {"anyOf": [_POSITIVE, _array(_POSITIVE, 3)]},
        "none: relative to the outside, which has 1",
        "index of refraction of the inside: RGB for a Conductor, one number for a Dielectric",
    ),
    "extinction": _Parameter(_COLOUR, "none: relative to the outside", "imaginary part of the index, RGB"),
    "color0": _Parameter(_COLOUR, "none", "reflectance at normal incidence, RGB"),
    "color82": _Parameter(_COLOUR, "none", "factor on the reflectance where the cosine is 1/7, RGB"),
    "color90": _Parameter(_COLOUR, "none", "reflectance at grazing incidence, RGB"),
    "exponent": _Parameter(_NOT_NEGATIVE, "none", "of Schlick's curve"),
    "alpha": _Parameter(_array(_POSITIVE, 2), "none", "microfacet width along the tangent, and across"),
    "tint": _Parameter(_COLOUR, "none", "factor on reflection and transmission, RGB"),
    "scatter_mode": _Parameter({"enum": list(SCATTER_MODES)}, "", "reflection, transmission or both"),
    "retro_transmission": _Parameter({"type": "boolean"}, "", "whether transmission is turned too"),
    "retroreflectivity": _Parameter(
        {"type": "number", "minimum": 0, "maximum": 1}, "none", "share r of the retroreflective lobe"
    ),
    "distribution": _Parameter(
        {"enum": list(DISTRIBUTIONS)}, "", "of microfacet normals; phong's exponent is 2 / alpha^2 - 2"
    ),
    "masking": _Parameter({"enum": ["smith", "vcavity"]}, "", "G1; phong's is always vcavity"),
    "correlation": _Parameter({"enum": list(CORRELATIONS)}, "", "G2 of Smith's two G1"),
    "energy_compensation": _Parameter(
        {"enum": list(COMPENSATIONS)}, "", "of lost multiple scattering; null: none"
    ),
    "thinfilm_thickness": _Parameter(_NOT_NEGATIVE, "nm", "of a film on the surface; 0: none"),
    "thinfilm_ior": _Parameter(_POSITIVE, "none: relative to the outside", "index of refraction of the film"),
    "slope_correlation": _Parameter(
        {"type": "number", "exclusiveMinimum": -1, "exclusiveMaximum": 1},
        "none",
        "correlation of the slopes along the tangent and across",
    ),
    "mean_slope": _Parameter(_array(_NUMBER, 2), "none", "mean slope along the tangent, and across"),
}
"""In the file colours are always RGB and alpha a pair, so that a reader meets one shape of each."""


def _signature(lobe: str) -> dict[str, inspect.Parameter]:
    return dict(inspect.signature(CLASSES[lobe]).parameters)


def _complete(lobe: str, given: dict[str, Any]) -> dict[str, Any]:
    """All parameters of a lobe, in the shape that the file has them in."""
    parameters = {}
    for name, parameter in _signature(lobe).items():
        value = given.get(name, parameter.default)
        length = 3 if name == "ior" and lobe == "Conductor" else _PARAMETERS[name].schema.get("minItems")
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        parameters[name] = [value] * length if length and is_number else value
    return parameters


def lobes() -> dict[str, Any]:
    """What each lobe takes: for each parameter whether it has to be given, its default, unit and meaning."""
    table: dict[str, Any] = {}
    for lobe in CLASSES:
        defaults = _complete(lobe, {})
        table[lobe] = {}
        for name in _signature(lobe):
            is_required = defaults[name] is inspect.Parameter.empty
            _, unit, meaning = _PARAMETERS[name]
            table[lobe][name] = {
                "required": is_required,
                "default": None if is_required else defaults[name],
                "unit": unit,
                "meaning": meaning,
            }
    return table


def _object(properties: dict[str, Any]) -> dict[str, Any]:
    """A schema in which every key is required and no other allowed."""
    return {
        "type": "object",
        "required": list(properties),
        "properties": properties,
        "additionalProperties": False,
    }


def schema() -> dict[str, Any]:
    """The JSON schema of the file: it has every key, and no other."""
    text = {"type": "string"}
    point = _object(
        {
            "v": _VECTOR,
            "l": _VECTOR,
            "eval": _COLOUR,
            "pdf": _NOT_NEGATIVE,
            "u": _VECTOR,
            "sample": _object(
                {"l": _VECTOR, "weight": _COLOUR, "pdf": _NOT_NEGATIVE, "delta": {"type": "boolean"}}
            ),
            "albedo": _COLOUR,
        }
    )
    described = _object({"required": {"type": "boolean"}, "default": True, "unit": text, "meaning": text})
    cases = [
        _object(
            {
                "name": text,
                "lobe": {"const": lobe},
                "parameters": _object({name: _PARAMETERS[name].schema for name in _signature(lobe)}),
                "points": {"type": "array", "items": {"$ref": "#/$defs/point"}},
            }
        )
        for lobe in CLASSES
    ]
    content = {
        "rule": text,
        "version": {"const": VERSION},
        "conventions": _object(dict.fromkeys(CONVENTIONS, text)),
        "lobes": _object({lobe: _object(dict.fromkeys(_signature(lobe), described)) for lobe in CLASSES}),
        "cases": {"type": "array", "items": {"oneOf": cases}},
    }
    return {"$schema": SCHEMA, "title": "MRM test vectors", **_object(content), "$defs": {"point": point}}


def _parameters() -> list[tuple[str, dict[str, Any]]]:
    cases: list[tuple[str, dict[str, Any]]] = []
    for (distribution, masking), share in product(PAIRS, (0.0, 0.3, 1.0)):
        common = {"distribution": distribution, "masking": masking, "retroreflectivity": share}
        for alpha in ([0.053, 0.053], [0.3, 0.1]):
            metal = {"ior": [0.2, 0.924, 1.102], "extinction": [3.91, 2.45, 2.14], "alpha": alpha}
            cases.append(("Conductor", metal | common))
            tape = {"color0": [0.19, 0.17, 0.03], "color82": [0.0, 0.0, 0.0], "alpha": alpha}
            cases.append(("GeneralizedSchlick", tape | {"scatter_mode": "RT"} | common))
            cases.append(("Dielectric", {"ior": 1.5, "alpha": alpha, "scatter_mode": "RT"} | common))
        turned = {"retro_transmission": True, "scatter_mode": "RT", "alpha": [0.4, 0.4]}
        cases.append(("Dielectric", {"ior": 1.5} | turned | common))
    for correlation in ("separable", "direction", "height_direction"):
        cases.append(
            (
                "Dielectric",
                {"ior": 1.5, "alpha": [0.5, 0.2], "retroreflectivity": 0.5, "correlation": correlation},
            )
        )
    for distribution in ("ggx", "beckmann"):
        skewed = {
            "alpha": [0.5, 0.3],
            "slope_correlation": 0.5,
            "distribution": distribution,
            "scatter_mode": "RT",
        }
        cases.append(("Dielectric", {"ior": 1.5, "retroreflectivity": 0.5} | skewed))
        cases.append(("Dielectric", {"ior": 0.7, "mean_slope": [0.2, -0.1]} | skewed))
    for scheme in ("materialx-1.39.5", "materialx-1.39.6", "turquin", "kulla-conty"):
        rough = {"ior": 0.2, "extinction": 3.9, "alpha": [0.7, 0.7], "retroreflectivity": 0.5}
        cases.append(("Conductor", rough | {"energy_compensation": scheme}))
    cases.append(("Dielectric", {"ior": 1.0, "alpha": [0.3, 0.3], "scatter_mode": "RT"}))
    cases.append(
        ("Dielectric", {"ior": 1.5, "alpha": [0.3, 0.3], "thinfilm_thickness": 350.0, "thinfilm_ior": 1.8})
    )
    return cases


def _directions(rng: np.random.Generator, count: int, sides: tuple[int, ...]) -> Array:
    d = rng.normal(size=(count, 3))
    d[:, 2] = np.abs(d[:, 2]) * rng.choice(sides, size=count)
    return np.asarray(d / np.linalg.norm(d, axis=-1, keepdims=True))


def build(points: int = 8, seed: int = 20260412) -> dict[str, Any]:
    """The whole file as a dictionary: `points` configurations a case, half of the lights on the lobe."""
    rng = np.random.default_rng(seed)
    cases = []
    for name, parameters in _parameters():
        lobe = CLASSES[name](**parameters)
        sides = (1, -1) if parameters.get("scatter_mode") == "RT" else (1,)
        v, l, u = _directions(rng, points, sides), _directions(rng, points, sides), rng.random((points, 3))  # noqa: E741
        drawn = lobe.sample(v, u)
        # Uniform directions miss a narrow lobe.
        on_lobe = (np.arange(points) % 2 == 0) & (drawn.pdf > 0.0)
        l = np.where(on_lobe[:, np.newaxis], drawn.l, l)  # noqa: E741
        value, density, albedo = lobe.eval(v, l), lobe.pdf(v, l), lobe.albedo(v)
        label = ", ".join(f"{key} {value}" for key, value in parameters.items())
        rows = [
            {
                "v": v[k].tolist(),
                "l": l[k].tolist(),
                "eval": value[k].tolist(),
                "pdf": float(density[k]),
                "u": u[k].tolist(),
                "sample": {
                    "l": drawn.l[k].tolist(),
                    "weight": drawn.weight[k].tolist(),
                    "pdf": float(drawn.pdf[k]),
                    "delta": bool(drawn.delta[k]),
                },
                "albedo": albedo[k].tolist(),
            }
            for k in range(points)
        ]
        cases.append(
            {
                "name": f"{name}: {label}",
                "lobe": name,
                "parameters": _complete(name, parameters),
                "points": rows,
            }
        )
    return {"rule": RULE, "version": VERSION, "conventions": CONVENTIONS, "lobes": lobes(), "cases": cases}


#: Where the page and the examples lie in the documentation.
PAGE, EXAMPLES = "vectors.md", "examples/vectors"


def write_vectors(path: str | Path, documentation: Path, points: int = 8) -> list[Path]:
    """Write the vectors to `path`, and beside it their schema, a page on how to use them, and a folder of examples
    in Python, C++, GLSL and JavaScript; returns the paths of all files. The page and the examples are those of the
    `documentation`.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps(build(points), indent=1) + "\n")
    schema_path = target.with_suffix(".schema.json")
    schema_path.write_text(json.dumps(schema(), indent=1) + "\n")
    examples = target.with_name(f"{target.stem}-examples")
    examples.mkdir(exist_ok=True)
    page = target.with_suffix(".md")
    page.write_text(
        (documentation / PAGE).read_text("utf-8").replace(f"{EXAMPLES}/", f"{examples.name}/"), "utf-8"
    )
    written = [target, schema_path, page]
    for source in sorted((documentation / EXAMPLES).iterdir()):
        if source.is_file():
            written.append(examples / source.name)
            written[-1].write_bytes(source.read_bytes())
    return written
