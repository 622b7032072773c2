"""ESSL shaders run where they are meant to run: in a browser, without a window, by WebGL 2."""

from __future__ import annotations

import base64
import json
import math
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError
from mrm_nodes.render.points import Floats, stream, uniform_values
from mrm_nodes.render.scene import Light
from mrm_nodes.shadergen import Shader

INSTALL = "install a browser (Debian, Ubuntu: apt-get install chromium)"

_NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
_TIMEOUT_SECONDS = 300
_RESULTS = ("image", "position", "normal", "tangent")

_VERTEX_MAIN = """
uniform ivec2 mrm_grid;
void main()
{
    mrm_materialx_main();
    vec2 pixel = vec2(float(gl_VertexID % mrm_grid.x), float(gl_VertexID / mrm_grid.x));
    gl_Position = vec4((pixel + 0.5) / vec2(mrm_grid) * 2.0 - 1.0, 0.0, 1.0);
    gl_PointSize = 1.0;
}
"""

_PIXEL_MAIN = """
layout(location = 1) out vec4 mrm_position;
layout(location = 2) out vec4 mrm_normal;
layout(location = 3) out vec4 mrm_tangent;
void main()
{
    mrm_materialx_main();
    mrm_position = vec4(positionWorld, 1.0);
    mrm_normal = vec4(normalWorld, 1.0);
    mrm_tangent = vec4(tangentWorld, 1.0);
}
"""


def find_browser() -> str | None:
    """Return the command of a browser that can run without a window: that of `MRM_BROWSER`, or one known."""
    names = [os.environ["MRM_BROWSER"]] if os.environ.get("MRM_BROWSER") else list(_NAMES)
    return next((path for path in map(shutil.which, names) if path), None)


class WebGLRenderer:
    """Shades points in a headless browser, as `Renderer.draw_points` does on OpenGL; each call starts one.

    Raises:
        MrmError: no browser.
    """

    backend = "webgl"

    def __init__(self) -> None:
        found = find_browser()
        if found is None:
            raise MrmError(f"no browser for WebGL; {INSTALL}")
        self._browser = found
        self.device = ""
        """WebGL's name for what drew, once something was drawn."""

    def draw_points(
        self,
        shader: Shader,
        attributes: Mapping[str, NDArray[Any]],
        camera_position: Sequence[float],
        lights: Sequence[Light] = (),
        uniforms: Mapping[str, Any] | None = None,
    ) -> dict[str, Floats]:
        """Shade n points, each with its own vertex data; arguments and result as those of `Renderer.draw_points`.

        Raises:
            MrmError: no ESSL, vertex data is missing, or the browser refuses the shader.
        """
        if shader.target != "essl":
            raise MrmError(f"{shader.name}: WebGL runs essl, not {shader.target}")
        vertex, pixel = _stages(shader)
        streams = _streams(vertex, attributes)
        count = len(streams["i_position"])
        width = math.isqrt(count - 1) + 1
        page = _page(
            {
                "vertex": vertex,
                "pixel": pixel,
                "size": [width, -(-count // width)],
                "count": count,
                "attributes": {
                    name: {"width": data.shape[1], "data": base64.b64encode(data.tobytes()).decode()}
                    for name, data in streams.items()
                },
                "uniforms": {
                    name: np.ravel(value).tolist()
                    for name, value in uniform_values(shader, uniforms, camera_position, lights).items()
                },
            }
        )
        answer = self._open(page)
        if "error" in answer:
            raise MrmError(f"{shader.name}: WebGL: {' '.join(str(answer['error']).split())}")
        self.device = str(answer["device"])
        results = {}
        for name in _RESULTS:
            data = np.frombuffer(base64.b64decode(answer[name]), np.float32)
            results[name] = data.reshape(-1, 4)[:count, :3].copy()
        return results

    def _open(self, page: str) -> dict[str, Any]:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "page.html"
            file.write_text(page, encoding="utf-8")
            command = [
                *(self._browser, "--headless=new", "--no-sandbox", "--disable-gpu-sandbox"),
                *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage"),
                *(f"--user-data-dir={folder}/profile", "--virtual-time-budget=100000", "--dump-dom"),
                file.as_uri(),
            ]
            finished = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT_SECONDS)
        found = re.search(r'<pre id="answer">(.*?)</pre>', finished.stdout, re.DOTALL)
        if found is None or not found[1]:
            reason = (finished.stderr.strip().splitlines() or ["no answer"])[-1]
            raise MrmError(f"{self._browser}: the page gave no answer: {reason}")
        answer: dict[str, Any] = json.loads(found[1])
        return answer


def _page(request: Mapping[str, Any]) -> str:
    template = (resources.files("mrm_nodes.render") / "webgl.html").read_text(encoding="utf-8")
    return template.replace("REQUEST", json.dumps(request).replace("<", "\\u003c"))


def _stages(shader: Shader) -> tuple[str, str]:
    """Return both stages, which put point i at pixel i and also write the geometry.

    MaterialX's own `main` is kept under another name. Its ESSL gives a `geompropvalue` the same name as
    attribute and as output: the attribute gets another one.
    """
    vertex = re.sub(
        r"^in (\w+) i_geomprop_(\w+);", r"in \1 a_geomprop_\2;", shader.vertex, flags=re.MULTILINE
    )
    vertex = re.sub(r"i_geomprop_(\w+) = i_geomprop_\1;", r"i_geomprop_\1 = a_geomprop_\1;", vertex)
    for name in ("positionWorld", "normalWorld", "tangentWorld"):
        if not re.search(rf"^out vec3 {name};", vertex, re.MULTILINE):
            raise MrmError(f"{shader.name}: the shader does not use {name}")
    vertex = re.sub(r"^void main\(\)", "void mrm_materialx_main()", vertex, flags=re.MULTILINE)
    pixel = re.sub(r"^void main\(\)", "void mrm_materialx_main()", shader.pixel, flags=re.MULTILINE)
    pixel = re.sub(r"^out vec4 (\w+);", r"layout(location = 0) out vec4 \1;", pixel, flags=re.MULTILINE)
    return vertex + _VERTEX_MAIN, pixel + _PIXEL_MAIN


def _streams(vertex: str, attributes: Mapping[str, NDArray[Any]]) -> dict[str, Floats]:
    names = re.findall(r"^in \w+ (\w+);", vertex, re.MULTILINE)
    return {name: stream(attributes, re.sub(r"^(?:i|a_geomprop)_", "", name)) for name in names}
