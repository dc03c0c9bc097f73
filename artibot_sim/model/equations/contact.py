"""Wheel and ground: eqs 15 to 19, wheel by wheel.

`fx` is None for the paper's model, and the record of the effects' parameters in the extended one: what stands under
``if fx is not None`` is not even compiled into the former.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from artibot_sim.model.effects import hooks
from artibot_sim.model.effects.force_law import LocalMotion
from artibot_sim.model.kernels.compilation import inlined, kernel
from artibot_sim.model.kernels.elementary import inverse_root
from artibot_sim.model.kernels.layout import ALPHA, GAMMA, Q_C, X, Y, Z


class WheelPair(NamedTuple):
    """What the two wheels of a motor meet, the front one (f) and the back one (b).

    p_xf, p_xb, p_yf, p_yb are the velocities of their centres, m/s; F_nf, F_nb normal forces, N. By N_f and N_b (N)
    eq. 16 decides whether a wheel slides: they are the same but where loads move, see `load_transfer`.
    """

    p_xf: float
    p_xb: float
    p_yf: float
    p_yb: float
    F_nf: float
    F_nb: float
    N_f: float
    N_b: float


class PairForces(NamedTuple):
    """What the two wheels of a motor do, the front one (f) and the back one (b).

    F_l is the sum of the longitudinal forces, at_rim that of those at radius r_w with the same torque, N; slope their
    secant slope by the rims' speed, N s/m. u_F_n is the sum of u F_n (N m), F_tf and F_tb the lateral forces (N), u_f
    and u_b how far ahead of the wheels' centres they act (m), rate_f and rate_b how fast lagging forces build up (N/s).
    F_lf and F_lb are the single wheels' (N), held_f and held_b what eq. 16 has left of eq. 15's, 1 where they hold.
    R_l, R_tf and R_tb are forces on the wheels' centres beside (N), which the motor does not feel: their sum along, and
    those across.
    wound_f and wound_b are how fast the wheels wind up (1/s), bent_f and bent_b how fast bristles bend along and across
    them, m/s. F_nf and F_nb are the normal forces
    under which all this is, N; more_f and more_b are what each newton of them adds to the forces along and across.
    """

    F_l: float
    at_rim: float
    slope: float
    u_F_n: float
    F_tf: float
    F_tb: float
    u_f: float
    u_b: float
    rate_f: float
    rate_b: float
    F_lf: float
    F_lb: float
    held_f: float
    held_b: float
    R_l: float
    R_tf: float
    R_tb: float
    wound_f: float
    wound_b: float
    bent_f: tuple[float, float]
    bent_b: tuple[float, float]
    F_nf: float
    F_nb: float
    more_f: tuple[float, float]
    more_b: tuple[float, float]


class PairSoil(NamedTuple):
    """The ground under a pair of wheels: eq. 15's coefficients, and eq. 16's for the front one and the back one.

    u_f, u_b are how far ahead of the wheels' centres the forces act, m; load is the mean one of the rover's wheels, N.
    x, y is the middle between the two wheels in `map`, ahead_x, ahead_y from there to the front one, m: with effects.
    stiffness_f and stiffness_b are factors of k_l and k_t under each wheel on uneven ground; None, at compile time, on
    flat ground.
    """

    u_f: float
    u_b: float
    k_l: float
    k_t: float
    mu_sf: float
    mu_df: float
    mu_sb: float
    mu_db: float
    load: float
    x: float
    y: float
    ahead_x: float
    ahead_y: float
    stiffness_f: float | None
    stiffness_b: float | None


@inlined
def unloaded_radius(body, p, fx, module, end, side):
    """With effects: r_0 of the wheel at `end` (1 in front, −1 behind) and `side` (1 left, −1 right), m.

    A wheel that carries more than a quarter of its module's weight is as much larger as it sinks deeper: so the
    rover stands level, and each wheel has its static load m g/4 (1 ± 2x/i_x)(1 ± 2y/i_y).
    """
    x, y = hooks.centre(fx, module)
    share = (1.0 + end * x / body.half_x) * (1.0 + side * y / body.half_y)
    return body.r_0 - body.m * p.g_z / (4.0 * p.k_n) * (share - 1.0)


@inlined
def normal_force(body, p, fx, module, end, side, v_z, alpha_dot, s_a, c_a, z):
    """F_n of a wheel (eq. 15), see `unloaded_radius`; the ground does not pull, so it is zero for one in the air."""
    y = side * body.half_y
    r_0 = body.r_0
    if fx is not None:
        r_0 = unloaded_radius(body, p, fx, module, end, side)
    return max(p.k_n * (r_0 - z - y * s_a) - p.c_n * (v_z + alpha_dot * y * c_a), 0.0)


@inlined
def wheel_pairs(body, p, fx, q, v, b, trig, module):
    """What a module's wheels meet: velocities of their centres (eq. 19) and normal forces (eq. 15).

    The module's coordinates begin at `b` in q and v; `trig` are sine and cosine of its roll and of its yaw. Pitch does
    not reach the wheels (section 4.3), so p_x and (for a mass in the middle) F_n are the same for both wheels of a
    side, and p_y for both of an axle.

    Returns
    -------
    tuple of 2 WheelPair
        Right and left.
    """
    s_a, c_a, s_g, c_g = trig
    v_x, v_y = c_g * v[b + X] + s_g * v[b + Y], c_g * v[b + Y] - s_g * v[b + X]
    z, v_z, alpha_dot, gamma_dot = q[b + Z], v[b + Z], v[b + ALPHA], v[b + GAMMA]
    turn, sweep, slide = gamma_dot * body.half_y * c_a, gamma_dot * body.half_x * c_a, c_a * v_y + s_a * v_z
    front, back = slide + sweep, slide - sweep
    on_right, on_left = v_x + turn, v_x - turn
    F_rf = normal_force(body, p, fx, module, 1.0, -1.0, v_z, alpha_dot, s_a, c_a, z)
    F_lf = normal_force(body, p, fx, module, 1.0, 1.0, v_z, alpha_dot, s_a, c_a, z)
    if fx is not None:
        F_rb = normal_force(body, p, fx, module, -1.0, -1.0, v_z, alpha_dot, s_a, c_a, z)
        F_lb = normal_force(body, p, fx, module, -1.0, 1.0, v_z, alpha_dot, s_a, c_a, z)
    else:
        F_rb, F_lb = F_rf, F_lf
    right = WheelPair(on_right, on_right, front, back, F_rf, F_rb, F_rf, F_rb)
    return right, WheelPair(on_left, on_left, front, back, F_lf, F_lb, F_lf, F_lb)


@inlined
def soil_under(body, p, fx, pair, x, y, s_g, c_g, c_a, side):
    """The soil under the wheels on one `side` (1 left, −1 right) of a module at (x, y) in `map`."""
    if fx is not None:
        soil = hooks.soil(fx)
        out_x, out_y = x - side * s_g * c_a * body.half_y, y + side * c_g * c_a * body.half_y
        ahead_x, ahead_y = c_g * body.half_x, s_g * body.half_x
        on_f = soil * hooks.grip(fx, out_x + ahead_x, out_y + ahead_y)
        on_b = soil * hooks.grip(fx, out_x - ahead_x, out_y - ahead_y)
        u_f = p.u_w * hooks.lead(fx, pair.p_xf, pair.p_yf)
        u_b = p.u_w * hooks.lead(fx, pair.p_xb, pair.p_yb)
        return PairSoil(
            u_f, u_b, soil * body.k_l, soil * body.k_t,
            on_f * body.mu_s, on_f * body.mu_d, on_b * body.mu_s, on_b * body.mu_d, p.load,
            out_x, out_y, ahead_x, ahead_y, None, None,
        )  # fmt: skip
    return PairSoil(
        p.u_w, p.u_w, body.k_l, body.k_t, body.mu_s, body.mu_d, body.mu_s, body.mu_d, p.load, 0.0, 0.0, 0.0, 0.0,
        None, None,
    )  # fmt: skip


@inlined
def times(factor, here):
    """A factor with that of the ground `here`, which is None, at compile time, on flat ground."""
    if here is None:
        return factor
    return factor * here


@inlined
def sliding_friction(body, mu_d, here):
    """mu_d of the paper's model: that of the module's soil, or on uneven ground (see `times`) that under the wheel."""
    if here is None:
        return body.mu_d
    return mu_d


@inlined
def within_friction(body, fx, F_l, F_t, F_n, N, mu_s, mu_d, slip_l, slip_t, here):
    """Eq. 16: F_l, F_t (N) within what friction holds, and the share of them that is left, 1 where nothing is cut.

    `N` decides whether it is, see `WheelPair`; for `here` see `times`. With a branch, for one rover alone: roots and
    quotients of those wheels only that slide. So that the compiler keeps it, mu_d of the paper's model is read, and
    forces are multiplied, inside.
    """
    F_h2 = F_l * F_l + F_t * F_t
    limit = mu_s * N
    if fx is not None and hooks.early_fall(fx) > 0.0:  # before a root is taken
        mu = hooks.friction(fx, mu_s, mu_d, math.sqrt(slip_l * slip_l + slip_t * slip_t))
        limit = N * (mu_s + hooks.early_fall(fx) * (mu - mu_s))
    if F_h2 > limit * limit:
        if fx is not None:
            mu_d = hooks.friction(fx, mu_s, mu_d, math.sqrt(slip_l * slip_l + slip_t * slip_t))
        else:
            mu_d = sliding_friction(body, mu_d, here)
        held = mu_d * F_n / math.sqrt(F_h2)
        return F_l * held, F_t * held, held
    return F_l, F_t, 1.0


@inlined
def within_friction_lanes(body, fx, F_l, F_t, F_n, N, mu_s, mu_d, slip_l, slip_t, here):
    """Eq. 16 for a wheel without a branch, so that loops over many rovers become vector code; see `within_friction`."""
    F_h2 = F_l * F_l + (F_t * F_t + 1e-30)  # so that there is a root to divide by
    limit = mu_s * N
    if fx is not None:
        early = hooks.early_fall(fx)
        mu_d = hooks.friction(fx, mu_s, mu_d, math.sqrt(slip_l * slip_l + slip_t * slip_t))
        limit = N * (mu_s + early * (mu_d - mu_s) if early > 0.0 else mu_s)
    held = mu_d * F_n * inverse_root(F_h2)
    held = held if F_h2 > limit * limit else 1.0
    return F_l * held, F_t * held, held


@inlined
def relaxed(fx, F_t, p_x, lag, dt):
    """With effects: what has built up of the lateral force `F_t` (N), now or at the end of `dt`, and its rate (N/s).

    `lag` is what has built up so far, N.
    """
    rate = hooks.follow_rate(fx, p_x)
    follows = rate > 0.0
    if dt is not None:
        growth = rate * (F_t - lag) / (1.0 + dt * rate)
        built = lag + dt * growth
    else:
        growth = rate * (F_t - lag)
        built = lag
    return (built if follows else F_t), (growth if follows else 0.0)


@inlined
def stiffer(fx, F_n, load, rim, p_x, p_y):
    """With effects: factor of k_l and k_t of a wheel, whose rim moves at `rim` (m/s)."""
    fastest = max(rim * rim, p_x * p_x + p_y * p_y)
    return hooks.stiffness_by_load(fx, F_n / load) * hooks.stiffness_by_speed(fx, fastest)


@inlined
def at_wheel(pair, soil, rim, angle, end):
    """With effects: what a law may follow at the wheel at `end` (1 in front, −1 behind) of a motor's two."""
    p_x, p_y, F_n = (pair.p_xf, pair.p_yf, pair.F_nf) if end > 0.0 else (pair.p_xb, pair.p_yb, pair.F_nb)
    x, y = soil.x + end * soil.ahead_x, soil.y + end * soil.ahead_y
    return LocalMotion(p_x, p_y, rim - p_x, angle, x, y, F_n)


@inlined
def mean(a, b):
    """Of two numbers; of two that are the same it is that to the bit."""
    return a + 0.5 * (b - a)


@inlined
def at_pair(pair, soil, rim, angle):
    """With effects: what a law may follow in the middle between the two wheels of a motor."""
    p_x, p_y = mean(pair.p_xf, pair.p_xb), 0.5 * (pair.p_yf + pair.p_yb)
    return LocalMotion(p_x, p_y, rim - p_x, angle, soil.x, soil.y, pair.F_nf + pair.F_nb)


@inlined
def held_by(F, stiff, k, z):
    """With effects: a force (N) with that of bristles that are bent by `z` (m) and `stiff` k strong (N/m)."""
    return F + stiff * k * z if stiff > 0.0 else F


@inlined
def released(stiff, renewal, k_l, k_t, slip_l, slip_t, narrow, friction, y_l, y_t):
    """With effects: rates (1/s) at which bristles that are bent by y (m) let go along and across; see `bending`."""
    F_l, F_t, k_across = stiff * k_l * y_l, stiff * narrow * k_t * y_t, narrow * k_t
    towards = max(F_l * k_l * slip_l + F_t * k_across * slip_t, 0.0)
    used = math.sqrt(F_l * F_l + F_t * F_t) / max(friction, 1e-9)
    gives = stiff * used * towards / max(k_l * F_l * F_l + narrow * k_across * F_t * F_t, 1e-30)
    return renewal + gives * k_l, renewal + gives * narrow * k_across


@inlined
def bending(stiff, renewal, k_l, k_t, slip_l, slip_t, narrow, friction, z_l, z_t, dt):
    """With effects: how fast a wheel's bristles bend along and across it, m/s, now or as a step `dt` takes it.

    They let go as rolling renews them. And as far as they are bent towards what `friction` (N) holds of them they give
    way to slip that bends them further, in the direction in which they pull (principle of maximum dissipation): so
    they never pull more, and on bristles that are stiffer one way than the other any small slip is resisted. Slip is
    what eq. 16 leaves of it: of all that its force takes out of the motion, bristles store what bends them, and the
    rest is lost.

    Parameters
    ----------
    stiff, renewal : float
        See `hooks.bristle`, 1/s.
    k_l, k_t : float
        N s/m.
    slip_l, slip_t : float
        m/s.
    narrow : float
        Friction along the wheel over that across it.
    z_l, z_t : float
        How far they are bent, m.
    """
    if stiff <= 0.0:  # before anything is computed: one rover alone without bristles does not pay for them
        return 0.0, 0.0
    y_l, y_t = z_l, z_t
    if dt is not None:  # as far as they are bent before they give way
        y_l, y_t = (z_l + dt * slip_l) / (1.0 + dt * renewal), (z_t + dt * slip_t) / (1.0 + dt * renewal)
    release_l, release_t = released(stiff, renewal, k_l, k_t, slip_l, slip_t, narrow, friction, y_l, y_t)
    rate_l, rate_t = slip_l - release_l * z_l, slip_t - release_t * z_t
    if dt is not None:
        return rate_l / (1.0 + dt * release_l), rate_t / (1.0 + dt * release_t)
    return rate_l, rate_t


@kernel
def steady_bending(body, stiff, friction, slip, renewal, rounds, out):
    """How far bristles are bent where they stay, into `out` (n, 2), m, at wheels of a module under a static load.

    Where a wheel slides eq. 16 leaves a share of its slip, which depends on how far they are bent: found in turn.

    Parameters
    ----------
    body : record
        The wheels' module.
    stiff, friction : float
        See `bending`.
    slip : array, shape (n, 2)
        m/s, along and across.
    renewal : array, shape (n,)
    rounds : int
        How often both are found.
    """
    k_l, k_t, load = body.k_l, body.k_t, friction / body.mu_s
    for i in range(len(slip)):
        s_l, s_t = slip[i, 0], slip[i, 1]
        pull_l, pull_t = k_l * s_l, k_t * s_t
        release = max(renewal[i] + stiff * math.sqrt(pull_l * pull_l + pull_t * pull_t) / friction, 1e-9)
        z_l, z_t, held = s_l / release, s_t / release, 1.0
        for _ in range(rounds):
            left_l, left_t = held * s_l, held * s_t
            on_l, on_t = released(stiff, renewal[i], k_l, k_t, left_l, left_t, 1.0, friction, z_l, z_t)
            z_l = math.copysign(math.sqrt(abs(z_l * left_l) / max(on_l, 1e-9)), s_l)
            z_t = math.copysign(math.sqrt(abs(z_t * left_t) / max(on_t, 1e-9)), s_t)
            F_l, F_t = held_by(pull_l, stiff, k_l, z_l), held_by(pull_t, stiff, k_t, z_t)
            _, _, held = within_friction(body, None, F_l, F_t, load, load, body.mu_s, body.mu_d, s_l, s_t, None)
        out[i, 0], out[i, 1] = z_l, z_t


@inlined
def unwound(way, F, wound):
    """With effects: the share of a force along a wheel (N) that is there while it is `wound` up (−1 to 1)."""
    return 0.5 * (1.0 + (wound if F > 0.0 else -wound)) if way > 0.0 else 1.0


@inlined
def winding(way, slip, wound, dt):
    """With effects: how fast a wheel that slips (m/s) winds up, 1/s, now or as a step `dt` takes it: Dahl's law."""
    if way <= 0.0:
        return 0.0
    rate = (slip - abs(slip) * wound) / way
    if dt is not None:
        return rate / (1.0 + dt * abs(slip) / way)
    return rate


LIGHT = 1e-9
"""A load that is none, N: what wheels that are lifted carry, so that quotients by it are none of rounding errors."""


@inlined
def by_load(F_l, F_t, held, F_n):
    """With effects: what each newton of load adds to eq. 16's forces; nothing where the wheel holds."""
    share = 1.0 / max(F_n, LIGHT) if held != 1.0 else 0.0
    return share * F_l, share * F_t


class Wheel(NamedTuple):
    """One of a motor's two wheels and the ground under it: its part of `WheelPair` and `PairSoil`, and its radius.

    r is its radius over the paper's.
    """

    p_x: float
    p_y: float
    F_n: float
    N: float
    mu_s: float
    mu_d: float
    stiffness: float | None
    r: float


class ViscousForces(NamedTuple):
    """What eq. 15 gives of a wheel: slip along it (m/s), forces along and across it (N), factor of k_l and k_t.

    With effects: rate is how fast a lagging force builds up (N/s), stiff and renewal are those of `hooks.bristle`.
    """

    slip: float
    F_l: float
    F_t: float
    s: float
    rate: float
    stiff: float
    renewal: float


class WheelForces(NamedTuple):
    """What one wheel does, see `PairForces`; s is `ViscousForces.s` times what is left of the force along it."""

    F_l: float
    F_t: float
    s: float
    held: float
    rate: float
    R_l: float
    R_t: float
    wound: float
    bent: tuple[float, float]
    more: tuple[float, float]


@inlined
def viscous(fx, soil, wheel, rim, kept, dt):
    """Eq. 15 for a wheel, and effects in their place; see `wheel_forces`."""
    F_t = -soil.k_t * wheel.p_y
    if fx is None:
        slip, s = rim - wheel.p_x, times(1.0, wheel.stiffness)
        return ViscousForces(slip, s * (soil.k_l * slip), s * F_t, s, 0.0, 0.0, 0.0)
    rim = wheel.r * rim
    slip = rim - wheel.p_x
    s = times(stiffer(fx, wheel.F_n, soil.load, rim, wheel.p_x, wheel.p_y), wheel.stiffness)
    F_l, F_t, rate, stiff, renewal = s * (soil.k_l * slip), s * F_t, 0.0, 0.0, 0.0
    if len(kept) == 4:
        F_t, rate = relaxed(fx, F_t, wheel.p_x, kept[0], dt)
        stiff, renewal = hooks.bristle(fx, rim)
        F_l = held_by(F_l, stiff, s * soil.k_l, kept[2])
        F_t = held_by(F_t, stiff, s * soil.k_t, kept[3])
    return ViscousForces(slip, F_l, F_t, s, rate, stiff, renewal)


@inlined
def limited(friction, body, fx, wheel, free, narrow):
    """Eq. 16 for a wheel: its forces as `friction` leaves them; see `wheel_forces`."""
    return friction(
        body, fx, free.F_l, narrow * free.F_t, wheel.F_n, wheel.N, wheel.mu_s, wheel.mu_d, free.slip, wheel.p_y,
        wheel.stiffness,
    )  # fmt: skip


@inlined
def after_friction(fx, soil, wheel, free, cut, wide, kept, dt):
    """What a wheel does, from its forces before (`free`) and after (`cut`) eq. 16, and effects in their place."""
    F_l, F_t, held = cut
    s, wound, bent = free.s * held, 0.0, (0.0, 0.0)
    if fx is None:
        return WheelForces(F_l, F_t, s, held, 0.0, 0.0, 0.0, wound, bent, bent)
    holds = wheel.mu_s * wheel.F_n
    if len(kept) == 4:
        way = hooks.windup(fx)
        there, wound = unwound(way, F_l, kept[1]), winding(way, free.slip, kept[1], dt)
        F_l, s = there * F_l, there * s
        bent = bending(
            free.stiff, free.renewal, free.s * soil.k_l, free.s * soil.k_t, held * free.slip, -held * wheel.p_y,
            1.0 / wide, holds, kept[2], kept[3], dt,
        )  # fmt: skip
    more_l, more_t = by_load(F_l, wide * F_t, held, wheel.F_n)
    R_l, R_t = hooks.wheel_resist(fx, holds, wheel.p_x, wheel.p_y)
    load = max(wheel.F_n, LIGHT)
    F_t = wide * F_t + hooks.lateral(fx, wheel.p_y, wheel.F_n)
    return WheelForces(F_l, F_t, s, held, free.rate, R_l, R_t, wound, bent, (more_l + R_l / load, more_t + R_t / load))


@inlined
def wheel_forces(friction, body, fx, pair, soil, motor, rim, angle, kept_f, kept_b, dt):
    """Eqs 15 and 16 for the two wheels of a motor, and effects in their place; `pair_forces` without laws.

    Parameters
    ----------
    friction : function
        Eq. 16: `within_friction` or `within_friction_lanes`.
    body : record
        The wheels' module.
    motor : int
    rim, angle : float
        Speed of the wheels' rims, m/s, and their angle, rad.
    kept_f, kept_b : tuple of 4 floats, or of none
        With effects: what the wheels remember, a lateral force that lags (N), how far they are wound up, and how far
        bristles are bent along and across (m). Empty, at compile time, where no effect has them remember anything.
    dt : float or None
        A step at whose end lagging forces are taken, s; None for the instant.

    Returns
    -------
    PairForces
    """
    r_f = r_b = wide = narrow = 1.0
    if fx is not None:
        wide = hooks.lateral_grip(fx)
        narrow = 1.0 / wide
        r_f, r_b = hooks.radius(fx, 2 * motor, angle), hooks.radius(fx, 2 * motor + 1, angle)
    front = Wheel(pair.p_xf, pair.p_yf, pair.F_nf, pair.N_f, soil.mu_sf, soil.mu_df, soil.stiffness_f, r_f)
    back = Wheel(pair.p_xb, pair.p_yb, pair.F_nb, pair.N_b, soil.mu_sb, soil.mu_db, soil.stiffness_b, r_b)
    # both wheels stage by stage: their roots and quotients wait for each other where one wheel comes after the other
    free_f, free_b = viscous(fx, soil, front, rim, kept_f, dt), viscous(fx, soil, back, rim, kept_b, dt)
    cut_f = limited(friction, body, fx, front, free_f, narrow)
    cut_b = limited(friction, body, fx, back, free_b, narrow)
    f = after_friction(fx, soil, front, free_f, cut_f, wide, kept_f, dt)
    b = after_friction(fx, soil, back, free_b, cut_b, wide, kept_b, dt)
    F_l = f.F_l + b.F_l
    at_rim, slope = F_l, soil.k_l * (f.s + b.s)
    if fx is not None:
        at_rim, slope = r_f * f.F_l + r_b * b.F_l, soil.k_l * (r_f * r_f * f.s + r_b * r_b * b.s)
    u_F_n = soil.u_f * pair.F_nf + soil.u_b * pair.F_nb
    return PairForces(
        F_l, at_rim, slope, u_F_n, f.F_t, b.F_t, soil.u_f, soil.u_b, f.rate, b.rate, f.F_l, b.F_l, f.held, b.held,
        f.R_l + b.R_l, f.R_t, b.R_t, f.wound, b.wound, f.bent, b.bent, pair.F_nf, pair.F_nb, f.more, b.more,
    )  # fmt: skip


@inlined
def pair_forces(friction, body, fx, pair, soil, motor, rim, angle, kept_f, kept_b, dt):
    """What the two wheels of a motor do: `wheel_forces`, and forces of laws (`effects.force_law`) beside."""
    forces = wheel_forces(friction, body, fx, pair, soil, motor, rim, angle, kept_f, kept_b, dt)
    if fx is None:
        return forces
    half = 0.5 * hooks.along(fx, motor, at_pair(pair, soil, rim, angle))
    on_f = hooks.across(fx, 2 * motor, at_wheel(pair, soil, rim, angle, 1.0))
    on_b = hooks.across(fx, 2 * motor + 1, at_wheel(pair, soil, rim, angle, -1.0))
    radii = hooks.radius(fx, 2 * motor, angle) + hooks.radius(fx, 2 * motor + 1, angle)
    f = forces
    return PairForces(
        f.F_l + 2.0 * half, f.at_rim + radii * half, f.slope, f.u_F_n, f.F_tf + on_f, f.F_tb + on_b, f.u_f, f.u_b,
        f.rate_f, f.rate_b, f.F_lf + half, f.F_lb + half, f.held_f, f.held_b, f.R_l, f.R_tf, f.R_tb,
        f.wound_f, f.wound_b, f.bent_f, f.bent_b, f.F_nf, f.F_nb, f.more_f, f.more_b,
    )  # fmt: skip


@inlined
def under(pair, F_nf, F_nb, N_f, N_b):
    """With effects: a `WheelPair` under other loads."""
    return WheelPair(pair.p_xf, pair.p_xb, pair.p_yf, pair.p_yb, F_nf, F_nb, N_f, N_b)


@inlined
def moved(over, back, F):
    """With effects: what moves of a load `F` (N) by which no wheel comes to carry less than nothing, N.

    `over` moves from each left wheel to the right one, `back` from each front wheel to the one behind, N; F are the
    loads of the right wheels, front and back, and of the left ones.
    """
    share = min(1.0, F[0] / max(back - over, LIGHT), F[1] / max(-back - over, LIGHT))
    share = min(share, F[2] / max(back + over, LIGHT), F[3] / max(over - back, LIGHT))
    return share * over, share * back


@inlined
def moved_loads(forces, body, fx, levers, pairs, soils, motor, rims, angles, kept):
    """With effects: a module's `pairs` under the loads that balance the forces of wheels which slide as `pairs` do.

    What the ground pushes a module by acts below its centre of mass, and normal forces balance the moment: they grow on
    the outer side of a turn and, where pitch reaches the wheels, behind while it gains speed. Their sum stays. The
    force of a wheel that slides grows with its load, that of one that holds does not: two equations for what moves over
    to the right and what moves back. Where wheels slide apart on high centres, nothing holds the loads before a wheel
    is off the ground: no load moves further than that (`LIGHT` is left, as bristles and loads divide by it).

    Parameters
    ----------
    forces : function
        See `load_transfer`.
    levers : tuple of 2 floats
        Load that a wheel takes on for each newton across the module, and along it.
    pairs : tuple of 2 WheelPair
        Right and left, at rest but for the loads that decide whether a wheel slides.
    motor : int
        The right one.
    """
    right, left = pairs
    R = forces(body, fx, right, soils[0], motor, rims[0], angles[0], kept[0], kept[1])
    L = forces(body, fx, left, soils[1], motor + 1, rims[1], angles[1], kept[2], kept[3])
    along = levers[1] * ((R.F_l + L.F_l) + (R.R_l + L.R_l))
    across = levers[0] * ((R.F_tf + R.F_tb + L.F_tf + L.F_tb) + (R.R_tf + R.R_tb + L.R_tf + L.R_tb))
    (rf_l, rf_t), (rb_l, rb_t), (lf_l, lf_t), (lb_l, lb_t) = R.more_f, R.more_b, L.more_f, L.more_b
    a, b = 1.0 - levers[0] * ((rf_t + rb_t) - (lf_t + lb_t)), levers[0] * ((rb_t - rf_t) + (lb_t - lf_t))
    c, d = levers[1] * ((rf_l + rb_l) - (lf_l + lb_l)), 1.0 - levers[1] * ((rb_l - rf_l) + (lb_l - lf_l))
    scale = 1.0 / max(a * d - b * c, LIGHT)
    over, back = scale * (d * across + b * along), scale * (a * along + c * across)
    over, back = moved(over, back, (right.F_nf, right.F_nb, left.F_nf, left.F_nb))
    R_f, R_b = max(right.F_nf + (over - back), LIGHT), max(right.F_nb + (over + back), LIGHT)
    L_f, L_b = max(left.F_nf - (over + back), LIGHT), max(left.F_nb - (over - back), LIGHT)
    return under(right, R_f, R_b, right.N_f, right.N_b), under(left, L_f, L_b, left.N_f, left.N_b)


@inlined
def load_transfer(forces, body, fx, pitching, pairs, soils, motor, rims, angles, kept):
    """With effects: a module's `pairs` (right and left) under the loads that its wheels carry as it moves.

    Which wheels slide follows from the loads, and loads from which wheels slide: where friction drops as a wheel breaks
    away, there may be none under which it either holds or slides. So it is decided once, by the loads that balance the
    forces of wheels which slide as they would under their loads at rest. Loads and forces of wheels that slide as
    decided then balance exactly, but where stiffness follows the load.

    Parameters
    ----------
    forces : function
        `wheel_forces` at an instant, with an eq. 16 that is fit for the loop. What laws add acts at the centre's
        height, as all does that is on no list.
    rims, angles, kept
        See `plane.module_wheels`.
    pitching : float
        1 where pitch reaches the wheels, 0 where it does not (`Robot.suspension`).
    """
    height = hooks.height(fx)
    levers = 0.25 * height / body.half_y, 0.25 * pitching * height / body.half_x
    by_r, by_l = moved_loads(forces, body, fx, levers, pairs, soils, motor, rims, angles, kept)
    right, left = pairs
    decided = (
        under(right, right.F_nf, right.F_nb, by_r.F_nf, by_r.F_nb),
        under(left, left.F_nf, left.F_nb, by_l.F_nf, by_l.F_nb),
    )
    return moved_loads(forces, body, fx, levers, decided, soils, motor, rims, angles, kept)


@inlined
def generalised_forces(body, p, fx, trig, right, left, pairs, module, w):
    """Eqs 17, 18: the wheels' forces on one module's x, y, z, alpha, beta, gamma, also into the row.

    They act u_w ahead of the wheel centres (eq. 20).

    Parameters
    ----------
    trig : tuple of 4 floats
        Sine and cosine of the module's roll and of its yaw.
    right, left : PairForces
    pairs : tuple of 2 WheelPair
        Right and left.

    Returns
    -------
    tuple of 5 floats
        Without that on beta, which is zero.
    """
    (s_a, c_a, s_g, c_g), (pair_r, pair_l) = trig, pairs
    across_f = c_a * (right.F_tf + left.F_tf) - s_a * (pair_r.F_nf + pair_l.F_nf)
    across_b = c_a * (right.F_tb + left.F_tb) - s_a * (pair_r.F_nb + pair_l.F_nb)
    F_n_right, F_n_left = pair_r.F_nf + pair_r.F_nb, pair_l.F_nf + pair_l.F_nb
    f_x, f_y = right.F_l + left.F_l, across_f + across_b
    m_g = (
        (body.half_x + p.u_w) * across_f - (body.half_x - p.u_w) * across_b + body.half_y * c_a * (right.F_l - left.F_l)
    )
    if fx is not None:
        m_g += (right.u_f - p.u_w) * (c_a * right.F_tf - s_a * pair_r.F_nf)
        m_g += (right.u_b - p.u_w) * (c_a * right.F_tb - s_a * pair_r.F_nb)
        m_g += (left.u_f - p.u_w) * (c_a * left.F_tf - s_a * pair_l.F_nf)
        m_g += (left.u_b - p.u_w) * (c_a * left.F_tb - s_a * pair_l.F_nb)
    x, y = c_g * f_x - s_g * f_y, s_g * f_x + c_g * f_y
    z = s_a * (right.F_tf + left.F_tf + right.F_tb + left.F_tb) + c_a * (F_n_right + F_n_left)
    m_a = body.half_y * (F_n_left - F_n_right)
    o = Q_C + 6 * module
    w[o], w[o + 1], w[o + 2], w[o + 3], w[o + 4], w[o + 5] = x, y, z, m_a, 0.0, m_g
    return x, y, z, m_a, m_g
