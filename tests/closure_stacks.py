"""Which closures generated code stacks on which: read from its text, alike for every target.

A stack is what light meets on its way down: names of BSDFs, the topmost first. Mixes, sums and factors are ways side by
side; what lets nothing through ends a stack, as pbrlib's GLSL has it.
"""

from __future__ import annotations

import re

Stacks = frozenset[tuple[str, ...]]

OPAQUE = {"conductor", "oren_nayar_diffuse", "burley_diffuse", "translucent", "subsurface", "chiang_hair"}
_CLOSURE = re.compile(r"^(?:mx_|mrm_)?(\w+?)_bsdf(?:_\w+)?$")
_OPERATORS = ("mix", "add", "multiply", "layer")


def stacks(source: str, target: str) -> Stacks:
    """Every stack of the closures that end in no other one."""
    read = _read_mdl if target == "mdl" else _read_calls
    functions: dict[str, Stacks] = {}
    last: Stacks = frozenset()
    for name, body in _functions(source, target):
        values, used = read(body, functions)
        # Targets that call a closure once for each way of light repeat its statements.
        ends = [value for variable, value in values.items() if variable not in used]
        found = frozenset(stack for value in ends for stack in value)
        if found:
            functions[name] = last = found
    return last


def _functions(source: str, target: str) -> list[tuple[str, str]]:
    source = re.sub(r"//[^\n]*|/\*.*?\*/", "", source, flags=re.DOTALL)
    if target == "mdl":
        heads = list(re.finditer(r"^(?:export )?material (\w+)\s*$", source, re.MULTILINE))
    else:
        heads = list(re.finditer(r"^ *(?:\w+ )?\w+ (\w+)\([^;{]*\)\s*$(?=\s*\{)", source, re.MULTILINE))
    ends = [head.start() for head in heads[1:]] + [len(source)]
    return [(head[1], source[head.end() : end]) for head, end in zip(heads, ends, strict=True)]


def _arguments(text: str) -> list[str]:
    """Split the arguments of a call at the commas that are its own."""
    parts, depth, start = [], 0, 0
    for position, letter in enumerate(text):
        depth += (letter in "([") - (letter in ")]")
        if letter == "," and depth == 0:
            parts.append(text[start:position].strip())
            start = position + 1
    return [*parts, text[start:].strip()]


def over(top: Stacks, base: Stacks) -> Stacks:
    return frozenset(t if t and t[-1] in OPAQUE else (*t, *b) for t in (top or {()}) for b in (base or {()}))


def _named(function: str) -> str:
    """The name of a BSDF, whoever's; empty for what is none."""
    found = _CLOSURE.match(function.removeprefix("mx_").removeprefix("mrm_"))
    return found[1] if found and found[1] not in _OPERATORS else ""


def _read_mdl(body: str, functions: dict[str, Stacks]) -> tuple[dict[str, Stacks], set[str]]:
    values: dict[str, Stacks] = {}
    used: set[str] = set()

    def take(name: str) -> Stacks:
        used.add(name)
        return values.get(name, frozenset())

    for match in re.finditer(r"^ *material (\w+) = (.*);$", body, re.MULTILINE):
        variable, text = match[1], match[2]
        call = re.match(r"(?:materialx::\w+::)?(\w+)\((.*)\)$", text)
        if call is None:
            values[variable] = take(text)
            continue
        name = call[1].removeprefix("mx_")
        given = dict(re.findall(r"mxp_(\w+): ?(\w+(?:\(\))?)", call[2]))
        if name == "material":
            values[variable] = take((re.match(r"surface: (\w+)\.surface", call[2]) or ["", ""])[1])
        elif name == "surface":
            take(given.get("bsdf", ""))
            used.add(variable)
            values["surface"] = values.get(given.get("bsdf", ""), frozenset())
        elif name.startswith("mix_bsdf"):
            values[variable] = take(given["fg"]) | take(given["bg"])
        elif name.startswith("add_bsdf"):
            values[variable] = take(given["in1"]) | take(given["in2"])
        elif name.startswith("multiply_bsdf"):
            values[variable] = take(given["in1"])
        elif call[1] in functions:
            values[variable] = functions[call[1]]
        elif _named(call[1]):
            values[variable] = over(frozenset({(_named(call[1]),)}), take(given.get("base", "")))
    return values, used


def _read_calls(body: str, functions: dict[str, Stacks]) -> tuple[dict[str, Stacks], set[str]]:
    values: dict[str, Stacks] = {}
    used: set[str] = set()

    def take(name: str) -> Stacks:
        used.add(name)
        return values.get(name, frozenset())

    for match in re.finditer(r"^ *(?:(\w+) )?(?:(\w+) = )?([^;={}]*);$", body, re.MULTILINE):
        kind, variable, text = match[1], match[2], match[3].strip()
        call = re.match(r"(?:\w+ \* )?(\w+)\((.*)\)$", text, re.DOTALL)
        if call is None:
            # OSL writes sums and factors as such.
            parts = re.fullmatch(r"\(?(\w+)(?: [*+] (\w+))?\)?", text)
            closures = [each for each in (parts.groups() if parts else ()) if each in values]
            if variable and closures:
                values[variable] = frozenset(stack for each in closures for stack in take(each))
            continue
        name, given = call[1], _arguments(call[2])
        if variable is None:
            given, variable = given[:-1], given[-1]
        elif kind != "BSDF":
            continue
        operator = next((each for each in _OPERATORS if re.match(rf"(mx_)?{each}(_bsdf|_vdf|$)", name)), "")
        closures = [each for each in given if each in values]
        if operator == "layer" and closures:
            top, *base = closures
            values[variable] = over(take(top), take(base[0]) if base else frozenset())
        elif operator and closures:
            values[variable] = frozenset(stack for each in closures for stack in take(each))
        elif name in functions:
            values[variable] = functions[name]
        elif _named(name):
            values[variable] = frozenset({(_named(name),)})
    return values, used
