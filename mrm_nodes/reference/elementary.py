"""Elementary functions without branches or calls, so that a loop over them becomes vector instructions."""

import math
from typing import Any

from numba import types
from numba.extending import intrinsic

from .compiled import contracted, inlined


# Numba's typing context comes first and is not passed, which a type checker cannot know: hence the Any below.
@intrinsic
def _to_integer(_context: Any, _value: Any) -> Any:
    def build(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], _context.get_value_type(types.int64))

    return types.int64(types.float64), build


@intrinsic
def _to_float(_context: Any, _value: Any) -> Any:
    def build(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], _context.get_value_type(types.float64))

    return types.float64(types.int64), build


_bits: Any = _to_integer
_from_bits: Any = _to_float

# 1.5 * 2^52: added and taken away again it rounds to an integer, which lies in the sum's lowest bits.
ROUND = 6755399441055744.0
LOG2_E = 1.4426950408889634
LOG_2_HIGH, LOG_2_LOW = 6.93145751953125e-1, 1.42860682030941723212e-6


@contracted
def exponential(x: float) -> float:
    """e^x for x <= 700, to 2 ulp; 0 where it would be less than 1e-307.

    The rational function of Cephes (Moshier 1989, `exp.c`), times a power of 2 made from its bits.
    """
    bounded = min(max(x, -708.0), 700.0)
    shifted = bounded * LOG2_E + ROUND
    k = shifted - ROUND
    r = bounded - k * LOG_2_HIGH - k * LOG_2_LOW
    rr = r * r
    p = r * ((1.26177193074810590878e-4 * rr + 3.02994407707441961300e-2) * rr + 1.0)
    q = 3.00198505138664455042e-6 * rr + 2.52448340349684104192e-3
    q = (q * rr + 2.27265548208155028766e-1) * rr + 2.0
    power: float = _from_bits((_bits(shifted) << 52) + (1023 << 52))
    value: float = (1.0 + 2.0 * p / (q - p)) * power
    return value if x >= -708.0 else 0.0


@contracted
def gaussian_excess(a: float) -> float:
    """(e^(-a²)/sqrt π - a erfc a) / 2 for a >= 0: to 3e-18 (a + its value).

    A rational function times e^(-a²); its coefficients were fitted to the integral with 40 digits.
    """
    t = min(a, 27.0)
    p = 9.9172511703394268389e-05 - 2.2877938876474845787e-9 * t
    p = ((p * t + 1.6228136161830543439e-3) * t + 1.2355678519849831316e-2) * t + 5.5705308036451737901e-2
    p = ((p * t + 1.610492036606922568e-1) * t + 2.8322762331557016563e-1) * t + 2.8209479177387814339e-1
    q = 1.1514377975700404383e-2 + 7.0257180956374329328e-4 * t
    q = ((q * t + 8.8557389681560403026e-2) * t + 4.1296618566963274864e-1) * t + 1.2674216916623382881
    q = ((q * t + 2.6065156520332011523) * t + 3.4920688574209116398) * t + 2.7764696341625143885
    q = q * t + 1.0
    return p / q * exponential(-t * t)


# Of sin r / r and of (cos r - 1 + r²/2) / r⁴ in r², for |r| <= π/4 (Moshier 1989, `sin.c`).
SINE = (
    1.58962301576546568060e-10,
    -2.50507477628578072866e-8,
    2.75573136213857245213e-6,
    -1.98412698295895385996e-4,
    8.33333333332211858878e-3,
    -1.66666666666666307295e-1,
)
COSINE = (
    -1.13585365213876817300e-11,
    2.08757008419747316778e-9,
    -2.75573141792967388112e-7,
    2.48015872888517045348e-5,
    -1.38888888888730564116e-3,
    4.16666666666665929218e-2,
)


@contracted
def sine_cosine(turns: float) -> tuple[float, float]:
    """sin and cos of 2π `turns`, for less than 2^50 of them, to 1e-16."""
    shifted = 4.0 * turns + ROUND
    # Exact: what is left of the nearest quarter.
    r = (turns - 0.25 * (shifted - ROUND)) * (2.0 * math.pi)
    rr = r * r
    s = ((((SINE[0] * rr + SINE[1]) * rr + SINE[2]) * rr + SINE[3]) * rr + SINE[4]) * rr + SINE[5]
    c = ((((COSINE[0] * rr + COSINE[1]) * rr + COSINE[2]) * rr + COSINE[3]) * rr + COSINE[4]) * rr + COSINE[5]
    s, c = r + r * rr * s, 1.0 - 0.5 * rr + rr * rr * c
    quarter = _bits(shifted)
    odd = (quarter & 1) != 0
    sine, cosine = (c if odd else s), (s if odd else c)
    return (-sine if (quarter & 2) != 0 else sine), (-cosine if ((quarter + 1) & 2) != 0 else cosine)


@contracted
def logarithm(x: float) -> float:
    """ln x of a normal number above 0, to 2e-16 of itself: the rational function of Cephes (Moshier 1989, `log.c`)."""
    bits = _bits(x)
    # Between sqrt(1/2) and sqrt 2, and a power of 2.
    shift = (bits - 0x3FE6A09E667F3BCD) >> 52
    e = _from_bits(_bits(ROUND) + shift) - ROUND
    z = _from_bits(bits - (shift << 52)) - 1.0
    p = 1.01875663804580931796e-4 * z + 4.97494994976747001425e-1
    p = (((p * z + 4.70579119878881725854) * z + 1.44989225341610930846e1) * z + 1.79368678507819816313e1) * z
    p = p + 7.70838733755885391666
    q = (z + 1.12873587189167450590e1) * z + 4.52279145837532221105e1
    q = ((q * z + 8.29875266912776603211e1) * z + 7.11544750618563894466e1) * z + 2.31251620126765340583e1
    zz = z * z
    y = z * (zz * p / q) - e * 2.121944400546905827679e-4 - 0.5 * zz
    value: float = (z + y) + e * 0.693359375
    return value


SQRT_PI = math.sqrt(math.pi)


@contracted
def scaled_error_complement(a: float) -> float:
    """e^(a²) erfc a for a >= 0, to 3e-16 of itself; beyond 27, where erfc is 0, that of 27.

    A rational function; its coefficients were fitted with 50 digits.
    """
    t = min(a, 27.0)
    p = 6.250907832258696e-05 * t + 0.0011889518408587877
    p = (p * t + 0.011072130569872007) * t + 0.06530807544587597
    p = (p * t + 0.2668547481066331) * t + 0.7806634813219434
    p = (p * t + 1.635245556309563) * t + 2.374732978354905
    p = (p * t + 2.1909658366660496) * t + 1.0
    q = 0.00011079445658976594 * t + 0.002107362268821527
    q = (q * t + 0.019680237697867246) * t + 0.11680923082427823
    q = (q * t + 0.4827447523865933) * t + 1.4405140201854394
    q = (q * t + 3.125218208198822) * t + 4.845694705104419
    q = (q * t + 5.120212729002641) * t + 3.3193450037615486
    q = q * t + 1.0
    return p / q


@contracted
def nearly_inverse_error_function(y: float) -> float:
    """erf⁻¹ to 2e-6 of itself: the polynomials of Giles 2010, and one that was fitted where they end.

    Coefficients are blended by weights of 0 and 1: what is chosen by comparing becomes branches, and the loop around it
    no vector instructions.
    """
    magnitude = min(abs(y), 1.0 - 1.2e-16)
    w = -logarithm((1.0 - magnitude) * (1.0 + magnitude))
    root = math.sqrt(max(w, 0.0))
    near, end = 1.0 if w < 5.0 else 0.0, 1.0 if w >= 14.0 else 0.0
    far = 1.0 - near - end
    t = near * (w - 2.5) + far * (root - 3.0) + end * (root - 5.0)
    p = 2.81022636e-08 * near - 0.000200214257 * far
    p = p * t + (3.43273939e-07 * near + 0.000100950558 * far)
    p = p * t + (-3.5233877e-06 * near + 0.00134934322 * far)
    p = p * t + (-4.39150654e-06 * near - 0.00367342844 * far)
    p = p * t + (0.00021858087 * near + 0.00573950773 * far + 0.000100275294 * end)
    p = p * t + (-0.00125372503 * near - 0.0076224613 * far - 0.000248820384 * end)
    p = p * t + (-0.00417768164 * near + 0.00943887047 * far - 0.000159760337 * end)
    p = p * t + (0.246640727 * near + 1.00167406 * far + 1.01031181 * end)
    p = p * t + (1.50140941 * near + 2.83297682 * far + 4.84990888 * end)
    return math.copysign(p * magnitude, y)


@inlined
def inverse_error_function(y: float) -> float:
    """erf⁻¹ to full precision: of what is nearly it one step of Halley's method, in the complement, which keeps the
    tail."""
    x = nearly_inverse_error_function(abs(y))
    magnitude = min(abs(y), 1.0 - 1.2e-16)
    # erf x less what it should be, over its derivative 2 e^(-x²) / sqrt π.
    step = 0.5 * SQRT_PI * ((1.0 - magnitude) * exponential(x * x) - scaled_error_complement(x))
    return math.copysign(x - step / (1.0 + x * step), y)
