"""What a regression run costs, case by case; beside MaterialX's own renderer, and beside OpenImageIO's idiff."""

from __future__ import annotations

import json
import multiprocessing
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import MaterialX as mx
import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError
from mrm_nodes.regression.cases.builtin import AROUND, FRONT, default_suite
from mrm_nodes.regression.cases.material_case import MaterialCase, source_of
from mrm_nodes.regression.run.cache import Cache
from mrm_nodes.regression.run.pool import threads
from mrm_nodes.regression.run.runner import run_suite
from mrm_nodes.regression.truth.material import BSDF, Value
from mrm_nodes.regression.verdict.compare import Bounds, compare
from mrm_nodes.render.images import read_image, write_exr
from mrm_nodes.render.mesh import Mesh, sphere

SIZE = 128

ONE_THREAD = {"LP_NUM_THREADS": "0", "NUMBA_NUM_THREADS": "1"}
"""llvmpipe counts the threads that it has besides the one that calls it."""


@dataclass(frozen=True)
class TimedRun:
    """One run in a process of its own."""

    count: int
    jobs: int
    all_threads: bool
    seconds: float
    """From the first to the last outcome's being written, workers' start included."""
    whole: float
    """The report and the search for OpenGL included."""
    cpu: float
    """Seconds of processor time of all processes together: what other programs disturb least."""
    stages: dict[str, float]
    """Seconds of all cases together."""
    shaders: int
    cached: int
    run_megabytes: float
    """Peak memory of the run's own process."""
    worker_megabytes: float
    """Peak memory of the largest worker process."""

    @property
    def rate(self) -> float:
        """Cases a second."""
        return self.count / self.seconds

    @property
    def overhead(self) -> float:
        """Share of the workers' time that is spent in no stage."""
        return self.jobs * self.seconds / sum(self.stages.values()) - 1


def suite() -> list[MaterialCase]:
    """The default suite's cases in direct light."""
    return [case for case in default_suite() if case.environment is None]


def cases(count: int) -> list[MaterialCase]:
    """So many different cases: those of `suite` at 128 by 128, with other weights and alphas."""
    known = suite()
    rng = np.random.default_rng(0)
    made = []
    for number in range(count):
        case = known[number % len(known)]
        alpha, weight = float(rng.uniform(0.05, 0.6)), float(rng.random())
        others: dict[str, Value] = {f"{BSDF}/roughness": (alpha, alpha), f"{BSDF}/retroreflectivity": weight}
        inputs = {name: others.get(name, value) for name, value in case.inputs.items()}
        made.append(replace(case, name=f"{number}-{case.name}", inputs=inputs, size=(SIZE, SIZE)))
    return made


def measure(
    count: int, jobs: int, all_threads: bool = False, backend: str = "auto", cache: Path | None = None
) -> TimedRun:
    """Run so many cases in a process of its own, each worker with one thread or with its share of the processors."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, context, max_tasks_per_child=1) as fresh:
        return fresh.submit(_measure, cases(count), jobs, all_threads, backend, cache).result()


def _measure(
    tasks: list[MaterialCase], jobs: int, all_threads: bool, backend: str, cache: Path | None
) -> TimedRun:
    os.environ.update(threads(jobs) if all_threads else ONE_THREAD)
    with tempfile.TemporaryDirectory() as folder:
        start, cpu, children = time.perf_counter(), time.process_time(), _children()
        report = run_suite(
            tasks,
            Path(folder),
            backend,
            jobs,
            cache=None if cache is None else Cache(cache, 1 << 40, link=True),
        )
        whole = time.perf_counter() - start
    environment = report["environment"]
    cached = environment.get("cached", 0)
    stages = {
        stage: sum(case["seconds"][stage] for case in report["cases"])
        for stage in ("generate", "compile", "render", "reference", "compare")
    }
    return TimedRun(
        len(tasks),
        jobs,
        all_threads,
        # From the cache nothing is left for the workers.
        whole if cached else sum(environment["backend_seconds"].values()),
        whole,
        time.process_time() - cpu + _children() - children,
        stages,
        len({case.material for case in tasks}),
        cached,
        _peak(resource.RUSAGE_SELF),
        _peak(resource.RUSAGE_CHILDREN),
    )


def _children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _peak(whose: int) -> float:
    return resource.getrusage(whose).ru_maxrss / 1024


@dataclass(frozen=True)
class BesideMaterialX:
    """The same materials on the same mesh in the same light, by MaterialX's GlslRenderer and by us.

    Seconds, one value a round: all materials.
    """

    count: int
    theirs: list[float]
    """Reads the document, generates, compiles, draws, and reads the pixels back."""
    drawn: list[float]
    """Ours, up to the same point; documents that differ in values share one shader."""
    judged: list[float]
    """Ours, complete: with geometry, reference, comparison and files."""


def beside_materialx(count: int = 24, rounds: int = 3, backend: str = "auto") -> BesideMaterialX:
    """Time both, in turns, each in a process of its own with one thread.

    Raises:
        MrmError: no virtual display, which MaterialX's renderer needs.
    """
    if shutil.which("xvfb-run") is None:
        raise MrmError("MaterialX's own renderer needs a display: apt-get install xvfb xauth libgl1 libxt6")
    chosen = [replace(case, mesh="sphere", camera=FRONT, lights=AROUND) for case in _plain(count)]
    # Another shader than any of theirs.
    warm = next(case for case in suite() if "-over-diffuse" in case.material)
    result = BesideMaterialX(count, [], [], [])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for case in chosen:
            (folder / f"{case.name}.mtlx").write_text(source_of(case))
        write_obj(sphere(), folder / "sphere.obj")
        for _ in range(rounds):
            result.theirs.append(_draw_with_materialx(folder))
            measured = _fresh(_run_here, chosen, warm, backend)
            result.judged.append(measured[0])
            result.drawn.append(measured[1])
    return result


def _plain(count: int) -> list[MaterialCase]:
    """Cases whose inputs are all values."""
    return [case for case in cases(4 * count) if "-" not in case.material][:count]


def _fresh(function: Callable[..., Any], *arguments: Any) -> Any:
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as fresh:
        return fresh.submit(function, *arguments).result()


def _run_here(chosen: Sequence[MaterialCase], warm: MaterialCase, backend: str) -> tuple[float, float]:
    """Seconds of all cases, and those of them until the pixels are there."""
    os.environ.update(ONE_THREAD)
    from mrm_nodes.regression.run.worker import Worker
    from mrm_nodes.render.context import get_context

    worker = Worker(get_context(backend).backend)
    with tempfile.TemporaryDirectory() as folder:
        worker.run(replace(warm, name="warm", size=(8, 8)), Path(folder))
        start = time.perf_counter()
        outcomes = [worker.run(case, Path(folder)) for case in chosen]
        seconds = time.perf_counter() - start
    return seconds, sum(
        each.seconds[stage] for each in outcomes for stage in ("generate", "compile", "render")
    )


def _draw_with_materialx(folder: Path) -> float:
    """Seconds that MaterialX's renderer takes for the documents of a folder."""
    program = f"from {__name__} import draw_with_materialx; import sys; draw_with_materialx(sys.argv[1])"
    path = os.pathsep.join(path for path in sys.path if path)
    done = subprocess.run(
        ["xvfb-run", "-a", sys.executable, "-c", program, str(folder)],
        capture_output=True,
        text=True,
        env={**os.environ, **ONE_THREAD, "PYTHONPATH": path},
    )
    if done.returncode:
        raise MrmError(f"MaterialX's own renderer failed: {(done.stderr.strip().splitlines() or ['?'])[-1]}")
    return float(done.stdout.splitlines()[-1])


def draw_with_materialx(folder: str) -> None:
    """Print the seconds that MaterialX's GlslRenderer takes to draw each .mtlx of a folder on its sphere.obj."""
    import MaterialX.PyMaterialXGenGlsl as mx_gen_glsl
    import MaterialX.PyMaterialXGenShader as mx_gen_shader
    import MaterialX.PyMaterialXRender as mx_render
    import MaterialX.PyMaterialXRenderGlsl as mx_render_glsl

    from mrm_nodes import library

    shared = library.shared_library()
    generator = mx_gen_glsl.GlslShaderGenerator.create()
    context = mx_gen_shader.GenContext(generator)
    context.registerSourceCodeSearchPath(library.search_path())
    context.getOptions().hwMaxActiveLightSources = 4
    renderer = mx_render_glsl.GlslRenderer.create(SIZE, SIZE, mx_render.BaseType.FLOAT)
    renderer.initialize()
    renderer.setImageHandler(mx_render_glsl.GLTextureHandler.create(mx_render.StbImageLoader.create()))
    geometry = mx_render.GeometryHandler.create()
    geometry.addLoader(mx_render.TinyObjLoader.create())
    geometry.loadGeometry(mx.FilePath(f"{folder}/sphere.obj"), False)
    renderer.setGeometryHandler(geometry)
    camera = mx_render.Camera.create()
    near, far = FRONT.clip_distances((0.0, 0.0, 0.0), 1.0)
    camera.setWorldMatrix(mx.Matrix44.IDENTITY)
    camera.setViewMatrix(mx.Matrix44(*FRONT.view_matrix().T.ravel()))
    camera.setProjectionMatrix(mx.Matrix44(*FRONT.projection_matrix(1.0, near, far).T.ravel()))
    renderer.setCamera(camera)
    rig = mx.createDocument()
    rig.importLibrary(shared)
    lamps = []
    for number, light in enumerate(AROUND):
        data = light.data(FRONT)
        lamp = rig.addNode("directional_light", f"lamp{number}", "lightshader")
        lamp.setInputValue("direction", mx.Vector3(*data["direction"]))
        lamp.setInputValue("color", mx.Color3(*data["color"]))
        lamp.setInputValue("intensity", float(data["intensity"]))
        lamps.append(lamp)
    lights = mx_render.LightHandler.create()
    lights.registerLights(rig, lamps, context)
    lights.setLightSources(lamps)
    black = mx_render.createUniformImage(2, 1, 3, mx_render.BaseType.FLOAT, mx.Color4(0.0, 0.0, 0.0, 1.0))
    lights.setEnvRadianceMap(black)
    lights.setEnvIrradianceMap(black)
    renderer.setLightHandler(lights)

    start = time.perf_counter()
    for file in sorted(Path(folder).glob("*.mtlx")):
        document = mx.createDocument()
        mx.readFromXmlFile(document, str(file))
        document.setDataLibrary(shared)
        shader = generator.generate("material", document.getMaterialNodes()[0], context)
        renderer.createProgram(shader)
        renderer.validateInputs()
        renderer.render()
        renderer.captureImage(None)
    print(time.perf_counter() - start)


def write_obj(mesh: Mesh, file: Path) -> None:
    """Write a mesh as MaterialX's loaders read it."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.positions]
    lines += [f"vt {u:.9g} {v:.9g}" for u, v in mesh.texcoords]
    lines += [f"vn {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.normals]
    corners = np.asarray(mesh.indices).reshape(-1, 3) + 1
    lines += ["f " + " ".join(f"{i}/{i}/{i}" for i in corner) for corner in corners]
    file.write_text("\n".join(lines) + "\n")


@dataclass(frozen=True)
class BesideIdiff:
    """Milliseconds of processor time to compare two EXR files of a size, the median of the rounds."""

    size: int
    command: float
    """idiff, a process for each pair."""
    library: float
    """OpenImageIO's comparison, which idiff calls, in this process, reading the files."""
    ours: float
    """Our comparison, in this process, reading the files."""
    library_alone: float
    """OpenImageIO's comparison of pixels that were read: largest and mean errors, and how many fail."""
    ours_alone: float
    """Ours: largest and root mean square errors, and the 99.9th percentile of the relative ones."""


def beside_idiff(sizes: Sequence[int] = (128, 1024), rounds: int = 9) -> list[BesideIdiff]:
    """Time them on the same files, those in this process in turns.

    Raises:
        MrmError: there is no idiff.
    """
    idiff = shutil.which("idiff")
    if idiff is None:
        raise MrmError("there is no idiff to compare with: apt-get install openimageio-tools")
    rng = np.random.default_rng(0)
    found = []
    for size in sizes:
        with tempfile.TemporaryDirectory() as name:
            one, two = Path(name) / "one.exr", Path(name) / "two.exr"
            image = rng.random((size, size, 3), np.float32)
            write_exr(one, image)
            write_exr(two, image * np.float32(1 + 1e-7))

            def run_idiff(pair: tuple[str, str] = (str(one), str(two))) -> None:
                subprocess.run([idiff, "-fail", "1e-5", *pair], check=True, capture_output=True)

            def call_library(pair: tuple[str, str] = (str(one), str(two))) -> None:
                first, second = map(oiio.ImageBuf, pair)
                for buffer in (first, second):
                    # Else OpenImageIO's cache would have it from the round before.
                    buffer.read(force=True)
                assert not oiio.ImageBufAlgo.compare(first, second, 1e-5, 1e-5).error

            def call_ours(pair: tuple[Path, Path] = (one, two)) -> None:
                first, second = (read_image(file).reshape(-1, 3) for file in pair)
                verdict, _ = compare(first, second, Bounds(np.array(1e-5), np.array(1e-5)))
                assert verdict == "pass"

            buffers = oiio.ImageBuf(str(one)), oiio.ImageBuf(str(two))
            for buffer in buffers:
                buffer.read(force=True)
            pixels = read_image(one).reshape(-1, 3), read_image(two).reshape(-1, 3)

            def call_library_alone(pair: tuple[oiio.ImageBuf, oiio.ImageBuf] = buffers) -> None:
                assert not oiio.ImageBufAlgo.compare(*pair, 1e-5, 1e-5).error

            def call_ours_alone(pair: tuple[NDArray[Any], NDArray[Any]] = pixels) -> None:
                assert compare(*pair, Bounds(np.array(1e-5), np.array(1e-5)))[0] == "pass"

            subjects: list[Callable[[], None]]
            subjects = [run_idiff, call_library, call_ours, call_library_alone, call_ours_alone]
            times: list[list[float]] = [[] for _ in subjects]
            # Starting idiff's process has this one's memory copied when it is next written to: it is not in turns.
            for turns in (subjects[1:], subjects[:1]):
                for _ in range(rounds):
                    for subject in turns:
                        start = time.process_time() + _children()
                        subject()
                        times[subjects.index(subject)].append(time.process_time() + _children() - start)
        found.append(BesideIdiff(size, *(1e3 * statistics.median(each) for each in times)))
    return found


def as_json(measurements: Sequence[TimedRun]) -> str:
    """Measurements as JSON has them."""
    rows = [{**vars(each), "rate": each.rate, "overhead": each.overhead} for each in measurements]
    return json.dumps(rows, indent=1) + "\n"
