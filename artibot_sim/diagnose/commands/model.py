"""How front motors respond to commands, as numbers, and the speeds that these predict."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from artibot_sim.diagnose.commands.data import CommandData, H
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
    """

    rate: float = math.inf
    threshold: float = 0.0
    lag: float = 0.0
    delay: float = 0.0
    scale: float = 1.0
    clock: float = 0.0
    filter: float = 0.0


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


def response_of(effects: Mapping[str, Values]) -> CommandResponse:
    """The response that a robot's effects make."""
    values = {
        field: float(effects[effect][parameter])
        for effect, (parameter, field) in PARAMETERS.items()
        if effect in effects and EFFECTS[effect].active(effects[effect])
    }
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


def predicted_speeds(data: CommandData, response: CommandResponse, speed: Array | None = None) -> Array:
    """Speeds that are measured if the motors respond so, rad/s, shape (n,); `speed` is what `followed` gave."""
    speed = followed(data.command, response, data.begins) if speed is None else speed
    speed = speed if data.rise else lagging(speed, response.filter)
    at = np.clip(data.at - (response.delay + response.clock) / H, 0.0, len(speed) - 1.000001)
    i = at.astype(np.int64)
    share = at - i
    if not data.rise:
        return response.scale * (speed[i] + share * (speed[i + 1] - speed[i])).mean(axis=1)
    turned = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))))
    angle = turned[i] + share * (speed[i] + 0.5 * share * (speed[i + 1] - speed[i]))
    return response.scale * (angle[:, 1] - angle[:, 0]) / (data.at[:, 1] - data.at[:, 0])
