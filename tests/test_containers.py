"""As containers have it: a read-only file system but for /tmp, no home, and a user without a name.

A namespace of Linux gives all of that to one process; where none may be made, there is nothing to test with.
"""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from mrm_nodes import cachefolder
from mrm_nodes.errors import MrmWarning

# The first line alone may fail here; what follows is then in a container.
BOX = "mount -t tmpfs tmpfs /tmp && mount -o remount,bind,ro / && exec unshare -U --map-user=4242 --map-group=4242 "
EVALUATE = f"""{sys.executable} - <<'END'
import numpy as np
from mrm_nodes import reference as ref
up = np.array([0.0, 0.0, 1.0])
print("value", ref.Conductor(1.5, 2.0, 0.5).eval(up, up)[0])
END
"""
VALUE = 4.25 / 10.25 / 3.141592653589793
"""F D / 4 at the mirror angle, with alpha 0.5."""
CHOOSE = f"""{sys.executable} - <<'END'
import os
from mrm_nodes.cachefolder import choose_numbas
choose_numbas(), choose_numbas()
print(os.environ["NUMBA_CACHE_DIR"])
END
"""
VELVET = """<materialx version="1.39">
<sheen_bsdf name="b" type="BSDF" />
<surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="b" /></surface>
<surfacematerial name="m" type="material">
  <input name="surfaceshader" type="surfaceshader" nodename="s" />
</surfacematerial>
</materialx>
"""


def boxed(script: str) -> subprocess.CompletedProcess[str]:
    """Run a shell script in such a container, with nothing in its environment that it does not set."""
    path = os.pathsep.join(path for path in sys.path if path)
    return subprocess.run(
        ["unshare", "-Urm", "sh", "-c", BOX + "sh -s"],
        input=script,
        env={"PATH": os.environ["PATH"], "LANG": "C.UTF-8", "PYTHONPATH": path},
        cwd="/",
        capture_output=True,
        text=True,
        timeout=600,
    )


@pytest.fixture(scope="module", autouse=True)
def box() -> None:
    if shutil.which("unshare") is None or boxed("test $(id -u) = 4242 && ! touch /var/x").returncode:
        pytest.skip("no namespaces here")


@pytest.mark.parametrize("home", ["", "export HOME=/\n", "export HOME=/nonexistent\n"])
def test_machine_code_goes_to_a_private_folder_and_one_line_says_so(home: str):
    ran = boxed(home + CHOOSE + "stat -c %a /tmp/mrm-nodes-4242; ls")
    place, mode, *left = ran.stdout.splitlines()
    assert (place, mode) == ("/tmp/mrm-nodes-4242/numba", "700") and "~" not in left
    assert ran.stderr.count(f"the compiled evaluator is kept in {place}") == 1


def test_a_suite_runs_and_doctor_says_what_may_not_last():
    """In one container, because what is compiled for one is there for the next."""
    count = "find /tmp/mrm-nodes-4242/numba -name '*.nbc' | wc -l\n"
    command = f"{sys.executable} -m mrm_nodes"
    ran = boxed(
        f"mkdir /tmp/suite; cat >/tmp/suite/m.mtlx <<'END'\n{VELVET}END\n"
        f"{command} doctor; echo doctor $?\n{count}{EVALUATE}{count}"
        f"{command} regress --suite /tmp/suite -o /tmp/report --jobs 2; echo regress $?; ls\n"
    )
    told = ran.stdout + ran.stderr
    assert "doctor 0" in ran.stdout, told
    assert "compiled evaluator: kept in /tmp/mrm-nodes-4242/numba" in ran.stdout
    assert "results of cases: kept in /tmp/mrm-nodes-4242/results, which may not last" in ran.stdout
    lines = ran.stdout.splitlines()
    (value,) = (line for line in lines if line.startswith("value"))
    assert float(value.split()[1]) == pytest.approx(VALUE, rel=1e-12)
    before, after = (int(line) for line in lines if line.isdecimal())
    assert before == after >= 1
    # The material has no baseline yet, which is no fault of the container's.
    assert "regress 1" in ran.stdout and "has no baseline yet" in told
    assert "unexpected" not in told and "Traceback" not in told and "~" not in lines
    # Once a command, not once a worker.
    assert ran.stderr.count("the compiled evaluator is kept in") == 3


def test_a_folder_of_somebody_else_s_is_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    taken = tmp_path / f"mrm-nodes-{os.geteuid()}"
    (tmp_path / "elsewhere").mkdir()
    for make in (
        lambda: taken.symlink_to(tmp_path / "elsewhere"),
        lambda: taken.mkdir() or taken.chmod(0o777),
        lambda: taken.write_text(""),
    ):
        make()
        cachefolder.private.cache_clear()
        found = cachefolder.private()
        assert found is not None or taken.is_file()
        if found is not None:
            assert found != taken and stat.S_IMODE(found.stat().st_mode) == 0o700
        taken.unlink() if taken.is_symlink() or taken.is_file() else taken.rmdir()
    cachefolder.private.cache_clear()


def test_without_any_folder_the_evaluator_compiles_for_itself(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "a file" / "below"))
    (tmp_path / "a file").write_text("")
    monkeypatch.setattr(cachefolder, "private", lambda: None)
    cachefolder.choose_numbas.cache_clear()
    with pytest.warns(MrmWarning, match="each process compiles the evaluator anew"):
        assert not cachefolder.choose_numbas()
    cachefolder.choose_numbas.cache_clear()
