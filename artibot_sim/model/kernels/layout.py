"""Where each quantity stands in the kernel's arrays, and what it is called outside.

The state is ``q`` (16,) and ``v`` (16,), eqs 10 and 11. Beside it the kernel fills a row ``w`` with every
physical contribution under its own name; :data:`COLUMNS` lists them in order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.robot.robot import MOTORS, WHEELS

X, Y, Z, ALPHA, BETA, GAMMA, THETA_R, THETA_L = range(8)
BACK = 8
"""Offset of the back module's coordinates."""

FRONT, BEHIND = np.int64(0), np.int64(1)
"""The modules. Not Python's integers, for each of whose values numba would compile every function anew."""

MOTOR = tuple(map(np.int64, range(4)))
"""Numbers of the motors, likewise."""

NOUGHT = np.int64(0)
"""Where a loop begins to count, likewise: what it calls with the count would be compiled for 0, then for others."""

COORDINATES = tuple(
    f"{symbol}_{module}{side}"
    for module in "fb"
    for symbol, side in (
        ("x", ""), ("y", ""), ("z", ""), ("alpha", ""), ("beta", ""), ("gamma", ""), ("theta", "r"), ("theta", "l"),
    )
)  # fmt: skip
"""Names of the generalised coordinates."""

MOTOR_COORDINATES = (6, 7, 14, 15)
"""Where the motors' angles stand in ``q``, in the order of MOTORS."""

MEMORY = 32
"""What eight wheels remember, in the order of WHEELS: lateral forces that lag (N), how far they are wound up (−1 to 1),
how far bristles are bent along the wheels and then across them (m). Some effects alone know it."""

_POSE = tuple(f"{symbol}_{module}" for module in "fb" for symbol in ("x", "y", "z", "alpha", "beta", "gamma"))

# The row of named contributions. Offsets are compile-time constants of the kernel.
P_X = 0  # velocity of the wheel centre along and across its plane, m/s (8 each)
P_Y = 8
F_N = 16  # contact forces after saturation, N (8 each)
F_L = 24
F_T = 32
SAT = 40  # 1 where eq. 16 has cut the force, else 0
M_M = 48  # motor torque, N m (4 each)
M_R = 52  # torque of the contact forces on the wheels' axle, N m
ETA = 56  # efficiency that entered eq. 21: eta_d or 1/eta_r
Q_G = 60  # generalised forces of gravity, of the contacts and of the joint, N and N m (12 each)
Q_C = 72
Q_J = 84
LAMBDA = 96  # Lagrange multipliers of eq. 13 (4)
ACC = 100  # accelerations of the 16 coordinates
M_D = 116  # of effects: drag on the motors, N m (4); torque in the joint's yaw, N m; force on the front module, N (2)
M_J = 120
PUSH = 121
LOAD = 123  # of effects: forces along x and y of `map` and yaw moment of each module, N and N m (3 each)
ROW = 129

COLUMNS: tuple[str, ...] = (
    *(f"p_x_{wheel}" for wheel in WHEELS),
    *(f"p_y_{wheel}" for wheel in WHEELS),
    *(f"F_n_{wheel}" for wheel in WHEELS),
    *(f"F_l_{wheel}" for wheel in WHEELS),
    *(f"F_t_{wheel}" for wheel in WHEELS),
    *(f"sat_{wheel}" for wheel in WHEELS),
    *(f"M_m_{motor}" for motor in MOTORS),
    *(f"M_r_{motor}" for motor in MOTORS),
    *(f"eta_{motor}" for motor in MOTORS),
    *(f"Q_gravity_{name}" for name in _POSE),
    *(f"Q_contact_{name}" for name in _POSE),
    *(f"Q_joint_{name}" for name in _POSE),
    *(f"lambda_{i}" for i in range(1, 5)),
    *(f"{name}_ddot" for name in COORDINATES),
    *(f"M_drag_{motor}" for motor in MOTORS),
    "M_joint",
    "push_x",
    "push_y",
    *(f"load_{name}_{module}" for module in "fb" for name in ("x", "y", "gamma")),
)
"""Names of the row's entries."""

# Energies, accumulated since the start of a rollout (J). Put in: motors. The rest is where it went.
E_MOTOR = 0
E_GEAR = 4
E_SLIP_L = 8
E_SLIP_T = 16
E_OFFSET = 24
E_ROLLING = 32
E_NORMAL = 40
E_TILT = 48
E_JOINT = 56
E_DRAG = 57  # of effects
E_ARTICULATION = 61
E_PUSH = 62
ENERGIES = 63

ENERGY_COLUMNS: tuple[str, ...] = (
    *(f"E_motor_{motor}" for motor in MOTORS),
    *(f"E_gear_{motor}" for motor in MOTORS),
    *(f"E_slip_l_{wheel}" for wheel in WHEELS),
    *(f"E_slip_t_{wheel}" for wheel in WHEELS),
    *(f"E_offset_{wheel}" for wheel in WHEELS),
    *(f"E_rolling_{wheel}" for wheel in WHEELS),
    *(f"E_normal_{wheel}" for wheel in WHEELS),
    *(f"E_tilt_{wheel}" for wheel in WHEELS),
    "E_joint",
    *(f"E_drag_{motor}" for motor in MOTORS),
    "E_articulation",
    "E_push",
)
"""Names of the energies: put in by the motors (and, for `E_push`, by an external force), then dissipated, or for
`E_joint` done by the constraint, or for `E_articulation` taken by torques in the joint (a spring gives its part back).
"""

assert len(COLUMNS) == ROW and len(ENERGY_COLUMNS) == ENERGIES


# ----------------------------------------------------------------------
# What loops take. Of a rover of one or two modules; of more modules `train_layout` says how the arrays are shaped.
# ----------------------------------------------------------------------


class RunState(NamedTuple):
    """What a loop advances in place.

    Attributes
    ----------
    q, v : array, shape (16,)
    eta, previous : array, shape (4,)
        Efficiencies for the next step, and motor torques of the step before (N m).
    behind : array, shape (4,)
        Integrals of the speeds' errors (rad) that velocity loops hold; only effects know them.
    """

    q: NDArray[np.float64]
    v: NDArray[np.float64]
    eta: NDArray[np.float64]
    previous: NDArray[np.float64]
    behind: NDArray[np.float64]


class KernelInputs(NamedTuple):
    """How each motor is moved, and what is commanded.

    Attributes
    ----------
    modes : array of int, shape (4,)
    position, velocity, torque_d : array, shape (n, 4)
        At knots (`Grid.knot_steps`); the first is at the start. A torque of NaN is eq. 30's.
    share : float, or of more than two modules array, shape (modules,)
        Factor of eq. 30, see `transmission.back_torque_factor` and `transmission.torque_factors`.
    """

    modes: NDArray[np.int64]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    torque_d: NDArray[np.float64]
    share: float | NDArray[np.float64]


class Grid(NamedTuple):
    """Steps of `dt` (s): how many, after how many a row is kept, and after how many a knot of the commands stands."""

    dt: float
    steps: int
    every: int
    knot_steps: int


class RowTables(NamedTuple):
    """Tables that a loop fills: coordinates and rates (rows, 16), and the named contributions (rows, ROW)."""

    q: NDArray[np.float64]
    v: NDArray[np.float64]
    w: NDArray[np.float64]
