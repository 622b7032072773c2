"""What the pages of prose say about files is true, and the code has one word for one thing."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "mrm_nodes"


def described() -> set[str]:
    """The modules that docs/architecture.md lists, from the package's folder: a room's are set in below its name."""
    text = (ROOT / "docs/architecture.md").read_text("utf-8").split("## The package")[1]
    found: set[str] = set()
    rooms: list[str] = []
    for indent, line in re.findall(r"^((?:  ){2,4})(\S.*)", text, re.MULTILINE):
        del rooms[len(indent) // 2 - 2 :]
        found |= {"".join(rooms) + name for name in re.findall(r"\w+\.py", line)}
        folder = re.match(r"\w+/(?= )", line)
        if folder:
            rooms.append(folder[0])
    return found


def test_the_architecture_lists_every_module_in_its_room():
    there = {str(path.relative_to(PACKAGE)) for path in PACKAGE.rglob("*.py")}
    own = {name for name in there if not name.startswith("commands/") and Path(name).name[0] != "_"}
    assert described() == own, "docs/architecture.md: a line for each module, below its folder's"


def test_the_files_that_contributors_are_sent_to_are_there():
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    named = set(re.findall(r"[\w/.-]*\w\.(?:py|glsl|mtlx|toml|md)\b", text)) - {"glsl/mrm_NAME.glsl"}
    assert len(named) > 20
    there = [
        path.as_posix()
        for folder in ("mrm_nodes", "glsl", "mtlx", "tests", "docs")
        for path in (ROOT / folder).rglob("*.*")
    ]
    lost = {
        name
        for name in named
        if not (ROOT / name).is_file() and not any(p.endswith("/" + name) for p in there)
    }
    assert not lost


def test_no_two_public_classes_have_one_name():
    places: dict[str, list[str]] = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(str(path.relative_to(PACKAGE)))
    assert len(places) > 100
    twice = {name: where for name, where in places.items() if len(where) > 1}
    assert not twice, "one word for one thing: name one of them after what it is"
