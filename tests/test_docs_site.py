"""The documentation's site: it builds with warnings as errors, its pages ask the network for nothing, and a link to
code that is gone, or an equation that cannot be drawn, ends the build."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

pytest.importorskip("mkdocs", reason="the site needs mkdocs: pip install 'mrm-nodes[docs]'")

ROOT = Path(__file__).parents[1]
if not (ROOT / "mkdocs.yml").exists():
    pytest.skip("the site is made of a checkout", allow_module_level=True)

#: What a browser fetches by itself; a link waits for a click.
FETCHED = {
    ("script", "src"),
    ("link", "href"),
    ("img", "src"),
    ("img", "srcset"),
    ("source", "src"),
    ("iframe", "src"),
}


def build(folder: Path, site: Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "mkdocs", "build", "-f", folder / "mkdocs.yml", "-d", site]
    return subprocess.run(command, capture_output=True, text=True, env=environment, cwd=folder, timeout=900)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    done = build(ROOT, folder)
    assert done.returncode == 0, done.stderr
    return folder


class _Page(HTMLParser):
    """What a page fetches, where it leads, and the names in it."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.links: list[str] = []
        self.names: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        for name, value in attributes:
            if value and (tag, name) in FETCHED and ("rel", "canonical") not in attributes:
                self.fetched.append(value)
            if value and (tag, name) == ("a", "href"):
                self.links.append(value)
            if value and name in ("id", "name"):
                self.names.add(value)


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, _Page]:
    return {path: _Page(path.read_text(encoding="utf-8")) for path in site.rglob("*.html")}


def test_every_kind_of_page_is_there(pages: dict[Path, _Page], site: Path):
    names = {path.relative_to(site).as_posix() for path in pages}
    written = {path.relative_to(ROOT / "docs") for path in (ROOT / "docs").rglob("*.md")}
    assert names >= {path.with_suffix(".html").as_posix() for path in written}
    assert names >= {f"reference/{name}.html" for name in ("nodes", "shaders", "commands", "suite-keys")}
    assert "source/glsl/lib/mrm_microfacet.glsl.html" in names


def test_pages_fetch_nothing_from_the_network(pages: dict[Path, _Page], site: Path):
    foreign = {url for page in pages.values() for url in page.fetched if urlsplit(url).netloc}
    assert not foreign
    for sheet in site.rglob("*.css"):
        text = sheet.read_text(encoding="utf-8")
        assert not re.findall(r"url\(['\"]?(?:https?:)?//|@import", text), sheet


def test_every_inner_link_leads_somewhere(pages: dict[Path, _Page], site: Path):
    """`strict` checks what pages are written of; this checks what became of it, the theme's links too."""
    dead = []
    for path, page in pages.items():
        if path.name == "404.html":  # a server's, whose top is the site's
            continue
        for url in {*page.links, *page.fetched}:
            parts = urlsplit(url)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            known = pages[target].names if target in pages else None
            if not target.exists() or (
                parts.fragment and known is not None and unquote(parts.fragment) not in known
            ):
                dead.append(f"{path.relative_to(site)}: {url}")
    assert not dead, "\n".join(sorted(dead)[:20])


def test_external_links_are_whole(pages: dict[Path, _Page]):
    """They are not followed: a test needs no network."""
    outer = {
        url for page in pages.values() for url in page.links if urlsplit(url).scheme not in ("", "javascript")
    }
    assert outer
    assert not {
        url for url in outer if not re.fullmatch(r"(https?://[\w.-]+\.\w+(/\S*)?|mailto:\S+@\S+)", url)
    }


def test_the_reference_has_every_public_name(pages: dict[Path, _Page], site: Path):
    import mrm_nodes

    for package in (mrm_nodes, mrm_nodes.reference, mrm_nodes.render, mrm_nodes.regression):
        names = pages[site / f"reference/{package.__name__}.html"].names
        public = {f"{package.__name__}.{name}" for name in package.__all__}
        inner = {
            f"mrm_nodes.{name}" for name in ("measured", "photometry", "reference", "regression", "render")
        }
        assert public - inner <= names, package.__name__


def test_the_reference_has_every_command_node_and_key(site: Path):
    from mrm_nodes.regression.suites.suitetable import SETTINGS

    commands = (site / "reference/commands.html").read_text(encoding="utf-8")
    assert 'id="mrm-nodes-regress"' in commands and "--retry-errors" in commands
    nodes = (site / "reference/nodes.html").read_text(encoding="utf-8")
    assert "mrm_open_pbr_surface" in nodes and "specular_retroreflectivity" in nodes
    keys = (site / "reference/suite-keys.html").read_text(encoding="utf-8")
    assert all(f"<code>{key}</code>" in keys for key in SETTINGS)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A site of one page, with the hooks for links and equations."""
    folder = tmp_path_factory.mktemp("small")
    (folder / "docs").mkdir()
    shutil.copytree(ROOT / "docs" / "hooks", folder / "docs" / "hooks")
    (folder / "glsl").mkdir()
    (folder / "glsl" / "lobe.glsl").write_text(
        "float other(float x) { return x; }\n\nfloat ndf(vec3 h)\n{\n}\n"
    )
    (folder / "code.py").write_text("LIMIT = 1\n\n\nclass Lobe:\n    def eval(self):\n        pass\n")
    (folder / "mkdocs.yml").write_text(
        "site_name: small\nstrict: true\nexclude_docs: /hooks/\nvalidation: {anchors: warn}\n"
        "hooks: [docs/hooks/code_links.py, docs/hooks/equations.py]\nuse_directory_urls: false\n"
        "markdown_extensions: [{pymdownx.arithmatex: {generic: true}}, pymdownx.superfences]\n"
    )
    return folder


def written(folder: Path, text: str) -> tuple[subprocess.CompletedProcess[str], str]:
    (folder / "docs" / "index.md").write_text(f"# Small\n\n{text}\n")
    done = build(folder, folder / "site")
    page = folder / "site" / "index.html"
    return done, page.read_text(encoding="utf-8") if page.exists() else ""


def test_code_and_equations_are_found(small: Path):
    text = "[a](../code.py#Lobe.eval) [b](../glsl/lobe.glsl#ndf) [c](../code.py#LIMIT) $\\hat h$\n\n$$\nx^2\n$$\n"
    done, page = written(small, text)
    assert done.returncode == 0, done.stderr
    for link in ("source/code.py.html#L-5", "source/glsl/lobe.glsl.html#L-3", "source/code.py.html#L-1"):
        assert f'href="{link}"' in page
    assert page.count("<svg") == 2 and 'aria-label="\\hat h"' in page


GONE = {
    "[a](../code.py#Lobe.pdf)": "code.py defines no Lobe.pdf",
    "[a](../code.py#eval)": "code.py defines no eval",
    "[a](../glsl/lobe.glsl#nd)": "lobe.glsl defines no nd",
    "[a](../gone.py)": "there is no file gone.py",
    "[a](../../outside.py)": "there is no file ../outside.py",
    "$\\nonesuch x$": "unknown command \\nonesuch",
    "$\\frac{1}$": "cannot be drawn",
    "[a](nowhere.md)": "nowhere.md",
    "[a](#nowhere)": "#nowhere",
}


def test_what_is_gone_ends_the_build(small: Path):
    (small.parent / "outside.py").write_text("")
    done, _ = written(small, "\n\n".join(GONE))
    assert done.returncode != 0 and f"Aborted with {len(GONE)} warnings" in done.stdout + done.stderr
    lines = [line for line in (done.stdout + done.stderr).splitlines() if line.startswith("WARNING")]
    for told in GONE.values():
        assert any(told in line for line in lines), (told, lines)
