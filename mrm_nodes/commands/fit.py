"""`mrm-nodes fit`: the model that comes nearest to a measured material, and how near that is."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mrm_nodes.commands.progress import progress
from mrm_nodes.errors import MrmError
from mrm_nodes.plotfile import ENDINGS, check_plot, figure_bytes

if TYPE_CHECKING:
    from mrm_nodes.measured import Fit, Measurement

BESIDE = "beside the document"


@click.command()
@click.argument("data", type=Path)
@click.option("-o", "--output", type=Path, required=True, help="Document to write: .mtlx.")
@click.option("--model", default="layered", show_default=True, help="Which model; --models lists them.")
@click.option(
    "--hold-out",
    "held",
    type=float,
    multiple=True,
    metavar="DEGREES",
    help="Tell the error at this angle of the light by a fit without it, not at each; may be repeated.",
)
@click.option(
    "--cosine", help="What an ALTA file's values hold: none, view or light.  [default: it is found out]"
)
@click.option(
    "--channel", "channels", multiple=True, help="Channel to fit, where there are not one or three."
)
@click.option("--compare/--no-compare", default=True, show_default=True, help="Fit the other models too.")
@click.option(
    "--plot",
    is_flag=False,
    flag_value=BESIDE,
    metavar="FILE",
    help=f"Draw the fit: {', '.join(ENDINGS)}; without a name, an SVG {BESIDE}.",
)
@click.option("--name", help="Name of the material.  [default: that of the document]")
@click.option(
    "--models", is_flag=True, is_eager=True, callback=lambda *given: _list_models(*given), expose_value=False
)
def fit(
    data: Path,
    output: Path,
    model: str,
    held: tuple[float, ...],
    cosine: str | None,
    channels: tuple[str, ...],
    compare: bool,
    plot: str | None,
    name: str | None,
) -> None:
    """Fit a measured material, and write the fit as a MaterialX document.

    DATA: ALTA .dat, MERL .binary, RGL .bsdf, ASTM E1392, OpenMATERIAL .xompt, or CSV.

    \b
    mrm-nodes fit tape.dat -o tape.mtlx --model widening --plot
    """
    from mrm_nodes.files import prepare_folder, write_together
    from mrm_nodes.measured import MODELS, folds, leave_angles_out, read
    from mrm_nodes.measured import fit as fit_model
    from mrm_nodes.measured.fitting import FOLDS, angles_to_leave_out, usable
    from mrm_nodes.measured.models import find_model

    if output.suffix.lower() != ".mtlx":
        raise MrmError(f"{output}: unknown document ending {output.suffix or '(none)'}; use .mtlx")
    drawing = None if plot is None else output.with_suffix(".svg") if plot == BESIDE else Path(plot)
    if drawing is not None:
        check_plot(drawing)
    find_model(model)
    measurement = read(data, cosine)
    if channels:
        measurement = measurement.pick(channels)
    angles = angles_to_leave_out(usable(measurement), held)
    rest = [each for each in MODELS if each != model] if compare else []
    others: dict[str, Fit | None] = {}
    left: dict[float, float | str] = {}
    crossed: float | str
    with progress("fit", 1 + FOLDS + len(angles) + len(rest)) as step:
        found = fit_model(measurement, model)
        step()
        try:
            crossed = folds(measurement, found, progress=step)
        except MrmError as error:
            crossed = str(error)
        for angle in angles:
            try:
                left |= leave_angles_out(measurement, found, (angle,), step)
            except MrmError as error:
                left[angle] = str(error)
        for each in rest:
            try:
                others[each] = fit_model(measurement, each, found.parameters)
            except MrmError:
                others[each] = None  # too few samples for it
            step()
    _tell(data, measurement, found, crossed, left, others)
    files = {output: found.markup(name or output.stem).encode()}
    if drawing is not None:
        files[drawing] = figure_bytes(found.measurement.plot([(f"fit, {found.model}", found.bsdf)]), drawing)
    for path in files:
        prepare_folder(path.parent)
    write_together(files)
    for path in files:
        click.echo(path)


def _list_models(context: click.Context, _: click.Parameter, asked: bool) -> None:
    if asked and not context.resilient_parsing:
        from mrm_nodes.measured import MODELS

        for name, model in MODELS.items():
            click.echo(f"{name:<10} {model.about}: {', '.join(model.free)}")
        context.exit()


def _tell(
    data: Path,
    measurement: Measurement,
    found: Fit,
    crossed: float | str,
    left: dict[float, float | str],
    others: dict[str, Fit | None],
) -> None:
    sample = f' "{measurement.sample}"' if measurement.sample else ""
    lights = measurement.light_angles()
    at = f", light at {', '.join(f'{each:g}' for each in lights)}°" if lights else ""
    click.echo(
        f"{data}:{sample} {len(measurement)} samples, {len(found.measurement)} fitted (below 80°, above 0{found.drawn})"
        f"{at}, {', '.join(measurement.channels)}"
    )
    click.echo(f"\n{f'model {found.model}':<20} {'value':>10} {'deviation':>10}")
    for name, value in found.parameters.items():
        deviation = found.deviations[name]
        spread = f"{deviation:>10.2g}" if math.isfinite(deviation) else f"{'?':>10}"
        click.echo(
            f"{name:<20} {value:>10.4g} {spread}{'  not identified' if name in found.unidentified else ''}"
        )
    for first, second, together in found.correlations:
        click.echo(f"{first} and {second} move together: correlation {together:+.2f}")
    click.echo(f"\nRMSE of ln(f + 0.001): {found.rmse:.4f} fitted, {_error(crossed, 'in five folds', 4)}")
    peaks = found.peaks()
    for angle in sorted({*peaks, *left}):
        peak = f"peak {100.0 * (peaks[angle] - 1.0):+.0f} %" if angle in peaks else "no sample at the peak"
        rest = f", RMSE {_error(left[angle], 'where it is left out', 3)}" if angle in left else ""
        click.echo(f"light at {angle:g}°: {peak}{rest}")
    if len(lights) == 1:
        click.echo("one angle of the light: what another would show is not known")
    if others:
        table: dict[str, Fit | None] = {found.model: found, **others}
        click.echo("\nmodels, best first:")
        fits = [each for each in table.values() if each is not None]
        for each in sorted(fits, key=lambda one: one.rmse):
            mark = "*" if each is found else " "
            click.echo(f"{mark} {each.model:<10} RMSE {each.rmse:.4f}, {len(each.parameters)} parameters")
        for name in (name for name, each in table.items() if each is None):
            click.echo(f"  {name:<10} too few samples")
        best = min(fits, key=lambda one: one.rmse)
        if best is not found:
            click.echo(f"{best.model} comes nearer: --model {best.model}")
    click.echo()


def _error(found: float | str, where: str, digits: int) -> str:
    """An error, or why it is not known."""
    return f"? {where} ({found})" if isinstance(found, str) else f"{found:.{digits}f} {where}"
