"""What every target that shades points needs: vertex data by name, and the values of MaterialX's own uniforms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError
from mrm_nodes.render.gbuffer import ALPHA_THRESHOLD
from mrm_nodes.render.renderer import samples_in_the_dark
from mrm_nodes.render.scene import Camera, Light, vector
from mrm_nodes.render.uniforms import uniforms_of
from mrm_nodes.shadergen import Shader

Floats = NDArray[np.float32]

#: MaterialX's names for matrices that leave points where they are.
_IDENTITIES = ("u_worldMatrix", "u_viewProjectionMatrix", "u_worldInverseTransposeMatrix", "u_envMatrix")


def stream(attributes: Mapping[str, NDArray[Any]], name: str) -> Floats:
    """Return vertex data as `(n, channels)`.

    Raises:
        MrmError: there is none of this name.
    """
    if name not in attributes:
        raise MrmError(f"draw_points: the shader needs the attribute {name}")
    data = np.ascontiguousarray(attributes[name], np.float32)
    return data.reshape(len(data), -1)


def uniform_values(
    shader: Shader,
    uniforms: Mapping[str, Any] | None,
    camera_position: Sequence[float],
    lights: Sequence[Light],
) -> dict[str, Any]:
    """Return the material's values and MaterialX's own, by the names that the shader has; images are left out.

    Raises:
        MrmError: a camera position that is none, or a uniform that the shader does not have.
    """
    position = vector(camera_position, "draw_points: camera_position")
    camera = Camera(position, (position[0], position[1], position[2] - 1.0))
    values: dict[str, Any] = {
        uniform.name: uniform.value
        for uniform in uniforms_of(shader, uniforms).values()
        if isinstance(uniform.value, list)
    }
    values |= dict.fromkeys(_IDENTITIES, np.eye(4).ravel().tolist())
    values |= {"u_viewPosition": position, "u_envLightIntensity": 1.0}
    if ALPHA_THRESHOLD in values:
        values[ALPHA_THRESHOLD] = 0.0  # every point is drawn
    values["u_envRadianceSamples"] = samples_in_the_dark(shader)
    values["u_numActiveLightSources"] = len(lights)
    for index, light in enumerate(lights):
        values |= {f"u_lightData[{index}].{name}": value for name, value in light.data(camera).items()}
    return values
