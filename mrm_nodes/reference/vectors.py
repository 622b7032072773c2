"""Test vectors for those who put MRM into another renderer: inputs and results in one JSON file.

Each case is self-contained: the lobe's class and parameters, and for each configuration v, l, eval and pdf,
then u with the direction, weight and density that `sample` gives, and the directional albedo."""

import json
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from .bsdf import Conductor, Dielectric, GeneralizedSchlick, Lobe
from .checks import PAIRS
from .compiled import Array

SCHEMA = "https://json-schema.org/draft/2020-12/schema"
#: Raised when a reader of the file would have to change.
VERSION = 1

CLASSES: dict[str, type[Lobe]] = {
    "Conductor": Conductor,
    "Dielectric": Dielectric,
    "GeneralizedSchlick": GeneralizedSchlick,
}

_VECTOR = {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3}


def schema() -> dict[str, Any]:
    """The JSON schema of the file."""
    point = {
        "type": "object",
        "required": ["v", "l", "eval", "pdf", "u", "sample", "albedo"],
        "properties": {
            "v": _VECTOR,
            "l": _VECTOR,
            "eval": _VECTOR,
            "pdf": {"type": "number", "minimum": 0},
            "u": _VECTOR,
            "sample": {
                "type": "object",
                "required": ["l", "weight", "pdf", "delta"],
                "properties": {
                    "l": _VECTOR,
                    "weight": _VECTOR,
                    "pdf": {"type": "number", "minimum": 0},
                    "delta": {"type": "boolean"},
                },
            },
            "albedo": _VECTOR,
        },
    }
    case = {
        "type": "object",
        "required": ["name", "lobe", "parameters", "points"],
        "properties": {
            "name": {"type": "string"},
            "lobe": {"enum": list(CLASSES)},
            "parameters": {"type": "object"},
            "points": {"type": "array", "items": point},
        },
    }
    return {
        "$schema": SCHEMA,
        "title": "MRM test vectors",
        "type": "object",
        "required": ["version", "conventions", "cases"],
        "properties": {
            "version": {"const": VERSION},
            "conventions": {"type": "object"},
            "cases": {"type": "array", "items": case},
        },
    }


CONVENTIONS = {
    "frame": "normal +z, tangent +x; v and l are unit vectors away from the surface",
    "eval": "f in 1/sr, RGB, without the cosine; v.z < 0 is seen from inside, where the index is ior",
    "pdf": "per steradian, of what sample draws",
    "alpha": "microfacet width along the tangent and across; a perceptual roughness r has alpha r * r",
    "sample": "weight is f |l.z| / pdf; a rejected sample has weight 0 and pdf 0; for a delta, pdf is a probability",
    "albedo": "energy reflected and transmitted, by quadrature to 3e-4",
    "precision": "eval and pdf are float64 and hold to 1e-12; compare a float32 renderer to 5e-6 / alpha",
}


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
        cases.append({"name": f"{name}: {label}", "lobe": name, "parameters": parameters, "points": rows})
    return {"version": VERSION, "conventions": CONVENTIONS, "cases": cases}


#: Braces are the examples' own: only @name@ and its like are put in.
PAGE = """# MRM test vectors

`@name@` holds @cases@ cases (version @version@; its schema is `@schema@`). A case names a lobe and its
parameters; each of its points has `v`, `l`, `eval` (RGB, 1/sr, without the cosine), `pdf`, and for the
uniforms `u` what sampling gives. Directions are unit vectors away from the surface in a frame whose normal
is +z and whose tangent is +x. A sampler of your own may draw other directions for the same `u`: compare its
`pdf`, and the mean of its weights with `albedo`.

The examples check a conductor of your own against `eval`, to 5e-6 over its smaller alpha, as a float32 renderer can
do it; `my_conductor` (`my_mrm_eval` in GLSL) is what you put in.

## C++

With [nlohmann/json](https://github.com/nlohmann/json) on the include path.

```cpp
#include <nlohmann/json.hpp>
#include <fstream>
#include <iostream>
int main() {
    auto file = nlohmann::json::parse(std::ifstream("@name@"));
    for (auto& c : file["cases"]) {
        auto p = c["parameters"];
        if (c["lobe"] != "Conductor" || p.value("distribution", "") != "ggx" || p["masking"] != "smith") continue;
        std::array<double, 2> alpha = p["alpha"];
        double tolerance = 5e-6 / std::min(alpha[0], alpha[1]);
        for (auto& q : c["points"]) {
            std::array<double, 3> f = my_conductor(
                p["ior"], p["extinction"], alpha, p["retroreflectivity"], q["v"], q["l"]), expected = q["eval"];
            for (int k = 0; k < 3; ++k)
                if (!(std::abs(f[k] - expected[k]) <= tolerance * std::max(expected[k], 1e-4)))
                    std::cout << c["name"] << ": " << f[k] << " is not " << expected[k] << "\\n";
        }
    }
}
```

## GLSL

One texel a point: `v`, `l` and `eval` of a case as float textures; the relative error is the image.

```glsl
#version 330
uniform sampler2D points_v, points_l, points_eval;
uniform vec2 alpha;
uniform float retroreflectivity;
out vec4 error;
void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec3 expected = texelFetch(points_eval, at, 0).rgb;
    vec3 f = my_mrm_eval(texelFetch(points_v, at, 0).xyz, texelFetch(points_l, at, 0).xyz, alpha, retroreflectivity);
    error = vec4(abs(f - expected) / max(expected, vec3(1e-4)), 1.0);
}
```

## JavaScript

In Node; in a browser `await (await fetch(...)).json()` reads the file.

```js
const file = JSON.parse(require('fs').readFileSync('@name@'));
for (const c of file.cases) {
  const p = c.parameters;
  if (c.lobe !== 'Conductor' || p.distribution !== 'ggx' || p.masking !== 'smith') continue;
  const tolerance = 5e-6 / Math.min(...p.alpha);
  for (const q of c.points) {
    const f = my_conductor(p.ior, p.extinction, p.alpha, p.retroreflectivity, q.v, q.l);
    const wrong = q.eval.some((x, k) => !(Math.abs(f[k] - x) <= tolerance * Math.max(x, 1e-4)));
    if (wrong) console.log(`${c.name}: ${f} is not ${q.eval}`);
  }
}
```
"""


def write_vectors(path: str | Path, points: int = 8) -> list[Path]:
    """Write the vectors to `path`, and beside it their schema and a page on how to use them; returns the
    three paths.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    content = build(points)
    target.write_text(json.dumps(content, indent=1) + "\n")
    schema_path = target.with_suffix(".schema.json")
    schema_path.write_text(json.dumps(schema(), indent=1) + "\n")
    page = target.with_suffix(".md")
    text = PAGE
    for name, value in (
        ("name", target.name),
        ("cases", len(content["cases"])),
        ("version", VERSION),
        ("schema", schema_path.name),
    ):
        text = text.replace(f"@{name}@", str(value))
    page.write_text(text)
    return [target, schema_path, page]
