"""The node library: where it lies, how to load it, how to put it into somebody else's `libraries` folder."""

from __future__ import annotations

import functools
import os
import shutil
import tempfile
from pathlib import Path

import MaterialX as mx

from mrm_nodes import surfaces as retrofitted
from mrm_nodes.errors import MrmError

#: Folder of the installed library below a `libraries` folder, and the file that marks it as ours.
INSTALL_NAME = "mrm"
INSTALL_MARK = "INSTALLED_BY_MRM_NODES"

#: The one GLSL file that names where MaterialX's own GLSL lies.
HOST_INCLUDE = Path("glsl/lib/mrm_host.glsl")
_HOST_INCLUDE_INSTALLED = (
    "// What MaterialX's own GLSL brings, from the `libraries` folder that this library was installed into.\n"
    '#include "../../../pbrlib/genglsl/lib/mx_closure_type.glsl"\n'
)


def root_path() -> Path:
    """Return the folder that holds `mtlx` and `glsl`: the checkout, or the data of an installed wheel."""
    package = Path(__file__).resolve().parent
    for root in (package / "data", package.parent):
        if (root / "mtlx" / "mrm").is_dir() and (root / "glsl").is_dir():
            return root
    raise MrmError(f"{package}: the node library (mtlx, glsl) is missing; reinstall mrm-nodes")


def library_path() -> Path:
    """Return the folder to load as a MaterialX library; its node definitions find their GLSL from there."""
    return root_path() / "mtlx" / "mrm"


def materials_path() -> Path:
    """Return the folder of the finished materials (.mtlx) that come with the package."""
    return root_path() / "mtlx" / "materials"


def search_path() -> mx.FileSearchPath:
    """Return the search path on which shader generation finds MaterialX's and our source files."""
    path = mx.getDefaultDataSearchPath()
    path.append(mx.FilePath(str(root_path())))
    return path


def load_library(doc: mx.Document | None = None, surfaces: bool = True) -> mx.Document:
    """Load MaterialX's standard libraries and ours into `doc`, or into a new document, and return it.

    With `surfaces`, the retroreflective twins of MaterialX's surfaces come too, made from the installed ones.

    One that is laid out in an unknown way is left out, with a warning.
    """
    if doc is None:
        doc = mx.createDocument()
    doc.importLibrary(_library(surfaces))
    return doc


def shared_library() -> mx.Document:
    """Return the one library document of this process; read it, never change it.

    A material's document points at it with `setDataLibrary`, which costs nothing;
    an import copies every definition.
    """
    return _library(True)


@functools.cache
def _library(surfaces: bool) -> mx.Document:
    library = mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), library)
    if library.getNodeDef("ND_conductor_bsdf") is None:
        raise MrmError(
            "MaterialX's standard libraries are missing from its Python package; reinstall MaterialX"
        )
    _add_nodes(library)
    if surfaces:
        for document in retrofitted.surface_documents(library).values():
            library.importLibrary(document)
    return library


def _add_nodes(library: mx.Document) -> None:
    for file in sorted(library_path().glob("*.mtlx")):
        part = mx.createDocument()
        mx.readFromXmlFile(part, str(file))
        library.importLibrary(part)


def _surfaces_for(folder: Path) -> dict[str, str]:
    """Return the retrofitted twins of the surfaces in `folder`, as text by file name; comments are kept."""
    options = mx.XmlReadOptions()
    options.readComments = options.readNewlines = True
    parts = [
        mx.FilePath(name) for name in ("targets", "stdlib", "pbrlib", "bxdf") if (folder / name).is_dir()
    ]
    library = mx.createDocument()
    mx.loadLibraries(parts, mx.FileSearchPath(str(folder)), library, readOptions=options)
    _add_nodes(library)
    documents = retrofitted.surface_documents(library)
    return {f"{name}.mtlx": mx.writeToXmlString(document) for name, document in documents.items()}


def install(libraries: str | os.PathLike[str]) -> list[Path]:
    """Copy the node library, its GLSL included, to `libraries`/mrm and return the files written.

    `libraries` is a MaterialX `libraries` folder: it holds `stdlib` and `pbrlib`. An earlier installation of
    ours is replaced as a whole; anything else in the way is left alone.

    Raises:
        MrmError: `libraries` is no such folder, cannot be written, or holds an `mrm` that is not ours.
    """
    folder = Path(libraries)
    if not folder.is_dir():
        raise MrmError(f"{folder}: no such folder; name a MaterialX `libraries` folder")
    if not (folder / "pbrlib" / "genglsl").is_dir():
        raise MrmError(f"{folder}: not a MaterialX `libraries` folder (no pbrlib/genglsl in it)")
    target = folder / INSTALL_NAME
    if target.is_symlink() or (target.exists() and not (target / INSTALL_MARK).is_file()):
        raise MrmError(f"{target}: exists and was not written by mrm-nodes; move it away first")
    try:
        staging = Path(tempfile.mkdtemp(prefix=".mrm-", dir=folder))
    except OSError as error:
        raise MrmError(
            f"{folder}: cannot be written ({error.strerror}); choose a folder that you may write"
        ) from None
    try:
        # A temporary folder is private; a library is for everybody who may read its neighbours.
        staging.chmod(folder.stat().st_mode & 0o777)
        shutil.copytree(library_path(), staging / "mtlx" / "mrm")
        shutil.copytree(root_path() / "glsl", staging / "glsl")
        (staging / HOST_INCLUDE).write_text(_HOST_INCLUDE_INSTALLED)
        for name, text in _surfaces_for(folder).items():
            (staging / "mtlx" / "mrm" / name).write_text(text, encoding="utf-8")
        files = sorted(path.relative_to(staging) for path in staging.rglob("*") if path.is_file())
        (staging / INSTALL_MARK).write_text("".join(f"{file.as_posix()}\n" for file in files))
        if target.exists():
            shutil.rmtree(target)
        staging.rename(target)
    except OSError as error:
        raise MrmError(f"{target}: cannot be written ({error.strerror})") from None
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    return [target / file for file in files]
