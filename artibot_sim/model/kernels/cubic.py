"""The cubic between two knots that meets both values and both rates (Hermite's): commands, and what sensors see."""

from __future__ import annotations

from artibot_sim.model.kernels.compilation import inlined


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
