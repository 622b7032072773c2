"""MaterialX's own documents through everything, where they lie beside the checkout; and its own renderer beside ours.

`make sweep` runs it; `python tests/sweep.py` prints the tables that it checks in docs/documents.md.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
import sweep

DATA = Path(__file__).parents[2] / "shared" / "data" / "materialx"
PAGE = Path(__file__).parents[1] / "docs" / "documents.md"
INSTALL = "no display for MaterialX's renderer: apt-get install xvfb xauth libgl1-mesa-dri libgl1 libxt6"

if shutil.which("xvfb-run") is None:
    assert "clients" not in os.environ.get("MRM_REQUIRE_COMPILERS", "").split(","), INSTALL
    pytest.skip(INSTALL, allow_module_level=True)


@pytest.mark.skipif(not DATA.is_dir(), reason="MaterialX's documents are not beside the checkout")
def test_materialx_own_documents_go_through_everything(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MATERIALX_SEARCH_PATH", str(tmp_path))
    found = sweep.everything(DATA, tmp_path)
    assert sweep.unexplained(found) == []
    assert sweep.unused_reasons(found) == []
    assert sweep.tables(found) in PAGE.read_text(encoding="utf-8")
