"""The fit: least squares of logarithms, from several starts, with deviations and tests on what was not fitted."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mrm_nodes.errors import MrmError
from mrm_nodes.measured.angles import Array
from mrm_nodes.measured.measurement import Measurement
from mrm_nodes.measured.models import PARAMETERS, Model, find_model
from mrm_nodes.photometry.retroreflector import Retroreflector

FLOOR = 1e-3
"""1/sr that is added before the logarithm is taken: below it, instruments see little."""
GRAZING = np.radians(80.0)
"""Beyond it nothing is fitted."""
NEAR = np.radians(8.0)
"""About retroreflection, where samples are few and matter most."""
NEAR_SHARE = 0.5
"""What these together weigh, where all samples of their light weigh 1."""
ROUGH, MOST = 1700, 20_000
"""Samples with which the starts are tried, and beyond which more teach nothing."""
EVALUATIONS = 40
UNSURE = 0.2
"""The deviation of a logarithm or a logit from which a parameter counts as not identified."""
SEED = 20140112
"""Which samples are drawn where there are too many: always the same."""

Progress = Callable[[], None]
"""Called after each fit of several."""
FOLDS = 5


@dataclass(frozen=True)
class Fit:
    """The model that comes nearest to a measurement."""

    model: str
    """One of `MODELS`."""
    parameters: dict[str, float]
    """What was fitted, by name."""
    deviations: dict[str, float]
    """Standard deviations of the parameters, from the residuals as they are; infinite where nothing is known."""
    unidentified: tuple[str, ...]
    """Parameters that the data do not fix: the logarithm or logit deviates by more than `UNSURE`, or is at a bound."""
    correlations: tuple[tuple[str, str, float], ...]
    """Pairs of parameters of which one moves with the other, above 0.9."""
    residuals: Array
    """(n, k): ln(model + 1e-3) - ln(measured + 1e-3) of the samples below 80°."""
    measurement: Measurement
    """Those samples."""
    drawn_from: int
    """How many there are of which these were drawn at random; as many, unless there are more than `MOST`."""
    bsdf: Retroreflector
    """What has `eval(v, l)`, f in 1/sr."""

    @property
    def rmse(self) -> float:
        """The root mean square of the residuals."""
        return float(np.sqrt(np.mean(self.residuals**2)))

    @property
    def drawn(self) -> str:
        """What to say where not all samples were fitted."""
        return f", drawn from {self.drawn_from}" if self.drawn_from > len(self.measurement) else ""

    def markup(self, name: str = "", doc: str = "") -> str:
        """The fit as the text of a MaterialX document.

        Args:
            name: of the material; by default the sample's.
            doc: what to say of it; what was fitted, and how well, goes before.
        """
        return self.bsdf.markup(name or self._name(), self._said(doc))

    def document(self, name: str = "", doc: str = "") -> Any:
        """The fit as a MaterialX document of today's nodes; name and doc as in `markup`."""
        return self.bsdf.document(name or self._name(), self._said(doc))

    def peaks(self) -> dict[float, float]:
        """For each angle of the light in degrees, the model over the measurement at the sample nearest to the light.

        The mean of the channels. It is one sample for a light, no surer than that one was, and left out where the
        nearest is more than 1.5° away.
        """
        m, found = self.measurement, {}
        for angle in m.light_angles():
            here = np.flatnonzero(m.at_light(angle))
            k = here[np.argmin(m.from_retro[here])]
            if m.from_retro[k] < np.radians(1.5):
                model = self.bsdf.eval(m.v[k], m.l[k])[..., : m.value.shape[1]]
                found[angle] = float(model.mean() / m.value[k].mean())
        return found

    def _name(self) -> str:
        return self.measurement.sample or "measured"

    def _said(self, doc: str) -> str:
        sample = f' of "{self.measurement.sample}"' if self.measurement.sample else ""
        parameters = ", ".join(f"{name} {value:.4g}" for name, value in self.parameters.items())
        said = (
            f"Fit{sample}, model {self.model}: {parameters}; RMSE {self.rmse:.3f} of ln(f + {FLOOR:g} 1/sr) over "
            f"{len(self.measurement)} samples below 80 degrees{self.drawn}."
        )
        if len(self.measurement.channels) == 1:
            said += " One channel was measured: colours are grey."
        return f"{said} {doc}".strip()


def fit(
    measurement: Measurement,
    model: str = "layered",
    start: Mapping[str, float] | None = None,
) -> Fit:
    """Fit a model to a measurement.

    Args:
        measurement: n samples.
        model: one of `MODELS`.
        start: values to start from instead of the usual ones, of some parameters or all.

    Raises:
        MrmError: no such model, no fewer parameters than samples, or channels other than one or three.
    """
    described = find_model(model)
    known = usable(measurement)
    fitted = _drawn(known)
    task = _Task(described, fitted, weights(fitted))
    count = len(task.names)
    if fitted.value.size <= count:
        raise MrmError(
            f"{fitted.value.size} values below 80°, but {count} parameters of {model}: that is too few to fit"
        )
    rough = _Task(described, *_thinned(fitted, weights(fitted), ROUGH))
    tried = [rough.search(task.free(each), EVALUATIONS) for each in _starts(task.names, fitted, start)]
    best = min(tried, key=lambda found: found.cost)
    polished = task.search(best.x, 2 * EVALUATIONS)
    return task.result(model, polished, len(known))


def usable(measurement: Measurement) -> Measurement:
    """The samples that can be fitted: below 80°, and not black.

    Raises:
        MrmError: none, or channels other than one or three.
    """
    measurement.check_colour()
    mask = (
        (measurement.theta_v < GRAZING)
        & (measurement.theta_l < GRAZING)
        & (measurement.value > 0.0).all(axis=1)
    )
    if not mask.any():
        raise MrmError("no sample below 80° has a value above 0: there is nothing to fit")
    return measurement.where(mask)


def _drawn(measurement: Measurement) -> Measurement:
    """At most `MOST` samples, each as likely as the others, so that errors over these are errors over all."""
    if len(measurement) <= MOST:
        return measurement
    return measurement.where(np.sort(np.random.default_rng(SEED).permutation(len(measurement))[:MOST]))


def weights(measurement: Measurement) -> Array:
    """(n): 1, but more near retroreflection, so that those samples of each light weigh half as much as all of its."""
    weight = np.ones(len(measurement))
    near = measurement.from_retro < NEAR
    groups = measurement.light_angles()
    masks = [measurement.at_light(angle) for angle in groups] or [np.ones(len(measurement), bool)]
    for mask in masks:
        count = (mask & near).sum()
        if count:
            weight[mask & near] = max(1.0, NEAR_SHARE * mask.sum() / count)
    return weight


def folds(
    measurement: Measurement, found: Fit, count: int = FOLDS, progress: Progress | None = None
) -> float:
    """The RMSE of samples that were not fitted: each fifth of them, drawn at random, by a fit to the others.

    Args:
        measurement: the whole of it; what is left out is of the samples that were fitted.
        found: a fit to it.
        count: parts that are left out in turn.
        progress: called after each.

    Raises:
        MrmError: too few samples are left.
    """
    fitted = found.measurement
    part = np.random.default_rng(SEED).permutation(len(fitted)) % count
    squares = []
    for k in range(count):
        other = fit(fitted.where(part != k), found.model, found.parameters)
        squares.append(_squares(other.bsdf, fitted.where(part == k)))
        if progress is not None:
            progress()
    return float(np.sqrt(np.concatenate(squares).mean()))


def leave_angles_out(
    measurement: Measurement, found: Fit, angles: Sequence[float] = (), progress: Progress | None = None
) -> dict[float, float]:
    """For each angle of the light, the RMSE of its samples by a fit to the others; empty where there is one angle.

    Args:
        measurement: the whole of it; what is left out is of the samples that were fitted.
        found: a fit to it.
        angles: those to leave out, each alone, in degrees; by default all.
        progress: called after each.

    Raises:
        MrmError: an angle that the light does not have; too few samples are left.
    """
    fitted = found.measurement
    chosen = angles_to_leave_out(fitted, angles)
    errors = {}
    for angle in chosen:
        mask = fitted.at_light(angle)
        other = fit(fitted.where(~mask), found.model, found.parameters)
        errors[angle] = float(np.sqrt(_squares(other.bsdf, fitted.where(mask)).mean()))
        if progress is not None:
            progress()
    return errors


def angles_to_leave_out(measurement: Measurement, angles: Sequence[float] = ()) -> list[float]:
    """The angles of the light in degrees, of those that a measurement has, nearest to some; by default all.

    None where one is all there is.

    Raises:
        MrmError: no sample has such an angle, or all have.
    """
    known = measurement.light_angles()
    if not angles:
        return known if len(known) > 1 else []
    chosen = []
    for asked in angles:
        nearest = min(known, key=lambda each: abs(each - asked), default=math.nan)
        if not abs(nearest - asked) <= 1.0:
            raise MrmError(
                f"no light at {asked:g}°: the samples have it at "
                f"{', '.join(f'{each:g}' for each in known) or 'many angles'}"
            )
        if len(known) < 2:
            raise MrmError(f"all samples have the light at {nearest:g}°: none is left where that is held out")
        chosen.append(nearest)
    return chosen


def _squares(bsdf: Retroreflector, measurement: Measurement) -> Array:
    channels = measurement.value.shape[1]
    model = bsdf.eval(measurement.v, measurement.l)[..., :channels]
    return np.asarray(np.log((model + FLOOR) / (measurement.value + FLOOR)) ** 2)


def _thinned(measurement: Measurement, weight: Array, most: int) -> tuple[Measurement, Array]:
    """At most so many samples: those near retroreflection first, weighted so that the others count as before."""
    if len(measurement) <= most:
        return measurement, weight
    rng = np.random.default_rng(SEED)
    near = np.flatnonzero(measurement.from_retro < NEAR)
    far = np.flatnonzero(measurement.from_retro >= NEAR)
    kept_near = rng.permutation(near)[: most // 2]
    kept_far = rng.permutation(far)[: most - len(kept_near)]
    kept = np.sort(np.concatenate([kept_near, kept_far]))
    scale = np.ones(len(measurement))
    for group, some in ((near, kept_near), (far, kept_far)):
        if len(some):
            scale[group] = len(group) / len(some)
    return measurement.where(kept), (weight * scale)[kept]


def _starts(
    names: Sequence[str], measurement: Measurement, start: Mapping[str, float] | None
) -> list[dict[str, float]]:
    usual = {name: PARAMETERS[name.split(".")[0]].start for name in names}
    far = measurement.from_retro > np.radians(30.0)
    if far.any():
        # Most of what is far from the return is the film's.
        for name in names:
            if name.split(".")[0] == "film":
                k = measurement.channels.index(name.split(".")[1]) if "." in name else 0
                median = float(np.median(measurement.value[far, k])) * np.pi
                usual[name] = float(np.clip(median, 0.01, 0.9))
    if start is not None:
        return [{**usual, **{name: value for name, value in start.items() if name in usual}}]
    widths = [{"alpha": alpha} for alpha in (0.05, 0.02, 0.008)]
    tops = [{"top_alpha": alpha} for alpha in (0.015, 0.15)] if "top_alpha" in names else [{}]
    return [{**usual, **one, **other} for one in widths for other in tops]


class _Task:
    """The samples, their weights, and the parameters as the search moves them."""

    def __init__(self, model: Model, measurement: Measurement, weight: Array) -> None:
        self.model = model
        self.measurement = measurement
        self.channels = measurement.channels
        self.names = model.names(self.channels)
        self.kinds = [PARAMETERS[name.split(".")[0]] for name in self.names]
        self.root = np.sqrt(np.repeat(weight[:, None], len(self.channels), axis=1))
        self.logarithm = np.log(measurement.value + FLOOR)
        self.low = np.array([kind.to_free(kind.low) for kind in self.kinds])
        self.high = np.array([kind.to_free(kind.high) for kind in self.kinds])

    def free(self, values: Mapping[str, float]) -> Array:
        """Where the search is for values, inside of its bounds."""
        where = [kind.to_free(np.clip(values[name], kind.low, kind.high)) for name, kind in self._each()]
        return np.asarray(np.clip(where, self.low + 1e-6, self.high - 1e-6))

    def _each(self) -> list[tuple[str, Any]]:
        return list(zip(self.names, self.kinds, strict=True))

    def values(self, free: Array) -> dict[str, Array]:
        """Parameters (...) from what the search moves, (..., p)."""
        return {name: kind.from_free(free[..., i]) for i, (name, kind) in enumerate(self._each())}

    def residuals(self, free: Array) -> Array:
        """(..., n, k) of free (..., p)."""
        bsdf = self.model.bsdf(self.values(free[..., None, :]), self.channels)
        model = bsdf.eval(self.measurement.v, self.measurement.l)[..., : len(self.channels)]
        return np.asarray(np.log(model + FLOOR) - self.logarithm)

    def search(self, free: Array, evaluations: int) -> Any:
        """Least squares from one start."""
        from scipy.optimize import least_squares

        return least_squares(
            lambda x: (self.residuals(x) * self.root).ravel(),
            free,
            jac=lambda x, *_: self.jacobian(x) * self.root.ravel()[:, None],
            bounds=(self.low, self.high),
            loss="soft_l1",
            max_nfev=evaluations,
            x_scale=1.0,
        )

    def jacobian(self, free: Array) -> Array:
        """(n k, p), by differences to both sides, in one evaluation."""
        step = 1e-5
        p = len(free)
        moved = free + step * np.concatenate([np.eye(p), -np.eye(p)])
        both = self.residuals(moved).reshape(2 * p, -1)
        return np.asarray((both[:p] - both[p:]).T / (2.0 * step))

    def result(self, name: str, found: Any, known: int) -> Fit:
        """What the search found, and how sure it is. known: how many samples these were drawn from."""
        residuals = self.residuals(found.x)
        values = {key: float(value) for key, value in self.values(found.x).items()}
        covariance = self._covariance(found.x, residuals.ravel())
        spread = np.sqrt(np.diag(covariance))
        deviations = {
            key: float(spread[i] * kind.slope(values[key])) for i, (key, kind) in enumerate(self._each())
        }
        at_bound = (found.x - self.low < 0.05) | (self.high - found.x < 0.05)
        unsure = tuple(key for i, key in enumerate(self.names) if at_bound[i] or not spread[i] <= UNSURE)
        sure = np.isfinite(spread) & (spread > 0.0)
        pairs = []
        for i in range(len(self.names)):
            for j in range(i):
                if sure[i] and sure[j]:
                    together = covariance[i, j] / (spread[i] * spread[j])
                    if abs(together) > 0.9:
                        pairs.append((self.names[j], self.names[i], float(together)))
        bsdf = self.model.bsdf({key: np.asarray(value) for key, value in values.items()}, self.channels)
        return Fit(
            name, values, deviations, unsure, tuple(pairs), residuals, self.measurement, known, _plain(bsdf)
        )

    def _covariance(self, free: Array, residuals: Array) -> Array:
        """Of the estimate, from the residuals as they are: samples weigh what they weigh, and outliers little."""
        slopes = self.jacobian(free)
        weight = self.root.ravel() ** 2
        tamed = weight / np.sqrt(1.0 + weight * residuals**2)
        curvature = weight / (1.0 + weight * residuals**2) ** 1.5
        bread = slopes.T @ (slopes * curvature[:, None])
        filling = (slopes * (tamed * residuals)[:, None]).T @ (slopes * (tamed * residuals)[:, None])
        known = np.diag(bread) > 1e-9 * max(1.0, float(np.diag(bread).max()))
        covariance = np.full(bread.shape, np.inf)
        inverse = np.linalg.pinv(bread[np.ix_(known, known)], rcond=1e-12, hermitian=True)
        n, p = len(residuals), len(free)
        covariance[np.ix_(known, known)] = (
            inverse @ filling[np.ix_(known, known)] @ inverse * (n / max(n - p, 1))
        )
        return covariance


def _plain(bsdf: Retroreflector) -> Retroreflector:
    """The same with numbers and tuples for arrays of one."""
    from dataclasses import fields, is_dataclass, replace

    def plain(value: Any) -> Any:
        if is_dataclass(value) and not isinstance(value, type):
            return replace(value, **{each.name: plain(getattr(value, each.name)) for each in fields(value)})
        if isinstance(value, np.ndarray | np.floating):
            numbers = [float(each) for each in np.ravel(value)]
            return numbers[0] if len(numbers) == 1 else tuple(numbers)
        return value

    plained: Retroreflector = plain(bsdf)
    return plained
