"""How front motors respond to commands, as numbers, and the speeds that these predict."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from artibot_sim.diagnose.commands.data import CommandData, H
from artibot_sim.diagnose.commands.loop import LOOP
from artibot_sim.model.effects import EFFECTS, Values
from artibot_sim.model.effects.command_rate_limit import on_ramp
from artibot_sim.model.effects.deadband import outside
from artibot_sim.model.effects.speed_loop_lag import weights
from artibot_sim.model.kernels.compilation import kernel

Array = NDArray[np.float64]


class CommandResponse(NamedTuple):
    """What happens to commands, in this order, and to what encoders record.

    Attributes
    ----------
    rate : float
        Largest change of a command, rad/s².
    threshold : float
        Speeds commanded below it give no motion, rad/s.
    lag : float
        Time constant, s.
    delay : float
        s.
    scale : float
        Recorded over true speed.
    clock : float
        s by which the stamps of measurements are late compared with those of commands: no effect, for nobody knows
        stamps better than that.
    filter : float
        Time constant of a low-pass on recorded speeds, s; angles know nothing of it.
    droop : float
        Speed by which a motor falls short for each N m that its velocity loop has not taken up yet, rad/s.
    integral : float
        Rate at which that loop takes it up, 1/s.
    windup : float
        Largest torque that it takes up, N m.
    """

    rate: float = math.inf
    threshold: float = 0.0
    lag: float = 0.0
    delay: float = 0.0
    scale: float = 1.0
    clock: float = 0.0
    filter: float = 0.0
    droop: float = 0.0
    integral: float = 0.0
    windup: float = math.inf


FILTER = "velocity_filter"
"""Effect that smooths recorded speeds, by id: what angles say of it is not sought between commands and motors."""
PARAMETERS = {
    "command_rate_limit": ("rate", "rate"),
    "deadband": ("threshold", "threshold"),
    "speed_loop_lag": ("time_constant", "lag"),
    "command_delay": ("delay", "delay"),
    "encoder_scale": ("scale", "scale"),
}
"""Effect → its parameter, and what it is called in a `CommandResponse`."""


_INSIDE = 1.000001
"""How far before the end of a grid the last place is between two of its points, in steps."""
SMOOTHED = 3
"""Samples of torques that are averaged: a velocity loop's motors are behind by little in less time."""


def response_of(effects: Mapping[str, Values]) -> CommandResponse:
    """The response that a robot's effects make."""
    values = {
        field: float(effects[effect][parameter])
        for effect, (parameter, field) in PARAMETERS.items()
        if effect in effects and EFFECTS[effect].active(effects[effect])
    }
    if LOOP in effects and EFFECTS[LOOP].active(effects[LOOP]):
        loop = effects[LOOP]
        values |= {"droop": 1.0 / float(loop["gain"]), "integral": float(loop.get("integral", 0.0))}
        values |= {"windup": float(loop.get("windup", math.inf))}
    return CommandResponse(**values, filter=float(effects.get(FILTER, {}).get("time_constant", 0.0)))


def followed(command: Array, response: CommandResponse, begins: Iterable[int] = (0,)) -> Array:
    """What motors do that are given a command (g,) on a grid H apart, before any delay, rad/s.

    The laws are those of the effects. Of several parts, which begin at the places `begins`, one after the other each is
    forgotten within the guard before the next; a ramp, which may take longer than that, begins anew.
    """
    speed = ramped(command, response.rate, begins)
    if response.threshold > 0.0:
        speed = outside(speed, response.threshold)
    return lagging(speed, response.lag)


def lagging(speed: Array, time_constant: float) -> Array:
    """Speeds (g,) on a grid H apart through a first-order low-pass that has settled at the first."""
    if time_constant <= 1e-4:
        return speed
    fresh, last, kept = weights(time_constant, H)
    settled = np.array([(last + kept) * speed[0]])
    return np.asarray(lfilter([fresh, last], [1.0, -kept], speed, zi=settled)[0])


def ramped(command: Array, rate: float, begins: Iterable[int] = (0,)) -> Array:
    """Commands (g,) on a grid H apart that change by at most `rate` (rad/s²), each part from its own first one."""
    if not np.isfinite(rate):
        return command
    wanted, out, now = np.array(command)[:, np.newaxis], np.empty((len(command), 1)), np.empty(1)
    _on_ramps(wanted, rate * H, np.array([*begins, len(command)], np.int64), now, out)
    return out[:, 0]


@kernel
def _on_ramps(wanted: Array, most: float, edges: NDArray[np.int64], now: Array, out: Array) -> None:
    """Part by part as `on_ramp`; `edges` are where parts begin, and where the last one ends."""
    for part in range(len(edges) - 1):
        begin, end = edges[part], edges[part + 1]
        now[0] = wanted[begin, 0]
        on_ramp(wanted[begin:end], most, now, out[begin:end])


def left_to_take_up(data: CommandData, integral: float, windup: float) -> Array:
    """Recorded torques (n,) less what the integral of a velocity loop has taken up of them (1/s), N m.

    The loop asks for gain · (e + integral · ∫ e dt), e being the speed by which its motor falls short, so that
    de/dt + integral · e is the torque's rate over the gain. It has settled where a part begins, and takes up no more
    than `windup` (N m); where no torque is known nothing is missing. Torques are noisier than speeds, so it is averaged
    over SMOOTHED samples.
    """
    out, smooth = np.empty(len(data)), np.empty(len(data))
    _pass_high(np.ascontiguousarray(data.torque), data.middle, data.whole[:, 0], integral, windup, out)
    _averaged(out, data.whole[:, 0], smooth)
    return smooth


@kernel
def _pass_high(torque: Array, t: Array, goes_on: NDArray[np.bool_], integral: float, windup: float, out: Array) -> None:
    for k in range(len(torque)):
        if not math.isfinite(torque[k]):
            out[k] = 0.0
        elif k == 0 or not goes_on[k] or not math.isfinite(torque[k - 1]):
            out[k] = 0.0 if integral > 0.0 else torque[k]
        else:
            step = integral * (t[k] - t[k - 1])
            mean = -math.expm1(-step) / step if step > 1e-6 else 1.0
            out[k] = math.exp(-step) * out[k - 1] + mean * (torque[k] - torque[k - 1])
        if integral > 0.0 and abs(torque[k] - out[k]) > windup:
            out[k] = torque[k] - math.copysign(windup, torque[k] - out[k])


@kernel
def _averaged(values: Array, goes_on: NDArray[np.bool_], out: Array) -> None:
    """Means over SMOOTHED samples around each, of one part only."""
    for k in range(len(values)):
        first = last = k
        for _ in range(SMOOTHED // 2):
            first -= 1 if first > 0 and goes_on[first] else 0
            last += 1 if last + 1 < len(values) and goes_on[last + 1] else 0
        out[k] = values[first : last + 1].mean()


def predicted_speeds(data: CommandData, response: CommandResponse, speed: Array | None = None) -> Array:
    """Speeds that are measured if the motors respond so, rad/s, shape (n,); `speed` is what `followed` gave."""
    found = _set_speeds(data, response, speed)
    if response.droop > 0.0:
        found = found - response.scale * response.droop * left_to_take_up(data, response.integral, response.windup)
    return found


def _set_speeds(data: CommandData, response: CommandResponse, speed: Array | None) -> Array:
    """Speeds that a response predicts of motors which never fall short of what their loops are asked for."""
    speed = followed(data.command, response, data.begins) if speed is None else speed
    speed = speed if data.rise else lagging(speed, response.filter)
    late = (response.delay + response.clock) / H
    if data.rise:
        turned, found = np.empty(len(speed)), np.empty(len(data))
        _mean_speeds(speed, data.at, late, turned, found)
        return response.scale * found
    at = np.clip(data.at - late, 0.0, len(speed) - _INSIDE)
    i = at.astype(np.int64)
    return response.scale * (speed[i] + (at - i) * (speed[i + 1] - speed[i])).mean(axis=1)


@kernel
def _mean_speeds(speed: Array, at: Array, late: float, turned: Array, out: Array) -> None:
    """Mean speeds (n,) between two places `at` (n, 2) of a grid of speeds (g,), straight between, that come `late`.

    `turned` (g,) is the angle at the places of the grid, in steps of it.
    """
    turned[0] = 0.0
    for k in range(1, len(speed)):
        turned[k] = turned[k - 1] + 0.5 * (speed[k] + speed[k - 1])
    last = len(speed) - _INSIDE
    for row in range(len(at)):
        begin, end = at[row, 0], at[row, 1]
        angle = 0.0
        for sign, place in ((-1.0, begin), (1.0, end)):
            place = min(max(place - late, 0.0), last)
            i = int(place)
            share = place - i
            angle += sign * (turned[i] + share * (speed[i] + 0.5 * share * (speed[i + 1] - speed[i])))
        out[row] = angle / (end - begin)
