"""The node library: where it lies, how to load it, how to put it into somebody else's `libraries` folder."""

from __future__ import annotations

import functools
import hashlib
import os
import re
import shutil
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import MaterialX as mx

from mrm_nodes.errors import MrmError
from mrm_nodes.files import ABANDONED, UNFINISHED, clear, reason
from mrm_nodes.host import CLOSURE_TYPE, UPGRADE, Environment, Host, read_host
from mrm_nodes.shipped import materials_path as materials_path
from mrm_nodes.shipped import root_path as root_path
from mrm_nodes.substitution import surface_documents

# Before anything of it is used: what follows relies on it.
if not hasattr(mx.Document, "setDataLibrary"):
    raise MrmError(f"MaterialX {mx.getVersionString()} is too old; {UPGRADE}")

#: Folder of the installed library below a `libraries` folder, and the file that lists what was written there.
INSTALL_NAME = "mrm"
INSTALL_MARK = "INSTALLED_BY_MRM_NODES"

#: The one GLSL file that depends on the host: where MaterialX's own GLSL lies, and its rules.
HOST_INCLUDE = Path("glsl/lib/mrm_host.glsl")

#: The portable graphs: MaterialX's own BSDFs blended, and their forward lobe alone.
_BLEND_GRAPHS = "mrm_ng.mtlx"
_FORWARD_GRAPHS = "mrm_genosl_ng.mtlx"


def library_path(libraries: str | os.PathLike[str] | None = None) -> Path:
    """Return the folder to load as a MaterialX library; its node definitions find their GLSL from there.

    libraries: the MaterialX `libraries` folder that it goes with, by default that of the installed MaterialX.
    Where that follows other rules than the newest release known, the folder is a copy made for it.
    """
    return _root_for(host(libraries)) / "mtlx" / "mrm"


def search_path(libraries: str | os.PathLike[str] | None = None) -> mx.FileSearchPath:
    """Return the search path on which shader generation finds MaterialX's and our source files.

    libraries: as in `library_path`.
    """
    path = mx.getDefaultDataSearchPath() if libraries is None else _search_path_above(Path(libraries))
    path.append(mx.FilePath(str(_root_for(host(libraries)))))
    return path


def _search_path_above(libraries: Path) -> mx.FileSearchPath:
    if libraries.resolve().name != "libraries":
        raise MrmError(f"{libraries}: MaterialX looks for its files in a folder named `libraries`; rename it")
    return mx.FileSearchPath(str(libraries.resolve().parent))


def host(libraries: str | os.PathLike[str] | None = None) -> Host:
    """Return the rules of a `libraries` folder, by default of the installed MaterialX's own.

    Raises:
        MrmError: it is no such folder, or too old.
    """
    return _own_host() if libraries is None else read_host(Path(libraries))


@functools.cache
def _own_host() -> Host:
    return read_host(own_libraries())


def own_libraries() -> Path:
    """Return the `libraries` folder of the installed MaterialX.

    Raises:
        MrmError: it has none.
    """
    libraries = Path(mx.getDefaultDataSearchPath().find("libraries").asString())
    if not (libraries / "pbrlib").is_dir():
        raise MrmError(
            "MaterialX's standard libraries are missing from its Python package; reinstall MaterialX"
        )
    return libraries


def load_library(
    doc: mx.Document | None = None,
    surfaces: bool = True,
    libraries: str | os.PathLike[str] | None = None,
    environment: Environment = "any",
) -> mx.Document:
    """Load MaterialX's standard libraries and ours into `doc`, or into a new document, and return it.

    With `surfaces`, the retroreflective twins of MaterialX's surfaces come too, made from the installed ones;
    one that is laid out in an unknown way is left out, with a warning. libraries: as in `library_path`.
    environment: the method by which the host will evaluate image light, `fis` or `prefilter`, where it is known
    now: the nodes then cost less. Whoever compiles the shaders can define MRM_ENVIRONMENT (1, 2) instead.
    """
    if doc is None:
        doc = mx.createDocument()
    doc.importLibrary(_library(surfaces, _key(libraries), environment))
    return doc


def shared_library(libraries: str | os.PathLike[str] | None = None) -> mx.Document:
    """Return the one library document of this process; read it, never change it.

    A material's document points at it with `setDataLibrary`, which costs nothing;
    an import copies every definition. libraries: as in `library_path`.
    """
    return _library(True, _key(libraries))


def _key(libraries: str | os.PathLike[str] | None) -> Path | None:
    return None if libraries is None else Path(libraries).resolve()


@functools.cache
def _library(surfaces: bool, libraries: Path | None, environment: Environment = "any") -> mx.Document:
    library = mx.createDocument()
    folder = _root_for(replace(host(libraries), environment=environment)) / "mtlx" / "mrm"
    path = mx.getDefaultDataSearchPath() if libraries is None else _search_path_above(libraries)
    mx.loadLibraries(["libraries"], path, library)
    _add_nodes(library, folder)
    if surfaces:
        for document in surface_documents(library).values():
            library.importLibrary(document)
    return library


@functools.cache
def node_names() -> tuple[str, ...]:
    """The names of our BSDF nodes, in their alphabet's order."""
    definitions = mx.createDocument()
    _add_nodes(definitions, root_path() / "mtlx" / "mrm")
    return tuple(
        sorted({each.getNodeString() for each in definitions.getNodeDefs() if each.getType() == "BSDF"})
    )


def _add_nodes(library: mx.Document, folder: Path) -> None:
    for file in sorted(folder.glob("*.mtlx")):
        part = mx.createDocument()
        mx.readFromXmlFile(part, str(file))
        library.importLibrary(part)


@functools.cache
def _root_for(rules: Host) -> Path:
    """Return a folder with `mtlx` and `glsl` for a host: ours, or a copy where the host has other rules."""
    if rules == Host():
        return root_path()
    folder = tempfile.TemporaryDirectory(prefix="mrm-nodes-")
    _STAGED.append(folder)
    _write_nodes(Path(folder.name), rules, "libraries")
    return Path(folder.name)


#: Removed when the process ends.
_STAGED: list[tempfile.TemporaryDirectory[str]] = []


def _write_nodes(folder: Path, rules: Host, libraries: str) -> None:
    """Write `mtlx` and `glsl` for a host whose `libraries` folder our GLSL reaches under this path."""
    shutil.copytree(root_path() / "mtlx" / "mrm", folder / "mtlx" / "mrm")
    shutil.copytree(root_path() / "glsl", folder / "glsl")
    by_average = rules.compensation != "materialx-1.39.5"
    include = (folder / HOST_INCLUDE).read_text(encoding="utf-8")
    include = re.sub(r'#include ".*"', f'#include "{libraries}/{CLOSURE_TYPE.as_posix()}"', include)
    include = re.sub(r"(#define MRM_COMPENSATION_BY_AVERAGE_FRESNEL) \d", rf"\g<1> {by_average:d}", include)
    if not rules.has_matrix_function:
        include = include.replace("mx_matrix_mul(m, v)", "((m) * (v))")
    if not rules.prefilters_by_albedo:
        include = include.replace("MRM_ENVIRONMENT_PREFILTER 2", "MRM_ENVIRONMENT_PREFILTER (-1)")
    if rules.environment != "any":
        method = f"MRM_ENVIRONMENT_{rules.environment.upper()}"
        include = include.replace("MRM_ENVIRONMENT MRM_ENVIRONMENT_UNKNOWN", f"MRM_ENVIRONMENT {method}")
    (folder / HOST_INCLUDE).write_text(include, encoding="utf-8")

    blend, forward = (folder / "mtlx" / "mrm" / name for name in (_BLEND_GRAPHS, _FORWARD_GRAPHS))
    if not rules.has_retroreflective:
        # The blend cannot be built: the forward lobe serves every target without fused code.
        blend.unlink()
        text = forward.read_text(encoding="utf-8")
        forward.write_text(text.replace(' target="genosl"', ""), encoding="utf-8")
    elif not rules.forward_targets:
        forward.unlink()
    else:
        targets = ", ".join(sorted(rules.forward_targets))
        text = forward.read_text(encoding="utf-8")
        forward.write_text(text.replace('target="genosl"', f'target="{targets}"'), encoding="utf-8")


def _surfaces_for(folder: Path, nodes: Path) -> dict[str, str]:
    """Return the retrofitted twins of the surfaces in `folder`, as text by file name; comments are kept."""
    options = mx.XmlReadOptions()
    options.readComments = options.readNewlines = True
    parts = [
        mx.FilePath(name) for name in ("targets", "stdlib", "pbrlib", "bxdf") if (folder / name).is_dir()
    ]
    library = mx.createDocument()
    mx.loadLibraries(parts, mx.FileSearchPath(str(folder)), library, readOptions=options)
    _add_nodes(library, nodes)
    documents = surface_documents(library)
    return {f"{name}.mtlx": mx.writeToXmlString(document) for name, document in documents.items()}


def install(libraries: str | os.PathLike[str], environment: Environment = "any") -> list[Path]:
    """Copy the node library, its GLSL included, to `libraries`/mrm and return the files written.

    `libraries` is a MaterialX `libraries` folder: it holds `stdlib` and `pbrlib`, and what is written follows
    the rules of what lies there. An earlier installation of ours is replaced as a whole; anything else in the
    way is left alone, and so is an installation that somebody has changed. environment: as in `load_library`.

    Raises:
        MrmError: `libraries` is no such folder, too old, cannot be written, or holds an `mrm` that is not
            ours or was changed.
    """
    folder = Path(libraries)
    rules = replace(read_host(folder), environment=environment)
    target = folder / INSTALL_NAME
    if target.is_symlink() or target.exists():
        found = None if target.is_symlink() else _examine_installation(target)
        if found is None:
            raise MrmError(f"{target}: exists and was not written by mrm-nodes; move it away first")
        if found.foreign:
            raise MrmError(
                f"{target}: {_names(found.foreign, target)} was added or changed since mrm-nodes wrote it; "
                "move it away first"
            )
    clear(folder, ABANDONED)
    try:
        staging = Path(tempfile.mkdtemp(prefix=UNFINISHED, dir=folder))
    except OSError as error:
        raise MrmError(
            f"{folder}: cannot be written ({error.strerror}); choose a folder that you may write"
        ) from None
    try:
        # A temporary folder is private; a library is for everybody who may read its neighbours.
        staging.chmod(folder.stat().st_mode & 0o777)
        _write_nodes(staging, rules, "../../..")
        for name, text in _surfaces_for(folder, staging / "mtlx" / "mrm").items():
            (staging / "mtlx" / "mrm" / name).write_text(text, encoding="utf-8")
        files = sorted(path.relative_to(staging) for path in staging.rglob("*") if path.is_file())
        # The form that sha256sum writes and checks.
        lines = [f"{_digest(staging / file)}  {file.as_posix()}\n" for file in files]
        (staging / INSTALL_MARK).write_text("".join(lines), encoding="utf-8")
        earlier = staging.with_name(f"{staging.name}-earlier")
        if target.exists():
            target.rename(earlier)
        try:
            staging.rename(target)
        except OSError:
            if earlier.exists():
                earlier.rename(target)
            raise
        shutil.rmtree(earlier, ignore_errors=True)
    except OSError as error:
        raise MrmError(f"{target}: cannot be written ({reason(error)})") from None
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    return [target / file for file in files]


def uninstall(libraries: str | os.PathLike[str]) -> tuple[list[Path], list[Path]]:
    """Remove what `install` wrote to `libraries`/mrm; return the files removed and those left alone.

    A file that was added or changed since is left alone, and so is a folder that holds one.

    Raises:
        MrmError: there is no installation of ours, or it cannot be removed.
    """
    target = Path(libraries) / INSTALL_NAME
    found = None if target.is_symlink() else _examine_installation(target)
    if found is None:
        raise MrmError(f"{target}: no installation of mrm-nodes there")
    try:
        for file in (*found.ours, target / INSTALL_MARK):
            file.unlink()
        folders = [path for path in target.rglob("*") if path.is_dir() and not path.is_symlink()]
        for folder in (*sorted(folders, reverse=True), target):
            if not any(folder.iterdir()):
                folder.rmdir()
    except OSError as error:
        raise MrmError(f"{target}: cannot be removed ({error.strerror})") from None
    return found.ours, found.foreign


@dataclass(frozen=True)
class _Installation:
    ours: list[Path]
    """Files as `install` wrote them."""
    foreign: list[Path]
    """Files that somebody added or changed."""


def _examine_installation(target: Path) -> _Installation | None:
    """Compare a folder with its list of what was written; None without such a list."""
    mark = target / INSTALL_MARK
    if not mark.is_file():
        return None
    written = {}
    for line in mark.read_text(encoding="utf-8").splitlines():
        digest, _, name = line.partition("  ")
        written[target / name] = digest
    present = [path for path in sorted(target.rglob("*")) if not path.is_dir() or path.is_symlink()]
    present.remove(mark)
    ours = [path for path in present if path in written and _digest(path) == written[path]]
    return _Installation(ours, [path for path in present if path not in ours])


def _digest(file: Path) -> str:
    return "" if file.is_symlink() else hashlib.sha256(file.read_bytes()).hexdigest()


def _names(files: list[Path], folder: Path) -> str:
    shown = ", ".join(str(file.relative_to(folder)) for file in files[:3])
    return f"{shown} and {len(files) - 3} more" if len(files) > 3 else shown
