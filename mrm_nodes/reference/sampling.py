"""Exact sampling of normals: all of them, and those visible from a direction."""

import math

from .compiled import formula
from .microsurface import (
    BECKMANN,
    BECKMANN_RATIONAL,
    GGX,
    PHONG,
    SQRT_PI,
    beckmann_projected_area,
    stretched_azimuth,
)


@formula
def inverse_error_function(y: float) -> float:
    """erf⁻¹ to full precision: Giles 2010's polynomial, then Newton steps in the tail-safe complement."""
    magnitude = min(abs(y), 1.0 - 1.2e-16)
    w = -math.log((1.0 - magnitude) * (1.0 + magnitude))
    if w < 5.0:
        t = w - 2.5
        p = 2.81022636e-08
        p = 3.43273939e-07 + p * t
        p = -3.5233877e-06 + p * t
        p = -4.39150654e-06 + p * t
        p = 0.00021858087 + p * t
        p = -0.00125372503 + p * t
        p = -0.00417768164 + p * t
        p = 0.246640727 + p * t
        p = 1.50140941 + p * t
    else:
        t = math.sqrt(w) - 3.0
        p = -0.000200214257
        p = 0.000100950558 + p * t
        p = 0.00134934322 + p * t
        p = -0.00367342844 + p * t
        p = 0.00573950773 + p * t
        p = -0.0076224613 + p * t
        p = 0.00943887047 + p * t
        p = 1.00167406 + p * t
        p = 2.83297682 + p * t
    x = p * magnitude
    for _ in range(2):
        x += 0.5 * SQRT_PI * (math.erfc(x) - (1.0 - magnitude)) * math.exp(x * x)
    return x if y >= 0.0 else -x


@formula
def sample_visible_ggx(x: float, y: float, z: float, u0: float, u1: float) -> tuple[float, float, float]:
    """A visible normal of the standard GGX, unnormalised: a spherical cap (Dupuy and Benyoub 2023)."""
    length = math.sqrt(x * x + y * y + z * z)
    x, y, z = x / length, y / length, z / length
    # At exactly 1 and normal incidence the normal would have no length.
    cz = (1.0 - min(u1, 1.0 - 2.0**-53)) * (1.0 + z) - z
    sine = math.sqrt(min(max((1.0 - cz) * (1.0 + cz), 0.0), 1.0))
    phi = 2.0 * math.pi * u0
    return sine * math.cos(phi) + x, sine * math.sin(phi) + y, max(cz + z, 0.0)


@formula
def sample_visible_beckmann(x: float, y: float, z: float, u0: float, u1: float) -> tuple[float, float, float]:
    """A visible normal of the standard Beckmann, unnormalised (Heitz and d'Eon 2014).

    The slope along the direction is found by inverting its distribution, (z erfc(-s) + sine e^(-s²)/sqrt π)
    / 2 up to normalisation, with Newton's method kept inside a bracket; the slope across is Gaussian."""
    sine = math.sqrt(x * x + y * y)
    across = inverse_error_function(2.0 * u1 - 1.0)
    if sine <= 1e-12 * z:
        along = inverse_error_function(2.0 * u0 - 1.0)
    else:
        target = u0 * beckmann_projected_area(z, sine)
        low = -9.0
        high = min(z / sine, 9.0)
        along = min(inverse_error_function(2.0 * u0 - 1.0), high)
        for _ in range(60):
            density = max(z - sine * along, 0.0) * math.exp(-along * along) / SQRT_PI
            value = 0.5 * z * math.erfc(-along) + sine / (2.0 * SQRT_PI) * math.exp(-along * along) - target
            if value > 0.0:
                high = along
            else:
                low = along
            step = along - value / density if density > 0.0 else low
            if not (low < step < high):
                step = 0.5 * (low + high)
            if abs(step - along) <= 4e-15 * max(1.0, abs(along)):
                along = step
                break
            along = step
    # Back to the azimuth of the direction.
    cos_phi = x / sine if sine > 0.0 else 1.0
    sin_phi = y / sine if sine > 0.0 else 0.0
    return -(cos_phi * along - sin_phi * across), -(sin_phi * along + cos_phi * across), 1.0


@formula
def sample_normal(
    distribution: int, ax: float, ay: float, correlation: float, u0: float, u1: float
) -> tuple[float, float, float]:
    """A normal with density D(m) n.m, unnormalised."""
    phi = 2.0 * math.pi * u0
    # At u1 = 1 the slope would be infinite.
    u1 = min(u1, 1.0 - 2.0**-53)
    if distribution == PHONG:
        # Ashikhmin and Shirley: the azimuth by stretching a circle, then cos^(e + 2) uniform.
        cx = ax * math.cos(phi)
        cy = ay * math.sin(phi)
        scale = math.sqrt(cx * cx + cy * cy)
        cx /= scale
        cy /= scale
        power = 2.0 * (cx * cx / (ax * ax) + cy * cy / (ay * ay))
        # tan² θ = u^(-2/power) - 1, without cancelling when the lobe is narrow.
        tangent = math.sqrt(math.expm1(-2.0 / power * math.log(1.0 - u1)))
        return cx * tangent, cy * tangent, 1.0
    if distribution == GGX:
        radius = math.sqrt(u1 / (1.0 - u1))
    elif distribution in (BECKMANN, BECKMANN_RATIONAL):
        radius = math.sqrt(-math.log1p(-u1))
    else:
        raise NotImplementedError("normals drawn from this distribution")
    return *stretch(radius * math.cos(phi), radius * math.sin(phi), ax, ay, correlation), 1.0


@formula
def stretch(x: float, y: float, ax: float, ay: float, correlation: float) -> tuple[float, float]:
    """L s: a standard slope (or normal's x and y) to the stretched one (eq. 88)."""
    return ax * x, ay * (correlation * x + math.sqrt(1.0 - correlation * correlation) * y)


@formula
def sample_visible_smith(
    distribution: int,
    vx: float,
    vy: float,
    vz: float,
    ax: float,
    ay: float,
    correlation: float,
    mean_x: float,
    mean_y: float,
    u0: float,
    u1: float,
) -> tuple[float, float, float]:
    """A normal visible from v (eq. 16) where masking does not depend on the normal, of unit length."""
    # The direction in the standard configuration, with the shear by the mean slope (Section 5.5).
    x, y = stretched_azimuth(vx, vy, ax, ay, correlation)
    z = vz - mean_x * vx - mean_y * vy
    if distribution == GGX:
        sx, sy, sz = sample_visible_ggx(x, y, z, u0, u1)
    elif distribution in (BECKMANN, BECKMANN_RATIONAL):
        sx, sy, sz = sample_visible_beckmann(x, y, z, u0, u1)
    else:
        raise NotImplementedError("visible normals drawn from this distribution")
    mx, my = stretch(sx, sy, ax, ay, correlation)
    mx -= mean_x * sz
    my -= mean_y * sz
    length = math.sqrt(mx * mx + my * my + sz * sz)
    return mx / length, my / length, sz / length


@formula
def sample_visible_vcavity(
    distribution: int,
    vx: float,
    vy: float,
    vz: float,
    ax: float,
    ay: float,
    correlation: float,
    u0: float,
    u1: float,
    u2: float,
) -> tuple[float, float, float, float]:
    """A normal visible from v in V-cavities (eq. 50), of unit length, and what is left of u2.

    A cavity is drawn by the area of the geometric surface that it covers, then one of its two facets by how
    much of each is seen (Heitz and d'Eon 2014)."""
    mx, my, mz = sample_normal(distribution, ax, ay, correlation, u0, u1)
    length = math.sqrt(mx * mx + my * my + mz * mz)
    mx, my, mz = mx / length, my / length, mz / length
    near = max(vx * mx + vy * my + vz * mz, 0.0)
    other = max(-vx * mx - vy * my + vz * mz, 0.0)
    chance = other / (near + other) if near + other > 0.0 else 0.0
    if u2 < chance:
        return -mx, -my, mz, u2 / chance
    return mx, my, mz, (u2 - chance) / (1.0 - chance)
