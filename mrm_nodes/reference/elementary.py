"""Elementary functions without branches or calls, so that a loop over them becomes vector instructions."""

from typing import Any

from numba import types
from numba.extending import intrinsic

from .compiled import contracted


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
