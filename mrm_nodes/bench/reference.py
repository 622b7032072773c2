"""Throughput of the evaluator, beside NumPy and, where it is installed, Mitsuba's LLVM variant on the same
arrays.
"""

import math
import resource
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from types import ModuleType
from typing import Any

import numpy as np

from mrm_nodes.reference import compiled
from mrm_nodes.reference.bsdf import Conductor, Dielectric, GeneralizedSchlick, Lobe
from mrm_nodes.reference.compiled import Array
from mrm_nodes.reference.energy import POINTS, RESOLUTION, white_albedo_table

#: Complex index of a copper-like metal, for red, green and blue.
IOR, EXTINCTION = (0.2004, 0.9240, 1.1022), (3.9129, 2.4528, 2.1421)


@dataclass(frozen=True)
class ReferenceRow:
    """One measurement, the best of a few runs: `rate` in results a second. A question that Mitsuba answers too runs
    turn about with its conductor of the same distribution, and `of_mitsuba` is its rate over that."""

    subject: str
    question: str
    lobe: str
    cores: int
    count: int
    seconds: float
    of_mitsuba: float | None = None
    #: Most memory that the process has held so far, in MiB.
    peak: float | None = None

    @property
    def rate(self) -> float:
        return self.count / self.seconds


def _directions(rng: np.random.Generator, count: int) -> Array:
    d = rng.normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    d[:, 2] = np.abs(d[:, 2])
    return d


#: Seconds after which a measurement is not repeated any more, and between two that take turns.
ENOUGH = 0.5
PAUSE = 0.03


def _best(works: Sequence[Callable[[], object]], repeats: int) -> list[float]:
    """The best seconds of each, run turn about so that what else the machine does meets all of them."""
    for work in works:
        work()
    best = [np.inf] * len(works)
    began = time.perf_counter()
    for _ in range(repeats):
        for k, work in enumerate(works):
            if len(works) > 1:
                # Mitsuba's threads wait for more by spinning, on the cores that the next one needs.
                time.sleep(PAUSE)
            start = time.perf_counter()
            work()
            best[k] = min(best[k], time.perf_counter() - start)
        if time.perf_counter() - began > ENOUGH * len(works):
            break
    return best


@contextmanager
def _cores(count: int | None) -> Iterator[None]:
    compiled.set_thread_count(count)
    try:
        yield
    finally:
        compiled.set_thread_count(None)


def _lobes(count: int) -> dict[str, Lobe]:
    return {
        "conductor": Conductor(IOR, EXTINCTION, 0.3, correlation="separable"),
        "conductor, half retro": Conductor(IOR, EXTINCTION, 0.3, 0.5),
        "half retro, varying": Conductor(
            IOR, EXTINCTION, np.stack([np.linspace(0.2, 0.4, count)] * 2, -1), np.linspace(0.4, 0.6, count)
        ),
        "dielectric R": Dielectric(1.5, 0.3),
        "dielectric RT": Dielectric(1.5, 0.3, scatter_mode="RT", correlation="separable"),
        "schlick": GeneralizedSchlick((0.9, 0.4, 0.1), 0.8, alpha=0.3),
        "conductor beckmann": Conductor(IOR, EXTINCTION, 0.3, distribution="beckmann"),
        "conductor vcavity": Conductor(IOR, EXTINCTION, 0.3, masking="vcavity"),
    }


def numpy_conductor(v: Array, l: Array, alpha: float) -> Array:  # noqa: E741
    """The same GGX conductor, separable masking, as whole-array NumPy: what a first draft looks like."""
    h = v + l
    length = np.linalg.norm(h, axis=-1)
    x, y, z = (h / length[:, None]).T
    d = 1.0 / (np.pi * alpha**2 * ((x**2 + y**2) / alpha**2 + z**2) ** 2)
    areas = [0.5 * (w[:, 2] + np.sqrt(w[:, 2] ** 2 + alpha**2 * (1.0 - w[:, 2] ** 2))) for w in (v, l)]
    c2, n2, k2 = 0.25 * length[:, None] ** 2, np.square(IOR), np.square(EXTINCTION)
    s2 = 1.0 - c2
    modulus = np.hypot(n2 - k2 - s2, 2.0 * np.sqrt(n2 * k2))
    cross = np.sqrt(2.0 * (modulus + n2 - k2 - s2) * c2)
    rs = (modulus + c2 - cross) / (modulus + c2 + cross)
    both = c2 * modulus + s2**2
    f = 0.5 * rs * (1.0 + (both - cross * s2) / (both + cross * s2))
    return np.asarray(f * (d / (4.0 * areas[0] * areas[1]))[:, None])


def _mitsuba() -> ModuleType | None:
    try:
        import mitsuba
    except ImportError:
        return None
    try:
        mitsuba.set_variant("llvm_ad_rgb")
    except (ImportError, RuntimeError):
        return None
    module: ModuleType = mitsuba
    return module


def mitsuba_conductor(
    mi: Any,
    distribution: str,
    v: Array,
    l: Array,  # noqa: E741
    u: Array,
) -> dict[str, Callable[[], object]]:
    """Calls by which Mitsuba's `roughconductor` answers each question of the same configurations, in float32."""
    import drjit

    dr: Any = drjit
    bsdf = mi.load_dict(
        {
            "type": "roughconductor",
            "distribution": distribution,
            "alpha": 0.3,
            "eta": {"type": "srgb", "color": list(IOR), "unbounded": True},
            "k": {"type": "srgb", "color": list(EXTINCTION), "unbounded": True},
        }
    )

    def columns(array: Array) -> list[Any]:
        return [mi.Float(np.ascontiguousarray(array[:, k], np.float32)) for k in range(array.shape[1])]

    si = dr.zeros(mi.SurfaceInteraction3f, len(v))
    si.wi = mi.Vector3f(*columns(v))
    wo = mi.Vector3f(*columns(l))
    x, y, z = columns(u)
    uniforms = mi.Point2f(y, z)
    dr.eval(si, wo, x, uniforms)
    context = mi.BSDFContext()

    def asking(ask: Callable[[], object]) -> Callable[[], object]:
        def work() -> object:
            value = ask()
            dr.eval(value)
            dr.sync_thread()
            return value

        return work

    return {
        "eval": asking(lambda: bsdf.eval(context, si, wo)),
        "pdf": asking(lambda: bsdf.pdf(context, si, wo)),
        "sample": asking(lambda: bsdf.sample(context, si, x, uniforms)),
    }


def measure(count: int = 1 << 20, repeats: int = 15) -> Iterator[ReferenceRow]:
    """Measure everything, a row as soon as it is known: `count` configurations for `eval` and `pdf`, fewer for
    what is slower, `repeats` runs or half a second.
    """
    rng = np.random.default_rng(0)
    v, l = _directions(rng, count), _directions(rng, count)  # noqa: E741
    u = rng.random((count, 3))
    every = compiled.thread_count()
    few = max(count >> 12, 1)
    mi = _mitsuba()
    theirs: dict[str, dict[str, Callable[[], object]]] = {}
    ours = "mrm_nodes, float64"
    if mi is not None:
        for distribution in ("ggx", "beckmann"):
            theirs[distribution] = mitsuba_conductor(mi, distribution, v, l, u)
            for question, ask in theirs[distribution].items():
                (seconds,) = _best([ask], repeats)
                lobe = "conductor" if distribution == "ggx" else f"conductor {distribution}"
                name = f"Mitsuba {mi.__version__}, llvm float32"
                yield ReferenceRow(name, question, lobe, every, count, seconds, 1.0)
    for name, bsdf in _lobes(count).items():
        questions: dict[str, tuple[int, Callable[[], object]]] = {
            "eval": (count, partial(bsdf.eval, v, l)),
            "pdf": (count, partial(bsdf.pdf, v, l)),
            "sample": (count, partial(bsdf.sample, v, u)),
            "albedo": (few, partial(bsdf.albedo, v[:few])),
        }
        if bsdf._shape:
            # Its parameters are `count`.
            del questions["albedo"]
        for question, (n, ask) in questions.items():
            for cores in sorted({1, every}):
                their = theirs.get("beckmann" if "beckmann" in name else "ggx", {}).get(question)
                beside = [their] if their is not None and cores == every else []
                with _cores(cores):
                    seconds, *others = _best([ask, *beside], repeats)
                ratio = others[0] / seconds if others else None
                yield ReferenceRow(ours, question, name, cores, n, seconds, ratio)
    (seconds,) = _best([lambda: numpy_conductor(v, l, 0.3)], repeats)
    yield ReferenceRow("NumPy, float64", "eval", "conductor", 1, count, seconds)
    yield _table(every)


def _table(cores: int) -> ReferenceRow:
    """Samples a second of the table that energy compensation reads, made anew."""
    start = time.perf_counter()
    white_albedo_table.__wrapped__("ggx", "smith", "height")
    samples = math.prod(POINTS) * RESOLUTION**2
    seconds = time.perf_counter() - start
    return ReferenceRow("mrm_nodes, float64", "table", "white, GGX", cores, samples, seconds)


def growth(sizes: tuple[int, ...] = (10**5, 10**6, 10**7, 10**8)) -> Iterator[ReferenceRow]:
    """`eval` of one conductor for growing grids of views and lights, ten million at a time."""
    rng = np.random.default_rng(0)
    bsdf = _lobes(1)["conductor"]
    for size in sizes:
        columns = min(size, 10**4)
        v, l = _directions(rng, size // columns)[:, np.newaxis], _directions(rng, columns)  # noqa: E741
        step = 10**7 // columns
        bsdf.eval(v[:1], l)
        start = time.perf_counter()
        for k in range(0, len(v), step):
            bsdf.eval(v[k : k + step], l)
        seconds = time.perf_counter() - start
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        cores = compiled.thread_count()
        yield ReferenceRow("mrm_nodes, float64", "eval", "conductor", cores, size, seconds, peak=peak)
