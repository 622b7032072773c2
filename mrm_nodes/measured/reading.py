"""Reads a table of measured scattering, whatever format it is in: its contents tell, not its name."""

from __future__ import annotations

import os
from pathlib import Path

from mrm_nodes.errors import MrmError
from mrm_nodes.files import read_bytes
from mrm_nodes.measured import alta, csvtable, merl, rgl, xompt
from mrm_nodes.measured.measurement import Measurement


def read(path: str | os.PathLike[str], cosine: str | None = None) -> Measurement:
    """The samples of a file: ALTA .dat, MERL .binary, RGL .bsdf, ASTM E1392, OpenMATERIAL .xompt, or CSV.

    Args:
        path: of the file; its ending says what it is.
        cosine: what an ALTA file's values are multiplied by, "none", "view" or "light"; by default reciprocity and the
            header say it. The other formats have plain f.

    Raises:
        MrmError: it cannot be read, is none of these, or is not whole.
    """
    file = Path(path)
    try:
        content = read_bytes(file)
    except FileNotFoundError:
        raise MrmError(f"{file}: no such file") from None
    except OSError as error:
        raise MrmError(f"{file}: cannot be read: {error.strerror}") from None
    try:
        return _read(file, content, cosine)
    except MrmError as error:
        message = str(error)
        raise MrmError(message if message.startswith(str(file)) else f"{file}: {message}") from None


def _read(file: Path, content: bytes, cosine: str | None) -> Measurement:
    if content.startswith(rgl.MAGIC):
        _check_plain(file, cosine)
        return rgl.read_rgl(file, content)
    if merl.is_merl(content) or file.suffix.lower() == ".binary":
        _check_plain(file, cosine)
        return merl.read_merl(file, content)
    text = _text(file, content)
    if alta.is_alta(text):
        return alta.read_alta(file, text, cosine)
    _check_plain(file, cosine)
    if text.lstrip().startswith("{"):
        return xompt.read_xompt(file, text)
    if csvtable.is_astm(text):
        return csvtable.read_astm(file, text)
    return csvtable.read_csv(file, text)


def _check_plain(file: Path, cosine: str | None) -> None:
    if cosine not in (None, "none"):
        raise MrmError(f"{file}: its format has plain f, so cosine {cosine} is not asked for")


def _text(file: Path, content: bytes) -> str:
    if not content.strip():
        raise MrmError(f"{file}: is empty")
    encoding = "utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError:
        # Names in old headers; the numbers are the same in all of them.
        text = content.decode("latin-1")
    if "\0" in text:
        raise MrmError(
            f"{file}: none of the formats that are read: ALTA .dat, MERL .binary, RGL .bsdf, ASTM E1392, .xompt, CSV"
        )
    return text.replace("\r\n", "\n").replace("\r", "\n")
