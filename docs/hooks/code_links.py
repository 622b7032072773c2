"""Links to code: a link out of docs/, `[text](../FILE#NAME)`, leads to the line of FILE that defines NAME.

Each file that is linked to becomes a page of the site, so that a link shows the code that the page was written of,
without network. A file or a name that is gone is a warning, which ends a strict build.
"""

from __future__ import annotations

import ast
import logging
import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files, InclusionLevel
from pygments import highlight
from pygments.formatters import HtmlFormatter
from pygments.lexers import GLShaderLexer, get_lexer_for_filename

ROOT = Path(__file__).parents[2]
DOCS = "docs"
_LOG = logging.getLogger("mkdocs.hooks.code_links")
_LINK = re.compile(r"(?<=\]\()(\.\./[^)\s#]+)(?:#([^)\s]+))?(?=\))")


def line_of(file: Path, name: str) -> int:
    """The line, from 1, on which a file defines a name.

    Args:
        file: Python, GLSL or MaterialX.
        name: of a function, class, method (`Class.method`) or constant; in MaterialX, of an element.

    Raises:
        LookupError: it defines no such name.
    """
    text = file.read_text(encoding="utf-8")
    if file.suffix == ".py":
        line = _line_in_python(ast.parse(text).body, name.split("."))
    else:
        escaped = re.escape(name)
        patterns = {
            ".glsl": rf"^(?:#define\s+{escaped}\b|struct\s+{escaped}\b|(?:\w+\s+)+{escaped}\s*\()",
            ".mtlx": rf'^[^\n]*<\w[^>]*\bname="{escaped}"',
        }
        found = re.search(patterns[file.suffix], text, re.MULTILINE) if file.suffix in patterns else None
        line = None if found is None else text.count("\n", 0, found.start()) + 1
    if line is None:
        raise LookupError(f"{file.name} defines no {name}")
    return line


def _line_in_python(body: list[ast.stmt], names: list[str]) -> int | None:
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == names[0]:
            return node.lineno if len(names) == 1 else _line_in_python(node.body, names[1:])
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        if len(names) == 1 and any(getattr(target, "id", None) == names[0] for target in targets):
            return node.lineno
    return None


def is_ours(path: str) -> bool:
    """Whether there is such a file in the repository."""
    return (ROOT / path).is_file() and (ROOT / path).resolve().is_relative_to(ROOT)


def page_of(path: str) -> str:
    """The page that shows a file: both from the top, of the repository and of the documentation."""
    return f"source/{path}.md"


def code_of(link: str, page: str) -> str | None:
    """The file from the top of the repository that a link of a page (from the top of docs/) leads to; None in docs/."""
    path = posixpath.normpath(posixpath.join(DOCS, posixpath.dirname(page), link))
    return None if path.startswith(f"{DOCS}/") else path


def _page(path: str) -> str:
    file = ROOT / path
    lexer = GLShaderLexer() if file.suffix == ".glsl" else get_lexer_for_filename(file.name)
    form = HtmlFormatter(wrapcode=True, lineanchors="L", linenos="inline", anchorlinenos=True)
    code = highlight(file.read_text(encoding="utf-8"), lexer, form)
    return f"---\nsearch:\n  exclude: true\nhide:\n  - toc\n---\n\n# {path}\n\n{code}\n"


def on_files(files: Files, config: Any, **_: Any) -> Files:
    """Add a page for each file that a page links to, and for the nodes' GLSL."""
    linked = {str(file.relative_to(ROOT)) for file in (ROOT / "glsl").rglob("*.glsl")}
    for page in files.documentation_pages():
        targets = (code_of(found[1], page.src_uri) for found in _LINK.finditer(page.content_string))
        linked |= {path for path in targets if path is not None}
    for path in sorted(linked):
        if is_ours(path):
            files.append(
                File.generated(
                    config, page_of(path), content=_page(path), inclusion=InclusionLevel.NOT_IN_NAV
                )
            )
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Replace the links to code."""
    here = page.file.src_uri

    def resolved(found: re.Match[str]) -> str:
        path, name = code_of(found[1], here), found[2]
        if path is None:
            return found[0]
        try:
            if not is_ours(path):
                raise LookupError(f"there is no file {path}")
            line = "" if name is None else f"#L-{line_of(ROOT / path, name)}"
        except LookupError as error:
            _LOG.warning(f"{here}: the link {found[0]}: {error}")
            # Another that leads nowhere would be warned of twice.
            return posixpath.basename(here)
        return posixpath.relpath(page_of(path), posixpath.dirname(here) or ".") + line

    return _LINK.sub(resolved, markdown)
