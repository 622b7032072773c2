"""Tone mapping beside three.js, which wrote Khronos' PBR Neutral by itself: the same picture in a browser."""

from __future__ import annotations

import functools
import http.server
import json
import os
import re
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest

from mrm_nodes.render.tonemap import find_tonemap, srgb_encoded
from mrm_nodes.render.webgl import INSTALL, find_browser

THREE = Path(os.environ.get("MRM_THREE") or Path(__file__).parents[1] / "node_modules" / "three")
WIDTH, HEIGHT = 32, 16
PAGE = """<!doctype html><body><script type="importmap">{"imports": {"three": "./three.module.js"}}</script>
<script type="module">
import * as THREE from "three";
const [width, height, values, exposure] = REQUEST;
const renderer = new THREE.WebGLRenderer({ preserveDrawingBuffer: true });
renderer.setPixelRatio(1);
renderer.setSize(width, height);
renderer.toneMapping = THREE.NeutralToneMapping;
renderer.toneMappingExposure = exposure;
const map = new THREE.DataTexture(new Float32Array(values), width, height, THREE.RGBAFormat, THREE.FloatType);
map.needsUpdate = true;
const scene = new THREE.Scene();
scene.add(new THREE.Mesh(new THREE.PlaneGeometry(2, 2), new THREE.MeshBasicMaterial({ map })));
const camera = new THREE.OrthographicCamera(-1, 1, 1, -1, 0, 2);
camera.position.z = 1;
renderer.render(scene, camera);
const gl = renderer.getContext(), codes = new Uint8Array(4 * width * height);
gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, codes);
const answer = document.createElement("pre");
answer.id = "answer";
answer.textContent = JSON.stringify([THREE.REVISION, Array.from(codes)]);
document.body.append(answer);
</script></body>"""

if find_browser() is None or not (THREE / "build" / "three.module.js").is_file():
    reason = INSTALL if find_browser() is None else "three.js is not there: npm install --no-save three"
    assert "three" not in os.environ.get("MRM_REQUIRE_COMPILERS", "").split(","), reason
    pytest.skip(reason, allow_module_level=True)


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *arguments: object) -> None:
        pass


def test_neutral_is_what_three_js_shows(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    colors = np.exp2(rng.uniform(-7, 8, (HEIGHT, WIDTH, 3))) * rng.choice(
        [0.0, 1.0], (HEIGHT, WIDTH, 3), p=[0.1, 0.9]
    )
    colors = colors.astype(np.float32)
    exposure = 0.7
    rgba = np.concatenate([colors, np.ones((HEIGHT, WIDTH, 1), np.float32)], axis=-1)
    for file in (THREE / "build").glob("three.*.js"):
        (tmp_path / file.name).symlink_to(file.resolve())
    request = json.dumps([WIDTH, HEIGHT, rgba.ravel().tolist(), exposure])
    (tmp_path / "page.html").write_text(PAGE.replace("REQUEST", request))
    server = http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), functools.partial(Quiet, directory=str(tmp_path))
    )
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        command = [
            *(str(find_browser()), "--headless=new", "--no-sandbox", "--disable-gpu-sandbox"),
            *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage"),
            *(f"--user-data-dir={tmp_path}/profile", "--virtual-time-budget=100000", "--dump-dom"),
            f"http://127.0.0.1:{server.server_port}/page.html",
        ]
        finished = subprocess.run(command, capture_output=True, text=True, timeout=120)
    finally:
        server.shutdown()
    found = re.search(r'<pre id="answer">(.*?)</pre>', finished.stdout, re.DOTALL)
    assert found, finished.stderr[-1000:]
    _, codes = json.loads(found[1])
    theirs = np.array(codes).reshape(HEIGHT, WIDTH, 4)[..., :3]
    ours = np.round(srgb_encoded(find_tonemap("neutral")(colors * np.float32(exposure))) * 255)
    assert len(np.unique(theirs)) > 100
    # A browser's driver rounds its powers otherwise.
    assert np.abs(ours - theirs).max() <= 1
