"""On a cluster as here: the same figures and bytes, and each file travels to a worker once."""

import itertools
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from nasty import Nasty

from mrm_nodes.bench.regress import write_obj
from mrm_nodes.errors import MrmError
from mrm_nodes.regression.cases.builtin import default_suite
from mrm_nodes.regression.cases.cloud import Cloud
from mrm_nodes.regression.cases.digests import digest
from mrm_nodes.regression.run.cluster import Cluster, ShippedFiles, dask_cluster
from mrm_nodes.regression.run.runner import run_suite
from mrm_nodes.regression.run.worker import Worker
from mrm_nodes.regression.suites import selection as suites
from mrm_nodes.render.images import write_exr
from mrm_nodes.render.mesh import sphere

BY_LIGHTS = [case for case in default_suite() if case.environment is None]
IMAGES = [replace(case, size=(48, 48)) for case in BY_LIGHTS[::12]]
MATERIAL = """<materialx version="1.39">
  <nodedef name="ND_halved" node="halved">
    <input name="in" type="float" value="0.0"/><output name="out" type="float"/>
  </nodedef>
  <implementation name="IM_halved" nodedef="ND_halved" target="genglsl" file="OUTSIDE/halved.glsl" function="halved"/>
  <image name="worn" type="float"><input name="file" type="filename" value="tex\\worn.exr"/></image>
  <image name="spare" type="float"><input name="file" type="filename" value="tex/spare.&lt;UDIM&gt;.exr"/></image>
  <halved name="half" type="float"><input name="in" type="float" nodename="worn"/></halved>
  <image name="brushed" type="vector2"><input name="file" type="filename" value="OUTSIDE/brushed.exr"/></image>
  <mrm_conductor_bsdf name="bsdf" type="BSDF">
    <input name="roughness" type="vector2" nodename="brushed"/>
    <input name="retroreflectivity" type="float" nodename="half"/>
  </mrm_conductor_bsdf>
  <surface name="surface" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="bsdf"/></surface>
  <surfacematerial name="m" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="surface"/>
  </surfacematerial>
</materialx>
"""
SOURCE = {
    "halved.glsl": '#include "lib/half.glsl"\nvoid halved(float i, out float o) { o = i * half_of_one; }\n',
    "lib/half.glsl": "#define half_of_one 0.5\n",
}
SUITE = """
[[case]]
name = "own"
material = "m.mtlx"
mesh = "ball.obj"
light = ["camera"]
size = [48, 48]
"""
CLOUDS = [Cloud("mrm_conductor_bsdf", configurations=5000)]


@pytest.fixture(scope="module")
def tasks(tmp_path_factory):
    """Images, a cloud, a material with a mesh, textures and a node of its own, some of them elsewhere by absolute
    names, and tasks that share files.
    """
    folder = tmp_path_factory.mktemp("files")
    files = [folder / "mesh.obj", folder / "texture.exr"]
    for number, file in enumerate(files):
        file.write_bytes(bytes([number]) * 300_000)
    reading = [Nasty(f"reads-{number}", file=file) for number, file in enumerate(files * 5)]
    (folder / "tex").mkdir()
    write_exr(folder / "tex" / "worn.exr", np.random.default_rng(0).random((16, 16), np.float32))
    for tile in ("1001", "1012"):
        (folder / "tex" / f"spare.{tile}.exr").write_bytes(tile.encode())
    write_obj(sphere(), folder / "ball.obj")
    outside = tmp_path_factory.mktemp("outside")
    write_exr(outside / "brushed.exr", np.random.default_rng(1).uniform(0.3, 0.5, (16, 16, 3)))
    (outside / "lib").mkdir()
    for name, text in SOURCE.items():
        (outside / name).write_text(text)
    (folder / "m.mtlx").write_text(MATERIAL.replace("OUTSIDE", str(outside)))
    (folder / "suite.toml").write_text(SUITE)
    return [*IMAGES, *CLOUDS, *reading, *suites.suite(str(folder / "suite.toml"), allow_external=True)]


@pytest.fixture(scope="module")
def expected(tasks, working_backend, tmp_path_factory):
    """What one worker process of this machine makes of the tasks."""
    folder = tmp_path_factory.mktemp("one")
    return run_suite(tasks, folder, working_backend), folder


def is_the_same(report, folder, expected):
    """Every figure and every byte of every file, but for the seconds."""
    one, there = expected
    cases = {case["name"]: {**case, "seconds": None} for case in report["cases"]}
    assert cases == {case["name"]: {**case, "seconds": None} for case in one["cases"]}
    files = {file.relative_to(there) for file in (there / "cases").rglob("*") if file.is_file()}
    assert files == {file.relative_to(folder) for file in (folder / "cases").rglob("*") if file.is_file()}
    for file in files:
        assert (folder / file).read_bytes() == (there / file).read_bytes(), file


def test_two_processes_do_as_one(tasks, expected, working_backend, tmp_path):
    is_the_same(run_suite(tasks, tmp_path, working_backend, 2), tmp_path, expected)


def test_a_dask_cluster_does_as_one_process(tasks, expected, working_backend, tmp_path):
    """Three worker processes of a real cluster; each gets each file's contents once, by their hash."""
    pytest.importorskip("distributed")
    with dask_cluster("local", 3) as cluster:
        report = run_suite(tasks, tmp_path, working_backend, cluster=cluster)
        client = cluster.executor._client
        stores = client.run(contents_of_store)
    is_the_same(report, tmp_path, expected)
    contents = {digest(path.read_bytes()) for task in tasks for path in task.files()}
    assert len(stores) == 3
    assert set(itertools.chain(*stores.values())) == contents
    for names in stores.values():
        assert len(names) == len(set(names)) <= len(contents)


def contents_of_store():
    """On a worker: the digests of what it got, by what it wrote."""
    from mrm_nodes.regression.run.cluster import _store

    return [path.name for path in _store().root.iterdir() if path.is_file()]


@pytest.mark.parametrize("executor", [ProcessPoolExecutor, ThreadPoolExecutor])
def test_any_executor_does_as_one_process(tasks, expected, working_backend, tmp_path, executor):
    with executor(2) as pool:
        report = run_suite(tasks, tmp_path, working_backend, cluster=Cluster(pool))
    is_the_same(report, tmp_path, expected)


def test_contents_that_a_worker_has_are_not_asked_for_again(tmp_path):
    store = ShippedFiles()
    contents = {digest(b"mesh"): b"mesh"}
    digests = {"/studio/a.obj": digest(b"mesh")}
    assert store.missing(digests, {}) == set(contents)
    tree = store.lay_out(digests, contents)
    assert (tree / "studio" / "a.obj").read_bytes() == b"mesh"
    assert store.missing(digests, {}) == set()
    assert store.lay_out(digests, {}) == tree
    other = store.lay_out({"/studio/a.obj": digest(b"new")}, {digest(b"new"): b"new"})
    assert (other / "studio" / "a.obj").read_bytes() == b"new"
    assert (tree / "studio" / "a.obj").read_bytes() == b"mesh"


def test_a_worker_with_another_library_is_an_error_of_its_cases(working_backend, tmp_path, monkeypatch):
    """Its results would not be this run's."""
    from mrm_nodes.regression.run import runner as run

    conditions = run.conditions
    monkeypatch.setattr(run, "conditions", lambda driver: {**conditions(driver), "MaterialX": "1.40.0"})
    with ThreadPoolExecutor(1) as pool:
        report = run_suite(IMAGES[:1], tmp_path, working_backend, cluster=Cluster(pool))
    assert "other versions" in report["cases"][0]["message"]


@pytest.fixture
def travelled(tmp_path, tasks):
    """The material's case as a worker elsewhere has it: its files laid out anew, and not where they came from."""
    case = tasks[-1]
    store = ShippedFiles()
    contents = {digest(path.read_bytes()): path.read_bytes() for path in case.files()}
    tree = store.lay_out({str(path): digest(path.read_bytes()) for path in case.files()}, contents)
    return case, case.moved(tree / case.root.relative_to("/")), store


@pytest.mark.parametrize("name", ["brushed.exr", "worn.exr", "halved.glsl", "half.glsl"])
def test_each_file_is_read_from_what_came_along(working_backend, travelled, expected, tmp_path, name):
    case, there, _store = travelled
    file = next(path for path in case.files() if path.name == name)
    file.rename(file.with_name("away"))
    try:
        worker = Worker(working_backend)
        outcome = worker.run(there, tmp_path)
        assert (outcome.verdict, outcome.message) == ("pass", "")
        render = f"cases/{working_backend}/{case.name}/render.exr"
        assert (tmp_path / render).read_bytes() == (expected[1] / render).read_bytes()
        assert str(file) in worker.run(case, tmp_path / "here").message
    finally:
        file.with_name("away").rename(file)


def test_every_tile_of_a_set_comes_along(travelled):
    _, there, _store = travelled
    for tile in ("1001", "1012"):
        assert (there.root / there.material).with_name("tex").joinpath(
            f"spare.{tile}.exr"
        ).read_text() == tile


@pytest.mark.parametrize(
    "what", ["a document", "an image", "an image by a prefix", "source", "source of source"]
)
def test_what_did_not_come_along_is_named(working_backend, travelled, tmp_path, what):
    """Also where the worker's machine has something under that name."""
    _, there, _store = travelled
    document = there.root / there.material
    document.unlink()
    file = Path(__file__)
    if what == "a document":
        file = tmp_path / "graph.mtlx"
        file.write_text('<materialx version="1.39" />')
        document.write_text(MATERIAL.replace("<image", f'<xi:include href="{file}" /><image', 1))
    elif what == "an image":
        document.write_text(MATERIAL.replace("OUTSIDE/brushed.exr", str(file)))
    elif what == "an image by a prefix":
        text = MATERIAL.replace("OUTSIDE/brushed.exr", file.name)
        document.write_text(text.replace('"1.39"', f'"1.39" fileprefix="{file.parent}/"', 1))
    elif what == "source":
        document.write_text(MATERIAL.replace("OUTSIDE/halved.glsl", str(file)))
    else:
        document.with_name("own.glsl").write_text(f'// #include "{file}"')
        document.write_text(MATERIAL.replace("OUTSIDE/halved.glsl", "own.glsl"))
    outcome = Worker(working_backend).run(there, tmp_path / "report")
    assert outcome.verdict == "error"
    assert f"{file} did not come along to the cluster's worker" in outcome.message


@pytest.mark.parametrize("what", ["the same", "another"])
def test_what_both_machines_have_on_the_search_path_is_the_same_or_an_error(
    working_backend, tmp_path, monkeypatch, what
):
    shared, own = tmp_path / "shared", tmp_path / "own"
    for place in (shared, own):
        place.mkdir()
    write_exr(shared / "worn.exr", np.full((4, 4), 0.3, np.float32))
    monkeypatch.setenv("MATERIALX_SEARCH_PATH", str(shared))
    text = MATERIAL.replace("tex\\worn.exr", "worn.exr").replace("OUTSIDE/halved.glsl", "halved.glsl")
    (own / "halved.glsl").write_text("void halved(float i, out float o) { o = 0.5 * i; }\n")
    (own / "m.mtlx").write_text(text.replace("OUTSIDE/brushed.exr", "worn.exr"))
    (case,) = suites.suite(str(own))
    contents = {digest(path.read_bytes()): path.read_bytes() for path in case.files()}
    store = ShippedFiles()
    tree = store.lay_out({str(path): digest(path.read_bytes()) for path in case.files()}, contents)
    there = replace(case, size=(16, 16)).moved(tree / case.root.relative_to("/"))
    if what == "another":
        write_exr(shared / "worn.exr", np.full((4, 4), 0.4, np.float32))
    outcome = Worker(working_backend).run(there, tmp_path / "report")
    assert outcome.verdict == ("pass" if what == "the same" else "error"), outcome.message
    assert ("did not come along" in outcome.message) == (what == "another")


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense://x"])
def test_a_scheduler_that_does_not_answer_is_one_line(address):
    pytest.importorskip("distributed")
    with (
        pytest.raises(MrmError, match=f"--dask {address}: no scheduler answers there"),
        dask_cluster(address),
    ):
        pass


TLS = """distributed:
  comm:
    tls:
      ca-file: ca.pem
      client:
        cert: certificate.pem
        key: key.pem
"""


@pytest.fixture
def tls(tmp_path):
    """A cluster that lets nobody in without its certificates; its address, and the file that names them."""
    distributed = pytest.importorskip("distributed")
    security = distributed.Security.temporary()
    folder = tmp_path / "tls"
    folder.mkdir()
    for name, key in (("ca", "ca_file"), ("certificate", "client_cert"), ("key", "client_key")):
        (folder / f"{name}.pem").write_text(
            security.get_tls_config_for_role("client")[key.removeprefix("client_")]
        )
    (folder / "dask.yaml").write_text(TLS)
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=None, security=security
    ) as cluster:
        yield cluster.scheduler_address, folder / "dask.yaml"


def test_a_scheduler_with_tls_takes_the_certificates_that_a_file_names_and_nobody_without(
    tls, expected, tasks, working_backend, tmp_path
):
    address, file = tls
    assert address.startswith("tls://")
    with (
        pytest.raises(MrmError, match=r"no scheduler answers there: .*; --dask-security FILE names its"),
        dask_cluster(address),
    ):
        pass
    one, own = expected
    with dask_cluster(address, security=file) as cluster:
        report = run_suite(tasks[-1:], tmp_path / "report", working_backend, cluster=cluster)
    (case,) = report["cases"]
    (here,) = (each for each in one["cases"] if each["name"] == case["name"])
    assert {**case, "seconds": None} == {**here, "seconds": None}
    render = case["files"]["render_data"]
    assert (tmp_path / "report" / render).read_bytes() == (own / render).read_bytes()


@pytest.mark.parametrize(
    "content, complaint",
    [
        (None, "cannot be read: No such file"),
        ("a: [", "cannot be read: while parsing"),
        ("- 1", "names no distributed.comm.tls.ca-file"),
        (TLS.replace("key: key.pem", "key:"), "names no distributed.comm.tls.client.key"),
        (TLS, "ca.pem: no such file"),
    ],
)
def test_certificates_that_are_not_there_are_one_line(tmp_path, content, complaint):
    pytest.importorskip("distributed")
    file = tmp_path / "dask.yaml"
    if content is not None:
        file.write_text(content)
    with pytest.raises(MrmError, match=complaint), dask_cluster("tls://127.0.0.1:9", security=file):
        pass
    with (
        pytest.raises(MrmError, match="is for a scheduler's tls:// address"),
        dask_cluster("tcp://127.0.0.1:9", security=file),
    ):
        pass


def test_an_executor_that_breaks_ends_the_run_with_one_line_and_keeps_what_is_done(working_backend, tmp_path):
    with ProcessPoolExecutor(1) as pool:

        def break_it(outcome, done, total):
            for process in pool._processes.values():
                process.kill()

        with pytest.raises(MrmError, match=r"takes no more tasks.*go on with --resume"):
            run_suite(IMAGES, tmp_path, working_backend, on_outcome=break_it, cluster=Cluster(pool))
    report = run_suite(IMAGES, tmp_path, working_backend, resume=True)
    assert report["environment"]["resumed"] >= 1
    assert not any("worker" in case["message"] for case in report["cases"])
