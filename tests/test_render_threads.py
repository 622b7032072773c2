"""Renders from threads, in forked processes and in processes that end: each image right, and nothing hangs.

Each test is a process of its own with a time limit, so that a hang is a failure.
"""

import ctypes
import gc
import os
import re
import subprocess
import sys
import textwrap
import threading

import pytest
from click.testing import CliRunner

from mrm_nodes.cli import cli
from mrm_nodes.errors import MrmError
from mrm_nodes.render import BACKENDS, CameraLight, Renderer, plane, shared_renderer
from mrm_nodes.shadergen import generate_shader, read_document

REQUIRED = [name for name in os.environ.get("MRM_REQUIRE_BACKENDS", "").split(",") if name]

#: Two materials, one with an image; `draw(i)` is the i-th of six draws, of which no two are alike.
PRELUDE = '''
import atexit, concurrent.futures as cf, multiprocessing as mp, os, sys, threading, time
import numpy as np
import mrm_nodes
from mrm_nodes.errors import MrmError
from mrm_nodes.render import Renderer, plane, sphere, write_png
from mrm_nodes.render.environment import find_environment
from mrm_nodes.shadergen import generate_shader

FOLDER, BACKEND = sys.argv[1:]
TEXTURED, PLAIN = FOLDER + "/textured.mtlx", FOLDER + "/plain.mtlx"

def write():
    write_png(FOLDER + "/a.png", np.random.default_rng(1).uniform(0.5, 1.0, (16, 16, 3)))
    for file, color in ((TEXTURED, 'nodename="i"'), (PLAIN, 'value="0.8, 0.4, 0.2"')):
        with open(file, "w") as text:
            text.write(f"""<?xml version="1.0"?><materialx version="1.39">
              <image name="i" type="color3"><input name="file" type="filename" value="a.png"/></image>
              <oren_nayar_diffuse_bsdf name="b" type="BSDF"><input name="color" type="color3" {color}/>
              </oren_nayar_diffuse_bsdf>
              <surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="b"/></surface>
              <surfacematerial name="m" type="material">
                <input name="surfaceshader" type="surfaceshader" nodename="s"/></surfacematerial>
            </materialx>""")

def draw(i, backend=BACKEND):
    file, lights = (TEXTURED, PLAIN)[i % 2], (["camera"], ["directional:-1,-2,-3", "camera"], [])[i % 3]
    around = "white" if not lights else None
    image = mrm_nodes.render(file, ("sphere", "plane")[i % 2], None, lights, (24 + i, 20), backend, None, around).image
    assert image.max() > 0.05
    return image.tobytes()

def complaint(work, *arguments):
    try:
        work(*arguments)
    except MrmError as error:
        return str(error)
    return "no complaint"
'''


@pytest.fixture(params=BACKENDS)
def backend(request):
    try:
        Renderer(request.param)
    except MrmError as error:
        if request.param in REQUIRED:
            raise
        pytest.skip(str(error))
    return request.param


@pytest.fixture
def python(backend, tmp_path):
    """Runs a program after PRELUDE; it must end by itself, in time and with status 0."""

    def run(code, seconds=200, **environment):
        program = tmp_path / "program.py"
        program.write_text(PRELUDE + textwrap.dedent(code))
        done = subprocess.run(
            [sys.executable, program, tmp_path, backend],
            env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)} | environment,
            capture_output=True,
            text=True,
            timeout=seconds,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.split("\n")[:-1]

    return run


def test_each_image_from_a_pool_of_threads_is_the_one_that_it_is_alone(python):
    assert python("""
        write()
        with cf.ThreadPoolExecutor(4) as pool:  # the first use of OpenGL too is by four at once
            found = list(pool.map(draw, [i % 6 for i in range(30)]))
        alone = [draw(i) for i in range(6)]
        print(len(set(alone)), [i for i, image in enumerate(found) if image != alone[i % 6]])
    """) == ["6 []"]


def test_renderers_of_both_backends_draw_in_threads_that_come_and_go(python):
    assert python("""
        write()
        shader = generate_shader(TEXTURED)
        others = [name for name in ("egl", "osmesa") if complaint(Renderer, name) == "no complaint"]
        def picture(backend):
            with Renderer(backend) as renderer:
                return renderer.render(shader, plane(), size=(16, 16), environment=AROUND).image.tobytes()
        AROUND = find_environment("sky", samples=4)
        alone = {name: picture(name) for name in others}
        wrong = []
        def work(name):
            for _ in range(3):
                wrong.extend([name] * (picture(name) != alone[name]))
        threads = [threading.Thread(target=work, args=(name,)) for name in others * 3]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        print(wrong)
    """) == ["[]"]


def test_a_forked_child_says_to_use_spawn_and_its_parent_goes_on(python):
    told = python("""
        if __name__ == "__main__":
            write()
            alone = draw(0)
            renderer = Renderer(BACKEND)
            shader = generate_shader(PLAIN)
            with mp.get_context("fork").Pool(2) as pool:
                told = pool.starmap_async(complaint, [(draw, 0), (Renderer, BACKEND)]).get(60)
            child = os.fork()
            if not child:
                told = complaint(renderer.render, shader, plane())
                os._exit("spawn" not in told)
            print(os.waitpid(child, 0)[1])
            print(*told, sep="\\n")
            print(draw(0) == alone)
            with mp.get_context("spawn").Pool(1) as pool:
                print(pool.map_async(draw, [0]).get(120) == [alone])
    """)
    assert told[0] == "0" and told[-2:] == ["True", "True"]
    assert len(told) == 5  # each complaint is one line
    for line in told[1:3]:
        assert "fork" in line and 'multiprocessing.get_context("spawn")' in line


def test_a_child_that_is_forked_before_the_first_render_draws(python):
    assert python("""
        write()
        generate_shader(TEXTURED)
        with mp.get_context("fork").Pool(1) as pool:
            found = pool.map_async(draw, [0]).get(120)
        print(found == [draw(0)])
    """) == ["True"]


def test_a_process_ends_while_a_thread_renders(python):
    assert python("""
        write()
        # Registered before OpenGL's own: it runs after that.
        atexit.register(lambda: print(complaint(draw, 0)))
        draw(0)
        def for_ever():
            while True:
                complaint(draw, 1)
        threading.Thread(target=for_ever, daemon=True).start()
        time.sleep(0.5)
        print("ends", flush=True)
    """) == ["ends", "this process is ending: it renders nothing more"]


def test_a_draw_that_never_ends_is_told_and_the_process_ends(python):
    told = python(
        """
        import dataclasses
        write()
        shader, renderer = generate_shader(PLAIN), Renderer(BACKEND)
        # Mesa's software driver ends a loop after 65535 turns: that is for ever where there are pixels enough.
        endless = "float mrm_x = 0.0; for (int i = 0; i != -1; i += 2) mrm_x = sin(mrm_x + gl_FragCoord.x);"
        place = shader.pixel.rindex("}")
        text = shader.pixel[:place] + endless + " if (mrm_x == 7.0) discard; }"
        spoilt = dataclasses.replace(shader, pixel=text)
        for which in (spoilt, shader):
            print(complaint(renderer.render, which, plane(), None, (), (1024, 1024)), flush=True)
        """,
        seconds=60,
        MRM_DRAW_SECONDS="2",
    )
    assert len(told) == 2
    for line in told:
        assert "the driver has not finished a draw within 2 s: a loop in the shader may never end" in line


def test_the_bench_tells_four_threads_from_one(backend):
    arguments = ["bench", "threads", "--backend", backend, "--size", "8", "--count", "4", "--rounds", "1"]
    done = CliRunner().invoke(cli, arguments)
    assert done.exit_code == 0, done.output
    assert re.search(r"^four threads take \d+\.\d\d of the time of one$", done.output, re.MULTILINE)


LAMBERT = """<?xml version="1.0"?><materialx version="1.39">
  <oren_nayar_diffuse_bsdf name="b" type="BSDF"/>
  <surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="b"/></surface>
  <surfacematerial name="m" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="s"/>
  </surfacematerial>
</materialx>"""


@pytest.fixture
def shader(tmp_path):
    (tmp_path / "m.mtlx").write_text(LAMBERT)
    return generate_shader(read_document(tmp_path / "m.mtlx"))


def still_there(gl, textures):
    """How many of these numbers OpenGL knows as textures."""
    is_texture = ctypes.CFUNCTYPE(ctypes.c_ubyte, ctypes.c_uint)(gl.load("glIsTexture"))
    return gl.run(lambda: sum(is_texture(number) for number in textures))


def textures_of(renderer):
    kept = renderer._kept
    return [kept.black.glo, *(texture.glo for target in kept.targets for texture in target.colors)]


def test_a_renderer_that_is_closed_gives_its_memory_back(backend, shader):
    renderer = Renderer(backend)
    gl = renderer._gl
    with renderer:
        assert renderer.render(shader, plane(), lights=[CameraLight()], size=(8, 8)).image.max() > 0.05
        numbers = textures_of(renderer)
        assert len(numbers) == still_there(gl, numbers) == 5
    assert renderer.closed and still_there(gl, numbers) == 0
    renderer.close()
    with pytest.raises(MrmError, match="this renderer was closed"):
        renderer.render(shader, plane(), size=(8, 8))
    assert Renderer(backend).render(shader, plane(), lights=[CameraLight()], size=(8, 8)).image.max() > 0.05


def test_a_renderer_that_is_collected_on_any_thread_gives_its_memory_back(backend, shader):
    renderer = Renderer(backend)
    gl = renderer._gl
    renderer.render(shader, plane(), size=(8, 8))
    numbers = textures_of(renderer)
    renderer.itself = renderer  # so that only the collector finds it
    del renderer
    collector = threading.Thread(target=gc.collect)
    collector.start()
    collector.join()
    assert still_there(gl, numbers) == 0


def test_the_shared_renderer_is_made_anew_where_somebody_closed_it(backend, shader):
    shared_renderer(backend).close()
    renderer = shared_renderer(backend)
    assert renderer is shared_renderer(backend) and not renderer.closed
    assert renderer.render(shader, plane(), lights=[CameraLight()], size=(8, 8)).image.max() > 0.05
