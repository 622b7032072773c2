"""What docstrings lack as pages: a public class, or what is in one, that stands in backticks becomes a link to it."""

from __future__ import annotations

import importlib
import inspect
import re
from typing import Any

import griffe

import mrm_nodes

_CODE = re.compile(r"(?<!\[)`([A-Z]\w+)(\.\w+)?`")

_BASE = "it is not made by itself"


class CrossReferences(griffe.Extension):
    """Changes the docstrings as they are read."""

    def __init__(self) -> None:
        packages = [mrm_nodes]
        for name in ("scenes", "measured", "photometry", "surfaces", "regression", "render", "reference"):
            packages.append(importlib.import_module(f"mrm_nodes.{name}"))
        self._classes = {
            name: f"{package.__name__}.{name}"
            for package in packages
            for name in package.__all__
            if inspect.isclass(getattr(package, name))
        }

    def on_class_members(self, *, cls: griffe.Class, **_: Any) -> None:
        """Leave out how a base class is made, where that is its heirs' affair."""
        text = cls.docstring.value if cls.docstring is not None else ""
        if _BASE in text and "Args:" not in text and "__init__" in cls.members:
            cls.del_member("__init__")

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Change the docstring of what was read."""
        if obj.docstring is not None:
            obj.docstring.value = _CODE.sub(lambda found: self._link(found, obj), obj.docstring.value)

    def _link(self, found: re.Match[str], where: griffe.Object) -> str:
        name, inside = found[1], found[2] or ""
        if name not in self._classes or name == where.name:
            return found[0]
        package = self._classes[name].rpartition(".")[0]
        value = getattr(importlib.import_module(package), name)
        if inside and not hasattr(value, inside[1:]):  # another library's
            return found[0]
        return f"[{found[0]}][{value.__module__}.{name}{inside}]"
