"""Mutants of the nodes' GLSL, and the default suite run on each of them: which of them no case would have noticed?

A mutant is one small change of one function: an operator, a constant, a term, a component. What no case fails is drawn
once more beside the original, with random configurations that owe nothing to the suite: a mutant that changes no more
than SHARE of them by more than CHANGE is equivalent, as far as an image can tell; any other has survived.

    python tests/mutants.py [--count 200] [--seed 1] [--function NAME] [--without NAME] [--backend egl] [-o FILE.json]
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import itertools
import json
import random
import re
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError
from mrm_nodes.regression.cases import cloud, material_case
from mrm_nodes.regression.cases.builtin import MapLight
from mrm_nodes.regression.cases.cloud import Cloud
from mrm_nodes.regression.cases.workshop import Workshop
from mrm_nodes.regression.run.worker import JUDGES
from mrm_nodes.regression.suites.selection import suite
from mrm_nodes.regression.truth import material, physics
from mrm_nodes.regression.verdict.compare import FLOOR, relative_error
from mrm_nodes.regression.verdict.outcome import Task, outcome_of
from mrm_nodes.render.renderer import shared_renderer
from mrm_nodes.render.scene import DirectionalLight
from mrm_nodes.shadergen import Shader, generate_shader

CHANGE = 1e-3
"""Relative, as the regression has it: values below FLOOR count as that."""
SHARE = 1e-3
FIRST = 8192
"""Configurations of a cloud that are looked at before all of them."""

_FUNCTION = re.compile(
    r"^(?:void|bool|float|vec[234]|MrmLobe) (mrm_\w+)\(.*\)\n\{\n(?:.*\n)*?\}\n", re.MULTILINE
)
_NAMES = re.compile(r"^#define MRM_GGX 0\n(?:#define MRM_\w+ \d\n)+", re.MULTILINE)
_TOKEN = re.compile(
    r"//.*|\d+\.\d*(?:e[+-]?\d+)?|\d+|[A-Za-z_]\w*|\+\+|--|[<>=!]=|&&|\|\||[^\s\w]"
)  # fmt: skip
_SWAPS = {
    "+": "-", "-": "+", "*": "/", "/": "*", "<": ">", ">": "<", "<=": ">", ">=": "<", "==": "!=", "!=": "==",
    "&&": "||", "||": "&&", "min": "max", "max": "min", "V": "L", "L": "V", "X": "Y", "Y": "X", "H": "N",
    "NdotV": "NdotL", "NdotL": "NdotV", "Vr": "V", "forward": "back", "back": "forward", "true": "false",
    "safeColor0": "safeColor90", "safeColor90": "safeColor82", "safeColor82": "safeColor0",
}  # fmt: skip
_COMPONENTS = {"x": "y", "y": "x", "z": "x", "w": "z", "xy": "yx", "zw": "wz", "xyz": "yxz"}
_DROPPED = ("normalize", "sqrt", "exp", "log", "mx_square", "reflect", "clamp")
"""Functions in whose place their first argument may stand."""


@dataclass(frozen=True)
class Mutant:
    """One change of the text of one function."""

    function: str
    """Its name; of several with one name, the first that the shaders of the suite compile."""
    start: int
    end: int
    """Of what is replaced, in the function's text."""
    replacement: str
    kind: str
    before: str
    """The function's text."""

    @property
    def name(self) -> str:
        """What it is, for people: the line, with the change in it."""
        line = self.before.rfind("\n", 0, self.start) + 1
        last = self.before.find("\n", self.end)
        old = self.before[self.start : self.end]
        return (
            f"{self.function}: {self.before[line : self.start].strip()}"
            f"[{old or 'nothing'} -> {self.replacement or 'nothing'}]{self.before[self.end : last].strip()}"
        )

    def applied(self, source: str) -> str:
        """A shader's source with the change, where it holds the function."""
        changed = self.before[: self.start] + self.replacement + self.before[self.end :]
        return source.replace(self.before, changed, 1)


_DIRECTIVE = re.compile(r"\s*#\s*(define|ifdef|ifndef|if|elif|else|endif)\b\s*(\w*)\s*([=!]=)?\s*(\w*)")


def compiled(source: str) -> list[bool]:
    """Whether each line of a shader's source is compiled, by the conditions that the nodes' GLSL has: a name's number,
    or whether two are equal.
    """
    defined: dict[str, str] = {}
    stack: list[tuple[bool, bool]] = []
    lines = []

    def number(name: str) -> str:
        return number(defined[name]) if defined.get(name, "") not in ("", name) else name

    for line in source.splitlines():
        found = _DIRECTIVE.match(line)
        directive, name, relation, other = found.groups() if found else ("", "", "", "")
        if directive in ("if", "ifdef", "ifndef"):
            is_true = (name in defined) == (directive == "ifdef")
            if directive == "if":
                is_true = _holds(number(name), relation, number(other))
            stack.append((is_true, is_true))
        elif directive in ("elif", "else"):
            _, taken = stack.pop()
            is_true = not taken and (directive == "else" or _holds(number(name), relation, number(other)))
            stack.append((is_true, taken or is_true))
        elif directive == "endif":
            stack.pop()
        active = all(is_true for is_true, _ in stack)
        if directive == "define" and active:
            defined[name] = other
        lines.append(active)
    return lines


def _holds(first: str, relation: str | None, second: str) -> bool:
    """A condition of two numbers, or of one."""
    return first == second if relation == "==" else first != (second if relation else "0")


def reached(source: str) -> str:
    """A shader's source with nothing but spaces in place of what is not compiled, or is part of no call from `main`."""
    active = compiled(source)
    text = "\n".join(
        line if is_active else " " * len(line)
        for line, is_active in zip(source.splitlines(), active, strict=True)
    )
    bodies = {match[1]: match for match in _FUNCTION.finditer(text + "\n")}
    wanted = set(re.findall(r"mrm_\w+", _FUNCTION.sub("", text + "\n")))
    while (
        more := {name for each in wanted & set(bodies) for name in re.findall(r"mrm_\w+", bodies[each][0])}
        - wanted
    ):
        wanted |= more
    for name, match in bodies.items():
        if name not in wanted:
            text = text[: match.start()] + re.sub(r"[^\n]", " ", match[0]) + text[match.end() :]
    return text


def functions(source: str) -> dict[str, str]:
    """The functions of the nodes in the source of a shader, and the numbers of their enumerations, by name."""
    found: dict[str, str] = {}
    for match in _FUNCTION.finditer(source):
        found.setdefault(match[1], match[0])
    names = _NAMES.search(source)
    return found if names is None else {**found, "enumerations": names[0]}


def mutants(function: str, text: str) -> Iterator[Mutant]:
    """Every mutant of a function."""
    body = text.index("{\n") if "{\n" in text else 0
    tokens = [each for each in _TOKEN.finditer(text, body) if not each[0].startswith("//")]

    def made(start: int, end: int, replacement: str, kind: str) -> Mutant:
        return Mutant(function, start, end, replacement, kind, text)

    for index, token in enumerate(tokens):
        word, (start, end) = token[0], token.span()
        before = tokens[index - 1][0] if index else ""
        after = tokens[index + 1][0] if index + 1 < len(tokens) else ""
        if before in ("#", "include", "struct"):
            continue
        if word == "-" and (before == "return" or not re.match(r"[\w)\]]", before)):
            yield made(start, end, "", "sign")
            continue
        if before == ".":
            if word in _COMPONENTS:
                yield made(start, end, _COMPONENTS[word], "component")
            continue
        is_declared = word[0].isalpha() and before[:1].isalpha() and before not in ("return", "else")
        if word in _SWAPS and not is_declared and after != "=":
            yield made(start, end, _SWAPS[word], "swap")
        if re.fullmatch(r"\d+\.\d*(e[+-]?\d+)?", word):
            yield made(start, end, f"{float(word) * 1.01:.9g}" if float(word) else "0.01", "constant")
            yield made(start, end, f"({word} + 1.0e-3)", "constant")
        elif word.isdigit() and (function == "enumerations" or before in ("=", "==", "!=", ">", ":", "?")):
            yield made(start, end, str(int(word) + 1), "constant")
        if word in ("+", "-", "*", "/"):
            stop = _operand_end(tokens, index, word)
            yield made(start, stop, "", "term" if word in "+-" else "factor")
        if word in _DROPPED and after == "(":
            inner = _first_argument(tokens, index + 1)
            closing = _closing(tokens, index + 1)
            yield made(start, tokens[closing].end(), f"({text[inner[0] : inner[1]]})", "function")
        if word == "if" and after == "(":
            closing = _closing(tokens, index + 1)
            yield made(tokens[index + 2].start(), tokens[closing].start(), "true", "branch")
            yield made(tokens[index + 2].start(), tokens[closing].start(), "false", "branch")
        may_lead = word in ("+", "=", ",", "(", "return") and before != "for"
        if may_lead and _is_number(after) and tokens[max(0, index - 2)][0] != "if":
            place = tokens[index + 1].start()
            yield made(place, place, "-", "sign")
        if before in ("{", ";", "}", ")") and re.match(r"[A-Za-z]", word) and after in ("=", ".", "("):
            stop = next(i for i in range(index, len(tokens)) if tokens[i][0] in (";", "{"))
            if tokens[stop][0] == ";" and word not in ("return", "if", "for"):
                yield made(start, tokens[stop].end(), "", "statement")


_NO_NUMBERS = (
    r"int|float|bool|true|false|lobe|drawn|fd|closureData|AB|compensation|response|if"
    r"|MRM_\w+|mrm_is\w+|m\w+_init_\w+"
)
"""Types, structures and what else takes no sign."""


def _is_number(word: str) -> bool:
    return bool(re.match(r"[A-Za-z]", word)) and not re.fullmatch(_NO_NUMBERS, word)


def _closing(tokens: list[re.Match[str]], opening: int) -> int:
    depth = 0
    for index in range(opening, len(tokens)):
        depth += tokens[index][0] in "([{"
        depth -= tokens[index][0] in ")]}"
        if depth == 0:
            return index
    raise ValueError("a bracket that nothing closes")


def _first_argument(tokens: list[re.Match[str]], opening: int) -> tuple[int, int]:
    depth = 0
    for index in range(opening, len(tokens)):
        word = tokens[index][0]
        if depth == 1 and word in (",", ")"):
            return tokens[opening].end(), tokens[index].start()
        depth += word in "([{"
        depth -= word in ")]}"
    raise ValueError("a bracket that nothing closes")


def _operand_end(tokens: list[re.Match[str]], index: int, operator: str) -> int:
    """Where the right operand of a binary operator ends."""
    ends = {",", ";", ")", "]", "?", ":", "<", ">", "<=", ">=", "==", "!=", "&&", "||", "+", "-"}
    ends |= {"*", "/"} if operator in "*/" else set()
    depth, at = 0, index + 1
    while at < len(tokens):
        word = tokens[at][0]
        if depth == 0 and word in ends and at > index + 1:
            break
        depth += word in "(["
        depth -= word in ")]"
        at += 1
    return tokens[at - 1].end()


def chosen(population: Mapping[str, list[Mutant]], count: int, seed: int) -> list[Mutant]:
    """So many mutants at random, from every function in turn: a long one has no more of them than a short one."""
    rng = random.Random(seed)
    queues = []
    for function in sorted(population):
        drawn = list(population[function])
        rng.shuffle(drawn)
        queues.append(drawn)
    turns = (mutant for each in itertools.zip_longest(*queues) for mutant in each if mutant is not None)
    return list(itertools.islice(turns, count))


class _Shaders(Workshop):
    """A workshop whose shaders were generated once for all mutants."""

    def __init__(self, backend: str, known: dict[Any, Shader]) -> None:
        super().__init__(backend)
        self.known = known
        self.mutant: Mutant | None = None

    def shader(self, key: Any, *given: Any, **others: Any) -> Shader:
        if key not in self.known:
            self.known[key] = super().shader(key, *given, **others)
        shader = self.known[key]
        return shader if self.mutant is None else _changed(shader, self.mutant)


def _changed(shader: Shader, mutant: Mutant) -> Shader:
    return dataclasses.replace(shader, pixel=mutant.applied(shader.pixel))


_EXPENSIVE = (
    (physics, "shade_tree"),
    (physics, "light_tree"),
)
"""What a case computes from its geometry alone: the same for every mutant, and so computed once."""
_UNSEEN = (
    (material_case, "write_pictures", {}),
    (material_case, "source_of", ""),
)


class _CloudCase:
    """A cloud whose configurations and references are made once, as far as they are asked for."""

    def __init__(self, task: Cloud, workshop: _Shaders) -> None:
        self.name, self.node, self._workshop = task.name, task.node, workshop
        self._key, self.method = task.structure, task.method
        self.is_around = task.environment is not None
        """Whether light comes from a map."""
        self._spy = _Spy(workshop.renderer)
        shader = self._shader()
        self.source = shader.pixel
        self._more = cloud._chunks(task, self._spy, shader)
        self._parts: list[dict[str, Any]] = []
        self._is_sound: bool | None = None

    def _shader(self) -> Shader:
        attributes = cloud.attributes_of(self.node)
        return self._workshop.shader(
            self._key,
            lambda: material.document(self.node, attributes=attributes),
            environment=self.method,
        )

    def fails_at_once(self) -> bool:
        """Whether one of the first configurations is beyond its bound: then all together are."""
        if not self._parts:
            with _original(self._workshop):
                self._parts.append(next(self._more))
        part = {key: value[:FIRST] for key, value in self._parts[0].items()}
        error = relative_error(self._drawn(0, FIRST), part["reference"])
        return bool((~(error <= part["max_bound"])).any())

    def fails(self) -> bool:
        """Whether the cloud fails."""
        with _original(self._workshop):
            self._parts += list(self._more)
        if self._is_sound is None:
            self._is_sound = self._verdict([part["image"] for part in self._parts]) == "pass"
        images = [self._drawn(number, None) for number in range(len(self._parts))]
        return self._is_sound and self._verdict(images) == "fail"

    def _drawn(self, number: int, count: int | None) -> NDArray[Any]:
        points, others = self._spy.calls[number]
        some = {key: value[:count] for key, value in points.items()}
        image: NDArray[Any] = self._workshop.renderer.draw_points(self._shader(), some, **others)["image"]
        return image

    def _verdict(self, images: list[NDArray[Any]]) -> str:
        joined = {
            key: np.concatenate([part[key] for part in self._parts])
            for key in self._parts[0]
            if key != "render_seconds"
        }
        return cloud._judge({**joined, "image": np.concatenate(images)}).verdict


class _ImageCase:
    """A case with what it computes for its geometry, once."""

    def __init__(self, task: Task, workshop: _Shaders, folder: Path) -> None:
        self.name, self.node, self._task, self._workshop, self._folder = (
            task.name,
            task.node,
            task,
            workshop,
            folder,
        )
        self._computed: dict[tuple[str, int], Any] = {}
        self._is_sound: bool | None = None
        self.is_around = getattr(task, "environment", None) is not None
        """Whether light comes from a map."""

    def fails(self) -> bool:
        """Whether the case fails, where it does not without a mutant."""
        if self._is_sound is None:
            with _original(self._workshop):
                self._is_sound = self._verdict() == "pass"
        return self._is_sound and self._verdict() in ("fail", "error")

    def _verdict(self) -> str:
        outcome = outcome_of(self._task, self._workshop.renderer.backend, "error")
        with self._remembering():
            JUDGES[self._task.kind](self._task, self._workshop, outcome, self._folder)
        return outcome.verdict

    @contextlib.contextmanager
    def _remembering(self) -> Iterator[None]:
        calls: dict[str, int] = defaultdict(int)

        def remembered(what: str, own: Callable[..., Any]) -> Callable[..., Any]:
            def call(*given: Any, **others: Any) -> Any:
                key = (what, calls[what])
                calls[what] += 1
                if key not in self._computed:
                    self._computed[key] = own(*given, **others)
                return self._computed[key]

            return call

        with contextlib.ExitStack() as stack:
            for module, what in _EXPENSIVE:
                stack.enter_context(_patched(module, what, remembered(what, getattr(module, what))))
            for module, what, result in _UNSEEN:
                stack.enter_context(_patched(module, what, lambda *_, result=result, **__: result))
            yield


class Suite:
    """The cases of a suite, for many mutants."""

    def __init__(self, backend: str, tasks: Iterable[Task], folder: Path) -> None:
        self._workshop = _Shaders(backend, {})
        self.clouds, self.images = [], []
        for task in tasks:
            if isinstance(task, Cloud):
                self.clouds.append(_CloudCase(task, self._workshop))
            else:
                self.images.append(_ImageCase(task, self._workshop, folder))
        self._killers: dict[str, list[str]] = defaultdict(list)

    def mutants(self) -> dict[str, list[Mutant]]:
        """By function, the mutants of the nodes as the clouds compile them, which hold all that the cases compile."""
        found: dict[str, list[Mutant]] = {}
        for each in self.clouds:
            if each.method != "fis":
                continue
            for source, method in ((each.source, ""), (each.source.replace(*_OTHER_METHOD, 1), PREFILTERED)):
                for name, made in _reached_mutants(source).items():
                    if all(known[0].before != made[0].before for known in found.values()):
                        key = f"{name}{method}"
                        found[key] = [dataclasses.replace(mutant, function=key) for mutant in made]
        return found

    def killer(self, mutant: Mutant, quickly: bool = False) -> str | None:
        """The first case found that fails the mutant, or None.

        quickly: whether only those are tried that are likely to.

        Raises:
            MrmError: it does not compile.
        """
        own = [each for each in self.clouds if mutant.before in each.source]
        nodes = {each.node for each in own}
        # A case of a material is named for its material.
        images = [each for each in self.images if each.node in nodes or not each.node.endswith("_bsdf")]
        around = [each for each in images if each.is_around]
        killers = self._killers[mutant.function]
        known = [each for each in (*own, *images) if each.name in killers[:4]]
        known.sort(key=lambda each: killers.index(each.name))
        trials: list[tuple[str, Callable[[], bool]]] = [
            (each.name, each.fails_at_once if isinstance(each, _CloudCase) else each.fails) for each in known
        ]
        if "environment" in mutant.function or mutant.function.endswith(PREFILTERED):
            of_method = PREFILTERED in mutant.function
            likely = [each for each in around if ("prefilter" in each.name) == of_method]
            trials += [(each.name, each.fails) for each in likely[:6]]
        elif "transmission" in mutant.function:
            trials += [(each.name, each.fails_at_once) for each in own if each.is_around]
        else:
            trials += [(each.name, each.fails_at_once) for each in own if not each.is_around]
            trials += [(each.name, each.fails) for each in images if "over-diffuse" in each.name]
        if not quickly:
            trials = [(each.name, each.fails) for each in (*around, *images, *own)]
        self._workshop.mutant = mutant
        try:
            for name, fails in dict(trials).items():
                if fails():
                    killers[:] = [name, *(each for each in killers if each != name)]
                    return name
            return None
        finally:
            self._workshop.mutant = None


PREFILTERED = " (prefiltered)"
"""After the name of a function that only that method of image light compiles."""
_OTHER_METHOD = ("#define MRM_ENVIRONMENT 1\n", "#define MRM_ENVIRONMENT 2\n")


def _reached_mutants(source: str) -> dict[str, list[Mutant]]:
    active = reached(source)
    found = {}
    for match in itertools.chain(_FUNCTION.finditer(source), _NAMES.finditer(source)):
        name = match[1] if match.re is _FUNCTION else "enumerations"
        every = mutants(name, match[0])
        made = [mutant for mutant in every if not active[match.start() + mutant.start].isspace()]
        if made:
            found[name] = made
    return found


@contextlib.contextmanager
def _original(workshop: _Shaders) -> Iterator[None]:
    with _patched(workshop, "mutant", None):
        yield


@contextlib.contextmanager
def _patched(module: Any, name: str, value: Any) -> Iterator[None]:
    own = getattr(module, name)
    setattr(module, name, value)
    try:
        yield
    finally:
        setattr(module, name, own)


class _Spy:
    """A renderer that keeps what it was asked to draw."""

    def __init__(self, renderer: Any) -> None:
        self._renderer = renderer
        self.backend: str = renderer.backend
        self.calls: list[tuple[dict[str, Any], dict[str, Any]]] = []

    def draw_points(self, shader: Shader, attributes: dict[str, Any], **others: Any) -> dict[str, Any]:
        self.calls.append((attributes, others))
        found: dict[str, Any] = self._renderer.draw_points(shader, attributes, **others)
        return found


@dataclass(frozen=True)
class _Draw:
    """Some configurations of one shader."""

    shader: Shader
    points: Mapping[str, NDArray[Any]]
    others: Mapping[str, Any]
    group: tuple[str, str]
    """What is counted together: a node, in direct light or in an environment."""
    image: NDArray[np.float32]
    """As the nodes are."""


class Witness:
    """Random configurations that owe nothing to the suite, to see what a mutant changes.

    Index 0.3 to 3, extinction from 0, film index from 1, exponent 0 to 10, alpha from 1e-4, both cosines down to 1e-5,
    anisotropy to 100:1, weights and colours above 1; over a white base and not, every scatter mode, and image light.
    """

    def __init__(self, backend: str, points: int = 4_000, around: int = 300, seed: int = 11) -> None:
        self._renderer = shared_renderer(backend)
        self._sizes, self._seed = (points, around), seed
        self._draws: dict[str, list[_Draw]] = {}

    def _of(self, node: str, points: int, around: int, rng: np.random.Generator) -> Iterator[_Draw]:
        attributes = cloud.attributes_of(node)
        document = material.document(node, attributes=attributes, base="oren_nayar_diffuse_bsdf")
        usual, prefiltered = (
            generate_shader(document, element=material.MATERIAL, environment=method)
            for method in ("fis", "prefilter")
        )
        inputs_of = material.inputs_of(node)
        # A black base is none.
        kinds = [(*pair, base, "R") for pair in material.PAIRS for base in (0.0, 0.9)]
        if "scatter_mode" in inputs_of:
            kinds += [("ggx", "smith", 0.9, mode) for mode in ("RT", "T")]
        for distribution, masking, base, mode in kinds:
            values: dict[str, Any] = {"distribution": distribution, "masking": masking}
            own = {"scatter_mode": mode, "retro_transmission": True}
            values |= {name: value for name, value in own.items() if name in inputs_of}
            uniforms = material.uniform_values(node, values)
            uniforms["base_color"] = (base, base, base)
            groups = [("direct", points, usual), ("image light", around, usual)]
            if (distribution, masking) == ("ggx", "smith"):
                # That method knows no other lobe.
                groups.append(("prefiltered image light", points, prefiltered))
            for group, count, shader in groups:
                eye = material.as_float32(rng.uniform(-1, 1, 3))
                to_light = material.as_float32(_unit(rng.normal(size=3)))
                inputs = configurations(node, rng, count)
                v, light = directions(inputs["roughness"], rng, count)
                placed = cloud.place(v, light, to_light, eye, rng)
                others: dict[str, Any] = {"camera_position": tuple(eye), "uniforms": uniforms}
                if group == "direct":
                    others["lights"] = [DirectionalLight(tuple(-to_light), (1.0, 1.0, 1.0), 1.0)]
                else:
                    sky = MapLight("sky", rotation=20.0, samples=24).load()
                    others["environment"] = sky
                drawn = {**placed, **{name: inputs[name] for name in attributes}}
                image = self._renderer.draw_points(shader, drawn, **others)["image"]
                yield _Draw(shader, drawn, others, (node, group), image)

    def _of_all(self, mutant: Mutant) -> Iterator[_Draw]:
        """The draws of the nodes that a mutant is a part of."""
        for number, node in enumerate(material.NODES):
            if mutant.function.endswith("_bsdf") and mutant.function != node:
                continue
            if node not in self._draws:
                rng = np.random.default_rng([self._seed, number])
                self._draws[node] = list(self._of(node, *self._sizes, rng))
            yield from self._draws[node]

    def changed(self, mutant: Mutant) -> dict[tuple[str, str], float]:
        """The share of configurations that a mutant changes by more than CHANGE, by node and light."""
        counts: dict[tuple[str, str], list[float]] = defaultdict(lambda: [0.0, 0.0])
        for draw in self._of_all(mutant):
            count = counts[draw.group]
            count[1] += len(draw.image)
            image = self._renderer.draw_points(_changed(draw.shader, mutant), draw.points, **draw.others)[
                "image"
            ]
            with np.errstate(invalid="ignore"):
                error = np.abs(image.astype(np.float64) - draw.image) / np.maximum(np.abs(draw.image), FLOOR)
            error[~np.isfinite(image) & np.isfinite(draw.image)] = np.inf
            count[0] += float((np.nan_to_num(error, nan=0.0, posinf=np.inf) > CHANGE).any(-1).sum())
        return {group: differing / total for group, (differing, total) in counts.items()}


def configurations(node: str, rng: np.random.Generator, n: int) -> dict[str, NDArray[Any]]:
    """Random values of every varying input of a node."""
    alpha = 10 ** rng.uniform(-4, 0, n)
    other = np.where(rng.random(n) < 0.5, alpha, np.minimum(alpha * 100 ** rng.random(n), 1.0))
    pair = np.stack([alpha, other], -1)
    kind = rng.integers(4, size=n)
    values: dict[str, NDArray[Any]] = {
        "weight": np.where(rng.random(n) < 0.8, 1.0, rng.uniform(0.0, 1.2, n)),
        "roughness": np.where(rng.random((n, 1)) < 0.5, pair, pair[:, ::-1]),
        "retroreflectivity": np.choose(kind, [np.zeros(n), np.ones(n), rng.random(n), rng.random(n)]),
        "thinfilm_thickness": np.where(rng.random(n) < 0.3, rng.uniform(0.0, 1000.0, n), 0.0),
        "thinfilm_ior": rng.uniform(1.0, 2.0, n),
        "exponent": np.where(rng.random(n) < 0.1, 0.0, rng.uniform(0.0, 10.0, n)),
        "extinction": np.where(rng.random((n, 1)) < 0.1, 0.0, rng.uniform(0.0, 6.0, (n, 3))),
        "ior": rng.uniform(0.3, 3.0, (n, 3) if node == "mrm_conductor_bsdf" else n),
    }
    for name in ("tint", "color0", "color82", "color90"):
        values[name] = rng.uniform(0.0, 1.2, (n, 3))
    return {name: material.as_float32(values[name]) for name in cloud.attributes_of(node)}


def directions(
    roughness: NDArray[Any], rng: np.random.Generator, n: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """View and light `(n, 3)` in the shading frame: half of the lights are where a lobe is, forward or retro."""

    def around(cosine: NDArray[Any]) -> NDArray[Any]:
        phi = rng.uniform(0, 2 * np.pi, n)
        sine = np.sqrt(1 - cosine**2)
        return np.stack([sine * np.cos(phi), sine * np.sin(phi), cosine], -1)

    def cosines() -> NDArray[Any]:
        return np.where(rng.random(n) < 0.7, rng.uniform(0.0, 1.0, n), 10 ** rng.uniform(-5, 0, n))

    v = around(np.maximum(cosines(), 1e-5))
    slope = np.sqrt(np.tan(0.5 * np.pi * rng.random(n)))[:, None] * around(np.zeros(n))[:, :2] * roughness
    half = _unit(np.concatenate([slope, np.ones((n, 1))], -1))
    seen = np.where(rng.random((n, 1)) < 0.5, v, v * (-1.0, -1.0, 1.0))
    mirrored = 2 * np.sum(seen * half, -1, keepdims=True) * half - seen
    light = np.where(rng.random((n, 1)) < 0.5, mirrored, around(np.maximum(cosines(), 1e-5)))
    return v, _unit(light)


def _unit(vector: NDArray[Any]) -> NDArray[Any]:
    unit: NDArray[Any] = vector / np.linalg.norm(vector, axis=-1, keepdims=True)
    return unit


def judge(mutant: Mutant, cases: Suite, witness: Callable[[], Witness]) -> dict[str, Any]:
    """What became of a mutant: killed by a case, discarded by the compiler, equivalent, or survived."""
    started = time.process_time()
    record: dict[str, Any] = {"mutant": mutant.name, "function": mutant.function, "kind": mutant.kind}
    try:
        by = cases.killer(mutant, quickly=True)
        if by is None:
            # Before all cases are run for what no image shows.
            shares = witness().changed(mutant)
            group, share = max(shares.items(), key=lambda item: item[1])
            record |= {"changes": share, "of": " in ".join(group)}
            if share > SHARE:
                by = cases.killer(mutant)
        verdict = "survived" if record.get("changes", 0.0) > SHARE else "equivalent"
        record |= {"verdict": verdict} if by is None else {"verdict": "killed", "by": by}
    except MrmError as error:
        record |= {"verdict": "discarded", "message": str(error).splitlines()[0][:200]}
    record["seconds"] = round(time.process_time() - started, 1)
    return record


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=240)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--function", help="only the mutants of one function")
    parser.add_argument("--without", help="no mutants of one function")
    parser.add_argument("--backend", default="egl")
    parser.add_argument("--filter", help="only cases whose name holds this")
    parser.add_argument(
        "--configurations", type=int, default=1_000_000, help="of each node, in the suite's clouds"
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("build/mutants.json"))
    given = parser.parse_args()
    given.output.parent.mkdir(parents=True, exist_ok=True)
    tasks = [
        task
        for task in suite("default", given.configurations)
        if given.filter is None or given.filter in task.name
    ]
    folder = tempfile.TemporaryDirectory(prefix="mrm-mutants-")
    cases = Suite(given.backend, tasks, Path(folder.name))
    population = cases.mutants()
    population.pop(given.without, None)
    if given.function is not None:
        population = {given.function: population[given.function]}
    print(
        f"{sum(map(len, population.values()))} mutants of {len(population)} functions; seed {given.seed}",
        flush=True,
    )
    kept: list[Witness] = []

    def witness() -> Witness:
        if not kept:
            kept.append(Witness(given.backend))
        return kept[0]

    records = []
    for number, mutant in enumerate(chosen(population, given.count, given.seed), 1):
        record = judge(mutant, cases, witness)
        records.append(record)
        print(
            number,
            record["verdict"],
            record.get("by", record.get("changes", "")),
            record["seconds"],
            record["mutant"],
            flush=True,
        )
        given.output.write_text(
            json.dumps({"seed": given.seed, "records": records}, indent=1), encoding="utf-8"
        )
    counts = {
        verdict: sum(each["verdict"] == verdict for each in records)
        for verdict in ("killed", "equivalent", "discarded", "survived")
    }
    print(counts, flush=True)


if __name__ == "__main__":
    main()
