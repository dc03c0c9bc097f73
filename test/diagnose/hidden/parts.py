"""What a rover is made of, as numbers: modules, ground, gears, and whatever is hidden."""

from __future__ import annotations

from math import inf
from typing import NamedTuple

GRAVITY = 9.81


class Body(NamedTuple):
    """A module with its wheels: m (kg), J_z about its centre of mass (kg m²), half wheel spacings and l (m), centre."""

    m: float
    J_z: float
    half_x: float
    half_y: float
    l: float  # noqa: E741 - the paper's symbol
    c_x: float = 0.0
    c_y: float = 0.0


class Ground(NamedTuple):
    """Contact parameters of eqs 15 to 20."""

    k_l: float
    k_t: float
    mu_s: float
    mu_d: float
    u_w: float


class Gear(NamedTuple):
    """A motor with its gear; J_w is that of both wheels."""

    tau: float
    eta_d: float
    eta_r: float
    J_m: float
    J_w: float


class Hidden(NamedTuple):
    """What acts besides the paper's model; SI units, in the order of the contract, then what is on no list."""

    front_max: float = inf
    stall: float = inf
    no_load: float = inf
    drag_motor: float = 0.0
    drag: float = 0.0
    drag_fades: float = inf  # s, time constant
    pull_x: float = 0.0  # m/s², gravity along the ground
    pull_y: float = 0.0
    gravity: float = GRAVITY  # m/s², what is left of it normal to the ground
    push_x: float = 0.0
    push_y: float = 0.0
    patch_scale: float = 1.0
    patch_x: float = 0.0
    patch_y: float = 0.0
    patch_radius: float = 0.0
    softening: float = 0.0
    back_scale: float = 1.0
    stribeck: float = 0.0
    bulldozing: float = 0.0
    relaxation: float = 0.0
    rolling_speed: float = 0.0
    joint_friction: float = 0.0
    joint_damping: float = 0.0
    joint_stiffness: float = 0.0
    joint_stop: float = inf
    yaw_drag: float = 0.0
    wander: tuple[float, float, float, float, float, float] = (0.0,) * 6  # two waves: N m, rad/s, rad
    ridge: float = 0.0
    ridge_x: float = 0.0  # rad/m
    ridge_y: float = 0.0
    ridge_phase: float = 0.0
    lame_wheel: float = 0.0
    lame: float = 0.0
    lame_phase: float = 0.0
    runout: float = 0.0
    runout_wheel: float = 0.0
    runout_phase: float = 0.0
    tether: float = 0.0
    tether_x: float = 0.0
    tether_y: float = 0.0
    preload: float = 0.0
    air: float = 0.0
    gyre: float = 0.0  # N m s²/(m rad)
    creep: float = 0.0  # N s/m, above
    creep_from: float = 0.0  # m/s
    hysteresis: float = 0.0  # N m/rad
    bristle: float = 0.0  # N m, at most
    bristle_angle: float = 1.0  # rad
    hose: float = 0.0  # N m/rad
    hose_time: float = 1.0  # s
    grease: float = 0.0  # N m, of motor
    grease_motor: float = 0.0
    grease_turns: float = 1.0  # rad
    skid: float = 0.0  # N s/m
    skid_wheel: float = 0.0
    growing: float = 0.0  # N/s
    bog: float = 0.0  # N, beyond
    bog_x: float = 0.0  # m


class Rover(NamedTuple):
    """All that is constant over a run; r_right and r_left are the wheels' radii, share is eq. 30's factor."""

    front: Body
    back: Body
    soil: Ground
    front_gear: Gear
    back_gear: Gear
    r_right: float
    r_left: float
    share: float
    hidden: Hidden
