"""The reference: pages that are made of the code while the site is built, so that nothing is written twice.

Names come from each package's `__all__` and their text from docstrings, nodes from the node definitions, keys of
suites from their schema, and commands from the command line itself.
"""

from __future__ import annotations

import html
import importlib
import inspect
import pkgutil
import re
import types
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import click
import MaterialX as mx
from mkdocs.structure.files import File, Files

import mrm_nodes
from mrm_nodes.cli import cli
from mrm_nodes.regression.suites import suitetable

ROOT = Path(__file__).parents[2]
_GLSL_FUNCTION = re.compile(r"^(?:\w+ )+(\w+)\(", re.MULTILINE)


def on_files(files: Files, config: Any, **_: Any) -> Files:
    """Add the pages of the reference; `code_links` runs later and finds their links."""
    pages = {
        "nodes": nodes(),
        "commands": commands(cli),
        "suite-keys": suite_keys(),
        "shaders": shaders(),
    } | {name: package(name) for name in packages()}
    for name, text in pages.items():
        files.append(File.generated(config, f"reference/{name}.md", content=text))
    return files


# Python


def packages() -> list[str]:
    """The packages that have public names."""
    inner = (found.name for found in pkgutil.iter_modules(mrm_nodes.__path__, "mrm_nodes.") if found.ispkg)
    return [name for name in ("mrm_nodes", *inner) if public_names(name)]


def public_names(package: str) -> list[str]:
    """What a package has in `__all__`, without the packages in it."""
    module = importlib.import_module(package)
    names = sorted(getattr(module, "__all__", []), key=str.lower)
    return [name for name in names if not isinstance(getattr(module, name), types.ModuleType)]


def where_defined(package: str, name: str) -> str:
    """The path of a public name where it is defined, which is where its text stands."""
    module = importlib.import_module(package)
    value = getattr(module, name)
    home = value.__module__ if inspect.isclass(value) or inspect.isfunction(value) else None
    return f"{home or package}.{name}"


def package(name: str) -> str:
    """The page of a package."""
    module = importlib.import_module(name)
    lines = [f"# {name}", "", inspect.cleandoc(module.__doc__ or ""), ""]
    for public in public_names(name):
        lines += [f"[](){{#{name}.{public}}}", "", f"::: {where_defined(name, public)}", ""]
    return "\n".join(lines)


# Nodes


def nodes() -> str:
    """The page of the nodes: the BSDFs, and the twins of MaterialX's surfaces."""
    library = mrm_nodes.load_library()
    ours = [d for d in library.getNodeDefs() if d.getNodeString().startswith("mrm_")]
    lines = [
        "# Nodes",
        "",
        f"As `load_library()` has them with MaterialX {mx.getVersionString()}. An input without a default",
        "takes what the mesh has there.",
        "",
    ]
    for definition in sorted(ours, key=lambda d: (d.getType() != "BSDF", d.getNodeString())):
        older = definition.hasVersionString() and not definition.getDefaultVersion()
        title = definition.getNodeString() + (f" {definition.getVersionString()}" if older else "")
        lines += [f"## {title}", "", _text(definition.getAttribute("doc")), ""]
        lines += [f"Gives `{'`, `'.join(o.getType() for o in definition.getActiveOutputs())}`.", ""]
        rows = [
            (f"`{port.getName()}`", f"`{port.getType()}`", _default(port), _range(port), _about(port))
            for port in definition.getActiveInputs()
        ]
        lines += [*_table(("input", "type", "default", "range", "what it is"), rows), ""]
    return "\n".join(lines)


def _default(port: mx.Input) -> str:
    value = port.getDefaultGeomPropString() or port.getValueString()
    return f"`{value}`" if value else ""


def _range(port: mx.Input) -> str:
    """The values that an interface offers."""
    if port.hasAttribute("enum"):
        return ", ".join(f"`{name.strip()}`" for name in port.getAttribute("enum").split(","))
    low, high = (port.getAttribute(f"ui{end}") or port.getAttribute(f"uisoft{end}") for end in ("min", "max"))
    return f"{float(low):g} to {float(high):g}" if low and high and "," not in low + high else ""


def _about(port: mx.Input) -> str:
    text = _text(port.getAttribute("doc"))
    if port.hasUnit():
        text += f" In {port.getUnit()}s."
    return text + " Uniform: no texture drives it." if port.getIsUniform() else text


# Suites


def suite_keys() -> str:
    """The page of what a suite's TOML may hold."""
    schema = suitetable.SuiteTable.model_json_schema()
    tables = {"Top level": schema}
    for key, found in schema["properties"].items():
        if (name := _table_of(found)) is not None:
            form = f"[{key}]" if "$ref" in found else f"[[{key}]]" if "items" in found else f"[{key}.NAME]"
            tables[form] = schema["$defs"][name]
            found.setdefault("description", tables[form].get("description", ""))
    lines = ["# Keys of a suite", "", "What a suite's TOML may hold; [Suites](../suites.md) explains it.", ""]
    for title, table in tables.items():
        lines += [f"## {title}", "", table.get("description", ""), ""]
        needed = table.get("required", ())
        rows = [
            (f"`{key}`" + (" (needed)" if key in needed else ""), _type(found), found.get("description", ""))
            for key, found in table["properties"].items()
        ]
        lines += [*_table(("key", "type", "what it is"), rows), ""]
    return "\n".join(lines)


def _table_of(schema: Mapping[str, Any]) -> str | None:
    """The name of the schema of the tables that a key holds."""
    for inner in (schema, schema.get("items"), schema.get("additionalProperties")):
        if isinstance(inner, dict) and "$ref" in inner:
            return str(inner["$ref"].rpartition("/")[2])
    return None


def _type(schema: Mapping[str, Any]) -> str:
    """What a value is, in TOML's words."""
    if "anyOf" in schema:
        return " or ".join(_type(each) for each in schema["anyOf"] if each.get("type") != "null")
    if "enum" in schema:
        return ", ".join(f'`"{value}"`' for value in schema["enum"])
    if "$ref" in schema:
        return "table"
    kind = schema.get("type", "any value")
    if kind == "array":
        each = schema["items"] if "items" in schema else schema["prefixItems"][0]
        return f"list of {_type(each)}"
    if kind == "object":
        each = schema.get("additionalProperties")
        return f"table of {_type(each)}" if isinstance(each, dict) else "table"
    return {"string": "text", "integer": "whole number"}.get(kind, kind)


# Commands


def commands(group: click.Command) -> str:
    """The page of the command line: each command as its `--help` has it."""
    root = click.Context(group, info_name="mrm-nodes")
    listed = list(_commands(group, root))
    lines = ["# Commands", "", _help(group), "", "| command | what it does |", "|---|---|"]
    lines += [
        f"| [`{context.command_path}`](#{_anchor(context)}) | {_text(command.get_short_help_str(200))} |"
        for command, context in listed
        if not isinstance(command, click.Group)
    ]
    for command, context in listed:
        lines += ["", f"## {context.command_path} {{ #{_anchor(context)} }}", "", _help(command), ""]
        usage = " ".join([context.command_path, *command.collect_usage_pieces(context)])
        lines += ["```text", usage, "```", ""]
        shown = [parameter.get_help_record(context) for parameter in command.get_params(context)]
        rows = [(f"`{names}`", _text(text)) for names, text in filter(None, shown)]
        if rows:
            lines += [*_table(("option", "what it does"), rows), ""]
        if command.epilog:
            lines += [_blocks(command.epilog), ""]
    return "\n".join(lines)


def _commands(group: click.Command, context: click.Context) -> Iterator[tuple[click.Command, click.Context]]:
    if not isinstance(group, click.Group):
        return
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if command is None or command.hidden:
            continue
        inner = click.Context(command, info_name=name, parent=context)
        yield command, inner
        yield from _commands(command, inner)


def _anchor(context: click.Context) -> str:
    return context.command_path.replace(" ", "-")


def _help(command: click.Command) -> str:
    return _blocks(inspect.cleandoc(command.help or ""))


def _blocks(text: str) -> str:
    """Click's help as Markdown: what `\\b` keeps from being wrapped stays as it is."""
    blocks = []
    for block in re.split(r"\n\s*\n", text.replace("\f", "")):
        kept = block.strip("\n").removeprefix("\b\n")
        blocks.append(f"```text\n{kept}\n```" if kept != block.strip("\n") else _text(block))
    return "\n\n".join(blocks)


# Shaders


def shaders() -> str:
    """The page of the GLSL: each file and what it defines."""
    lines = [
        "# Shaders",
        "",
        "The GLSL of the nodes, as the package has it; each name leads to its line.",
        "",
    ]
    for file in sorted((ROOT / "glsl").rglob("*.glsl")):
        path = file.relative_to(ROOT).as_posix()
        names = dict.fromkeys(_GLSL_FUNCTION.findall(file.read_text(encoding="utf-8")))
        lines += [f"## {file.name}", "", f"[{path}](../../{path})", ""]
        lines += [f"- [`{name}`](../../{path}#{name})" for name in names]
        lines += [""]
    return "\n".join(lines)


# Markdown


def _table(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> list[str]:
    heads = list(heads)
    lines = [heads, ["---"] * len(heads), *rows]
    return ["| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines]


def _text(text: str) -> str:
    """Plain text as Markdown shows it, on one line; what stands in backticks is code."""
    parts = re.split(r"(`[^`]*`)", " ".join(text.split()))
    return "".join(part if part.startswith("`") else _escaped(part) for part in parts)


def _escaped(text: str) -> str:
    return re.sub(r"([\\*_\[\]{}#])", r"\\\1", html.escape(text, quote=False))
