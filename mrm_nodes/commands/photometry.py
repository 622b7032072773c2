"""`mrm-nodes photometry`: the coefficients of a document's material, and whether it is in a class."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mrm_nodes.commands.options import external_option, material_argument, within_limits
from mrm_nodes.errors import MrmError

if TYPE_CHECKING:
    from mrm_nodes.photometry import Row

FAILED = 1

UNASKED = ((0.2, -4.0), (0.2, 30.0), (0.5, -4.0), (0.5, 30.0))
"""Geometries in degrees where neither a class nor one is named."""
WITHIN, ENTRANCE = 4.0, 5.0
"""Degrees of observation and entrance of R_T, as far from the mirror's direction as those of the classes."""
ROUNDING = 1e-4
"""What two points of a uniform material may differ by, whose graphs are worked out in float32."""
POINTS, FEW_POINTS = 2048, 64
"""Points that stand for an area; fewer where many directions are needed."""


@click.command()
@material_argument
@click.option(
    "--class", "name", help="Class to check: RA2, ISO 20471, D4956 III, number plate, EN 1436 dry, ..."
)
@click.option("--colour", "--color", help="Colour of the class.")
@click.option(
    "--geometry",
    "geometries",
    multiple=True,
    metavar="OBSERVATION,BETA1[,BETA2[,ROTATION]]",
    help="Angles in degrees, such as 0.2,-4; may be repeated.  [default: the class's]",
)
@click.option("--element", help="Material, where the file has several.")
@click.option("--uv", metavar="U,V[:U,V]", help="Point of the material, or two corners of an area.")
@click.option(
    "--over-uv", is_flag=True, help="The whole UV square.  [default, where graphs drive the material]"
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON in place of the table.")
@click.option("--plot", type=Path, help="Plot of R_A to write too: .svg, .png or .pdf.")
@click.option("--backend", default="auto", show_default=True, help="egl, osmesa or auto.")
@external_option
@within_limits
def photometry(
    file: Path,
    name: str | None,
    colour: str | None,
    geometries: tuple[str, ...],
    element: str | None,
    uv: str | None,
    over_uv: bool,
    as_json: bool,
    plot: Path | None,
    backend: str,
    allow_external: bool,
) -> int:
    """Print R_A (R_L and Q_d of road markings) of a material; status 1 if it is below a minimum of the class.

    MATERIAL is a .mtlx file, or a name that `mrm-nodes materials` lists; a file wins where it has such a name.

    Design help, no certification: that takes a laboratory and the standard itself.

    \b
    mrm-nodes photometry yellow_tape --geometry 0.2,-4
    mrm-nodes photometry sign.mtlx --class RA2 --colour yellow --plot sign.svg
    """
    from mrm_nodes.files import prepare_folder
    from mrm_nodes.photometry import check, find_class, read_sheet
    from mrm_nodes.photometry.plot import write_plot
    from mrm_nodes.plotfile import check_plot

    if name is None and colour is not None:
        raise MrmError("--colour is of a class: name it with --class")
    if uv is not None and over_uv:
        raise MrmError("--uv is a point or an area, --over-uv the whole square: give one of them")
    retro_class = None if name is None else find_class(name)
    asked = () if retro_class is None else retro_class.of(colour)
    given = [parse_geometry(text) for text in geometries]
    area = ((0.0, 0.0), (1.0, 1.0)) if over_uv else None if uv is None else parse_uv(uv)
    if plot is not None:
        check_plot(plot)
    sheet = read_sheet(file, element, allow_external, backend)
    quantities = {each.quantity for each in asked} or {"R_A"}
    if not sheet.is_retroreflective and "Q_d" not in quantities:
        raise MrmError(
            f"{file}: no lobe of it is retroreflective, so nothing comes back but what is matt or mirror-like; "
            "give a lobe a retroreflectivity (mrm-nodes retrofit)"
        )
    if area is None:
        area = ((0.0, 0.0), (1.0, 1.0)) if sheet.is_driven else ((0.5, 0.5), (0.5, 0.5))
    few = sheet.at(spread(area, FEW_POINTS))
    if len(few.uv) > 1 and not sheet.asks_where and _agree(few):
        points = few = sheet.at(few.uv[:1])
    else:
        points = sheet.at(spread(area, POINTS))

    rows = [] if name is None else check(few if "Q_d" in quantities else points, name, colour)
    measured = [_measured(points, each) for each in given or ([] if rows else UNASKED)]
    shape = _shape(few)
    if as_json:
        described = None if retro_class is None else _described(retro_class, colour)
        click.echo(_json(file, element, area, described, rows, measured, shape))
    else:
        title = None if retro_class is None else f"{retro_class.name}: {retro_class.title}"
        _print(file, area, title, rows, measured, shape)
        if retro_class is not None:
            click.echo(f"values of {retro_class.name} ({retro_class.standing}): {retro_class.source}")
    if plot is not None:
        prepare_folder(plot.parent)
        write_plot(plot, few, file.name, retro_class, asked)
    return 0 if all(row.passes for row in rows) else FAILED


Area = tuple[tuple[float, float], tuple[float, float]]


def parse_geometry(text: str) -> tuple[float, ...]:
    """Angles in degrees from `OBSERVATION,BETA1[,BETA2[,ROTATION]]`.

    Raises:
        MrmError: anything else.
    """
    angles = _numbers(text)
    if angles is None or not 2 <= len(angles) <= 4:
        raise MrmError(f"--geometry {text}: write two to four angles in degrees, such as 0.2,-4")
    return angles


def parse_uv(text: str) -> Area:
    """Corners of an area from `U,V` or `U,V:U,V`.

    Raises:
        MrmError: anything else.
    """
    corners = [_numbers(corner) for corner in text.split(":")]
    pairs = [corner for corner in corners if corner is not None and len(corner) == 2]
    if len(pairs) != len(corners) or len(pairs) > 2:
        raise MrmError(f"--uv {text}: write a point as 0.5,0.5 or the corners of an area as 0,0.4:1,0.6")
    first, second = pairs[0], pairs[-1]
    return (first[0], first[1]), (second[0], second[1])


def _numbers(text: str) -> tuple[float, ...] | None:
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        return None
    return found if all(map(math.isfinite, found)) else None


def spread(area: Area, count: int) -> Any:
    """Texture coordinates (n, 2) all over an area, in no regular order that a pattern could be in step with."""
    import numpy as np

    low, high = np.array(area)
    if (low == high).all():
        return low[None]
    # Roberts' R2 sequence: the plastic number's powers.
    step = 1.0 / 1.32471795724474602596 ** np.array([1.0, 2.0])
    return low + (high - low) * ((0.5 + step * np.arange(count)[:, None]) % 1.0)


def _agree(bsdf: Any) -> bool:
    """Whether its points have the same R_A, as where a graph asks for the view alone."""
    import numpy as np

    from mrm_nodes.photometry import luminance, retroreflection

    value = luminance(retroreflection(bsdf, *np.array(UNASKED).T[..., None]))
    least, most = value.min(axis=-1), value.max(axis=-1)
    return bool((most <= least * (1.0 + ROUNDING)).all())


def _measured(bsdf: Any, angles: Sequence[float]) -> dict[str, Any]:
    """R_A in one geometry, over the points of a sheet."""
    import numpy as np

    from mrm_nodes.photometry import luminance, night_chromaticity, retroreflection

    value = retroreflection(bsdf, *np.reshape(angles, (len(angles), 1)))
    seen = luminance(value)
    rgb = value.mean(axis=0)
    names = ("observation", "beta1", "beta2", "rotation")
    return {
        **dict.fromkeys(names, 0.0),
        **dict(zip(names, angles, strict=False)),
        "quantity": "R_A",
        "unit": "cd/(lx m²)",
        "least": float(seen.min()),
        "value": float(seen.mean()),
        "most": float(seen.max()),
        "rgb": rgb.tolist(),
        "night_chromaticity": [None if math.isnan(each) else float(each) for each in night_chromaticity(rgb)],
    }


def _shape(bsdf: Any) -> dict[str, float | None]:
    """What is no table's: how wide the lobe is, and which share of the light it sends back."""
    import numpy as np

    from mrm_nodes.photometry import half_width, luminance, total_retroreflectance

    width = half_width(bsdf, ENTRANCE)
    back = float(np.mean(luminance(total_retroreflectance(bsdf, WITHIN, ENTRANCE))))
    return {
        "half_width": None if math.isnan(width) else width,
        "R_T": back,
        "R_T_within": WITHIN,
        "shape_entrance": ENTRANCE,
    }


def row_data(row: Row) -> dict[str, Any]:
    """A row of a check, for JSON."""
    from mrm_nodes.photometry.classes import UNITS

    asked = row.requirement
    return {
        "quantity": asked.quantity,
        "unit": UNITS[asked.quantity],
        "observation": asked.observation,
        "beta1": asked.beta1,
        "least": row.least,
        "value": row.value,
        "most": row.most,
        "minimum": asked.minimum,
        "maximum": asked.maximum,
        "margin": row.margin,
        "passes": row.passes,
    }


def _described(retro_class: Any, colour: str | None) -> dict[str, Any]:
    return {
        "name": retro_class.name,
        "colour": retro_class.resolve(colour),
        "title": retro_class.title,
        "standing": retro_class.standing,
        "source": retro_class.source,
    }


def _json(
    file: Path,
    element: str | None,
    area: Area,
    described: dict[str, Any] | None,
    rows: Sequence[Row],
    measured: Sequence[dict[str, Any]],
    shape: dict[str, float | None],
) -> str:
    tree = {
        "file": str(file),
        "element": element,
        "uv": [list(corner) for corner in area],
        "illuminant": "A",
        "class": described,
        "rows": [row_data(row) for row in rows],
        "passes": all(row.passes for row in rows) if rows else None,
        "geometries": list(measured),
        **shape,
    }
    return json.dumps(tree, indent=2, allow_nan=False)


def _print(
    file: Path,
    area: Area,
    title: str | None,
    rows: Sequence[Row],
    measured: Sequence[dict[str, Any]],
    shape: dict[str, float | None],
) -> None:
    from rich.console import Console
    from rich.table import Table

    (u0, v0), (u1, v1) = area
    where = f"uv {u0:g},{v0:g}" + (f" to {u1:g},{v1:g}" if area[0] != area[1] else "")
    click.echo(f"{file}, {where}, illuminant A" + (f"; {title}" if title else ""))
    spans = [(row.least, row.most) for row in rows] + [(each["least"], each["most"]) for each in measured]
    varies = any(most > least * (1.0 + ROUNDING) for least, most in spans)
    console = Console(markup=False, width=100)
    if rows:
        console.print(rows_table(rows, varies))
    if measured:
        table = Table("observation, entrance", *_spread_columns(varies, "R_A"))
        for each in measured:
            angles = [each["observation"], each["beta1"]] + [
                each[k] for k in ("beta2", "rotation") if each[k]
            ]
            cells = ("least", "value", "most") if varies else ("value",)
            table.add_row(", ".join(f"{angle:g}°" for angle in angles), *(f"{each[k]:.4g}" for k in cells))
        console.print(table)
    width = shape["half_width"]
    click.echo(
        f"half of R_A at {'no angle' if width is None else f'{width:.3g}°'} of observation, "
        f"{shape['R_T']:.3g} of the light back within {WITHIN:g}° (R_T); entrance {ENTRANCE:g}°"
    )


def _spread_columns(varies: bool, quantity: str) -> tuple[str, ...]:
    return ("least", "mean", "most") if varies else (quantity,)


def rows_table(rows: Sequence[Row], varies: bool = False) -> Any:
    """The table of a check."""
    from rich.table import Table

    from mrm_nodes.photometry.classes import UNITS

    quantity = rows[0].requirement.quantity
    table = Table(
        "observation, entrance",
        "minimum",
        *_spread_columns(varies, quantity),
        "margin",
        "verdict",
        caption=UNITS[quantity],
    )
    for row in rows:
        values = (row.least, row.value, row.most) if varies else (row.value,)
        asked = row.requirement
        verdict = (
            "pass" if row.passes else "below" if row.value < asked.minimum else f"above {asked.maximum:g}"
        )
        table.add_row(
            asked.geometry,
            f"{asked.minimum:g}",
            *(f"{value:.4g}" for value in values),
            f"{row.margin:+.1%}",
            verdict,
        )
    return table
