"""MaterialX's own documents through everything: generated, drawn beside MaterialX's own renderer, moved over, compared.

`python tests/sweep.py FOLDER` does it to every document of a folder, such as MaterialX's `resources`, and prints
tables of it.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import MaterialX as mx
import MaterialX.PyMaterialXGenShader as mx_gen_shader
import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from mrm_nodes import library, shadergen
from mrm_nodes.documents import read_document
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.regression.run.runner import run_suite
from mrm_nodes.regression.suites import suitefile
from mrm_nodes.render.environment import Environment
from mrm_nodes.render.mesh import Mesh
from mrm_nodes.render.meshfile import load_mesh
from mrm_nodes.render.renderer import RenderedImage, shared_renderer
from mrm_nodes.render.scene import Camera, DirectionalLight
from mrm_nodes.surfaces.convert import convert

SIZE = (64, 64)
CAMERA = Camera((0.5, 0.7, 4.0), (0.0, 0.0, 0.0))
LAMP = DirectionalLight(direction=(-0.3, -0.5, -1.0), color=(1.0, 0.9, 0.8))
AROUND = (0.3, 0.4, 0.5)
"""Radiance from everywhere: a glass without it is black."""
SAMPLES = 4
RENDERER = Path(__file__).with_name("materialx_renderer.py")


def picture(name: str, size: int = 32) -> NDArray[np.uint8]:
    """A picture that no other name has: blocks of 8 × 8 pixels, which a JPEG keeps as they are."""
    seed = int.from_bytes(hashlib.sha256(name.encode()).digest()[:4], "big")
    blocks = np.random.default_rng(seed).integers(30, 226, (size // 8, size // 8, 3))
    if "norm" in name.lower():
        # A tangent-space normal map leans a little.
        blocks = np.concatenate([blocks[..., :2] // 4 + 96, np.full_like(blocks[..., :1], 240)], axis=-1)
    return np.repeat(np.repeat(blocks, 8, axis=0), 8, axis=1).astype(np.uint8)


def write_picture(file: Path, pixels: NDArray[np.uint8]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, oiio.UINT8)
    spec.attribute("compression", "jpeg:100")
    spec.attribute("jpeg:subsampling", "4:4:4")
    output = oiio.ImageOutput.create(str(file))
    assert output.open(str(file), spec), output.geterror()
    assert output.write_image(pixels), output.geterror()
    assert output.close()


def write_obj(mesh: Mesh, file: Path) -> None:
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.positions]
    lines += [f"vt {u:.9g} {v:.9g}" for u, v in mesh.texcoords]
    lines += [f"vn {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.normals]
    corners = np.asarray(mesh.indices).reshape(-1, 3) + 1
    lines += ["f " + " ".join(f"{i}/{i}/{i}" for i in corner) for corner in corners]
    file.write_text("\n".join(lines) + "\n")


def copied(source: Path, folder: Path, kept_missing: Sequence[str] = ()) -> list[Path]:
    """Copy a folder of documents, write a small picture for each that they name and that is missing, and return them.

    What they name from `resources/…` lies below the copy's parent, which MaterialX's search path has.
    """
    shutil.copytree(source, folder)
    for file in (folder, *folder.rglob("*")):
        file.chmod(0o755 if file.is_dir() else 0o644)
    documents = sorted(folder.rglob("*.mtlx"))
    for document in documents:
        for name in _names(document, folder):
            if any(part in name for part in kept_missing):
                continue
            base = folder.parent if name.startswith("resources/") else document.parent
            tiles = ("1001", "1002") if "<UDIM>" in name else ("",)
            for tile in tiles:
                file = base / name.replace("<UDIM>", tile)
                if not file.exists():
                    write_picture(file, picture(file.name))
    return documents


def _names(document: Path, root: Path) -> list[str]:
    doc = mx.createDocument()
    mx.readFromXmlFile(doc, str(document), _search_path(document, root))
    found = [
        element.getResolvedValueString()
        for element in doc.traverseTree()
        if isinstance(element, mx.ValueElement) and element.getType() == "filename"
    ]
    return sorted({name for name in found if name})


def _search_path(document: Path, root: Path) -> mx.FileSearchPath:
    path = mx.FileSearchPath(str(document.parent))
    path.append(str(root.parent))
    return path


class Theirs:
    """MaterialX's own generators on its own reader: its colour management, its units, nothing of ours."""

    def __init__(self, libraries: mx.Document | None = None) -> None:
        self._libraries = libraries or mx.createDocument()
        if libraries is None:
            folders = mx.getDefaultDataLibraryFolders()
            mx.loadLibraries(folders, mx.getDefaultDataSearchPath(), self._libraries)
        self._generators = {target: self._generator(target) for target in shadergen.supported_targets()}

    def _generator(self, target: str) -> tuple[Any, Any, Any]:
        """A generator, its context and its units; the context would only hand out the generator's base class."""
        generator = shadergen._generators()[target].create()
        context = mx_gen_shader.GenContext(generator)
        context.registerSourceCodeSearchPath(library.search_path())
        colors = mx_gen_shader.DefaultColorManagementSystem.create(generator.getTarget())
        colors.loadLibrary(self._libraries)
        generator.setColorManagementSystem(colors)
        units = mx_gen_shader.UnitSystem.create(generator.getTarget())
        units.loadLibrary(self._libraries)
        units.setUnitConverterRegistry(self._registry())
        context.getOptions().targetColorSpaceOverride = "lin_rec709"
        context.getOptions().targetDistanceUnit = "meter"
        return generator, context, units

    def _registry(self) -> Any:
        registry = mx.UnitConverterRegistry.create()
        for kind in ("distance", "angle"):
            definition = self._libraries.getUnitTypeDef(kind)
            registry.addUnitConverter(definition, mx.LinearUnitConverter.create(definition))
        return registry

    def document(self, file: Path, root: Path) -> mx.Document:
        doc = mx.createDocument()
        mx.readFromXmlFile(doc, str(file), _search_path(file, root))
        doc.setDataLibrary(self._libraries)
        return doc

    def renderables(self, document: mx.Document) -> list[str]:
        return [each.getNamePath() for each in mx_gen_shader.findRenderableElements(document)]

    def takes(self, document: mx.Document, element: str, target: str) -> str:
        """What a generator has against an element; empty where it generates it."""
        complaint = self._complaint(document, element, target, with_units=True)
        # With a unit system, MaterialX 1.39.5 has no implementation of any angle's unit.
        if "unit" in complaint.lower():
            complaint = self._complaint(document, element, target, with_units=False)
        return complaint

    def _complaint(self, document: mx.Document, element: str, target: str, with_units: bool) -> str:
        generator, context, units = self._generators[target]
        generator.setUnitSystem(units if with_units else None)
        try:
            if hasattr(generator, "registerTypeDefs"):
                generator.registerTypeDefs(document)
            shader = generator.generate("shader", document.getDescendant(element), context)
        except Exception as error:
            return _line(error)
        return "" if shader and shader.getSourceCode("pixel") else "nothing was generated"


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:300]


@dataclass
class Row:
    """One element of a document, and what became of it."""

    document: str
    element: str
    refused: dict[str, str] = field(default_factory=dict)
    """By target: what we have against it, where MaterialX generates it."""
    upstream: dict[str, str] = field(default_factory=dict)
    """By target: what MaterialX has against it."""
    picture: str = ""
    """`same`, `differs`, `black` (both), `theirs fails`, `refused`, `neither` (both refuse), or `fails`."""
    message: str = ""
    warnings: list[str] = field(default_factory=list)


def generated(documents: Iterable[Path], root: Path, most: int = 2) -> Iterator[Row]:
    """The first renderable elements of each document through every generator, ours beside MaterialX's; all in GLSL."""
    theirs = Theirs()
    for file in documents:
        document = theirs.document(file, root)
        ours: mx.Document | str
        try:
            ours = read_document(file, allow_external=True)
        except MrmError as error:
            ours = _line(error)
        except Exception as error:
            ours = f"unexpected {type(error).__name__}: {_line(error)}"
        for number, element in enumerate(theirs.renderables(document)):
            row = Row(str(file.relative_to(root)), element)
            for target in shadergen.supported_targets() if number < most else ["glsl"]:
                complaint = theirs.takes(document, element, target)
                if complaint:
                    row.upstream[target] = complaint
                refused = ours if isinstance(ours, str) else _refused(ours, target, element)
                if refused and (not complaint or "unexpected" in refused):
                    row.refused[target] = refused
            yield row


def _refused(document: mx.Document, target: str, element: str) -> str:
    """What we have against generating an element; empty where it is generated."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MrmWarning)
            shadergen.generate_shader(document, target, element)
    except MrmError as error:
        return _line(error)
    except Exception as error:
        return f"unexpected {type(error).__name__}: {_line(error)}"
    return ""


def draw(rows: Sequence[Row], root: Path, work: Path, backend: str = "auto") -> None:
    """Draw each element with our renderer and with MaterialX's, and note how the two differ."""
    work.mkdir(exist_ok=True)
    mesh_file = work / "sphere.obj"
    write_obj(load_mesh("sphere"), mesh_file)
    mesh = load_mesh(mesh_file)
    jobs = [
        {
            "material": str(root / row.document),
            "element": row.element,
            "search": [str(root.parent)],
            "interface": interface_of(root / row.document, root),
            "output": str(work / f"{number}.npy"),
        }
        for number, row in enumerate(rows)
    ]
    process = start_theirs(jobs, mesh, mesh_file, work)
    images = [drawn(row, job["interface"], root, mesh, backend) for row, job in zip(rows, jobs, strict=True)]
    _, complaints = process.communicate(timeout=1800)
    assert process.returncode == 0, complaints[-2000:]
    for row, ours, job in zip(rows, images, jobs, strict=True):
        output = Path(job["output"])
        theirs_fails = not output.exists() and output.with_suffix(".txt").read_text()
        if theirs_fails and row.picture != "fails":
            row.picture = "neither" if ours is None else "theirs fails"
            row.message = f"{row.message}; theirs: {theirs_fails}"
        elif ours is not None:
            compare(row, np.load(output), ours.image, ours.mask, _has_jpeg(root / row.document, root))


def interface_of(document: Path, root: Path) -> str:
    """Drivers compile far less of a reduced shader, but such a one has no address modes for MaterialX's renderer."""
    return "complete" if _names(document, root) else "reduced"


def _has_jpeg(document: Path, root: Path) -> bool:
    return any(name.endswith(".jpg") for name in _names(document, root))


def drawn(row: Row, interface: str, root: Path, mesh: Mesh, backend: str) -> RenderedImage | None:
    """Our picture of an element, or none: then the row says why."""
    around = Environment(np.full((8, 16, 3), AROUND, np.float32), samples=SAMPLES)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            shader = shadergen.generate_shader(
                root / row.document, "glsl", row.element, interface=interface, allow_external=True
            )
            return shared_renderer(backend).render(shader, mesh, CAMERA, [LAMP], SIZE, environment=around)
        except MrmError as error:
            row.picture, row.message = "refused", _line(error)
        except Exception as error:
            row.picture, row.message = "fails", f"unexpected {type(error).__name__}: {_line(error)}"
        finally:
            row.warnings = [str(each.message) for each in caught if issubclass(each.category, MrmWarning)]
    return None


SAME, SAME_WITH_JPEG = 1e-3, 5e-2
"""Relative difference of 99 of 100 pixels. Two decoders of a JPEG round its colours differently."""


def compare(
    row: Row, theirs: NDArray[Any], ours: NDArray[Any], mask: NDArray[np.bool_], has_jpeg: bool = False
) -> None:
    inside = inner(mask)
    if inside.sum() < 100:
        row.picture, row.message = "differs", f"{inside.sum()} pixels are covered"
        return
    theirs = theirs[..., :3][inside].astype(np.float64)
    seen = ours[inside].astype(np.float64)
    difference = np.abs(theirs - seen) / np.maximum(np.abs(seen), 1e-2)
    # A value that both have, infinite or none, is the same.
    difference[(theirs == seen) | (np.isnan(theirs) & np.isnan(seen))] = 0.0
    worst = np.nan_to_num(difference, nan=np.inf).max(axis=-1)
    error = float(np.quantile(worst, 0.99))
    means = f"mean {theirs.mean():.3g}, ours {seen.mean():.3g}"
    row.message = f"99 % within {error:.2g}, all within {worst.max():.2g}; {means}"
    row.picture = "same" if error < (SAME_WITH_JPEG if has_jpeg else SAME) else "differs"
    if not np.any(theirs) and not np.any(seen):
        row.picture = "black"


def inner(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Where a pixel and its neighbours are covered: at an outline the two rasterizers may differ."""
    inside = mask & np.roll(mask, 1, 0) & np.roll(mask, -1, 0)
    return inside & np.roll(mask, 1, 1) & np.roll(mask, -1, 1)


def start_theirs(
    jobs: list[dict[str, Any]], mesh: Mesh, mesh_file: Path, work: Path
) -> subprocess.Popen[str]:
    """Have MaterialX's own renderer draw the jobs in one process of its own."""
    near, far = CAMERA.clip_distances(mesh.center, mesh.radius)
    scene = {
        "size": SIZE,
        # MaterialX's matrices multiply row vectors.
        "view": CAMERA.view_matrix().T.ravel().tolist(),
        "projection": CAMERA.projection_matrix(SIZE[0] / SIZE[1], near, far).T.ravel().tolist(),
        "direction": LAMP.direction,
        "color": LAMP.color,
        "around": AROUND,
        "samples": SAMPLES,
        "mesh": str(mesh_file),
        "jobs": jobs,
    }
    return start(scene, work)


def start(scene: dict[str, Any], work: Path) -> subprocess.Popen[str]:
    """Start MaterialX's own renderer on a scene: see materialx_renderer.py."""
    (work / "scene.json").write_text(json.dumps(scene))
    return subprocess.Popen(
        ["xvfb-run", "-a", sys.executable, str(RENDERER), str(work / "scene.json")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def retrofitted(documents: Iterable[Path], root: Path) -> Iterator[tuple[str, list[str], str]]:
    """Each document with surfaces of ours: its name, what changed, and what we have against it.

    What changed is read by MaterialX's own reader and generated.
    """
    theirs = Theirs(library.load_library())
    for number, file in enumerate(documents):
        name = str(file.relative_to(root))
        # Beside the document, so that what it names is where it was.
        target = file.with_name(f"{file.stem}.retrofitted{number}.mtlx")
        try:
            changed = convert(file, target, allow_external=True)
            complaint = ""
            if changed:
                document = theirs.document(target, root)
                for element in theirs.renderables(document)[:1]:
                    complaint = theirs.takes(document, element, "glsl") or _refused_file(target, element)
            yield name, changed, complaint
        except MrmError as error:
            yield (
                name,
                [],
                "" if re.search(r"has (nothing to retrofit|none of)", str(error)) else _line(error),
            )
        except Exception as error:
            yield name, [], f"unexpected {type(error).__name__}: {_line(error)}"
        finally:
            target.unlink(missing_ok=True)


def _refused_file(file: Path, element: str) -> str:
    try:
        return _refused(read_document(file, allow_external=True), "glsl", element)
    except MrmError as error:
        return _line(error)


def regressed(
    documents: Iterable[Path], root: Path, folder: Path, backend: str = "auto"
) -> list[dict[str, Any]]:
    """The report's records of a suite of the documents: one material of each."""
    listed = json.dumps([str(file.relative_to(root.parent)) for file in documents])
    suite = root.parent / "suite.toml"
    suite.write_text(
        f"[defaults]\nsize = [16, 16]\n\n[[case]]\nmaterial = {listed}\n" + 'name = "{material}-{element}"\n'
    )
    first = {case.material: case for case in reversed(suitefile.load(suite, allow_external=True).cases)}
    report = run_suite(list(first.values()), folder, backend, jobs=2)
    cases: list[dict[str, Any]] = report["cases"]
    return cases


def outcome(record: dict[str, Any]) -> str:
    """What became of a case: `evaluator`, `baseline` (drawn, and none is stored yet), or what is wrong."""
    if record["verdict"] == "pass":
        return "evaluator"
    if "baseline" in record["message"] and record["files"].get("render"):
        return "baseline"
    return f"{record['verdict']}: {record['message'] or record['max_rel']}"


@dataclass
class Found:
    """What a sweep of a folder came to."""

    documents: list[str]
    generated: list[Row]
    drawn: list[Row]
    retrofitted: list[tuple[str, list[str], str]]
    regressed: list[dict[str, Any]]


REASONS: dict[tuple[str, str], str] = {
    ("render", r"image_default\.mtlx .*: refused: "): (
        "a picture that is named and missing is refused; MaterialX draws the node's default"
    ),
    ("render", r"(brass_wire_mesh|transparency_hints|clock|shader/surface)\.mtlx .*: differs: "): (
        "cut out or blended over black, as MaterialX's viewer does; its `GlslRenderer` was not asked to"
    ),
    ("render", r"ocio_color_management\.mtlx .*: differs: "): (
        "colour spaces that OpenColorIO knows are converted; MaterialX takes them as they are, and says so"
    ),
    ("render", r"mapped_surfaceshader\.mtlx UnitMappedShaderMaterial: differs: "): (
        "two graphs have a node of one name each: MaterialX's renderer gives both the values of the first"
    ),
    ("render", r"tiled(_unit)?_image3_output: differs: "): (
        "the closest texel; MaterialX's renderer asks for anisotropy there too, and llvmpipe then blends texels"
    ),
    ("render", r"geompropvalue\.mtlx .*: neither: "): (
        "vertex data that the sphere does not have: both refuse"
    ),
    ("render", r": black: "): "black in both: an output that is no colour, or light that nothing gives",
    ("retrofit", r"image_default\.mtlx: .*there is no texture"): "a picture that is named and missing",
    ("regress", r": its opacity is not 1 everywhere"): "transparent: a case of its own with a stored image",
    ("regress", r": it emits light"): "emits light: the same",
    ("regress", r"is anisotropic, and MaterialX approximates"): "MaterialX's own anisotropic lobes: the same",
    ("regress", r": undecided: an image 10 % off would pass: its lobes are too narrow"): (
        "a mirror: its lobe is too narrow for float32 to say anything, and the verdict says so"
    ),
    (
        "regress",
        r": undecided: nothing is lit",
    ): "nothing that the light of the case would show: it only emits",
}
"""Why something is not as MaterialX has it: by stage and pattern of the document's name and what is said."""


def everything(source: Path, folder: Path, most: int = 2, only: str = "") -> Found:
    """Put every document of a folder through generate, render, retrofit and regress, in a copy."""
    root = folder / "resources"
    documents = [file for file in copied(source, root, MISSING) if re.search(only, str(file))]
    theirs = Theirs()
    rows = [
        Row(str(file.relative_to(root)), element)
        for file in documents
        for element in theirs.renderables(theirs.document(file, root))[:most]
    ]
    draw(rows, root, folder / "work")
    with_materials = [file for file in documents if theirs.document(file, root).getMaterialNodes()]
    return Found(
        [str(file.relative_to(root)) for file in documents],
        list(generated(documents, root, most)),
        rows,
        list(retrofitted(documents, root)),
        regressed(with_materials, root, folder / "report"),
    )


MISSING = ("invalid.png",)
"""Pictures that MaterialX's own documents name and that nobody has."""


def complaints(found: Found) -> list[tuple[str, str]]:
    """By stage, what is not as MaterialX has it."""
    listed = [
        ("generate", f"{row.document} {row.element}, {target}: {message}")
        for row in found.generated
        for target, message in row.refused.items()
    ]
    listed += [
        ("render", f"{row.document} {row.element}: {row.picture}: {row.message}")
        for row in found.drawn
        if row.picture != "same"
    ]
    listed += [("retrofit", f"{name}: {message}") for name, _, message in found.retrofitted if message]
    listed += [
        ("regress", f"{record['name']}: {outcome(record)}")
        for record in found.regressed
        if outcome(record) not in ("evaluator", "baseline")
    ]
    return listed


def _reason(stage: str, complaint: str) -> tuple[str, str] | None:
    return next((key for key in REASONS if key[0] == stage and re.search(key[1], complaint)), None)


def unexplained(found: Found) -> list[str]:
    """What has no reason, or is an error that nobody expected."""
    return [
        f"{stage}: {complaint}"
        for stage, complaint in complaints(found)
        if "unexpected" in complaint or _reason(stage, complaint) is None
    ]


def unused_reasons(found: Found) -> list[tuple[str, str]]:
    """Reasons that nothing needs any more."""
    used = {_reason(stage, complaint) for stage, complaint in complaints(found)}
    return [key for key in REASONS if key not in used]


def tables(found: Found) -> str:
    """What came of it, as tables."""
    same = sum(row.picture == "same" for row in found.drawn)
    outcomes = [outcome(record) for record in found.regressed]
    upstream = sum(bool(row.upstream) for row in found.generated)
    lines = [
        "| what | count |",
        "|---|---|",
        f"| documents | {len(found.documents)} |",
        f"| with something to draw | {len({row.document for row in found.generated})} |",
        f"| elements generated in GLSL | {len(found.generated)} |",
        f"| of these, in every target (the first two of a document) | {len(found.drawn)} |",
        f"| that a generator of MaterialX refuses itself | {upstream} |",
        f"| refused by us only | {sum(bool(row.refused) for row in found.generated)} |",
        f"| drawn beside MaterialX's own renderer | {len(found.drawn)} |",
        f"| the same picture | {same} |",
        f"| not, see below | {len(found.drawn) - same} |",
        f"| moved over by `retrofit` (something in it changed) | {sum(bool(c) for _, c, _ in found.retrofitted)} |",
        f"| materials in `regress` | {len(outcomes)} |",
        f"| compared with the evaluator, and passed | {outcomes.count('evaluator')} |",
        f"| drawn, for a stored image | {outcomes.count('baseline')} |",
        "",
        "| command | elements | why |",
        "|---|---|---|",
    ]
    told = [(stage, _reason(stage, complaint)) for stage, complaint in complaints(found)]
    for key, reason in REASONS.items():
        lines.append(f"| `{key[0]}` | {told.count((key[0], key))} | {reason} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    import tempfile

    with tempfile.TemporaryDirectory() as scratch:
        os.environ["MATERIALX_SEARCH_PATH"] = scratch
        result = everything(
            Path(sys.argv[1]), Path(scratch), int((*sys.argv, "", "2")[3]), (*sys.argv, "")[2]
        )
    print(tables(result))
    for each in unexplained(result):
        print("unexplained:", each, file=sys.stderr)
    sys.exit(bool(unexplained(result)))
