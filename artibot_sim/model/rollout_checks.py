"""What `rollout` is asked for: modes, steps and rows, checked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.model.commands import Commands
from artibot_sim.model.effects import at_work
from artibot_sim.model.param_types import Params
from artibot_sim.model.params import params
from artibot_sim.model.robot import Robot
from artibot_sim.model.stability import largest_step
from artibot_sim.model.state import State, initial_state
from artibot_sim.model.transmission import Mode

Array = NDArray[np.float64]

INTEGRATORS = ("rk4", "semi_implicit")

DEFAULT_MODES = (Mode.PRESCRIBED, Mode.PRESCRIBED, Mode.TORQUE, Mode.TORQUE)
"""As in the paper: front motors follow their profile, back motors share their torque."""


def default_modes(robot: Robot) -> tuple[Mode, Mode, Mode, Mode]:
    """As in the paper, but front motors that an effect limits are driven: prescribed ones know no limit."""
    if any(effect.drives_front for effect, _ in at_work(robot.effects).values()):
        return Mode.DRIVEN, Mode.DRIVEN, *DEFAULT_MODES[2:]
    return DEFAULT_MODES


def chosen_modes(robot: Robot, commands: Commands, modes: Mode | Sequence[Mode] | None) -> tuple[Mode, ...]:
    """The four modes asked for, or the default ones; those moved by speed must have speeds in `commands`."""
    chosen = (
        default_modes(robot) if modes is None else (modes,) * 4 if isinstance(modes, Mode) else tuple(map(Mode, modes))
    )
    if len(chosen) != 4:
        raise ArtibotError(f"modes: {len(chosen)} given; expected one, or four in the order of MOTORS")
    names = ("front_right", "front_left", "back_right", "back_left")[: 4 if robot.articulated else 2]
    for name, mode, given in zip(names, chosen, commands.commanded, strict=False):
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


def number_of_steps(duration: float, dt: float) -> int:
    """Steps in a duration (s)."""
    if not (math.isfinite(duration) and duration >= 0):
        raise ArtibotError(f"duration: {duration} s; expected a finite time of at least 0")
    return round(duration / dt)


class Setup(NamedTuple):
    """What is to be simulated, checked: `p` and `modes` as the kernel takes them, `kappa`, where from, how far."""

    robot: Robot
    commands: Commands
    p: Params
    modes: tuple[Mode, ...]
    kappa: float
    start: State
    steps: int


def prepare(
    robot: Robot, commands: Commands, dt: float, integrator: str, every: int, modes: Mode | Sequence[Mode] | None,
    kappa: float | None, state: State | None, duration: float | None,
) -> Setup:  # fmt: skip
    """Check what `rollout` is given, see there."""
    chosen = chosen_modes(robot, commands, modes)
    check_step(commands, dt, integrator, every)
    p = unlimited_beside_prescribed(params(robot), chosen)
    longest, mode = largest_step(p, integrator, chosen)
    if dt > longest:
        mend = "" if integrator == "semi_implicit" else ", or use the integrator 'semi_implicit'"
        raise ArtibotError(
            f"dt: {dt:g} s is unstable with '{integrator}'; expected at most {longest:.3g} s ({mode}); "
            f"take a shorter step{mend}"
        )
    share = robot.control.kappa if kappa is None else float(kappa)
    if not 0.0 < share <= 1.0:
        raise ArtibotError(f"kappa: {share:g}; expected a share of the front module in (0, 1] (eq. 29)")
    start = initial_state(robot, t=commands.t0) if state is None else state
    steps = number_of_steps(commands.duration if duration is None else duration, dt)
    return Setup(robot, commands, p, chosen, share, start, steps)


def driven_by(commands: Commands) -> tuple[Array, Array, Array]:
    """Positions, velocities and torques (n, 4) as the kernel takes them: zeros where none are commanded.

    All can be written, as those of `Stepper` are: numba compiles anew for one that cannot.
    """
    given = np.array(commands.commanded)
    position, velocity = np.where(given, commands.position, 0.0), np.where(given, commands.velocity, 0.0)
    return position, velocity, commands.torque.copy()
