"""Simulate: `rollout` checks what it is given, runs the compiled loop and names what comes out."""

from __future__ import annotations

import enum
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.model.analysis.stability import (
    RELAXATION,
    largest_step,
    limited_by,
    number_of_parts,
    parts,
    relaxation_limit,
)
from artibot_sim.model.effects import at_work, has_memory, record
from artibot_sim.model.equations.kinematics import articulation, articulations
from artibot_sim.model.equations.transmission import Mode, back_torque_factor, torque_factors
from artibot_sim.model.ground.raster import BEYOND, WALL, Ground, Surface, sample
from artibot_sim.model.kernels.layout import (
    ALPHA,
    BACK,
    BETA,
    COLUMNS,
    COORDINATES,
    ENERGIES,
    ENERGY_COLUMNS,
    F_N,
    GAMMA,
    LOAD,
    M_M,
    MOTOR_COORDINATES,
    PUSH,
    ROW,
    SAT,
    THETA_R,
    Grid,
    KernelInputs,
    RowTables,
    RunState,
    Z,
)
from artibot_sim.model.kernels.train_layout import Places, places, symbol
from artibot_sim.model.robot.derived import on_ground, packed, params, train
from artibot_sim.model.robot.parameters import ModuleParams, Params, Train
from artibot_sim.model.robot.robot import MOTORS, Robot, module_name
from artibot_sim.model.simulate import trains
from artibot_sim.model.simulate.commands import Commands
from artibot_sim.model.simulate.state import State, at_rest_on_a_plane, from_memory, initial_state

# ----------------------------------------------------------------------
# What `rollout` is asked for: modes, steps and rows, checked.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]

INTEGRATORS = ("rk4", "semi_implicit")

DEFAULT_MODES = (Mode.PRESCRIBED, Mode.PRESCRIBED, Mode.TORQUE, Mode.TORQUE)
"""As in the paper: front motors follow their profile, back motors share their torque."""


def default_modes(robot: Robot) -> tuple[Mode, ...]:
    """As in the paper, but front motors that an effect limits are driven: prescribed ones know no limit.

    Motors behind the back module share their torque as the back ones do.
    """
    front, behind = DEFAULT_MODES[:2], (Mode.TORQUE,) * (len(robot.motors) - 2)
    if any(effect.drives_front for effect, _ in at_work(robot.effects).values()):
        front = Mode.DRIVEN, Mode.DRIVEN
    return *front, *behind


_MOST_PARTS = 100
"""Parts of a step at most into which RK4 is cut. On stiff ground as many are needed; gears, lines and loops of small
motors ask for thousands, and semi-implicit steps take these implicitly."""


def integration(
    robot: Robot, dt: float, modes: tuple[Mode, ...] | None = None, kappa: float | None = None,
    ground: Ground | None = None,
) -> tuple[str, float]:  # fmt: skip
    """The integrator and the step (s) to simulate a robot with, whole numbers of which make `dt` (s).

    RK4, which on stiff ground is nearer to the paper's equations at about the same cost, with the longest step that is
    stable. Semi-implicit steps of `dt` where these would be very short.

    Parameters
    ----------
    robot : Robot
    dt : float
    modes : tuple of Mode, optional
        As for `rollout`; the default ones.
    kappa : float, optional
        As for `rollout`; the robot's own.
    ground : Ground, optional

    Returns
    -------
    {"rk4", "semi_implicit"}
    float
    """
    if robot.trailing:
        return "rk4", dt  # trains' loops cut its steps themselves
    chosen = default_modes(robot) if modes is None else modes
    p = unlimited_beside_prescribed(on_ground(params(robot), ground, robot.wheel.r_w), chosen)
    longest, motion = largest_step(p, "rk4", chosen, back_torque_factor(robot, kappa))
    if dt > _MOST_PARTS * longest:
        return "semi_implicit", dt
    return "rk4", dt / number_of_parts(dt, 1.0 / longest, motion)


def chosen_modes(robot: Robot, commands: Commands, modes: Mode | Sequence[Mode] | None) -> tuple[Mode, ...]:
    """The modes asked for, or the default ones; those moved by speed must have speeds in `commands`."""
    motors = robot.motors
    given_modes = (modes,) * len(motors) if isinstance(modes, Mode) else modes
    chosen = default_modes(robot) if given_modes is None else tuple(map(Mode, given_modes))
    if len(chosen) != len(motors):
        expected = "four in the order of MOTORS" if len(motors) == 4 else f"{len(motors)}: {', '.join(motors)}"
        raise ArtibotError(f"modes: {len(chosen)} given; expected one, or {expected}")
    names = motors if robot.articulated else motors[:2]
    commanded = commands.commanded + (False,) * (len(motors) - len(commands.commanded))
    for name, mode, given in zip(names, chosen, commanded, strict=False):
        if mode != Mode.TORQUE and not given:
            raise ArtibotError(f"commands.velocity: no speeds for {name}, which is {mode.name}; give its column")
    return chosen


def unlimited_beside_prescribed(p: Params, modes: tuple[Mode, ...]) -> Params:
    """Motors that share the torque of prescribed ones, which have no limit, have none themselves."""
    if Mode.DRIVEN in modes[:2]:
        return p
    right = p.right_back if modes[2] == Mode.DRIVEN else p.right_back._replace(torque_max=math.inf)
    left = p.left_back if modes[3] == Mode.DRIVEN else p.left_back._replace(torque_max=math.inf)
    return p._replace(right_back=right, left_back=left)


def check_step(commands: Commands, dt: float, integrator: str, every: int) -> None:
    """Refuse an integrator that is unknown, and a step or a distance of rows that cannot be."""
    if integrator not in INTEGRATORS:
        raise ArtibotError(f"integrator: '{integrator}'; expected one of {', '.join(INTEGRATORS)}")
    if not (math.isfinite(dt) and dt > 0):
        raise ArtibotError(f"dt: {dt} s; expected a finite step greater than 0, such as 0.001 s")
    ratio = commands.dt / dt
    if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6:
        raise ArtibotError(f"dt: {dt:g} s does not divide the commands' knot spacing of {commands.dt:g} s")
    if not (isinstance(every, int | np.integer) and every >= 1):
        raise ArtibotError(f"every: {every!r}; expected a number of steps of at least 1")


_MOST_STEPS = 10**10
"""Steps that take more than an hour."""

_MOST_MEMORY = 0.5
"""Share of the machine's memory that the rows of one rollout may take."""


def number_of_steps(duration: float, dt: float, every: int = 1, modules: int = 2) -> int:
    """Steps in a duration (s); so many that they, or the rows kept each `every` of them, are too many are refused."""
    if not (math.isfinite(duration) and duration >= 0):
        raise ArtibotError(f"duration: {duration} s; expected a finite time of at least 0")
    if duration / dt > _MOST_STEPS:
        raise ArtibotError(
            f"duration: {duration:g} s at a dt of {dt:g} s are {duration / dt:.3g} steps; expected at most "
            f"{_MOST_STEPS:.0e}; take a longer step or simulate a shorter time"
        )
    steps = round(duration / dt)
    needed = 4 * modules * (32 + ROW + ENERGIES) * (steps / every)
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if needed > _MOST_MEMORY * memory:
        raise ArtibotError(
            f"every: {steps / every:.3g} rows, one each {every} of {steps:.3g} steps, take {needed / 2**30:.0f} GiB; "
            f"expected at most {_MOST_MEMORY * memory / 2**30:.0f} GiB; keep fewer rows or simulate a shorter time"
        )
    return steps


def fastest_wheel(robot: Robot, p: Params | Train, commands: Commands, modes: tuple[Mode, ...]) -> float:
    """The highest speed at a rim that the commands ask of a motor which follows them, m/s."""
    if isinstance(p, Train):
        all_sides = [unit for module in p.modules for unit in (module.right_front, module.left_front)]
        motors = [all_sides[side] for side in trains.sides(robot)]
    else:
        motors = [p.right_front, p.left_front, p.right_back, p.left_back]
    driven = [i for i, given in enumerate(commands.commanded) if given and modes[i] != Mode.TORQUE]
    return max(
        (motors[i].r_w * motors[i].tau * float(np.abs(commands.velocity[:, i]).max()) for i in driven), default=0.0
    )


class RolloutSetup(NamedTuple):
    """What is to be simulated, checked: `p` and `modes` as the kernel takes them, `kappa`, where from, how far.

    Of a train `modes` are those of its motors. `ground` is None where it is flat.
    """

    robot: Robot
    commands: Commands
    p: Params | Train
    modes: tuple[Mode, ...]
    kappa: float
    start: State
    steps: int
    ground: Ground | None = None


def prepare(
    robot: Robot, commands: Commands, dt: float, integrator: str, every: int, modes: Mode | Sequence[Mode] | None,
    kappa: float | None, state: State | None, duration: float | None, ground: Ground | None = None,
) -> RolloutSetup:  # fmt: skip
    """Check what `rollout` is given, see there."""
    chosen = chosen_modes(robot, commands, modes)
    check_step(commands, dt, integrator, every)
    if robot.trailing:
        trains.inputs_of(robot, commands)
    elif commands.velocity.shape[1] != len(MOTORS):
        raise ArtibotError(
            f"commands: {commands.velocity.shape[1]} columns; robot '{robot.name}' takes {len(MOTORS)}: "
            f"{', '.join(MOTORS)}"
        )
    share = robot.control.kappa if kappa is None else float(kappa)
    if not 0.0 < share <= 1.0:
        raise ArtibotError(f"kappa: {share:g}; expected a share of the front module in (0, 1] (eq. 29)")
    if ground is not None and robot.trailing:
        raise ArtibotError(
            f"ground: robot '{robot.name}' has {len(robot.modules)} modules; uneven ground is for robots of one or two"
        )
    p = _numbers(robot, chosen, ground)
    longest, mode = _longest(robot, p, commands, integrator, chosen, share)
    if dt > longest and not (integrator == "rk4" and mode != RELAXATION and robot.trailing):
        mend = "" if integrator == "semi_implicit" else ", or use the integrator 'semi_implicit'"

        def longest_of(other: Robot) -> float:
            return _longest(other, _numbers(other, chosen, ground), commands, integrator, chosen, share)[0]

        what = limited_by(robot, mode, longest_of)
        raise ArtibotError(
            f"dt: {dt:g} s is unstable with '{integrator}'; expected at most {longest:.3g} s ({what}); "
            f"take a shorter step{mend}"
        )
    if state is not None:
        start = state
    elif ground is None and isinstance(p, Params):
        start = at_rest_on_a_plane(robot, p, (0.0, 0.0, 0.0), 0.0, commands.t0)
    else:
        start = initial_state(robot, t=commands.t0, ground=ground)
    if len(start.q) != 8 * max(2, len(robot.modules)):
        raise ArtibotError(
            f"state: {len(start.q)} coordinates; robot '{robot.name}' has {8 * max(2, len(robot.modules))}"
        )
    steps = number_of_steps(commands.duration if duration is None else duration, dt, every, max(2, len(robot.modules)))
    return RolloutSetup(robot, commands, p, chosen, share, start, steps, ground)


def _numbers(robot: Robot, modes: tuple[Mode, ...], ground: Ground | None) -> Params | Train:
    """A robot's numbers as the kernel takes them, without limits of torque where a motor is prescribed."""
    if robot.trailing:
        return trains.unlimited_beside_prescribed(train(robot), trains.by_side(robot, modes))
    return unlimited_beside_prescribed(on_ground(params(robot), ground, robot.wheel.r_w), modes)


def _longest(
    robot: Robot, p: Params | Train, commands: Commands, integrator: str, modes: tuple[Mode, ...], kappa: float
) -> tuple[float, str]:
    """Longest stable step (s) of what is to be simulated, and which motion sets it; `p` are the robot's `_numbers`."""
    if isinstance(p, Train):
        common = p.modules[0]
        longest, motion = largest_step(p, integrator, trains.by_side(robot, modes), torque_factors(robot, kappa))
    else:
        common = p
        longest, motion = largest_step(p, integrator, modes, back_torque_factor(robot, kappa))
    if integrator == "rk4" and common.relaxation > 0.0:
        limit = relaxation_limit(common, fastest_wheel(robot, p, commands, modes))
        return min((longest, motion), (limit, RELAXATION))
    return longest, motion


def driven_by(commands: Commands) -> tuple[Array, Array, Array]:
    """Positions, velocities and torques (n, 4) as the kernel takes them: zeros where none are commanded.

    All can be written, as those of `Stepper` are: numba compiles anew for one that cannot.
    """
    position, velocity = commands.position.copy(), commands.velocity.copy()
    for motor, given in enumerate(commands.commanded):
        if not given:
            position[:, motor] = velocity[:, motor] = 0.0
    return position, velocity, commands.torque.copy()


# ----------------------------------------------------------------------
# Simulate: `rollout` checks what it is given, runs the compiled loop and names what comes out.
# ----------------------------------------------------------------------


__all__ = ["DEFAULT_MODES", "INTEGRATORS", "Rollout", "Status", "rollout", "unlimited_beside_prescribed"]


class Status(enum.IntEnum):
    """How a rollout ended: at its end, or where the model no longer holds.

    DIVERGED left the finite world; TIPPED rolled or pitched over; AIRBORNE has a module in the air; INVALID breaks an
    assumption of the model, which the message names.
    """

    OK = 0
    DIVERGED = 1
    TIPPED = 2
    AIRBORNE = 3
    INVALID = 4


FASTEST = 50.0
"""Speed of a module (m/s) beyond which no rover drives: eqs 15 and 16 are laws of wheels that roll and slide slowly."""

HARDEST = 20.0
"""Force of effects on a module over its weight beyond which its wheels do not carry their static load: on flat ground
the model transfers none (section 4.3)."""

TIPPED_AT = 1.0
"""Roll or pitch of a module (rad) from which it lies rather than stands; the wheels' contact knows no sides."""


def _bodies(p: Params | Train) -> list[ModuleParams]:
    if isinstance(p, Train):
        return [module.front for module in p.modules]
    return [p.front, p.back][: 2 if p.two else 1]


def first_fault(
    p: Params | Train, robot: Robot, q: Array, v: Array, w: Array | None, t: Array, ground: Surface | None = None
) -> tuple[int, Status, str] | None:  # fmt: skip
    """The first of the rows where the model does not hold, how, and a line for a person; None if it does.

    Rows are those of q and v (n, 16) and of the named contributions (n, ROW), None where they end in a divergence:
    speeds and forces then tell of that alone.

    On flat ground the modules' pitch does not reach the wheels (section 4.3), so that what would pitch over is known
    before it moves.
    """
    x = robot.effects.get("com_offset", {}).get("x", 0.0)
    bodies = _bodies(p)
    plain = x == 0.0 and ground is None
    if plain and w is not None and isinstance(p, Params):
        pushed = w[:, PUSH:ROW] if robot.effects else None
        if _far_from_faults(p, bodies, robot.wheel.r_w, q, v, pushed):
            return None
    found: list[tuple[int, Status, str]] = []
    if abs(float(x)) >= bodies[0].half_x:
        wheels = f"the wheels at ±{bodies[0].half_x:g} m; two of them would carry less than nothing"
        found.append(
            (0, Status.INVALID, f"effects.com_offset.x: {x:g} m is beyond {wheels}, and the model has no pitch")
        )
    for i, body in enumerate(bodies):
        name, b = module_name(i), BACK * i
        if ground is None:
            found += _fallen(body, robot.wheel.r_w, name, q[:, b : b + 6], t)
        else:
            loads = None if w is None else w[:, F_N + 4 * i : F_N + 4 * i + 4]
            found += _fallen_over(ground, body, robot.wheel.r_w, name, q[:, b : b + 6], loads, t)
        if w is not None:
            at = (places(len(bodies)) if isinstance(p, Train) else _TWO_MODULES).columns
            pushes = [(f"load_x_{symbol(i)}", f"load_y_{symbol(i)}"), *([("push_x", "push_y")] if i == 0 else [])]
            force = np.sum([[w[:, at[x][1]], w[:, at[y][1]]] for x, y in pushes], axis=0)
            g_z = (p.modules[0] if isinstance(p, Train) else p).g_z
            found += _overstrained(body.m * abs(g_z), name, v[:, b : b + 2].T, force, t)
    return min(found) if found else None


def _far_from_faults(
    p: Params, bodies: list[ModuleParams], r_w: float, q: Array, v: Array, pushed: Array | None
) -> bool:
    """Whether no row is near a fault, by the largest value that each quantity has in any of them; not where one is NaN.

    `pushed` are the effects' forces, None of a robot without effects.

    A rover that is stepped asks hundreds of times a second. Two components of a speed within 0.7 of its limit do not
    exceed it together, nor do the four of a force within 0.3.
    """
    at, speed = _largest(q), _largest(v)
    if pushed is not None:
        force, hard = _largest(pushed), 0.3 * HARDEST * min(body.m for body in bodies) * abs(p.g_z)
        if not all(force[i] <= hard for i in _FORCES):
            return False
    return all(
        at[b + ALPHA] <= TIPPED_AT
        and at[b + BETA] <= TIPPED_AT
        and at[b + Z] <= body.r_0 + r_w
        and speed[b] <= 0.7 * FASTEST
        and speed[b + 1] <= 0.7 * FASTEST
        for b, body in zip((0, BACK), bodies, strict=False)
    )


_FORCES = tuple(place - PUSH for place in (PUSH, PUSH + 1, LOAD, LOAD + 1, LOAD + 3, LOAD + 4))


def _largest(rows: Array) -> list[float]:
    """The largest absolute value in each column; NaN where there is one.

    NumPy takes the largest row by row, and rows are short: several count as one until the end, a quarter of the time.
    """
    values = np.abs(rows)
    if len(rows) > 1:
        width, several = rows.shape[1], math.isqrt(len(rows))
        cut = len(rows) - len(rows) % several
        folded = values[:cut].reshape(-1, several * width).max(axis=0).reshape(several, width)
        values = np.concatenate((folded, values[cut:])).max(axis=0, keepdims=True)
    found: list[float] = values[0].tolist() if len(values) else [0.0] * rows.shape[1]
    return found


def _fallen(body: ModuleParams, r_w: float, name: str, q: Array, t: Array) -> Iterator[tuple[int, Status, str]]:
    """Where a module, by its six coordinates q (n, 6), lies or is in the air."""
    z, alpha, height = q[:, Z], q[:, ALPHA], body.r_0 + r_w
    yield from _tipped(name, q, t)
    if z.max(initial=0.0) > height:
        lifted = z - body.half_y * np.abs(np.sin(alpha)) > height
        if lifted.any():
            yield _airborne(int(np.argmax(lifted)), name, t)


def _tipped(name: str, q: Array, t: Array) -> Iterator[tuple[int, Status, str]]:
    tilt = np.maximum(np.abs(q[:, ALPHA]), np.abs(q[:, BETA]))
    if tilt.max(initial=0.0) > TIPPED_AT:
        row = int(np.argmax(tilt > TIPPED_AT))
        what = f"rolls or pitches by more than {TIPPED_AT:g} rad"
        yield row, Status.TIPPED, f"tipped over at {t[row]:.3f} s: the {name} module {what}"


def _airborne(row: int, name: str, t: Array) -> tuple[int, Status, str]:
    what = "is in the air with all wheels, by more than their radius"
    return row, Status.AIRBORNE, f"left the ground at {t[row]:.3f} s: the {name} module {what}"


def _fallen_over(
    ground: Surface, body: ModuleParams, r_w: float, name: str, q: Array, loads: Array | None, t: Array
) -> Iterator[tuple[int, Status, str]]:
    """Where a module lies or is in the air on uneven ground.

    `loads` (n, 4) are those of its wheels (N), None where they tell nothing.
    """
    yield from _tipped(name, q, t)
    if loads is None:
        return
    for row in np.flatnonzero(loads.max(axis=1) <= 0.0):
        x, y, z, alpha, beta, gamma = q[row]
        ends = np.array([[1, 1, -1, -1], [1, -1, 1, -1]]) * [[body.half_x], [body.half_y]]
        c, s = math.cos(gamma), math.sin(gamma)
        highest = sample(ground, x + c * ends[0] - s * ends[1], y + s * ends[0] + c * ends[1])[0].max()
        if z - body.half_y * abs(math.sin(alpha)) - body.half_x * abs(math.sin(beta)) - highest > body.r_0 + r_w:
            yield _airborne(int(row), name, t)
            return


def _overstrained(
    weight: float, name: str, velocity: Array, force: Array, t: Array
) -> Iterator[tuple[int, Status, str]]:  # fmt: skip
    """Where a module of this `weight` (N) is faster or pushed harder than can be, by its velocity and force (2, n)."""
    push, speed = np.hypot(*force), np.hypot(*velocity)
    for where, what in (
        (
            push > HARDEST * weight,
            f"pushed by more than {HARDEST:g} times its weight; wheels carry their static load",
        ),
        (speed > FASTEST, f"faster than {FASTEST:g} m/s; contact (eqs 15, 16) is that of wheels that drive slowly"),
    ):
        if where.any():
            row = int(np.argmax(where))
            yield row, Status.INVALID, f"broke an assumption at {t[row]:.3f} s: the {name} module is {what}"


_PLACES = {
    **{name: ("q", i) for i, name in enumerate(COORDINATES)},
    **{f"{name}_dot": ("v", i) for i, name in enumerate(COORDINATES)},
    **{name: ("row", i) for i, name in enumerate(COLUMNS)},
}
"""Column → the array of a Rollout that holds it, and where."""

_TWO_MODULES = Places(_PLACES, {name: ("energy", i) for i, name in enumerate(ENERGY_COLUMNS)})


def motor_coordinates(robot: Robot) -> list[int]:
    """Where the angles of `Robot.motors` stand in a state."""
    if not robot.trailing:
        return list(MOTOR_COORDINATES)
    return [8 * (side // 2) + THETA_R + side % 2 for side in trains.sides(robot)]


def torque_columns(robot: Robot) -> tuple[list[int], int]:
    """Where the torques of `Robot.motors` stand in a rollout's row, and how long that is."""
    if not robot.trailing:
        return list(range(M_M, M_M + 4)), ROW
    columns = places(len(robot.modules)).columns
    width = 1 + max(i for table, i in columns.values() if table == "row")
    return [columns[f"M_m_{motor}"][1] for motor in robot.motors], width


def side_gears(robot: Robot) -> Array:
    """Wheel speed over the speed that stands in a state, of each side of all modules (of two at least)."""
    drive = robot.drive
    first = [drive.front.tau] * 2 + [(drive.back or drive.front).tau] * 2
    return np.array(first + [tau for one in drive.trailing for tau in [1.0 if one is None else one.tau] * 2])


@dataclass(frozen=True)
class Rollout:
    """What a simulation gives: rows at ``t``, every quantity under its name (see `columns`).

    Attributes
    ----------
    status : Status
        Where it is not OK, rows end where the model ceased to hold: before a divergence (there are none where it began
        outside the finite world), with the first row of any other fault.
    message : str
        One line for a person.
    t : array, shape (n,), s
    q, v : array, shape (n, 16)
        Generalised coordinates and their rates; eight columns a module for a robot of more than two.
    row : array, shape (n, len(COLUMNS))
        Contributions by name; for a robot of more than two modules as `train_layout.places` has them.
    energy : array, shape (n, len(ENERGY_COLUMNS)) or None
        Energies since the start (J), where asked for.
    ground : Ground or None
        None where it is flat.
    final_state : State or None
        To go on from; None where it is not OK.
    """

    robot: Robot
    status: Status
    message: str
    t: Array
    q: Array
    v: Array
    row: Array
    energy: Array | None
    final_state: State | None
    modes: tuple[Mode, ...] = DEFAULT_MODES
    ground: Ground | None = None

    def __post_init__(self) -> None:
        for array in (self.t, self.q, self.v, self.row, self.energy):
            if array is not None:
                array.setflags(write=False)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names that ``rollout[name]`` knows."""
        columns, energies = self._places
        return tuple(columns if self.energy is None else columns | energies)

    @property
    def _places(self) -> Places:
        return places(len(self.robot.modules)) if self.robot.trailing else _TWO_MODULES

    def __getitem__(self, name: str) -> Array:
        columns, energies = self._places
        place = columns.get(name) or (None if self.energy is None else energies.get(name))
        if place is None:
            hint = "; pass energy=True to rollout for energies" if name in energies else ""
            raise ArtibotError(f"rollout: no column '{name}'; known: {', '.join(self.columns)}{hint}")
        table, column = place
        values: Array = getattr(self, table)[:, column]
        return values

    @property
    def pose(self) -> Array:
        """x, y (m) and yaw (rad) of the front module in `map`, shape (n, 3)."""
        return self.q[:, [0, 1, GAMMA]]

    @cached_property
    def twist(self) -> Array:
        """Forward and leftward velocity (m/s) and yaw rate (rad/s) of the front module, in its frame, (n, 3)."""
        c, s = np.cos(self.q[:, GAMMA]), np.sin(self.q[:, GAMMA])
        x, y = self.v[:, 0], self.v[:, 1]
        return np.column_stack([c * x + s * y, c * y - s * x, self.v[:, GAMMA]])

    @property
    def motor_position(self) -> Array:
        """Motor angles, rad, shape (n, 4), in the order of `Robot.motors`."""
        return self.q[:, self._motor_coordinates]

    @cached_property
    def _motor_coordinates(self) -> list[int]:
        return motor_coordinates(self.robot)

    @property
    def motor_velocity(self) -> Array:
        """Motor speeds, rad/s, shape (n, 4)."""
        return self.v[:, self._motor_coordinates]

    @property
    def motor_torque(self) -> Array:
        """Motor torques, N m, shape (n, 4)."""
        if self.robot.trailing:
            return self.row[:, torque_columns(self.robot)[0]]
        return self.row[:, M_M : M_M + 4]

    def _of_wheels(self, coordinates: Array) -> Array:
        turning = coordinates.reshape(len(coordinates), -1, 8)[:, :, THETA_R : THETA_R + 2]
        return np.repeat(turning.reshape(len(coordinates), -1) * side_gears(self.robot), 2, axis=1)

    @property
    def wheel_position(self) -> Array:
        """Wheel angles, rad, shape (n, 8), in the order of WHEELS."""
        return self._of_wheels(self.q)

    @property
    def wheel_velocity(self) -> Array:
        """Wheel speeds, rad/s, shape (n, 8)."""
        return self._of_wheels(self.v)

    @property
    def articulations(self) -> Array:
        """Yaw and roll of every joint, rad, shape (n, joints, 2): the module behind's less those of the one ahead."""
        joints = len(self.robot.modules) - 1
        return articulations(self.q)[:, : 2 * joints].reshape(len(self.q), joints, 2)

    @property
    def articulation_yaw(self) -> Array:
        """gamma_b − gamma_f, rad, shape (n,); the paper's gamma_r is its negative."""
        return articulation(self.q)[:, 0] if self.robot.articulated else np.zeros(len(self.t))

    @property
    def articulation_roll(self) -> Array:
        """alpha_b − alpha_f, rad, shape (n,)."""
        return articulation(self.q)[:, 1] if self.robot.articulated else np.zeros(len(self.t))


def rollout(
    robot: Robot,
    commands: Commands,
    *,
    dt: float = 1e-3,
    integrator: str = "rk4",
    every: int = 10,
    modes: Mode | Sequence[Mode] | None = None,
    kappa: float | None = None,
    state: State | None = None,
    duration: float | None = None,
    energy: bool = False,
    ground: Ground | None = None,
) -> Rollout:
    """Simulate a rover (eqs 1 to 30).

    Parameters
    ----------
    robot : Robot
    commands : Commands
        What the motors are commanded, from its ``t0``; `dt` must divide the spacing of its knots.
    dt : float
        Integration step, s.
    integrator : {"rk4", "semi_implicit"}
        Explicit fourth order, or one right-hand side a step with implicit wheel spin. A step of the latter is cut
        into as many parts as the ground's stiffness needs (`stability.parts`); of a robot of three modules or more one
        of the former, too, into as many as its quickest motion needs: the free wheels of a passive module are quick.
    every : int
        A row is kept each `every` steps, and at the end.
    modes : Mode or sequence of Mode, optional
        One for all, or one for each of `Robot.motors` (four, but for robots with more driven modules): how each motor
        is moved; front prescribed and those behind under torque by default, as in the paper (front driven where an
        effect limits them). Torque limits hold for motors that are driven, and for torques only beside driven ones:
        prescribed front motors have no limit, so their share has none.
    kappa : float, optional
        Front share of eq. 29, in (0, 1]; the robot's own by default.
    state : State, optional
        Where to start; at rest at the origin by default.
    duration : float, optional
        Length, s; that of `commands` by default. Past the last knot the commands stay.
    energy : bool
        Whether to account for the energy of every contribution.
    ground : Ground, optional
        Uneven ground, over which modules roll and pitch; flat by default. For robots of one or two modules.

    Raises
    ------
    ArtibotError
        Naming what is wrong, the value found, what is expected, and the mend.

    Notes
    -----
    The step before feeds back (Fig. 7): back torques of a step are eq. 30 of the front torques at the start of the
    step before, and the efficiencies are those of eq. 23 there. Both are in `State`, so a rollout continued from
    `final_state` at a knot equals one that was never cut, bit for bit.
    """
    setup = prepare(robot, commands, dt, integrator, every, modes, kappa, state, duration, ground)
    return simulate(setup, dt, integrator, every, energy)


def simulate(setup: RolloutSetup, dt: float, integrator: str, every: int, energy: bool) -> Rollout:
    """The rollout of a setup that was checked."""
    from artibot_sim.model.kernels import loop
    from artibot_sim.model.kernels.advance import advance

    robot, commands, p, modes, kappa, start, steps, ground = setup
    if isinstance(p, Train):
        sides = trains.inputs_of(robot, commands, trains.by_side(robot, modes), torque_factors(robot, kappa))
        grid = Grid(dt, steps, every, round(commands.dt / dt))
        found, kept, final = trains.run(robot, p, sides, start, grid, integrator, energy)
        return finished(setup, dt, integrator, every, kept, found, final)
    cut = 1
    if integrator == "semi_implicit":
        cut = parts(p, dt, back_torque_factor(robot, kappa))
    rows = -(-steps // every) + 1
    q, v, eta, torque, memory, behind = (
        array.copy() for array in (start.q, start.v, start.eta, start.torque, start.memory, start.behind)
    )
    fx = record(robot.effects, start.t)
    inputs = KernelInputs(np.array(modes, dtype=np.int64), *driven_by(commands), back_torque_factor(robot, kappa))
    grid = Grid(dt / cut, steps * cut, every * cut, round(commands.dt / dt) * cut)
    out = RowTables(*(np.empty((rows, width)) for width in (16, 16, ROW)))
    out_e = np.empty((rows, ENERGIES)) if energy else None
    given = RunState(q, v, eta, torque, behind), packed(p), inputs, grid, loop.workspace(), out, out_e
    effects: tuple[Any, ...] = ()
    if fx is not None:
        effects = fx, (memory,) if has_memory(robot.effects) else ()
    surface = None if ground is None else ground.under_wheels(robot.wheel.r_w)
    status, kept = advance(integrator, given, effects, surface)
    final = None
    if status == Status.OK:
        final = State(start.t + steps * dt, q, v, eta, torque, *from_memory(memory), behind)
    return finished(setup, dt, integrator, every, kept, (*out, out_e), final, surface)


def stopped(found: Array, ground: str) -> str | None:
    """What `Surface.found` says of how a run over `ground` ended, a line for a person; None if it did not end it."""
    what, x, y, _ = found.tolist()
    if what == 0.0:
        return None
    if what == BEYOND:
        return f"a wheel came to x {x:.2f} m, y {y:.2f} m, where the ground '{ground}' ends"
    met = "met a step of the ground higher than its axle" if what == WALL else "touched a face steeper than 79 degrees"
    return f"a wheel at x {x:.2f} m, y {y:.2f} m {met}; no wheel rolls there"


SPUN_UP = 5e5
"""Speed of a motor (rad/s), half of `loop.LIMIT`: one that is there when a rollout ends has sped up until then."""


def _spun_up(setup: RolloutSetup, v: Array, w: Array) -> str | None:
    """Which motor has spun up by the last row of a rollout that ended, as its wheels slide; None if that is not why."""
    if setup.robot.trailing:
        return None
    motor = max(range(4), key=lambda i: abs(v[MOTOR_COORDINATES[i]]))
    speed, wheel = abs(v[MOTOR_COORDINATES[motor]]), 2 * motor
    others = np.delete(v, MOTOR_COORDINATES)
    if speed < SPUN_UP or np.abs(others).max() > FASTEST or not w[SAT + wheel : SAT + wheel + 2].all():
        return None
    by = ""
    if setup.modes[motor] == Mode.TORQUE and np.isnan(setup.commands.torque[:, motor]).all():
        by = f", eq. 30's share at a kappa of {setup.kappa:g},"
    return (
        f"the motor {MOTORS[motor]} had spun up to {speed:.2g} rad/s, for its wheels slide and {w[M_M + motor]:.3g} N m"
        f"{by} turn it without a limit; take another kappa, or less torque"
    )


def finished(
    setup: RolloutSetup, dt: float, integrator: str, every: int, kept: int,
    tables: tuple[Array, Array, Array, Array | None], final: State | None, surface: Surface | None = None,
) -> Rollout:  # fmt: skip
    """A rollout's result: the first `kept` rows of q, v, the named contributions and energies; diverged if not `final`.

    Rows from where the model does not hold on are left out.

    Tables have a row each `every` steps, and one for the end.
    """
    overflown = kept > 0 and not np.isfinite(tables[2][kept - 1]).all()  # at a state that is sound itself
    if overflown:
        kept, final = kept - 1, None
    count = -(-setup.steps // every) + 1
    t = setup.start.t + np.minimum(np.arange(count) * every, setup.steps)[:kept] * dt
    ended = None if surface is None or setup.ground is None else stopped(surface.found, setup.ground.name)
    if surface is not None and ended is not None and kept:
        t[-1] = setup.start.t + surface.found[3]
    if final is not None:
        message = f"{setup.steps} steps of {dt:g} s with {integrator}"
    elif overflown:
        at = setup.start.t + min(kept * every, setup.steps) * dt
        message = f"diverged at {at:.3f} s: a force on the rover is beyond all numbers; take effects of another size"
    elif not kept:
        message = "diverged before its first step: the state it starts from has a speed or angle that no rover has"
    elif (spun := _spun_up(setup, tables[1][kept - 1], tables[2][kept - 1])) is not None:
        message = f"diverged between {t[-1]:.3f} and {t[-1] + every * dt:.3f} s: {spun}"
    else:
        message = (
            f"diverged between {t[-1]:.3f} and {t[-1] + every * dt:.3f} s, at speeds up to "
            f"{np.abs(tables[1][kept - 1]).max():.2g} (m/s, rad/s); the linearised rover is stable at this step, so "
            f"try less extreme commands, another kappa or weaker effects before a shorter dt than {dt:g} s"
        )
    status = Status.DIVERGED if final is None else Status.OK
    if ended is not None:
        status, message = Status.INVALID, f"ended at {t[-1]:.3f} s: {ended}"
    strained = None if status == Status.DIVERGED else tables[2][:kept]
    rows = tables[0][:kept], tables[1][:kept], strained
    fault = first_fault(setup.p, setup.robot, *rows, t, surface) if kept else None
    if fault is not None:
        row, status, message = fault
        kept, final = row + 1, None
        t = t[:kept]
    q, v, w, e = (None if table is None else table[:kept] for table in tables)
    assert q is not None and v is not None and w is not None
    return Rollout(setup.robot, status, message, t, q, v, w, e, final, setup.modes, setup.ground)
