"""No file that is read makes the command line crash, hang, eat memory, or end with anything but status 0, 1 or 2.

MRM_FUZZ says how many mutated files are tried: 300 by default, and thousands for a release.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import fuzzing
import pytest

from mrm_nodes.render import probe_backends

COUNT = int(os.environ.get("MRM_FUZZ", "300"))


@pytest.fixture(scope="module")
def victim() -> Iterator[fuzzing.Victim]:
    """A process that may be harmed."""
    if not any(probe.works for probe in probe_backends()):
        pytest.skip("no backend works")
    process = fuzzing.Victim()
    yield process
    process.end()


def test_mutated_files_of_each_kind_end_with_a_status_and_a_word_on_why(victim: object, tmp_path: Path):
    faults, statuses = fuzzing.run(tmp_path, fuzzing.numbers_of(COUNT))
    assert not faults, "\n".join(map(str, faults))
    assert sum(statuses.values()) >= COUNT - 6
    assert statuses[0] > COUNT // 20, "next to none is still sound: the mutations are too wild to reach far"
    assert statuses[2] > COUNT // 4


def die(arguments: list[str]) -> None:
    os.abort()


def sleep(arguments: list[str]) -> None:
    time.sleep(60)


def hoard(arguments: list[str]) -> None:
    bytearray(fuzzing.MEMORY + (1 << 20))


def stumble(arguments: list[str]) -> None:
    raise ZeroDivisionError


def test_the_instrument_sees_a_crash_a_hang_too_much_memory_and_a_traceback(victim: object):
    watched = fuzzing.Victim(seconds=10.0)
    try:
        for harm, seen in ((die, "killed by -6"), (sleep, "hung"), (hoard, "raised"), (stumble, "raised")):
            result = watched.run([], harm)
            assert result[0] == seen and fuzzing.is_fault(result)
        assert watched.run(["--help"])[0] == 0
    finally:
        watched.end()


SURFACE = """<surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="b" /></surface>
<surfacematerial name="m" type="material">
  <input name="surfaceshader" type="surfaceshader" nodename="s" />
</surfacematerial>"""


def node(name: str, source: str, kind: str = "color3") -> str:
    """An `add` whose input is another node."""
    return f'<add name="{name}" type="{kind}"><input name="in1" type="{kind}" nodename="{source}" /></add>'


def definition(number: int, inner: str, kind: str = "color3", count: int = 1) -> str:
    """A node of our own whose graph holds other nodes."""
    nodes = "".join(f'<{inner} name="x{k}" type="{kind}" />' for k in range(count))
    return (
        f'<nodedef name="ND_{number}" node="n{number}"><output name="out" type="{kind}" /></nodedef>'
        f'<nodegraph name="NG_{number}" nodedef="ND_{number}">{nodes}'
        f'<output name="out" type="{kind}" nodename="x0" /></nodegraph>'
    )


def emission(count: int, width: int) -> str:
    """Additions of light, each of the next one, once or twice."""
    ports = [f"in{k + 1}" for k in range(width)]
    return (
        "".join(
            f'<add name="e{k}" type="EDF">'
            + "".join(f'<input name="{port}" type="EDF" nodename="e{k + 1}" />' for port in ports)
            + "</add>"
            for k in range(count)
        )
        + f'<uniform_edf name="e{count}" type="EDF" />'
    )


def graph(name: str, source: str) -> str:
    """A graph that hands on what another one gives."""
    connected = f'nodegraph="{source}" output="o"' if source else 'value="1, 0, 0"'
    return (
        f'<nodegraph name="{name}"><input name="i" type="color3" {connected} /><add name="x" type="color3">'
        '<input name="in1" type="color3" interfacename="i" /></add>'
        '<output name="o" type="color3" nodename="x" /></nodegraph>'
    )


THROUGH_GRAPHS = (
    '<mrm_conductor_bsdf name="b" type="BSDF"><input name="ior" type="color3" nodegraph="g1" output="o" />'
    "</mrm_conductor_bsdf>" + SURFACE
)
SHINING = '<mrm_conductor_bsdf name="b" type="BSDF" />' + SURFACE.replace(
    "</surface>", '<input name="edf" type="EDF" nodename="e0" /></surface>'
)
SHOWN = '<output name="o" type="color3" nodename="a" />'
OWN = '<n0 name="a" type="color3" />' + SHOWN
ROUND = {
    "a node is its own source": node("a", "a") + SHOWN,
    "two nodes are each other's": node("a", "c") + node("c", "a") + SHOWN,
    "a lobe is mixed of itself": '<mix name="b" type="BSDF"><input name="fg" type="BSDF" nodename="b" />'
    '<input name="mix" type="float" value="0.5" /></mix>' + SURFACE,
    "a node's graph holds the node": definition(0, "n0") + OWN,
    "a lobe's graph holds the lobe": definition(0, "n0", "BSDF") + '<n0 name="b" type="BSDF" />' + SURFACE,
    "graphs hold each other": definition(0, "n1") + definition(1, "n0") + OWN,
    "a thousand graphs in each other": "".join(definition(k, f"n{k + 1}") for k in range(1000))
    + definition(1000, "constant")
    + OWN,
    "a graph that doubles thirty times": "".join(definition(k, f"n{k + 1}", count=2) for k in range(30))
    + definition(30, "constant")
    + OWN,
    "a definition inherits from itself": '<nodedef name="A" node="n0" inherit="B" />'
    '<nodedef name="B" node="n0" inherit="A"><output name="out" type="color3" /></nodedef>' + OWN,
    "a node inherits from itself": '<constant name="a" type="color3" inherit="a" />' + SHOWN,
    "an interface is its own": '<nodegraph name="g"><input name="i" type="float" interfacename="i" />'
    '<input name="j" type="BSDF" interfacename="j" />'
    '<mrm_conductor_bsdf name="k" type="BSDF"><input name="weight" type="float" interfacename="i" />'
    '</mrm_conductor_bsdf><mix name="x" type="BSDF"><input name="fg" type="BSDF" interfacename="j" />'
    '<input name="bg" type="BSDF" nodename="k" /><input name="mix" type="float" value="0.5" /></mix>'
    '<output name="o" type="BSDF" nodename="x" /></nodegraph>'
    + SURFACE.replace('nodename="b"', 'nodegraph="g" output="o"'),
    "a lobe that doubles thirty times": "".join(
        f'<mix name="b{"" if k == 0 else k}" type="BSDF"><input name="fg" type="BSDF" nodename="b{k + 1}" />'
        f'<input name="bg" type="BSDF" nodename="b{k + 1}" /><input name="mix" type="float" value="0.5" /></mix>'
        for k in range(30)
    )
    + '<mrm_conductor_bsdf name="b30" type="BSDF" />'
    + SURFACE,
    "a lobe is mixed a thousand times over": "".join(
        f'<mix name="b{"" if k == 0 else k}" type="BSDF"><input name="fg" type="BSDF" nodename="b{k + 1}" />'
        '<input name="mix" type="float" value="0.5" /></mix>'
        for k in range(1000)
    )
    + '<mrm_conductor_bsdf name="b1000" type="BSDF" />'
    + SURFACE,
    "a light that doubles thirty times": emission(30, 2) + SHINING,
    "a light that is a thousand additions": emission(1000, 1) + SHINING,
    "a light that adds itself": '<add name="e0" type="EDF"><input name="in1" type="EDF" nodename="e0" /></add>'
    + SHINING,
    "a number that doubles thirty times": "".join(
        f'<max name="x{k}" type="float"><input name="in1" type="float" nodename="x{k + 1}" />'
        f'<input name="in2" type="float" nodename="x{k + 1}" /></max>'
        for k in range(30)
    )
    + '<constant name="x30" type="float" /><mrm_conductor_bsdf name="b" type="BSDF">'
    '<input name="retroreflectivity" type="float" nodename="x0" /></mrm_conductor_bsdf>' + SURFACE,
    "graphs that are each other's source": graph("g1", "g2") + graph("g2", "g1") + THROUGH_GRAPHS,
    "graphs behind each other": "".join(graph(f"g{k}", f"g{k + 1}") for k in range(1, 300))
    + graph("g300", "")
    + THROUGH_GRAPHS,
    "a chain of a thousand nodes": "".join(node("a" if k == 0 else f"a{k}", f"a{k + 1}") for k in range(1000))
    + '<constant name="a1000" type="color3" />'
    + SHOWN,
}


@pytest.mark.parametrize("body", ROUND.values(), ids=ROUND)
def test_what_goes_round_or_grows_without_end_comes_to_an_end(
    body: str, victim: fuzzing.Victim, tmp_path: Path
):
    file = tmp_path / "a.mtlx"
    file.write_text(f'<materialx version="1.39">{body}</materialx>')
    for arguments in (
        ["generate", str(file), "--target", "glsl", "-o", str(tmp_path / "out")],
        ["suite", "check", str(tmp_path)],
    ):
        result = victim.run(arguments)
        assert not fuzzing.is_fault(result), result


def test_a_mutation_is_found_again_by_its_number():
    content = fuzzing.METAL.encode()
    first = [fuzzing.mutated(content, "mtlx", number) for number in range(20)]
    assert first == [fuzzing.mutated(content, "mtlx", number) for number in range(20)]
    assert len(set(first)) > 15


def colors(count: int) -> str:
    return (
        "".join(node(f"a{k}", f"a{k + 1}") for k in range(count))
        + f'<constant name="a{count}" type="color3" />'
        + '<output name="o" type="color3" nodename="a0" />'
    )


def lobes(count: int) -> str:
    return (
        "".join(
            f'<mix name="b{k}" type="BSDF"><input name="fg" type="BSDF" nodename="b{k + 1}" /></mix>'
            for k in range(count)
        )
        + f'<mrm_conductor_bsdf name="b{count}" type="BSDF" />'
        + SURFACE.replace('"b"', '"b0"')
    )


def graphs(count: int) -> str:
    return (
        "".join(graph(f"g{k}", f"g{k + 1}") for k in range(1, count))
        + graph(f"g{count}", "")
        + THROUGH_GRAPHS
    )


def zigzag(count: int) -> str:
    """One graph, through which a chain passes again and again by other inputs and outputs."""
    ports = "".join(
        f'<input name="i{k}" type="color3" nodename="a{k}" /><output name="o{k}" type="color3" nodename="x{k}" />'
        f'<add name="x{k}" type="color3"><input name="in1" type="color3" interfacename="i{k}" /></add>'
        for k in range(count)
    )
    outside = "".join(
        f'<add name="a{k}" type="color3"><input name="in1" type="color3" nodegraph="g1" output="o{k + 1}" /></add>'
        for k in range(count - 1)
    )
    return (
        f'<nodegraph name="g1">{ports}</nodegraph>{outside}<constant name="a{count - 1}" type="color3" />'
        + THROUGH_GRAPHS.replace('output="o"', 'output="o0"')
    )


@pytest.mark.parametrize("chain", [colors, lobes, graphs, zigzag])
def test_a_chain_of_nodes_has_a_limit_below_which_all_goes_well(
    chain: object, victim: fuzzing.Victim, tmp_path: Path
):
    # MaterialX's generators go into each source from within the one before, and crash at thirty thousand.
    assert callable(chain)
    for count, statuses, told in (
        (300, (0,), ""),
        (1100, (2,), "more than 1000 nodes, each the source of"),
    ):
        file = tmp_path / "a.mtlx"
        file.write_text(f'<materialx version="1.39">{chain(count)}</materialx>')
        for arguments in (
            ["generate", str(file), "--target", "glsl", "-o", str(tmp_path / "out")],
            ["suite", "check", str(tmp_path)],
        ):
            status, said = victim.run(arguments)
            assert status in statuses and told in said, said
