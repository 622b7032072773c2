"""The triangles of a Wavefront .obj file, with everything that its vertices carry.

MaterialX's own loader drops colours, crashes on some faces, and opens the material library that a file names,
whatever file that is. Nothing but the file itself is opened here.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.render.mesh import Part

#: What vertex data needs at least, and has at most.
_WIDTHS = {"v": (3, 7), "vt": (1, 3), "vn": (3, 3)}
_NOT_DRAWN = {"p": "points", "l": "lines", "curv": "curves", "curv2": "curves", "surf": "free-form surfaces"}
_POLYPAINT = "#MRGB"

#: v, vt and vn of a face's corner, counted from 0; -1 where it has none.
Corner = tuple[int, int, int]


@dataclass
class _Content:
    """What a file's lines say."""

    values: dict[str, list[list[float]]] = field(default_factory=lambda: {"v": [], "vt": [], "vn": []})
    faces: list[list[Corner]] = field(default_factory=list)
    notes: dict[str, None] = field(default_factory=dict)


def read_obj_mesh(file: Path) -> list[Part]:
    """Read the faces of a file as one part, polygons cut into triangles.

    Warns (MrmWarning) of what is there and is not drawn: points, lines, curves.

    Raises:
        MrmError: a face refers to what the file lacks, a number is none, or there is no face.
    """
    content = _Content()
    for number, words in _statements(file):
        _read(words, content, f"{file}, line {number}")
    points = content.values["v"]
    if not content.faces or not points:
        raise MrmError(f"{file}: the mesh is empty: {len(points)} vertices, {len(content.faces)} faces")
    for note in content.notes:
        warnings.warn(f"{file}: {note}", MrmWarning, stacklevel=4)
    return [_part(content)]


def _statements(file: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the words of each statement and its first line's number; a backslash continues it on the next."""
    begun: list[str] = []
    first = 1
    try:
        with file.open(encoding="utf-8-sig", errors="replace") as lines:
            for number, line in enumerate(lines, start=1):
                text = line.rstrip("\n")
                if text.startswith(_POLYPAINT):
                    yield number, [_POLYPAINT]
                text = text.split("#", 1)[0].rstrip()
                first = first if begun else number
                begun += text.removesuffix("\\").split()
                if not text.endswith("\\"):
                    if begun:
                        yield first, begun
                    begun = []
    except OSError as error:
        raise MrmError(f"{file}: cannot be read: {error.strerror}") from None
    if begun:
        yield first, begun


def _read(words: list[str], content: _Content, where: str) -> None:
    kind = words[0]
    if kind in _WIDTHS:
        content.values[kind].append(_numbers(words, where))
    elif kind == "f":
        if len(words) < 4:
            raise MrmError(f"{where}: a face needs three vertices or more")
        counts = {name: len(values) for name, values in content.values.items()}
        content.faces.append([_corner(text, counts, where) for text in words[1:]])
    elif kind in _NOT_DRAWN:
        content.notes[f"its {_NOT_DRAWN[kind]} are not drawn"] = None
    elif kind == _POLYPAINT:
        content.notes[f"its vertex colours in comments ({_POLYPAINT}) are not read"] = None


def _numbers(words: list[str], where: str) -> list[float]:
    least, most = _WIDTHS[words[0]]
    shown = " ".join(words)[:80]
    try:
        numbers = [float(word) for word in words[1 : most + 1]]
    except ValueError:
        raise MrmError(f"{where}: not numbers: {shown}") from None
    if len(numbers) < least:
        raise MrmError(f"{where}: {words[0]} needs {least} numbers: {shown}")
    if not np.isfinite(numbers).all():
        raise MrmError(f"{where}: NaN or infinite: {shown}")
    return numbers


def _corner(text: str, counts: dict[str, int], where: str) -> Corner:
    """Return what a corner of a face (`v`, `v/vt`, `v//vn` or `v/vt/vn`) refers to."""
    fields = text.split("/")
    if len(fields) > 3:
        raise MrmError(f"{where}: not a vertex of a face: {text}")
    found = [-1, -1, -1]
    for place, (kind, digits) in enumerate(zip(("v", "vt", "vn"), fields, strict=False)):
        if not digits and kind != "v":
            continue
        try:
            index = int(digits)
        except ValueError:
            raise MrmError(f"{where}: not a vertex of a face: {text}") from None
        # Indices count from 1, or backwards from the last one read.
        if index == 0 or index > counts[kind] or -index > counts[kind]:
            raise MrmError(f"{where}: the face refers to {kind} {index}, but {counts[kind]} are there so far")
        found[place] = index - 1 if index > 0 else counts[kind] + index
    return found[0], found[1], found[2]


def _part(content: _Content) -> Part:
    points = np.array([values[:3] for values in content.values["v"]])
    starts = np.cumsum([0, *map(len, content.faces)])
    corners = np.array([corner for face in content.faces for corner in face], np.int64)
    triangles = _cut(points[corners[:, 0]], starts)
    vertices, number = np.unique(corners, axis=0, return_inverse=True)
    v, vt, vn = vertices.T
    streams: dict[str, NDArray[Any]] = {"position": points[v]}
    if (vt >= 0).any():
        streams["texcoord_0"] = _taken([[*uv, 0.0][:2] for uv in content.values["vt"]], vt, np.nan)
    if (vn >= 0).any():
        streams["normal"] = _taken(content.values["vn"], vn, 0.0)
    if any(len(values) >= 6 for values in content.values["v"]):
        colors = [_color(values) for values in content.values["v"]]
        streams["color_0"] = np.array(colors)[v]
    return Part(streams, number.reshape(-1)[triangles])


def _taken(values: list[list[float]], indices: NDArray[np.int64], lacking: float) -> NDArray[np.float64]:
    """Return the values that indices refer to, and `lacking` where an index is -1."""
    taken: NDArray[np.float64] = np.array(values)[indices]
    taken[indices < 0] = lacking
    return taken


def _color(values: list[float]) -> list[float]:
    """Return the colour after a vertex's position, white where there is none; a fourth number alone is a weight."""
    return [*values[3:], 1.0][:4] if len(values) >= 6 else [1.0] * 4


def _cut(points: NDArray[np.float64], starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cut polygons into triangles (m, 3), in the order of the polygons.

    points: of all polygons' corners, one polygon after the other; polygon i starts at `starts[i]`.
    """
    sizes = np.diff(starts)
    pieces: list[NDArray[np.int64]] = []
    order: list[NDArray[np.int64]] = []
    for size in np.unique(sizes):
        polygons = np.flatnonzero(sizes == size)
        corners = starts[polygons][:, None] + np.arange(size)
        fans = np.stack([np.zeros(size - 2, int), np.arange(1, size - 1), np.arange(2, size)], axis=-1)
        cuts = np.broadcast_to(fans, (len(polygons), size - 2, 3)).copy()
        if size > 3:
            for concave in np.flatnonzero(~_convex(points[corners])):
                cuts[concave] = _ears(points[corners[concave]])
        pieces.append(np.take_along_axis(corners, cuts.reshape(len(polygons), -1), axis=1).reshape(-1, 3))
        order.append(np.repeat(polygons, size - 2))
    sorting = np.argsort(np.concatenate(order), kind="stable")
    return np.concatenate(pieces)[sorting]


def _newell(polygons: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the normals of polygons (..., n, 3), as long as twice their areas."""
    areas: NDArray[np.float64] = np.cross(polygons, np.roll(polygons, -1, axis=-2))
    return np.asarray(areas.sum(axis=-2))


def _convex(polygons: NDArray[np.float64]) -> NDArray[np.bool_]:
    centred = polygons - polygons.mean(axis=-2, keepdims=True)
    before, after = centred - np.roll(centred, 1, axis=-2), np.roll(centred, -1, axis=-2) - centred
    turns = np.einsum("...ij,...j->...i", np.cross(before, after), _newell(centred))
    return np.asarray((turns >= 0.0).all(axis=-1))


def _ears(polygon: NDArray[np.float64]) -> NDArray[np.int64]:
    """Cut a polygon (n, 3) into n - 2 triangles by clipping ears (Meisters 1975), seen along its normal."""
    centred = polygon - polygon.mean(axis=0)
    normal = _newell(centred)
    kept = [axis for axis in range(3) if axis != int(np.abs(normal).argmax())]
    flat = centred[:, kept]
    x, y = flat.T
    if float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) < 0.0:
        flat = flat[:, ::-1]
    left = list(range(len(polygon)))
    triangles = []
    place = 0
    while len(left) > 3:
        count = len(left)
        # A polygon that crosses itself may have no ear: any corner is as good as another then.
        tried = ((place + step) % count for step in range(count))
        place = next((each for each in tried if _is_ear(flat, left, each)), 0)
        triangles.append((left[place - 1], left[place], left[(place + 1) % count]))
        del left[place]
    return np.array([*triangles, left])


def _is_ear(flat: NDArray[np.float64], left: list[int], place: int) -> bool:
    corners = [left[place - 1], left[place], left[(place + 1) % len(left)]]
    a, b, c = flat[corners]
    if _turn(a, b, c) <= 0.0:
        return False
    # Corners that lie on the ear's own, as at the bridge to a hole, are not inside it.
    rest = flat[left]
    others = rest[~(rest[:, None] == flat[corners]).all(axis=-1).any(axis=-1)]
    inside = (_turn(a, b, others) >= 0.0) & (_turn(b, c, others) >= 0.0) & (_turn(c, a, others) >= 0.0)
    return not np.any(inside)


def _turn(a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]) -> Any:
    """Return twice the area of triangles a, b, c (..., 2), positive where they turn left."""
    return (b[0] - a[0]) * (c[..., 1] - a[1]) - (b[1] - a[1]) * (c[..., 0] - a[0])
