"""What stands in front of the material: the camera and the lights."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError

Vec3 = tuple[float, float, float]

_WHITE: Vec3 = (1.0, 1.0, 1.0)

#: How many radii away an orthographic camera stands. MaterialX's shaders take the view direction from its
#: position: far away, it is nearly the same at every pixel.
ORTHOGRAPHIC_DISTANCE = 1000.0

LIGHT_SYNTAX = (
    "camera[:COLOUR], directional:X,Y,Z[:COLOUR], point:X,Y,Z[:COLOUR] or spot:X,Y,Z:DX,DY,DZ[:COLOUR], "
    "where COLOUR is R,G,B or one number"
)
CAMERA_SYNTAX = "X,Y,Z[:TX,TY,TZ] or frame:DX,DY,DZ, then any of :fov=DEGREES :width=W :up=X,Y,Z"


def vector(value: Sequence[float] | NDArray[Any], what: str) -> Vec3:
    """Return three finite numbers as floats.

    Raises:
        MrmError: not three numbers, or one of them is NaN or infinite.
    """
    try:
        numbers = [float(number) for number in value]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) != 3 or not all(math.isfinite(number) for number in numbers):
        raise MrmError(f"{what}: {_shown(value)} is not three finite numbers")
    return (numbers[0], numbers[1], numbers[2])


def unit_vector(value: Sequence[float] | NDArray[Any], what: str) -> Vec3:
    """Return a direction at unit length.

    Raises:
        MrmError: not three finite numbers, or all are zero.
    """
    x, y, z = vector(value, what)
    length = math.hypot(x, y, z)
    if length == 0.0:
        raise MrmError(f"{what}: a direction cannot be zero")
    return (x / length, y / length, z / length)


def finite(value: float, what: str) -> float:
    """Return a finite number as float.

    Raises:
        MrmError: no number, NaN or infinite.
    """
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise MrmError(f"{what}: {value} is not a finite number")
    return number


def _shown(value: Any) -> str:
    return value if isinstance(value, str) else str(np.asarray(value).tolist())


@dataclass(frozen=True)
class DirectionalLight:
    """MaterialX's `directional_light`: light travels along `direction`.

    Args:
        direction: in world space, of any length but zero.
        color: linear.
        intensity: irradiance on a plane that faces it, times `color`.

    Raises:
        MrmError: a number that is none, or a direction of zero length. The direction is stored normalised,
            because MaterialX's node uses it as given.
    """

    direction: Vec3
    color: Vec3 = _WHITE
    intensity: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "direction", unit_vector(self.direction, "directional light: direction"))
        _check_emission(self, "directional light")

    def data(self, camera: Camera) -> dict[str, Any]:
        """Return MaterialX's `LightData` members, for what this camera sees."""
        return {"type": 1, "direction": self.direction, **_emission(self)}


@dataclass(frozen=True)
class PointLight:
    """MaterialX's `point_light`: irradiance is intensity / (1 + distance)^decay_rate, as its node has it.

    Args:
        position: in scene units.
        color: linear.
        intensity: irradiance at its position, times `color`.
        decay_rate: 0 for none.

    Raises:
        MrmError: a number that is none.
    """

    position: Vec3
    color: Vec3 = _WHITE
    intensity: float = 1.0
    decay_rate: float = 2.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", vector(self.position, "point light: position"))
        object.__setattr__(self, "decay_rate", finite(self.decay_rate, "point light: decay_rate"))
        _check_emission(self, "point light")

    def data(self, camera: Camera) -> dict[str, Any]:
        """Return MaterialX's `LightData` members, for what this camera sees."""
        return {"type": 2, "position": self.position, "decay_rate": self.decay_rate, **_emission(self)}


@dataclass(frozen=True)
class SpotLight:
    """MaterialX's `spot_light`: a point light that fades between an inner and an outer cone.

    `inner_angle` and `outer_angle` are cosines, because MaterialX's shader compares them with one.

    Args:
        position: in scene units.
        direction: along which its axis points, in world space.
        color: linear.
        intensity: irradiance at its position, times `color`.
        decay_rate: as of `PointLight`.

    Raises:
        MrmError: a number that is none, or a direction of zero length. The direction is stored normalised.
    """

    position: Vec3
    direction: Vec3
    color: Vec3 = _WHITE
    intensity: float = 1.0
    decay_rate: float = 2.0
    inner_angle: float = math.cos(math.radians(15.0))
    outer_angle: float = math.cos(math.radians(20.0))

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", vector(self.position, "spot light: position"))
        object.__setattr__(self, "direction", unit_vector(self.direction, "spot light: direction"))
        for name in ("decay_rate", "inner_angle", "outer_angle"):
            object.__setattr__(self, name, finite(getattr(self, name), f"spot light: {name}"))
        _check_emission(self, "spot light")

    def data(self, camera: Camera) -> dict[str, Any]:
        """Return MaterialX's `LightData` members, for what this camera sees."""
        angles = {"inner_angle": self.inner_angle, "outer_angle": self.outer_angle}
        point = {"type": 3, "position": self.position, "direction": self.direction}
        return point | {"decay_rate": self.decay_rate} | angles | _emission(self)


@dataclass(frozen=True)
class CameraLight:
    """A point light without decay at the camera's position: light and view direction agree at every pixel.

    Args:
        color: linear.
        intensity: irradiance on a plane that faces it, times `color`.

    Raises:
        MrmError: a number that is none.
    """

    color: Vec3 = _WHITE
    intensity: float = 1.0

    def __post_init__(self) -> None:
        _check_emission(self, "camera light")

    def data(self, camera: Camera) -> dict[str, Any]:
        """Return MaterialX's `LightData` members, for what this camera sees."""
        return {"type": 2, "position": camera.position, "decay_rate": 0.0, **_emission(self)}


Light = DirectionalLight | PointLight | SpotLight | CameraLight


def _check_emission(light: Light, what: str) -> None:
    object.__setattr__(light, "color", vector(light.color, f"{what}: color"))
    object.__setattr__(light, "intensity", finite(light.intensity, f"{what}: intensity"))


def _emission(light: Light) -> dict[str, Any]:
    return {"color": light.color, "intensity": light.intensity}


def parse_light(text: str) -> Light:
    """Read a light from text as the command line writes it: see `LIGHT_SYNTAX`; colours are linear.

    A colour is three numbers, or one: `camera:2` is twice as bright as `camera`.
    Point and spot lights of this syntax do not decay, so that a scene's scale does not change its exposure.

    Raises:
        MrmError: unknown kind, or a part that is not three finite numbers.
    """
    kind, *parts = text.strip().split(":")
    makers: dict[str, tuple[int, Callable[..., Light]]] = {
        "camera": (0, lambda color: CameraLight(color)),
        "directional": (1, lambda direction, color: DirectionalLight(direction, color)),
        "point": (1, lambda position, color: PointLight(position, color, decay_rate=0.0)),
        "spot": (2, lambda position, axis, color: SpotLight(position, axis, color, decay_rate=0.0)),
    }
    if kind not in makers:
        close = difflib.get_close_matches(kind[:100], makers, n=1)
        hint = f"did you mean {close[0]}?" if close else f"write {LIGHT_SYNTAX}"
        raise MrmError(f"unknown light {kind or repr(text)}; {hint}")
    needed, make = makers[kind]
    if not needed <= len(parts) <= needed + 1:
        raise MrmError(f"light {text}: {len(parts)} parts after {kind}; write {LIGHT_SYNTAX}")
    vectors = [_parse_vector(part, f"light {text}") for part in parts[:needed]]
    return make(*vectors, _parse_colour(parts[needed], f"light {text}") if parts[needed:] else _WHITE)


def _parse_colour(text: str, what: str) -> Vec3:
    """Three numbers, or one that is all three."""
    return _parse_vector(text if "," in text else ",".join([text] * 3), what)


def _parse_vector(text: str, what: str) -> Vec3:
    return vector([_parse_number(part, what) for part in text.split(",")], what)


def _parse_number(text: str, what: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise MrmError(f"{what}: {text!r} is not a number") from None


@dataclass(frozen=True)
class Camera:
    """A camera at `position` that looks at `target`, in the scene's units.

    Args:
        position: in scene units.
        target: in scene units.
        up: a direction that is upwards in the picture.
        fov: vertical field of view in degrees.
        width: width of the picture in scene units; makes the camera orthographic, and `fov` is not used.
            MaterialX's shaders take the view direction from `position` in both cases.
        near: the nearest distance that is drawn, in scene units; by default it follows the mesh.
        far: the farthest, in scene units.

    Raises:
        MrmError: a number that is none or out of range, or position, target and up in one line.
    """

    position: Vec3 = (0.0, 0.0, 3.0)
    target: Vec3 = (0.0, 0.0, 0.0)
    up: Vec3 = (0.0, 1.0, 0.0)
    fov: float = 45.0
    width: float | None = None
    near: float | None = None
    far: float | None = None

    def __post_init__(self) -> None:
        for name in ("position", "target"):
            object.__setattr__(self, name, vector(getattr(self, name), f"camera: {name}"))
        object.__setattr__(self, "up", unit_vector(self.up, "camera: up"))
        if not 0.0 < finite(self.fov, "camera: fov") < 180.0:
            raise MrmError(f"camera: fov {self.fov:g} is not between 0 and 180 degrees")
        if self.width is not None and not finite(self.width, "camera: width") > 0.0:
            raise MrmError(f"camera: width {self.width:g} is not positive")
        for name in ("near", "far"):
            distance = getattr(self, name)
            if distance is not None and not finite(distance, f"camera: {name}") > 0.0:
                raise MrmError(f"camera: {name} {distance:g} is not positive")
        if self.near is not None and self.far is not None and self.near >= self.far:
            raise MrmError(f"camera: near {self.near:g} is not below far {self.far:g}")
        unit_vector(np.subtract(self.target, self.position), "camera: from position to target")
        unit_vector(np.cross(self._axis, self.up), "camera: up must not point along the view")

    @property
    def _axis(self) -> NDArray[np.float64]:
        offset = np.subtract(self.target, self.position)
        return np.asarray(offset / np.linalg.norm(offset))

    def view_matrix(self) -> NDArray[np.float64]:
        """Return the 4 × 4 matrix from world to camera space (it looks along -z), for column vectors."""
        right = np.cross(self._axis, self.up)
        right /= np.linalg.norm(right)
        matrix = np.eye(4)
        matrix[:3, :3] = right, np.cross(right, self._axis), -self._axis
        matrix[:3, 3] = -matrix[:3, :3] @ self.position
        return matrix

    def projection_matrix(self, aspect: float, near: float, far: float) -> NDArray[np.float64]:
        """Return OpenGL's 4 × 4 projection for column vectors.

        Args:
            aspect: width of the picture over its height.
            near: clipping distance in scene units.
            far: likewise, the farther one in scene units.
        """
        matrix = np.zeros((4, 4))
        if self.width is not None:
            matrix[0, 0], matrix[1, 1] = 2.0 / self.width, 2.0 * aspect / self.width
            matrix[2, 2], matrix[2, 3] = -2.0 / (far - near), -(far + near) / (far - near)
            matrix[3, 3] = 1.0
        else:
            focal = 1.0 / math.tan(math.radians(self.fov) / 2.0)
            matrix[0, 0], matrix[1, 1] = focal / aspect, focal
            matrix[2, 2], matrix[2, 3] = -(far + near) / (far - near), -2.0 * far * near / (far - near)
            matrix[3, 2] = -1.0
        return matrix

    def clip_distances(self, center: Vec3, radius: float) -> tuple[float, float]:
        """Return near and far: as given, else just around a bounding sphere, of center and radius in scene units."""
        depth = float(np.dot(np.subtract(center, self.position), self._axis))
        far = self.far if self.far is not None else max(depth + 1.01 * radius, 1e-3 * radius)
        near = self.near if self.near is not None else max(depth - 1.01 * radius, 1e-3 * far)
        return (near, far) if near < far else (near, 2.0 * near)


@dataclass(frozen=True)
class Framing:
    """A camera still to be placed: it stands in `direction` and has the whole mesh in the picture.

    Args:
        direction: from the mesh to the camera, in world space.
        up: a direction that is upwards in the picture.
        fov: vertical field of view in degrees.
        orthographic: parallel rays; see ORTHOGRAPHIC_DISTANCE.

    Raises:
        MrmError: a number that is none or out of range, or a direction of zero length.
    """

    direction: Vec3 = (0.0, 0.0, 1.0)
    up: Vec3 = (0.0, 1.0, 0.0)
    fov: float = 45.0
    orthographic: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "direction", unit_vector(self.direction, "camera: direction"))
        up = unit_vector(self.up, "camera: up")
        # Seen from straight above or below, -z is at the top of the picture; else along z, it is y.
        if np.linalg.norm(np.cross(self.direction, up)) < 1e-6:
            up = (0.0, 0.0, -1.0) if abs(self.direction[2]) < 0.5 else (0.0, 1.0, 0.0)
        object.__setattr__(self, "up", up)
        if not 0.0 < finite(self.fov, "camera: fov") < 180.0:
            raise MrmError(f"camera: fov {self.fov:g} is not between 0 and 180 degrees")

    def camera(
        self, center: Vec3, radius: float, aspect: float, points: NDArray[Any] | None = None
    ) -> Camera:
        """Return the camera that looks at `center` and just has everything in the picture.

        Args:
            center: what it looks at, in scene units.
            radius: of the bounding sphere that is framed where there are no `points`, in scene units.
            aspect: width of the picture over its height.
            points: (n, 3), what is to be seen: framed more tightly than their bounding sphere.
        """
        margin = 1.03
        half_height = math.tan(math.radians(self.fov) / 2.0)
        half_width = half_height * aspect
        right = np.cross(self.up, self.direction)
        right /= np.linalg.norm(right)
        frame = np.stack([right, np.cross(self.direction, right), self.direction])
        if points is None:
            distance = radius / math.sin(math.atan(min(half_height, half_width)))
            reach_x = reach_y = radius
        else:
            x, y, z = frame @ np.subtract(points, center).T
            x, y = np.abs(x), np.abs(y)
            distance = float(np.max(z + np.maximum(x / half_width, y / half_height)))
            reach_x, reach_y = float(x.max()), float(y.max())
        if self.orthographic:
            width = 2.0 * margin * max(reach_x, reach_y * aspect)
            position = np.add(center, ORTHOGRAPHIC_DISTANCE * radius * frame[2])
            return Camera(vector(position, "camera: position"), center, self.up, self.fov, width)
        position = np.add(center, margin * distance * frame[2])
        return Camera(vector(position, "camera: position"), center, self.up, self.fov)


def parse_camera(text: str) -> Camera | Framing:
    """Read a camera from text as the command line writes it: see `CAMERA_SYNTAX`.

    `X,Y,Z` is the position and `TX,TY,TZ` the point looked at, by default the origin; `frame:DX,DY,DZ` stands
    in that direction and shows the whole mesh. `width` makes the camera orthographic.

    Raises:
        MrmError: anything else.
    """
    what = f"camera {text}"
    places: list[str] = []
    options: dict[str, Any] = {}
    for part in text.strip().split(":"):
        name, equals, value = part.partition("=")
        if not equals:
            places.append(part)
        elif name in ("fov", "width"):
            options[name] = _parse_number(value, what)
        elif name == "up":
            options[name] = _parse_vector(value, what)
        else:
            raise MrmError(f"{what}: unknown option {name}; write {CAMERA_SYNTAX}")
    if places and places[0] == "frame" and len(places) <= 2 and "width" not in options:
        direction = _parse_vector(places[1], what) if len(places) == 2 else (0.0, 0.0, 1.0)
        return Framing(unit_vector(direction, what), **options)
    if not 1 <= len(places) <= 2 or places[0] == "frame":
        raise MrmError(f"{what}: write {CAMERA_SYNTAX}")
    if len(places) == 2:
        options["target"] = _parse_vector(places[1], what)
    return Camera(_parse_vector(places[0], what), **options)
