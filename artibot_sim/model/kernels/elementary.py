"""Elementary functions and cubics without branches and without calls, so that loops over many rovers are vector code.

They are exact to about a rounding error, and the same on every machine.
"""

from __future__ import annotations

import math
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from artibot_sim.model.kernels.compilation import inlined

_QUARTER = (math.pi / 2, 6.123233995736766e-17)
"""pi/2 in two parts, for the reduction of an angle to within ±pi/4."""

_ROUND = 1.5 * 2.0**52
"""Adding and subtracting it rounds to a whole number, sooner than a conversion to an integer and back."""

_LN2 = (0.6931471803691238, 1.9082149292705877e-10)
"""ln 2 in two parts; the first has zeros at its end, so that its whole multiples are exact."""

_MANTISSA, _ONE, _EXPONENTS = (1 << 52) - 1, 1023 << 52, 1075 << 52
"""Bits of a number's digits; those of 1; and those of 2^52, whose last digit is 1."""

_LEAST, _MOST = -708.0, 709.0
"""Where `exp` ends: beyond, powers of two are no ordinary numbers."""


def _bits(typing_context: Any, number: Any) -> Any:
    """The bits of a float64, as an integer."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.IntType(64))

    return types.int64(types.float64), generate


def _number(typing_context: Any, bits: Any) -> Any:
    """The float64 that has these bits."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.DoubleType())

    return types.float64(types.int64), generate


def _root_estimate(typing_context: Any, number: Any) -> Any:
    """About 1/√number to single precision: said to need no more, compilers take the processor's estimate of it."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        single = ir.FloatType()
        root = builder.module.declare_intrinsic("llvm.sqrt", [single])
        short = builder.fptrunc(arguments[0], single)
        estimate = builder.fdiv(single(1.0), builder.call(root, [short], fastmath=("fast",)), flags=("fast",))
        return builder.fpext(estimate, ir.DoubleType())

    return types.float64(types.float64), generate


bits_of: Any = intrinsic(_bits)
number_of: Any = intrinsic(_number)
root_estimate: Any = intrinsic(_root_estimate)


@inlined
def whole(x):
    """The whole number next to x, for |x| < 2^51."""
    return (x + _ROUND) - _ROUND


@inlined
def inverse_root(x):
    """1/√x to rounding, for 1e-30 < x < 1e38: in vector code three times faster than a root and a quotient."""
    y = root_estimate(x)
    wrong = 1.0 - x * y * y  # cubic convergence: 1e-6 becomes 1e-18
    return y + y * wrong * (0.5 + 0.375 * wrong)


@inlined
def sincos(angle):
    """Sine and cosine together, to rounding (2e-16) for angles up to 1e4 rad.

    Taylor's series after reduction to ±pi/4: several times faster than two calls of the C library.
    """
    n = whole(angle * (2.0 / math.pi))
    x = (angle - n * _QUARTER[0]) - n * _QUARTER[1]
    y = x * x
    y2 = y * y
    y4 = y2 * y2
    # summed by halves (Estrin), which shortens the chain that everything else waits for
    s = x + x * y * (
        ((-1 / 6 + y * (1 / 120)) + y2 * (-1 / 5040 + y * (1 / 362880)))
        + y4 * ((-1 / 39916800 + y * (1 / 6227020800)) + y2 * (-1 / 1307674368000))
    )
    c = 1.0 + y * (
        ((-1 / 2 + y * (1 / 24)) + y2 * (-1 / 720 + y * (1 / 40320)))
        + y4 * ((-1 / 3628800 + y * (1 / 479001600)) + y2 * (-1 / 87178291200 + y * (1 / 20922789888000)))
    )
    quadrant = n - 4.0 * whole(0.25 * n)  # −2 to 2
    odd = abs(quadrant) == 1.0
    sine, cosine = c if odd else s, s if odd else c
    sine = -sine if quadrant * (quadrant - 1.0) > 1.0 else sine  # −2, −1, 2
    return sine, -cosine if quadrant * (quadrant + 1.0) > 1.0 else cosine  # −2, 1, 2


@inlined
def turn_by(angle, s, c):
    """Sine and cosine, of an angle that has turned by at most 0.05 rad since they were `s` and `c`, to rounding."""
    y = angle * angle
    sine = angle + angle * y * (-1 / 6 + y * (1 / 120 + y * (-1 / 5040)))
    less = y * (-1 / 2 + y * (1 / 24 + y * (-1 / 720 + y * (1 / 40320))))  # cosine − 1
    return s + (s * less + c * sine), c + (c * less - s * sine)


@inlined
def _power(x):
    """n and expm1(r) for x = n ln 2 + r with |r| < 0.35, and 2^n; for x within what `exp` knows."""
    magic = x * (1.0 / math.log(2.0)) + _ROUND
    n = magic - _ROUND
    r = (x - n * _LN2[0]) - n * _LN2[1]
    r2 = r * r
    r4 = r2 * r2
    low = (1 / 2 + r * (1 / 6)) + r2 * (1 / 24 + r * (1 / 120))
    high = (1 / 720 + r * (1 / 5040)) + r2 * (1 / 40320 + r * (1 / 362880))
    top = (1 / 3628800 + r * (1 / 39916800)) + r2 * (1 / 479001600 + r * (1 / 6227020800))
    # the sum's last bits are n; they become the exponent
    return r + r2 * (low + r4 * (high + r4 * top)), number_of((bits_of(magic) << 52) + (1023 << 52))


@inlined
def exp(x):
    """e^x, to a rounding error; below −708 and above 709 as there."""
    x = _LEAST if x < _LEAST else x  # this way round NaN stays NaN
    x = _MOST if x > _MOST else x
    fraction, power = _power(x)
    return power + power * fraction


@inlined
def log(x):
    """Natural logarithm of an ordinary number above zero, to two rounding errors."""
    bits = bits_of(x)
    # the exponent, as whole numbers next to a power of two that is large enough for all of them
    n = number_of((bits >> 52) + _EXPONENTS) - (2.0**52 + 1023.0)
    m = number_of((bits & _MANTISSA) + _ONE)  # 1 to 2
    large = m > math.sqrt(2.0)
    m, n = 0.5 * m if large else m, n + 1.0 if large else n
    t = (m - 1.0) / (m + 1.0)
    y = t * t
    y2 = y * y
    y4 = y2 * y2
    # atanh's series beyond t, summed by halves
    low = (1 / 3 + y * (1 / 5)) + y2 * (1 / 7 + y * (1 / 9))
    high = (1 / 11 + y * (1 / 13)) + y2 * (1 / 15 + y * (1 / 17))
    rest = 2.0 * t * y * (low + y4 * (high + y4 * (1 / 19 + y * (1 / 21))))
    return n * _LN2[0] + (2.0 * t + (rest + n * _LN2[1]))


@inlined
def tanh_alone(x):
    """`tanh` to the bit, sooner where it is ±1: it branches, for one rover alone."""
    if abs(x) > 20.0:
        return math.copysign(1.0, x)
    return tanh(x)


@inlined
def tanh(x):
    """Hyperbolic tangent, to two rounding errors."""
    y = 2.0 * abs(x)
    y = 40.0 if y > 40.0 else y  # tanh(20) is 1 in double precision
    fraction, power = _power(y)
    less = power * fraction + (power - 1.0)  # expm1
    return math.copysign(less / (less + 2.0), x)


# The cubic between two knots that meets both values and both rates (Hermite's): commands, and what sensors see.


@inlined
def cubic_between(x_0, x_1, v_0, v_1, inverse_h):
    """Its coefficients of s² and s³, s being the time since the first knot, 1/`inverse_h` before the second one.

    Those of 1 and s are x_0 and v_0. With `inverse_h` zero they vanish.
    """
    rise = (x_1 - x_0) * inverse_h
    return (3.0 * rise - 2.0 * v_0 - v_1) * inverse_h, (v_0 + v_1 - 2.0 * rise) * (inverse_h * inverse_h)


@inlined
def cubic_at(c_0, c_1, c_2, c_3, s):
    """Value, rate and its rate at s."""
    return c_0 + s * (c_1 + s * (c_2 + s * c_3)), c_1 + s * (2.0 * c_2 + 3.0 * s * c_3), 2.0 * c_2 + 6.0 * s * c_3
