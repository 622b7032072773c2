"""glTF materials as MaterialX documents and back, KHR_materials_retroreflection included.

Each input of MaterialX's `gltf_pbr` is a factor, a texture, or their product; `_SCALARS` and `_COLORS` say where a
glTF material keeps them. Going back, only what differs from the original glTF is written into a copy of it.
"""

from __future__ import annotations

import base64
import binascii
import copy
import json
import math
import mimetypes
import os
import struct
import urllib.parse
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import MaterialX as mx

from mrm_nodes import external, filenames, jsontext, library
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.files import write_bytes
from mrm_nodes.surfaces.names import fitting
from mrm_nodes.surfaces.weights import Weight, check_weights, find_image

EXTENSION = "KHR_materials_retroreflection"

#: Attributes of the MaterialX document and its materials that say where they came from.
SOURCE, INDEX = "gltf_source", "gltf_material"

Json = dict[str, Any]


@dataclass(frozen=True)
class _Place:
    """Where a glTF material keeps a quantity: "" is the material itself."""

    extension: str
    factor: str
    default: float
    texture: str = ""
    channel: int = 0


_PBR = "pbrMetallicRoughness"
_K = "KHR_materials_"
_ANISOTROPY = f"{_K}anisotropy"
_ANISOTROPY_IMAGE = "gltf_anisotropy_image"
_SCALARS = {
    "metallic": _Place(_PBR, "metallicFactor", 1.0, "metallicRoughnessTexture", 2),
    "roughness": _Place(_PBR, "roughnessFactor", 1.0, "metallicRoughnessTexture", 1),
    "transmission": _Place(f"{_K}transmission", "transmissionFactor", 0.0, "transmissionTexture", 0),
    "specular": _Place(f"{_K}specular", "specularFactor", 1.0, "specularTexture", 3),
    "ior": _Place(f"{_K}ior", "ior", 1.5),
    "alpha_cutoff": _Place("", "alphaCutoff", 0.5),
    "iridescence": _Place(f"{_K}iridescence", "iridescenceFactor", 0.0, "iridescenceTexture", 0),
    "iridescence_ior": _Place(f"{_K}iridescence", "iridescenceIor", 1.3),
    "sheen_roughness": _Place(f"{_K}sheen", "sheenRoughnessFactor", 0.0, "sheenRoughnessTexture", 3),
    "clearcoat": _Place(f"{_K}clearcoat", "clearcoatFactor", 0.0, "clearcoatTexture", 0),
    "clearcoat_roughness": _Place(
        f"{_K}clearcoat", "clearcoatRoughnessFactor", 0.0, "clearcoatRoughnessTexture", 1
    ),
    "emissive_strength": _Place(f"{_K}emissive_strength", "emissiveStrength", 1.0),
    "thickness": _Place(f"{_K}volume", "thicknessFactor", 0.0, "thicknessTexture", 1),
    "attenuation_distance": _Place(f"{_K}volume", "attenuationDistance", math.inf),
    "anisotropy_strength": _Place(_ANISOTROPY, "anisotropyStrength", 0.0, "anisotropyTexture"),
    "anisotropy_rotation": _Place(_ANISOTROPY, "anisotropyRotation", 0.0, "anisotropyTexture"),
    "dispersion": _Place(f"{_K}dispersion", "dispersion", 0.0),
    "retroreflection": _Place(EXTENSION, "retroreflectionFactor", 0.0, "retroreflectionTexture", 0),
}
_COLORS = {
    "base_color": _Place(_PBR, "baseColorFactor", 1.0, "baseColorTexture"),
    "specular_color": _Place(f"{_K}specular", "specularColorFactor", 1.0, "specularColorTexture"),
    "sheen_color": _Place(f"{_K}sheen", "sheenColorFactor", 0.0, "sheenColorTexture"),
    "emissive": _Place("", "emissiveFactor", 0.0, "emissiveTexture"),
    "attenuation_color": _Place(f"{_K}volume", "attenuationColor", 1.0),
}
_NORMALS = {"normal": ("", "normalTexture"), "clearcoat_normal": (f"{_K}clearcoat", "clearcoatNormalTexture")}
_ALPHA_MODES = ("OPAQUE", "MASK", "BLEND")
#: Extensions of a material that MaterialX's gltf_pbr cannot take: the converted material would be another one.
_EXCLUDED = (f"{_K}unlit", f"{_K}pbrSpecularGlossiness")
_KNOWN = {place.extension for place in (*_SCALARS.values(), *_COLORS.values())}
#: Formats of images that are no glTF 2.0, by the extensions that bring them.
_IMAGE_EXTENSIONS = {
    "image/webp": "EXT_texture_webp",
    "image/ktx2": "KHR_texture_basisu",
    "image/avif": "EXT_texture_avif",
    "image/vnd-ms.dds": "MSFT_texture_dds",
}
_WRAPS = {33071: "clamp", 33648: "mirror", 10497: "periodic"}


@dataclass
class GltfAsset:
    """A glTF file: its JSON, and the binary chunk of a .glb."""

    path: Path
    json: Json
    binary: bytes = b""
    given: set[Path] = field(default_factory=set)
    """Images that were named beside it."""


def read_gltf(path: str | os.PathLike[str]) -> GltfAsset:
    """Read a .gltf or .glb file.

    Raises:
        MrmError: missing, neither of the two, damaged, or not glTF 2.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise MrmError(f"{path}: cannot be read ({error.strerror})") from None
    binary = b""
    if data[:4] == b"glTF":
        text, binary = _chunks(data, path)
    else:
        text = data
    try:
        content = jsontext.loads(text)
    except ValueError as error:
        raise MrmError(f"{path}: not glTF: {error}") from None
    about = content.get("asset") if isinstance(content, dict) else None
    version = about.get("version") if isinstance(about, dict) else None
    if not (isinstance(version, str) and version.startswith("2.")):
        raise MrmError(f"{path}: not glTF 2: its asset says version {version}")
    for name in ("materials", "textures", "images", "samplers", "bufferViews", "buffers", "meshes"):
        if not isinstance(content.get(name) or [], list):
            raise MrmError(f"{path}: not laid out as glTF 2.0 says: {name} is no list")
    return GltfAsset(path, content, binary)


def _chunks(data: bytes, path: Path) -> tuple[bytes, bytes]:
    """Return the JSON and the binary chunk of a .glb: glTF 2.0, section 4."""
    found = {b"JSON": b"", b"BIN\0": b""}
    position = 12
    if len(data) < 20 or struct.unpack_from("<I", data, 8)[0] > len(data):
        raise MrmError(f"{path}: a .glb that is cut short")
    while position + 8 <= len(data):
        length, kind = struct.unpack_from("<I4s", data, position)
        if position + 8 + length > len(data):
            raise MrmError(f"{path}: a .glb that is cut short")
        found.setdefault(kind, b"")
        found[kind] = data[position + 8 : position + 8 + length]
        position += 8 + length
    return found[b"JSON"], found[b"BIN\0"]


def write_gltf(asset: GltfAsset, target: Path) -> None:
    """Write a .gltf, or a .glb with the asset's binary chunk.

    Raises:
        MrmError: it cannot be written.
    """
    text = json.dumps(asset.json, indent=None if asset.binary else 2, ensure_ascii=False).encode("utf-8")
    if target.suffix.lower() != ".glb":
        write_bytes(target, text + b"\n")
        return
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if asset.binary:
        binary = asset.binary + b"\0" * (-len(asset.binary) % 4)
        chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    write_bytes(target, struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


# --- glTF to MaterialX --------------------------------------------------------------------------------------


def gltf_to_materialx(
    source: Path,
    target: Path,
    weights: Mapping[str, Weight] | None = None,
    allow_external: bool = False,
) -> list[str]:
    """Write a .mtlx with an `mrm_gltf_pbr` for every material of a glTF, and return the materials' names.

    Images inside the glTF are written beside the document. A material that MaterialX has nothing for is left out,
    with a warning.

    Args:
        weights: `retroreflection` is every material's factor then; a texture goes on to multiply it. Text is the
            name of an image file whose red channel is the weight.
        allow_external: whether the glTF may name files outside of its folder.

    Raises:
        MrmError: a glTF that is broken, has no material or none that MaterialX has something for, an image that is
            missing or outside, or a target that cannot be written. Nothing is written then.
    """
    asset = read_gltf(source)
    images: dict[str, bytes] = {}
    weights = dict(weights or {})
    for name in weights:
        if name != "retroreflection":
            raise MrmError(f"{source}: glTF has no input {name}; the one that can be set is retroreflection")
    check_weights(weights)
    for weight in weights.values():
        _set_weight(asset, weight)
    document = _document(asset, target, images, allow_external)
    names = [node.getName() for node in document.getMaterialNodes()]
    valid, message = _with_library(document).validate()
    if not valid:
        raise MrmError(f"{source}: its MaterialX is not valid: {' '.join(message.split())}")
    document.setDataLibrary(None)
    try:
        external.check_files(document, target, allow_external)
    except MrmError as error:
        warnings.warn(str(error), MrmWarning, stacklevel=2)
    for name, content in images.items():
        write_bytes(target.parent / name, content)
    write_bytes(target, mx.writeToXmlString(document).encode("utf-8"))
    return names


def _set_weight(asset: GltfAsset, weight: Weight) -> None:
    """Set the weight of every material to a number, or to the red channel of an image."""
    texture: Json = {}
    if isinstance(weight, str):
        file = find_image("retroreflection", weight)
        if not file:
            raise MrmError(f"--set retroreflection={weight}: there is no such file, and glTF has no nodes")
        added = _Images(asset.json, Path(), asset.path.parent)
        texture = {"retroreflectionTexture": added.add(file, None, "--set retroreflection")}
        asset.given.add(Path(file).resolve())
    for material in asset.json.get("materials") or []:
        if isinstance(material, dict):
            part = _made(material, EXTENSION)
            part.update({"retroreflectionFactor": 1.0 if texture else weight, **texture})


class _NothingForIt(MrmError):
    """A material is sound, and MaterialX has nothing for it."""


def _document(
    asset: GltfAsset, target: Path, images: dict[str, bytes], allow_external: bool = False
) -> mx.Document:
    """Return the MaterialX document of an asset; `images` takes the files that have to lie beside it."""
    materials = asset.json.get("materials") or []
    if not materials:
        raise MrmError(f"{asset.path}: has no materials")
    document = mx.createDocument()
    document.setDataLibrary(library.shared_library())
    document.setAttribute(SOURCE, _relative(asset.path, target.parent))
    left_out: list[str] = []
    for index, material in enumerate(materials):
        where = f"{asset.path}: material {index}"
        reader = _Reader(asset, target, document, images, where, allow_external)
        try:
            reader.add(index, material)
        except _NothingForIt as error:
            left_out.append(str(error))
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            # Each of its numbers and objects is looked at once, as what it should be.
            raise MrmError(f"{reader.where}: not laid out as glTF 2.0 says: {error}") from error
    if len(left_out) == len(materials):
        raise MrmError(left_out[0])
    for reason in left_out:
        warnings.warn(f"{reason}; the material is left out", MrmWarning, stacklevel=3)
    return document


def _with_library(document: mx.Document) -> mx.Document:
    document.setDataLibrary(library.shared_library())
    return document


def _relative(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()


@dataclass
class _Reader:
    """Turns one glTF material into MaterialX nodes."""

    asset: GltfAsset
    target: Path
    document: mx.Document
    images: dict[str, bytes]
    where: str
    allow_external: bool

    def add(self, index: int, material: Json) -> None:
        self._check(material)
        valid = mx.createValidName(str(material.get("name") or f"material{index}"))
        name = fitting(valid, {child.getName() for child in self.document.getChildren()})
        shader = self.document.addNode("mrm_gltf_pbr", f"{name}_shader", "surfaceshader")
        vertex_colors = self._vertex_colors(index)
        for socket, place in _COLORS.items():
            self._color(shader, socket, place, material, vertex_colors if socket == "base_color" else None)
        known = {one.getName() for one in shader.getNodeDef("", True).getActiveInputs()}
        for socket, place in _SCALARS.items():
            if socket in known:
                self._scalar(shader, socket, place, material)
            elif place.factor in _part(material, place.extension):
                warnings.warn(
                    f"{self.where}: the gltf_pbr of MaterialX {mx.getVersionString()} has no {socket}; left out",
                    MrmWarning,
                    stacklevel=2,
                )
        for socket, (extension, key) in _NORMALS.items():
            self._normal(shader, socket, _part(material, extension).get(key))
        self._occlusion(shader, material.get("occlusionTexture"))
        self._alpha(shader, material, vertex_colors)
        self._film(shader, material)
        node = self.document.addNode("surfacematerial", name, "material")
        node.addInput("surfaceshader", "surfaceshader").setConnectedNode(shader)
        node.setAttribute(INDEX, str(index))

    def _check(self, material: Json) -> None:
        if not isinstance(material, dict):
            raise MrmError(f"{self.where}: is not an object")
        extensions = material.get("extensions", {})
        if not isinstance(extensions, dict):
            raise MrmError(f"{self.where}: extensions is not an object")
        for name in _EXCLUDED:
            if name in extensions:
                raise _NothingForIt(
                    f"{self.where}: {name} is not metallic-roughness; MaterialX's gltf_pbr cannot take it"
                )
        for name, extension in extensions.items():
            if not isinstance(extension, dict):
                raise MrmError(f"{self.where}: {name} is not an object")
            if name not in _KNOWN:
                if name in self.asset.json.get("extensionsRequired", []):
                    raise _NothingForIt(f"{self.where}: requires {name}, which MaterialX has nothing for")
                warnings.warn(
                    f"{self.where}: {name} is left out: MaterialX has nothing for it",
                    MrmWarning,
                    stacklevel=2,
                )
        retro = extensions.get(EXTENSION, {})
        factor = retro.get("retroreflectionFactor", 0.0)
        if isinstance(factor, bool) or not isinstance(factor, int | float) or not 0.0 <= factor <= 1.0:
            raise MrmError(f"{self.where}: retroreflectionFactor {factor!r} is not a number from 0 to 1")
        unknown = set(retro) - {"retroreflectionFactor", "retroreflectionTexture", "extensions", "extras"}
        if unknown:
            raise MrmError(f"{self.where}: {EXTENSION} has no {min(unknown)}")
        # Before the first node is made of it.
        for info in _texture_infos(material):
            self._image_of(self._item("textures", info.get("index")))

    def _number(self, part: Json, place: _Place) -> float:
        value = part.get(place.factor, place.default)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise MrmError(f"{self.where}: {place.factor} {value!r} is not a number")
        return float(value)

    def _scalar(self, shader: mx.Node, socket: str, place: _Place, material: Json) -> None:
        part = _part(material, place.extension)
        factor = self._number(part, place)
        texture = part.get(place.texture) if place.texture else None
        if texture is None:
            if factor != place.default:
                shader.addInput(socket, _type(shader, socket)).setValueString(_text([factor]))
            return
        if place.extension == _ANISOTROPY:
            self._anisotropy(shader, socket, factor, texture)
            return
        image = self._image(texture, "vector3" if place.channel < 3 else "color4", f"{socket}_image")
        value = self._extract(image, place.channel, f"{socket}_channel")
        if factor != 1.0:
            value = self._math("multiply", f"{socket}_scaled", value, factor)
        shader.addInput(socket, "float").setConnectedNode(value)

    def _anisotropy(self, shader: mx.Node, socket: str, factor: float, texture: Json) -> None:
        """Connect strength or rotation to the one node that has both: their texture is a direction and a strength."""
        other = shader.getInput("anisotropy_strength")
        image = other.getConnectedNode() if other is not None else None
        if image is None:
            image = self._image(texture, "multioutput", "anisotropy_image", category=_ANISOTROPY_IMAGE)
        image.addInput(socket, "float").setValueString(_text([factor]))
        connected = shader.addInput(socket, "float")
        connected.setConnectedNode(image)
        connected.setOutputString(f"{socket}_out")

    def _vertex_colors(self, index: int) -> mx.Node | None:
        """Return a node for the colours of the vertices, where meshes of the material have them: they multiply."""
        primitives = [
            primitive
            for mesh in self.asset.json.get("meshes") or []
            for primitive in mesh.get("primitives") or []
            if primitive.get("material") == index
        ]
        colored = [primitive for primitive in primitives if "COLOR_0" in primitive.get("attributes", {})]
        if not colored:
            return None
        if len(colored) < len(primitives):
            warnings.warn(
                f"{self.where}: some of its meshes have no vertex colours; a renderer may draw them black",
                MrmWarning,
                stacklevel=2,
            )
        return self.document.addNode("geomcolor", self._free("vertex_colors"), "color4")

    def _color(
        self, shader: mx.Node, socket: str, place: _Place, material: Json, vertex_colors: mx.Node | None
    ) -> None:
        part = _part(material, place.extension)
        factor = part.get(place.factor, [place.default] * 3)
        if not (
            isinstance(factor, list) and len(factor) >= 3 and all(isinstance(x, int | float) for x in factor)
        ):
            raise MrmError(f"{self.where}: {place.factor} {factor!r} is not a colour")
        texture = part.get(place.texture) if place.texture else None
        image = None
        if texture is not None:
            image = self._image(texture, "color3", f"{socket}_image", "srgb_texture")
            if factor[:3] != [1.0] * 3:
                image.addInput("factor", "color3").setValueString(_text(factor[:3]))
        if vertex_colors is not None:
            converted = self.document.addNode("convert", self._free(f"{socket}_vertices"), "color3")
            converted.addInput("in", "color4").setConnectedNode(vertex_colors)
            product = self.document.addNode("multiply", self._free(f"{socket}_product"), "color3")
            self._set(product.addInput("in1", "color3"), image, factor[:3])
            product.addInput("in2", "color3").setConnectedNode(converted)
            shader.addInput(socket, "color3").setConnectedNode(product)
        elif image is not None or factor[:3] != [place.default] * 3:
            self._set(shader.addInput(socket, "color3"), image, factor[:3])

    def _set(self, socket: mx.Input, node: mx.Node | None, value: list[float]) -> None:
        if node is not None:
            socket.setConnectedNode(node)
        else:
            socket.setValueString(_text(value))

    def _normal(self, shader: mx.Node, socket: str, texture: Json | None) -> None:
        if texture is None:
            return
        image = self._image(texture, "vector3", f"{socket}_image", category="gltf_normalmap")
        scale = texture.get("scale", 1.0)
        if scale == 1.0:
            shader.addInput(socket, "vector3").setConnectedNode(image)
            return
        image.setCategory("gltf_image")
        mapped = self.document.addNode("normalmap", self._free(f"{socket}_map"), "vector3")
        mapped.addInput("in", "vector3").setConnectedNode(image)
        mapped.addInput("scale", "float").setValueString(_text([scale]))
        shader.addInput(socket, "vector3").setConnectedNode(mapped)

    def _occlusion(self, shader: mx.Node, texture: Json | None) -> None:
        if texture is None:
            return
        value = self._extract(self._image(texture, "vector3", "occlusion_image"), 0, "occlusion_channel")
        strength = texture.get("strength", 1.0)
        if strength != 1.0:
            # 1 + strength (sampled - 1): glTF 2.0, section 5.23.
            mixed = self.document.addNode("mix", self._free("occlusion_mixed"), "float")
            mixed.addInput("bg", "float").setValueString("1")
            mixed.addInput("fg", "float").setConnectedNode(value)
            mixed.addInput("mix", "float").setValueString(_text([strength]))
            value = mixed
        shader.addInput("occlusion", "float").setConnectedNode(value)

    def _alpha(self, shader: mx.Node, material: Json, vertex_colors: mx.Node | None) -> None:
        mode = material.get("alphaMode", "OPAQUE")
        if mode not in _ALPHA_MODES:
            raise MrmError(f"{self.where}: alphaMode {mode!r} is not one of {', '.join(_ALPHA_MODES)}")
        if mode != "OPAQUE":
            shader.addInput("alpha_mode", "integer").setValueString(str(_ALPHA_MODES.index(mode)))
        part = _part(material, _PBR)
        factor = (part.get("baseColorFactor") or [1.0] * 4)[3:] or [1.0]
        texture = part.get("baseColorTexture")
        channels = [] if mode == "OPAQUE" or vertex_colors is None else [vertex_colors]
        if mode != "OPAQUE" and texture is not None:
            channels.append(self._image(texture, "color4", "alpha_image"))
        value = None
        for node in channels:
            channel = self._extract(node, 3, "alpha_channel")
            value = channel if value is None else self._math("multiply", "alpha_product", value, channel)
        if value is not None and factor[0] != 1.0:
            value = self._math("multiply", "alpha_scaled", value, factor[0])
        if value is not None or factor[0] != 1.0:
            self._set(shader.addInput("alpha", "float"), value, factor)

    def _film(self, shader: mx.Node, material: Json) -> None:
        part = _part(material, f"{_K}iridescence")
        low, high = (
            part.get(f"iridescenceThickness{end}", d) for end, d in (("Minimum", 100.0), ("Maximum", 400.0))
        )
        texture = part.get("iridescenceThicknessTexture")
        if texture is not None:
            image = self._image(texture, "float", "film_image", category="gltf_iridescence_thickness")
            image.addInput("thicknessMin", "float").setValueString(_text([low]))
            image.addInput("thicknessMax", "float").setValueString(_text([high]))
            shader.addInput("iridescence_thickness", "float").setConnectedNode(image)
        elif part:
            shader.addInput("iridescence_thickness", "float").setValueString(_text([high]))

    def _image(
        self, info: Json, kind: str, name: str, colorspace: str = "", category: str = "gltf_image"
    ) -> mx.Node:
        """Add the node that looks up a textureInfo."""
        texture = self._item("textures", info.get("index") if isinstance(info, dict) else None)
        file = self._file(self._image_of(texture))
        node = self.document.addNode(category, self._free(name), kind)
        socket = node.addInput("file", "filename")
        socket.setValueString(file)
        if colorspace:
            socket.setAttribute("colorspace", colorspace)
        transform = info.get("extensions", {}).get("KHR_texture_transform", {})
        coordinates = transform.get("texCoord", info.get("texCoord", 0))
        if coordinates:
            uv = self.document.addNode("texcoord", self._free(f"{name}_uv"), "vector2")
            uv.addInput("index", "integer").setValueString(str(coordinates))
            node.addInput("texcoord", "vector2").setConnectedNode(uv)
        for key in ("offset", "scale"):
            if key in transform:
                node.addInput(key, "vector2").setValueString(_text(transform[key]))
        if "rotation" in transform:
            node.addInput("rotate", "float").setValueString(_text([math.degrees(transform["rotation"])]))
        sampler = self._item("samplers", texture["sampler"]) if "sampler" in texture else {}
        for key, mode in (("wrapS", "uaddressmode"), ("wrapT", "vaddressmode")):
            if sampler.get(key, 10497) != 10497:
                node.addInput(mode, "string").setValueString(_WRAPS[sampler[key]])
        if sampler.get("magFilter") == 9728:
            node.addInput("filtertype", "string").setValueString("closest")
        return node

    def _item(self, kind: str, index: Any) -> Json:
        items = self.asset.json.get(kind) or []
        if not isinstance(index, int) or not 0 <= index < len(items):
            raise MrmError(f"{self.where}: there is no {kind[:-1]} {index}; the glTF has {len(items)}")
        item: Json = items[index]
        return item

    def _image_of(self, texture: Json) -> Any:
        """Return the image of a texture in a format of glTF itself.

        Raises:
            _NothingForIt: it has none, but one of an extension.
        """
        index = texture.get("source")
        if index is None:
            for name, extension in texture.get("extensions", {}).items():
                if "source" in extension:
                    raise _NothingForIt(
                        f"{self.where}: a texture is in {name} only, which MaterialX has nothing for; "
                        "convert its image to PNG"
                    )
        image = self._item("images", index)
        kind = image.get("mimeType") or mimetypes.guess_type(str(image.get("uri", "")))[0]
        content = self._embedded(image, index)[:12] if _is_embedded(image) else b""
        kind = "image/webp" if content[:4] == b"RIFF" else kind
        kind = "image/ktx2" if content[1:4] == b"KTX" else kind
        if kind in _IMAGE_EXTENSIONS:
            raise _NothingForIt(
                f"{self.where}: image {index} is {kind}, of {_IMAGE_EXTENSIONS[kind]}, which MaterialX has nothing "
                "for; convert it to PNG"
            )
        return index

    def _file(self, index: Any) -> str:
        """Return the name of an image for the document; an image inside the glTF becomes a file beside it."""
        image = self._item("images", index)
        if not _is_embedded(image):
            path = self.asset.path.parent / urllib.parse.unquote(image["uri"])
            if not filenames.is_file(path):
                raise MrmError(f"{self.where}: there is no texture {path}")
            if path.resolve() not in self.asset.given:
                self._check_inside(path, image["uri"])
            return _relative(path, self.target.parent)
        content = self._embedded(image, index)
        ending = ".jpg" if content[:2] == b"\xff\xd8" else ".png"
        name = f"{self.target.stem}_image{index}{ending}"
        self.images[name] = content
        return name

    def _embedded(self, image: Json, index: Any) -> bytes:
        try:
            if "uri" in image:
                return base64.b64decode(image["uri"].partition(",")[2], validate=True)
        except (binascii.Error, ValueError):
            raise MrmError(f"{self.where}: image {index} is not base64") from None
        view = self._item("bufferViews", image.get("bufferView"))
        start = view.get("byteOffset", 0)
        content = self._buffer(view.get("buffer"))[start : start + view.get("byteLength", 0)]
        if len(content) != view.get("byteLength"):
            raise MrmError(f"{self.where}: image {index} lies outside its buffer")
        return content

    def _buffer(self, index: Any) -> bytes:
        uri = self._item("buffers", index).get("uri")
        if uri is None:
            return self.asset.binary
        try:
            if uri.startswith("data:"):
                return base64.b64decode(uri.partition(",")[2])
            path = self.asset.path.parent / urllib.parse.unquote(uri)
            self._check_inside(path, uri)
            return path.read_bytes()
        except (OSError, ValueError):
            raise MrmError(f"{self.where}: buffer {index} cannot be read") from None

    def _check_inside(self, path: Path, name: str) -> None:
        folder = self.asset.path.resolve().parent
        external.check_inside(path, name, self.where, folder, self.allow_external)

    def _extract(self, image: mx.Node, channel: int, name: str) -> mx.Node:
        node = self.document.addNode("extract", self._free(name), "float")
        node.addInput("in", image.getType()).setConnectedNode(image)
        node.addInput("index", "integer").setValueString(str(channel))
        return node

    def _math(self, category: str, name: str, value: mx.Node, other: mx.Node | float) -> mx.Node:
        node = self.document.addNode(category, self._free(name), "float")
        node.addInput("in1", "float").setConnectedNode(value)
        if isinstance(other, mx.Node):
            node.addInput("in2", "float").setConnectedNode(other)
        else:
            node.addInput("in2", "float").setValueString(_text([other]))
        return node

    def _free(self, name: str) -> str:
        free: str = self.document.createValidChildName(name)
        return free


def _is_embedded(image: Json) -> bool:
    uri = image.get("uri")
    return uri is None or uri.startswith("data:")


def _texture_infos(part: Json) -> Iterator[Json]:
    """Yield every textureInfo of a material, of the extensions that are known too."""
    for name, value in part.items():
        if name == "extensions":
            for extension in set(value) & _KNOWN:
                yield from _texture_infos(value[extension])
        elif isinstance(value, dict):
            if name.endswith("Texture"):
                yield value
            else:
                yield from _texture_infos(value)


def _part(material: Json, extension: str) -> Json:
    """Return the object of a material that holds an extension's properties."""
    if extension == "":
        return material
    if extension == _PBR:
        return material.get(_PBR) or {}
    return (material.get("extensions") or {}).get(extension) or {}


def _type(shader: mx.Node, socket: str) -> str:
    kind: str = shader.getNodeDef("", True).getActiveInput(socket).getType()
    return kind


def _text(numbers: list[float]) -> str:
    return ", ".join(f"{number:.9g}" for number in numbers)


# --- MaterialX to glTF --------------------------------------------------------------------------------------


def materialx_to_gltf(source: Path, target: Path, allow_external: bool = False) -> list[str]:
    """Write a document that `gltf_to_materialx` made back as glTF; return the materials that changed.

    The original glTF, which the document names, is copied; of its materials, only the numbers and image files that
    differ are written: geometry, animation, extras and unknown extensions stay.

    Raises:
        MrmError: no such document, not made from glTF, the original or a new image is missing, or nodes that
            glTF has nothing for. Nothing is written then.
    """
    from mrm_nodes.documents import read_document

    document = read_document(source, allow_external=allow_external)
    name = document.getAttribute(SOURCE)
    if not name:
        raise MrmError(f"{source}: was not made from a glTF: it has no {SOURCE}")
    asset = read_gltf(source.parent / name)
    if target.suffix.lower() != asset.path.suffix.lower():
        raise MrmError(f"{target}: the original is a {asset.path.suffix} file; end the name so")
    if target.exists() and target.samefile(asset.path):
        raise MrmError(f"{target}: is the original glTF; name another file")
    if not asset.binary and target.resolve().parent != asset.path.resolve().parent:
        raise MrmError(
            f"{target}: its images and buffers are named relative to {asset.path.parent}; write it there"
        )
    baseline = _document(asset, source, {}, allow_external)
    result = GltfAsset(asset.path, copy.deepcopy(asset.json), asset.binary)
    changed = []
    for node in document.getMaterialNodes():
        if not node.hasAttribute(INDEX):
            raise MrmError(f"{source}: {node.getName()} was not made from a glTF: it has no {INDEX}")
        index = int(node.getAttribute(INDEX))
        originals = [m for m in baseline.getMaterialNodes() if m.getAttribute(INDEX) == str(index)]
        if not originals:
            raise MrmError(f"{source}: {node.getName()}: {asset.path} has no material {index}")
        before, after = (
            _inputs(document_, n) for document_, n in ((baseline, originals[0]), (document, node))
        )
        if before != after:
            images = _Images(result.json, source.parent, target.parent)
            _apply(result.json, images, index, before, after, f"{source}: {node.getName()}")
            changed.append(node.getName())
    write_gltf(result, target)
    return changed


def _inputs(document: mx.Document, material: mx.Node) -> dict[str, Any]:
    """Return what drives each input of a material's shader: numbers, or ("texture", …) with its numbers last."""
    shader = material.getConnectedNode("surfaceshader")
    if shader is None or shader.getCategory() not in ("mrm_gltf_pbr", "gltf_pbr"):
        raise MrmError(f"{material.getName()}: its shader is not an mrm_gltf_pbr")
    return {socket.getName(): _described(socket) for socket in shader.getInputs()}


def _described(socket: mx.Input) -> Any:
    node = socket.getConnectedNode()
    if node is None:
        return tuple(float(x) for x in socket.getValueString().replace(",", " ").split())
    children = [
        (
            one.getName(),
            _described(one) if one.getType() not in ("filename", "string") else one.getValueString(),
        )
        for one in node.getInputs()
    ]
    return (node.getCategory(), *sorted(children))


@dataclass
class _Images:
    """Adds image files to a glTF."""

    content: Json
    source: Path
    target: Path

    def add(self, file: str, original: Json | None, where: str) -> Json:
        """Return a textureInfo that shows `file`, otherwise as the original one."""
        path = self.source / filenames.with_slashes(file)
        if not filenames.is_file(path):
            raise MrmError(f"{where}: there is no texture {path}")
        image = {"uri": urllib.parse.quote(_relative(path, self.target))}
        texture: Json = {"source": self._index("images", image)}
        if original is not None:
            texture = self.content["textures"][original["index"]] | texture
        return (original or {}) | {"index": self._index("textures", texture)}

    def _index(self, kind: str, item: Json) -> int:
        items = self.content.setdefault(kind, [])
        if item not in items:
            items.append(item)
        index: int = items.index(item)
        return index


def _apply(content: Json, images: _Images, index: int, before: Json, after: Json, where: str) -> None:
    """Write the inputs that differ into a material of the glTF."""
    material = content["materials"][index]
    for socket in sorted(set(before) | set(after)):
        if before.get(socket) == after.get(socket):
            continue
        place = _SCALARS.get(socket) or _COLORS.get(socket)
        if place is None:
            raise MrmError(f"{where}: {socket} changed, which cannot be written back; change it in the glTF")
        old, new = _split(before.get(socket), socket, place), _split(after.get(socket), socket, place)
        lookup = (old.lookup if old.file else _plain_lookup(socket, place)) if new.file else None
        if (new.lookup, new.has_vertex_colors) != (lookup, old.has_vertex_colors):
            raise MrmError(
                f"{where}: what drives {socket} is not a texture times a factor as it was; change it in the glTF"
            )
        part = _made(material, place.extension)
        _set_factor(part, socket, place, new.factor, has_texture=bool(new.file))
        if new.file != old.file:
            if new.file:
                part[place.texture] = images.add(new.file, part.get(place.texture), f"{where}: {socket}")
            else:
                del part[place.texture]
        used = content.setdefault("extensionsUsed", [])
        if place.extension.startswith("KHR_") and place.extension not in used:
            used.append(place.extension)
        if not used:
            del content["extensionsUsed"]


def _set_factor(
    part: Json, socket: str, place: _Place, factor: tuple[float, ...] | None, has_texture: bool
) -> None:
    """Write a factor; of None, what it is without being written."""
    if factor is None and place.factor not in part and (not has_texture or place.default == 1.0):
        return
    numbers = list(factor or ((1.0 if has_texture else place.default),))
    if socket in _COLORS:
        numbers = numbers * 3 if len(numbers) == 1 else numbers
        if socket == "base_color":
            numbers.append(part.get(place.factor, [1.0] * 4)[3])
        part[place.factor] = numbers
    else:
        part[place.factor] = numbers[0]


@dataclass(frozen=True)
class _Driver:
    """What an input is driven by: a factor (None where it is the default), and the look-up of an image file."""

    factor: tuple[float, ...] | None
    file: str = ""
    lookup: Any = None
    has_vertex_colors: bool = False


def _split(described: Any, socket: str, place: _Place) -> _Driver:
    """Take apart what `_described` says of an input."""
    if described is None or all(isinstance(x, float) for x in described):
        return _Driver(described)
    inputs = dict(described[1:])
    if described[0] == "multiply" and inputs.get("in2", ("",))[0] == "convert":
        inner = _split(inputs["in1"], socket, place)
        return replace(inner, has_vertex_colors=True)
    factor = None
    if described[0] == "multiply":
        factor, described = inputs.get("in2"), inputs.get("in1", ("",))
    elif described[0] == "gltf_image":
        factor = inputs.pop("factor", None)
        described = ("gltf_image", *sorted(inputs.items()))
    elif described[0] == _ANISOTROPY_IMAGE:
        factor = inputs.get(socket)
        inputs = {name: value for name, value in inputs.items() if not name.startswith("anisotropy")}
        described = (_ANISOTROPY_IMAGE, *sorted(inputs.items()))
    file, lookup = _without_file(described)
    return _Driver(factor, file, lookup)


def _without_file(described: Any) -> tuple[str, Any]:
    """Take the image file out of a look-up: directly, or in the image whose channel is extracted."""
    inputs = dict(described[1:])
    if described[0] == "extract":
        file, inputs["in"] = _without_file(inputs.get("in", ("",)))
    else:
        file = inputs.pop("file", "")
    return file, (described[0], *sorted(inputs.items()))


def _plain_lookup(socket: str, place: _Place) -> Any:
    """Return the look-up of a texture that the glTF did not have."""
    if place.extension == _ANISOTROPY:
        return (_ANISOTROPY_IMAGE,)
    if socket in _COLORS:
        return ("gltf_image",)
    return ("extract", ("in", ("gltf_image",)), ("index", (float(place.channel),)))


def _made(material: Json, extension: str) -> Json:
    """Return the object of a material that holds an extension's properties; make it if it is not there."""
    if extension == "":
        return material
    if extension == _PBR:
        part: Json = material.setdefault(_PBR, {})
        return part
    part = material.setdefault("extensions", {}).setdefault(extension, {})
    return part
