"""The pages of prose: what they say about files is true."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "mrm_nodes"


def described() -> set[str]:
    """The modules that docs/architecture.md lists, from the package's folder: a room's are set in below its name."""
    text = (ROOT / "docs/architecture.md").read_text("utf-8").split("## The package")[1]
    found, room = set(), ""
    for indent, line in re.findall(r"^( {4}| {6})(\S.*)", text, re.MULTILINE):
        if indent == "    ":
            folder = re.match(r"\w+/(?= )", line)
            room = folder[0] if folder else ""
        found |= {room + name for name in re.findall(r"\w+\.py", line)}
    return found


def test_the_architecture_lists_every_module_in_its_room():
    there = {str(path.relative_to(PACKAGE)) for path in PACKAGE.rglob("*.py")}
    own = {name for name in there if not name.startswith("commands/") and Path(name).name[0] != "_"}
    assert described() == own, "docs/architecture.md: a line for each module, below its folder's"
