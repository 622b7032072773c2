"""Throughput of the evaluator, beside NumPy and, where it is installed, Mitsuba's LLVM variant on the same
arrays.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from . import compiled
from .bsdf import Conductor, Dielectric, GeneralizedSchlick, Lobe
from .compiled import Array
from .fresnel import fresnel_conductor

#: Complex index of a copper-like metal, for red, green and blue.
IOR, EXTINCTION = (0.2004, 0.9240, 1.1022), (3.9129, 2.4528, 2.1421)


@dataclass(frozen=True)
class Row:
    """One measurement: `rate` is the best of a few runs, in results a second."""

    subject: str
    question: str
    lobe: str
    cores: int
    count: int
    rate: float


def _directions(rng: np.random.Generator, count: int) -> Array:
    d = rng.normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    d[:, 2] = np.abs(d[:, 2])
    return d


def _rate(work: Callable[[], object], count: int, repeats: int) -> float:
    work()
    best = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - start)
    return count / best


@contextmanager
def _cores(count: int | None) -> Iterator[None]:
    compiled.set_thread_count(count)
    try:
        yield
    finally:
        compiled.set_thread_count(None)


def _lobes() -> dict[str, Lobe]:
    return {
        "conductor": Conductor(IOR, EXTINCTION, 0.3, correlation="separable"),
        "conductor, half retro": Conductor(IOR, EXTINCTION, 0.3, 0.5),
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
    f = fresnel_conductor(np.minimum(0.5 * length, 1.0)[:, None], IOR, EXTINCTION)
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


def mitsuba_conductor(mi: Any, v: Array, l: Array) -> Callable[[], object]:  # noqa: E741
    """A call that evaluates Mitsuba's `roughconductor` on the same configurations, in float32."""
    import drjit

    dr: Any = drjit
    bsdf = mi.load_dict(
        {
            "type": "roughconductor",
            "distribution": "ggx",
            "alpha": 0.3,
            "eta": {"type": "srgb", "color": list(IOR), "unbounded": True},
            "k": {"type": "srgb", "color": list(EXTINCTION), "unbounded": True},
        }
    )
    si = dr.zeros(mi.SurfaceInteraction3f, len(v))
    si.wi = mi.Vector3f(*(mi.Float(np.ascontiguousarray(v[:, k], np.float32)) for k in range(3)))
    wo = mi.Vector3f(*(mi.Float(np.ascontiguousarray(l[:, k], np.float32)) for k in range(3)))
    dr.eval(si, wo)
    context = mi.BSDFContext()

    def work() -> object:
        value = bsdf.eval(context, si, wo)
        dr.eval(value)
        dr.sync_thread()
        return value

    return work


def measure(count: int = 1 << 20, repeats: int = 7) -> list[Row]:
    """Measure everything: `count` configurations for each question, `repeats` runs of which the best
    counts.
    """
    rng = np.random.default_rng(0)
    v, l = _directions(rng, count), _directions(rng, count)  # noqa: E741
    u = rng.random((count, 3))
    every = compiled.thread_count()
    few = count // 256
    rows = []

    def add(subject: str, question: str, lobe: str, cores: int, n: int, work: Callable[[], object]) -> None:
        rows.append(Row(subject, question, lobe, cores, n, _rate(work, n, repeats)))

    mi = _mitsuba()
    if mi is not None:
        version = f"Mitsuba {mi.__version__}, llvm float32"
        add(version, "eval", "conductor", every, count, mitsuba_conductor(mi, v, l))
    for name, bsdf in _lobes().items():
        questions: dict[str, tuple[int, Callable[[Lobe], object]]] = {
            "eval": (count, lambda b: b.eval(v, l)),
            "pdf": (count, lambda b: b.pdf(v, l)),
            "sample": (count, lambda b: b.sample(v, u)),
            "albedo": (few, lambda b: b.albedo(v[: count // 256])),
        }
        for question, (n, ask) in questions.items():
            for cores in sorted({1, every}):
                with _cores(cores):
                    add("mrm_nodes, float64", question, name, cores, n, lambda ask=ask, b=bsdf: ask(b))  # type: ignore[misc]
    add("NumPy, float64", "eval", "conductor", 1, count, lambda: numpy_conductor(v, l, 0.3))
    return rows


def growth(sizes: tuple[int, ...] = (10**5, 10**6, 10**7, 10**8)) -> list[Row]:
    """`eval` of one conductor for growing arrays; one view against many lights keeps the inputs small."""
    rng = np.random.default_rng(0)
    bsdf = _lobes()["conductor"]
    rows = []
    for size in sizes:
        columns = min(size, 10**4)
        v, l = _directions(rng, size // columns)[:, np.newaxis], _directions(rng, columns)  # noqa: E741
        step = max(1, 10**7 // columns)

        def work(v: Array = v, l: Array = l, step: int = step) -> None:  # noqa: E741
            for k in range(0, len(v), step):
                bsdf.eval(v[k : k + step], l)

        rows.append(
            Row(
                "mrm_nodes, float64", "eval", "conductor", compiled.thread_count(), size, _rate(work, size, 1)
            )
        )
    return rows
