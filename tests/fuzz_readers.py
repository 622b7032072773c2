"""The readers that are ours, each as a function of a file's bytes, and sound files for each to begin with.

A reader may raise MrmError and nothing else. `guided.py` looks for what they do otherwise, led by coverage.
"""

from __future__ import annotations

import base64
import contextlib
import json
import shutil
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fuzzing
import numpy as np

from mrm_nodes import cycles, documents, elements, external, filenames, values, xmltext
from mrm_nodes.cli import parse_setting
from mrm_nodes.commands.baseline import _Run
from mrm_nodes.commands.options import parse_size
from mrm_nodes.commands.regress import parse_shard
from mrm_nodes.errors import MrmError
from mrm_nodes.library import shared_library
from mrm_nodes.naming import named_for_code
from mrm_nodes.regression.cases import baseline
from mrm_nodes.regression.run import cache, journal
from mrm_nodes.regression.run.runner import merge
from mrm_nodes.regression.suites import suitefile
from mrm_nodes.regression.truth.closure import closure_of
from mrm_nodes.regression.verdict.compare import Figures
from mrm_nodes.regression.verdict.outcome import Outcome, as_record
from mrm_nodes.render import imagelayers
from mrm_nodes.render.gltffile import buffer_files
from mrm_nodes.render.meshfile import load_mesh
from mrm_nodes.render.scene import parse_camera, parse_light
from mrm_nodes.surfaces.convert import convert
from mrm_nodes.surfaces.markup import parse
from mrm_nodes.surfaces.rewrite import at_zero, retrofit_text

Read = Callable[[bytes, Path], None]
"""Reads a file's contents; the folder is its own, and empty but for what `prepare` wrote."""


@dataclass(frozen=True)
class Reader:
    """One reader, and what it is fed with first.

    prepare: writes what lies beside the file.
    form: `text`, `bytes`, or `json`: lines of it.
    """

    read: Read
    seeds: tuple[bytes, ...]
    prepare: Callable[[Path], None] = lambda folder: None
    form: str = "text"


def _xml(data: bytes, folder: Path) -> None:
    text, codec = xmltext.decode(data, "file")
    assert text.encode(codec) == data
    for token in xmltext.tokens(text, "file"):
        xmltext.attributes_of(token.attributes)
    parse(text, "file")
    at_zero(data, "file")
    retrofit_text(data, "file", {"specular_retroreflectivity": 0.5})


def _document(data: bytes, folder: Path) -> None:
    document = documents.parse_document(data, folder / "file.mtlx")
    document.setDataLibrary(shared_library())
    cycles.check_cycles(document, "file")
    external.check_files(document, folder / "file.mtlx")
    element = elements.find_renderable(document, "file", None)
    elements.check_document(document, "file", element, "genglsl")
    values.settle(*named_for_code(document, element), "file")
    closure_of(document, element.getNamePath())


def _mesh(ending: str) -> Read:
    def read(data: bytes, folder: Path) -> None:
        file = folder / f"file.{ending}"
        file.write_bytes(data)
        buffer_files(file)
        mesh = load_mesh(file)
        assert mesh.indices.max() < len(mesh.positions) and np.isfinite(mesh.positions).all()

    return read


def _gltf_material(data: bytes, folder: Path) -> None:
    file = folder / "file.gltf"
    file.write_bytes(data)
    convert(file, folder / "out.mtlx")
    convert(folder / "out.mtlx", folder / "again.gltf")


def _suite(data: bytes, folder: Path) -> None:
    (folder / "suite.toml").write_bytes(data)
    suitefile.load(folder / "suite.toml")


def _journal_lines(data: bytes) -> bytes:
    """Lines with their checksums, which no mutation would hit."""
    return b"".join(_summed(line) + b"\n" for line in data.split(b"\n"))


def _summed(line: bytes) -> bytes:
    try:
        return journal.line_with_sum(json.loads(line)).rstrip(b"\n")
    except (ValueError, RecursionError):
        return line


def _journal(data: bytes, folder: Path) -> None:
    for contents in (data, _journal_lines(data)):
        (folder / journal.NAME).write_bytes(contents)
        past = journal.read(folder)
        for entry in past.entries if past else ():
            entry.is_intact(folder)


def _shard(data: bytes, folder: Path) -> None:
    lines, _, report = data.partition(b"\n\n")
    part, whole = folder / "part", folder / "whole"
    shutil.rmtree(whole, ignore_errors=True)
    part.mkdir(exist_ok=True)
    (part / journal.NAME).write_bytes(_journal_lines(lines))
    (part / "report.json").write_bytes(report)
    (part / "a.txt").write_bytes(A_FILE)
    merge([part], whole, partial=True)


def _report(data: bytes, folder: Path) -> None:
    (folder / "report.json").write_bytes(data)
    run = _Run(folder, None)
    run.image(run.record("metal"))


def _cached(data: bytes, folder: Path) -> None:
    for contents in (data, _journal_lines(data)):
        place = folder / "cache" / KEY[:2] / KEY
        place.mkdir(parents=True, exist_ok=True)
        (place / "outcome").write_bytes(contents)
        (place / "0").write_bytes(A_FILE)
        cache.Cache(folder / "cache", secret="").get(KEY, folder / "report")
        cache.Cache(folder / "cache", secret="known").get(KEY, folder / "report")


def _baseline(data: bytes, folder: Path) -> None:
    (folder / "metal.json").write_bytes(data)
    (folder / baseline.LOG).write_bytes(data)
    store = baseline.Store(folder)
    list(store.decisions())
    store.provenance("metal")


def _names(data: bytes, folder: Path) -> None:
    for name in data.decode("utf-8", errors="replace").split("\n")[:4]:
        found = filenames.find(name, [folder])
        filenames.absence(name, [folder])
        for file in found.all():
            filenames.absolute(file)
        external.moved_name(name, Path("/a"), Path("/b"))


def _source(data: bytes, folder: Path) -> None:
    (folder / "node.glsl").write_bytes(data)
    external.check_files(_custom_node(folder), folder / "file.mtlx")


def _custom_node(folder: Path) -> Any:
    return documents.parse_document(CUSTOM.encode(), folder / "file.mtlx")


def _layers(data: bytes, folder: Path) -> None:
    parts = [_Part(line) for line in data.decode("utf-8", errors="replace").split("\n")[:4]]
    layers = imagelayers.layers_of(_Image(parts))
    for name in ("", layers[-1].name if layers else ""):
        chosen = imagelayers.choose_layer(layers, "file", name)
        spec = parts[chosen.part]
        imagelayers.check_shown(spec, "file")
        assert max(chosen.channels) < len(spec.channelnames)
        if max(spec.width, spec.height, spec.full_width, spec.full_height) <= 64:
            imagelayers.shown(np.zeros((spec.height, spec.width, 1), np.float32), spec)


class _Part:
    """What OpenImageIO says of a part of a file: `channel,channel;x y width height;the same of its display window`."""

    deep, depth = False, 1

    def __init__(self, line: str) -> None:
        names, data, display = (*line.split(";"), "", "")[:3]
        self.channelnames = names.split(",")
        self.x, self.y, self.width, self.height = _four(data)
        self.full_x, self.full_y, self.full_width, self.full_height = _four(display)

    def getattribute(self, name: str) -> str:
        return self.channelnames[0] if name == "oiio:subimagename" else ""


def _four(text: str) -> tuple[int, int, int, int]:
    numbers = [
        int(word) for word in text.split()[:4] if word.lstrip("-").isascii() and word.lstrip("-").isdigit()
    ]
    x, y, width, height = (max(-(1 << 31), min(each, (1 << 31) - 1)) for each in (*numbers, 0, 0, 1, 1)[:4])
    return x, y, max(1, width), max(1, height)


class _Image:
    def __init__(self, parts: list[_Part]) -> None:
        self._parts, self._at = parts, 0

    def format_name(self) -> str:
        return "openexr"

    def seek_subimage(self, part: int, level: int) -> bool:
        self._at = part
        return part < len(self._parts)

    def spec(self) -> _Part:
        return self._parts[self._at]


def _words(data: bytes, folder: Path) -> None:
    text = data.decode("utf-8", errors="replace")
    for parse_text in (parse_camera, parse_light, parse_size, parse_setting, _parse_shard):
        with contextlib.suppress(MrmError):
            parse_text(text)


def _parse_shard(text: str) -> None:
    parse_shard(None, None, text)


KEY = "ab" * 32
A_FILE = b"a file"
CUSTOM = """<?xml version="1.0"?>
<materialx version="1.39">
  <nodedef name="ND_own" node="own"><output name="out" type="color3" /></nodedef>
  <implementation name="IM_own" nodedef="ND_own" file="node.glsl" function="own" target="genglsl" />
</materialx>
"""
SURFACES = """<?xml version="1.0" encoding="utf-8"?>
<materialx version="1.38"><!-- a comment > -->
  <standard_surface name="s" type="surfaceshader">
    <input name="specular_roughness" type="float" value="0.3" /> </standard_surface>
  <surfacematerial name="m" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="s" />
  </surfacematerial>
  <conductor_bsdf name="c" type="BSDF"><input name="retroreflective" type="boolean" value="true"/></conductor_bsdf>
</materialx>
"""


def _gltf() -> bytes:
    """A .gltf that holds its data, with a material that has textures and extensions."""
    glb = fuzzing.glb()
    end = 20 + int.from_bytes(glb[12:16], "little")
    tree = json.loads(glb[20:end])
    data = base64.b64encode(glb[end + 8 :]).decode()
    tree["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{data}"
    tree["materials"] = [
        {
            "name": "cone",
            "pbrMetallicRoughness": {
                "baseColorFactor": [1, 0.4, 0.1, 1],
                "baseColorTexture": {"index": 0, "texCoord": 0},
                "metallicFactor": 0.0,
                "roughnessFactor": 0.3,
            },
            "normalTexture": {"index": 0, "scale": 0.5},
            "emissiveFactor": [0, 0, 0.1],
            "alphaMode": "MASK",
            "alphaCutoff": 0.25,
            "extensions": {
                "KHR_materials_retroreflection": {
                    "retroreflectionFactor": 0.8,
                    "retroreflectionTexture": {
                        "index": 0,
                        "extensions": {"KHR_texture_transform": {"scale": [2, 2], "rotation": 0.1}},
                    },
                },
                "KHR_materials_anisotropy": {"anisotropyStrength": 0.5},
            },
        }
    ]
    tree["textures"] = [{"source": 0, "sampler": 0}]
    tree["samplers"] = [{"wrapS": 33071, "wrapT": 10497}]
    tree["images"] = [{"uri": "picture.png"}]
    return json.dumps(tree).encode()


def _outcome() -> Outcome:
    figures = Figures(1e-6, 1e-6, 1e-6, 1e-6, 0.5, 100, 90)
    return Outcome(
        "metal",
        "mrm_conductor_bsdf",
        "egl",
        "pass",
        kind="material",
        figures=figures,
        files={"render_data": "a.txt", "exposure": 0.0},
        setup={"size": [16, 16], "lights": ["camera"]},
    )


def _line() -> dict[str, Any]:
    return {"outcome": as_record(_outcome()), "files": {"a.txt": [len(A_FILE), zlib.crc32(A_FILE)]}}


def _header() -> dict[str, Any]:
    return {
        "format": journal.FORMAT,
        "suite": "x",
        "shard": [1, 1],
        "conditions": {},
        "keys": {"egl metal": KEY},
        "environment": {
            "date": "2026-01-01 00:00 UTC",
            "platform": "Linux",
            "processors": 2,
            "backends": {"egl": "llvmpipe"},
            "versions": {"mrm-nodes": "0"},
        },
    }


def _journal_seed() -> bytes:
    return b"\n".join(json.dumps(each).encode() for each in (_header(), _line()))


def _cache_seed() -> bytes:
    header = {"key": KEY, "name": "metal", "backend": "egl"}
    return b"\n".join(json.dumps(each).encode() for each in (header, _line()))


def _report_seed() -> bytes:
    report = {"environment": _header()["environment"], "cases": [as_record(_outcome())]}
    return json.dumps({**report, "summary": {"seconds": 1.0}}).encode()


def _beside(folder: Path) -> None:
    fuzzing.write_seeds(folder)
    for number in (1001, 1002):
        shutil.copyfile(folder / "picture.png", folder / f"tiles.{number}.png")


READERS: dict[str, Reader] = {
    "xml": Reader(_xml, (fuzzing.METAL.encode(), SURFACES.encode(), SURFACES.encode("utf-16-le"))),
    "document": Reader(
        _document, (fuzzing.METAL.encode(), fuzzing.PATTERN.encode(), SURFACES.encode()), _beside
    ),
    "obj": Reader(
        _mesh("obj"), (fuzzing.BOX.encode(), b"v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nf 1 2 \\\n3\n")
    ),
    "glb": Reader(_mesh("glb"), (fuzzing.glb(),), form="bytes"),
    "gltf": Reader(_mesh("gltf"), (_gltf(),), form="json"),
    "gltf material": Reader(_gltf_material, (_gltf(),), _beside, "json"),
    "suite": Reader(_suite, (fuzzing.SUITE.encode(),), _beside),
    "journal": Reader(_journal, (_journal_seed(),), form="json"),
    "shard": Reader(_shard, (_journal_seed() + b"\n\n" + _report_seed(),), form="json"),
    "report": Reader(_report, (_report_seed(),), form="json"),
    "cache": Reader(_cached, (_cache_seed(),), form="json"),
    "baseline": Reader(
        _baseline,
        (
            json.dumps(
                {"format": baseline.FORMAT, "sha256": "0", "inputs": "0", "accepted": {"why": "dye"}}
            ).encode(),
        ),
        form="json",
    ),
    "name": Reader(
        _names, (b"tex\\a.png\nfile:///a\ntiles.<UDIM>.png\nC:/a", b"tiles.<UVTILE>.png\n../%20/~/x"), _beside
    ),
    "source": Reader(
        _source, (b'#include "lib/mx_math.glsl"\n#include "node.glsl"\nvoid own(out vec3 c) {}\n',)
    ),
    "layers": Reader(
        _layers,
        (
            b"R,G,B,A;0 0 8 8;0 0 8 8",
            b"beauty.R,beauty.G,beauty.B;-2 -2 8 8;0 0 16 16\nN.X,N.Y,N.Z;0 0 8 8;0 0 8 8",
        ),
    ),
    "words": Reader(
        _words,
        (
            b"frame:0.4,0.5,1:fov=30",
            b"0,0,3:1,0,0:width=2:up=0,1,0",
            b"spot:0,1,2:0,0,-1:1,0.5,0.5",
            b"directional:0,0,-1",
            b"640x480",
            b"2/5",
            b"retroreflection=0.5",
        ),
    ),
}
