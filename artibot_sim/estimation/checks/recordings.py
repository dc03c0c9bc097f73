"""What is doubtful about recordings, before a cause is looked for in the rover: sentences for a person."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.checks.common_map import in_common_map, needed
from artibot_sim.estimation.checks.findings import COLUMNS, findings
from artibot_sim.estimation.checks.wheels import FACTOR_REFUSED, Rolled, clock_faults, rolled, wheel_faults
from artibot_sim.estimation.measurements import missing, other_robot, require_stretch, stretches
from artibot_sim.experiment import Channel, Experiment
from artibot_sim.experiment.columns import silences
from artibot_sim.experiment.measured import Measured
from artibot_sim.experiment.smoothing import fresh, noise_of
from artibot_sim.model import MOTORS, Robot
from artibot_sim.model.effects import EFFECTS

SHORT = 15.0
"""s of motion below which few parameters can be determined."""
_HELD = 0.2
"""Share of repeated samples that is said."""
_STUCK = 0.1
"""s for which a saturated sensor stands at its very largest value, at least."""
_STUCK_RUN = 5
"""Samples in which a saturated sensor stands at its very largest value, at least."""
_STANDS = 0.5
"""Share of the time at standstill that is said."""
_NOISY = 0.05
"""m of a position's noise that is said."""
_STILL = 1.0
"""rad/s below which a motor stands."""
_CREEP = 0.01
"""m/s of a wheel's rim, below which it stands."""
_ABOVE_NOISE = 4.0
"""Standard deviations of a wheel speed's noise, below which it stands."""

USED = ("motor_torques", "total_station", "ground_truth_odom", "imu", "joint_states", "motor_command")
"""Channels that are checked."""


def require_usable(recordings: Sequence[Experiment], robot: Robot) -> None:
    """Refuse recordings from which nothing can be learnt about this robot.

    Raises
    ------
    ArtibotError
        Naming the file, the topic, what was found and the mend.
    """
    if not recordings:
        raise ArtibotError("no recording; give at least one")
    for experiment in recordings:
        require_stretch(experiment, robot)
    for one, other in combinations(recordings, 2):
        if _same(one, other):
            again = "" if one.path == other.path else f" (as {one.path})"
            raise ArtibotError(
                f"{other.path}: given twice{again}; what is fitted to cannot be held out, or count double; "
                "parts of a recording are held out with --holdout-share 0.5"
            )
    require_fitting_wheels(recordings, robot)


def require_fitting_wheels(recordings: Sequence[Experiment], robot: Robot) -> None:
    """Refuse recordings in which nothing moves, or whose wheels cannot have been this robot's.

    Raises
    ------
    ArtibotError
        Naming the file, what was found and the mend.
    """
    found = [way for experiment in recordings if (way := rolled(experiment, robot)) is not None]
    for way in found:
        if not _foreign(way.factor):
            continue
        if lifted := [one for one in findings(way.experiment, robot) if one.name == "in_air"]:
            raise ArtibotError(f"{way.experiment.path}: {lifted[0]}")
        if way.guess(robot):
            raise ArtibotError(wrong_robot(way, robot))
    if not found:
        raise ArtibotError(
            f"{recordings[0].path}: the rover never moves: its wheels do not turn on "
            f"{recordings[0].channels['motor_torques'].topic}; record a drive"
        )
    factor = float(np.median([way.factor for way in found]))
    if _foreign(factor):
        way = min(found, key=lambda w: abs(np.log(w.factor / factor)))
        raise ArtibotError(wrong_robot(way, robot))


def _foreign(factor: float) -> bool:
    """Whether wheels and path do not fit, whatever slips."""
    return not 1.0 / FACTOR_REFUSED < factor < FACTOR_REFUSED


def _same(one: Experiment, other: Experiment) -> bool:
    """Whether two recordings hold the same measurements."""
    channels, others = one.channels, other.channels
    if one.start_ns != other.start_ns or channels.keys() != others.keys():
        return False
    return all(
        np.array_equal(channels[key].t, others[key].t)
        and channels[key].columns.keys() == others[key].columns.keys()
        and all(
            np.array_equal(channels[key].columns[name], others[key].columns[name], equal_nan=True)
            for name in channels[key].columns
        )
        for key in channels
    )


def wrong_robot(way: Rolled, robot: Robot) -> str:
    """One line on wheels that do not fit the path."""
    return (
        f"{way.experiment.path}: by robot '{robot.name}' its wheels rolled {way.wheels:.3g} m, but on "
        f"{way.source} it moved {way.path:.3g} m, a factor of {way.factor:.3g}{way.guess(robot)}; expected about 1; "
        "give the right robot with --robot, or mend the units"
    )


def data_warnings(
    recordings: Sequence[Experiment],
    robot: Robot,
    held: Sequence[Experiment] = (),
    found: Sequence[str] | None = None,
) -> tuple[str, ...]:
    """What is doubtful about recordings, one sentence each.

    Parameters
    ----------
    recordings : sequence of Experiment
    robot : Robot
    held : sequence of Experiment, optional
        Held out: of these only what is wrong with robot and wheels.
    found : sequence of str, optional
        What is wrong with the streams of `recordings`, where that is known already.
    """
    if found is None:
        found = [f"{one.name}: {finding}" for one in recordings for finding in findings(one, robot)]
    said = list(found)
    said += doubts(recordings, robot)
    if not in_common_map([*recordings, *held]):
        fixed = [name.replace("_", " ") for name in EFFECTS if needed(name)]
        said.append(
            "the segments of a recording have no map in common: their poses jump over the gaps, or all begin at one "
            f"place; so nothing that is fixed in the map is looked for ({', '.join(fixed)})"
        )
    for experiment in held:
        said += [f"{experiment.name}: {word}" for word in other_robot(experiment, robot)]
        said += [f"{experiment.name}: {fault}" for fault in wheel_faults(experiment, robot)]
    return tuple(dict.fromkeys(said))


def doubts(recordings: Sequence[Experiment], robot: Robot) -> list[str]:
    """What is doubtful about recordings beside what has a name among the findings, one sentence each."""
    said: list[str] = []
    for experiment in recordings:
        said += [f"{experiment.name}: {fault}" for fault in _faults(experiment, robot)]
    said += _together(recordings, robot)
    return said


def _faults(experiment: Experiment, robot: Robot) -> Iterator[str]:
    """Of one recording."""
    yield from experiment.remarks
    yield from other_robot(experiment, robot)
    if len(experiment.segments) > 1 and not in_common_map([experiment]):
        yield f"{len(experiment.segments)} segments; a pose says nothing about the one before the gap"
    for key in USED:
        if key in experiment.channels:
            yield from _channel_faults(experiment.channels[key], experiment, key not in COLUMNS)
    yield from clock_faults(experiment)
    yield from wheel_faults(experiment, robot)


def _channel_faults(channel: Channel, experiment: Experiment, repeats: bool) -> Iterator[str]:
    """Gaps and stops of one topic; repetitions where the streams' comparison does not see them."""
    gaps = silences(channel, experiment.segments)
    if gaps:
        start, length = max(gaps, key=lambda gap: gap[1])
        more = f", and {len(gaps) - 1} shorter gaps" if len(gaps) > 1 else ""
        yield f"{channel.topic} is silent for {length:.1f} s from {start:.1f} s on{more}"
    held = _held(channel) if repeats else 0.0
    if held > _HELD:
        yield f"{channel.topic}: {100 * held:.0f} % of its samples repeat the one before; they count once"
    for name in (name for name in _LIVELY if name in channel):
        _, values = channel.series(name)
        if len(values) > _SOME and not np.ptp(values):
            yield f"{channel.topic}: {name} never changes: is the sensor connected?"
    for name in channel.columns:
        limit = _limit(channel, name, experiment.channels["motor_torques"])
        if limit is not None:
            yield f"{channel.topic}: {name} stands at ±{limit:.3g} for a while: is the sensor saturated?"


def _held(channel: Channel) -> float:
    """Share of samples that repeat the one before while others change; parts of a topic come in separate messages."""
    shares = []
    for name in channel.columns:
        _, values = channel.series(name)
        if len(values) > 20 and np.ptp(values) > 0:
            shares.append(1.0 - float(np.mean(fresh(values))))
    return min(shares, default=0.0)


_LIVELY = ("yaw_rate", "articulation_yaw.position")
"""Columns that change with every sample, if only by noise."""
_SOME = 50
"""Samples of such a column below which nothing is said of it."""
_LIMITED = ("yaw_rate", "ax", "ay", "articulation_yaw.position", "effort")
"""Ends of the names of columns that a sensor's range limits."""


def _limit(channel: Channel, name: str, motors: Channel) -> float | None:
    """The value at which a column stands as if cut off while motors turn, None where it does not."""
    if not name.endswith(_LIMITED):
        return None
    t, values = channel.series(name)
    if len(values) < 50 or np.ptp(values) <= 0:
        return None
    peak = float(np.abs(values).max())
    at = np.abs(values) >= peak * (1 - 1e-9)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], at.astype(int), [0]))))
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        long_enough = end - first >= _STUCK_RUN and t[end - 1] - t[first] >= _STUCK
        if long_enough and peak > 0 and _turning(motors, t[first], t[end - 1]):
            return peak
    return None


def _turning(motors: Channel, first: float, last: float) -> bool:
    """Whether motors turn all the time between two times, s."""
    part = motors.between(first, last)
    for motor in MOTORS[:2]:
        name = f"{motor}.velocity"
        if name in part and len(speed := part.series(name)[1]):
            return bool(np.abs(speed).min() > _STILL)
    return len(part) > 0


def _together(recordings: Sequence[Experiment], robot: Robot) -> Iterator[str]:
    """Of all recordings together: what they do not measure, how little was driven."""
    found = [stretch for experiment in recordings for stretch in stretches(experiment, robot)]
    absent = missing(found, robot)
    if absent:
        words = ", ".join(name.replace("_", " ") for name in absent)
        yield f"not measured: {words}; effects that show there only cannot be found"
    if not any("motor_command" in experiment.channels for experiment in recordings):
        yield "no /motor_command: delays, lags, dead bands and limits of the front drives cannot be determined"
    noise = [s.sigma for stretch in found for s in stretch.series if s.channel == "position"]
    if noise and np.median(noise) > _NOISY:
        yield f"positions are noisy: {float(np.median(noise)):.2g} m; small effects drown in it"
    moving, total = _moving(recordings, robot)
    if moving < SHORT:
        yield f"only {moving:.0f} s of motion; few parameters can be determined with less than {SHORT:g} s"
    elif moving < (1 - _STANDS) * total:
        yield f"the rover stands for {100 * (1 - moving / total):.0f} % of the time, which tells nothing"
    yield from _one_sided(recordings)


def _moving(recordings: Sequence[Experiment], robot: Robot) -> tuple[float, float]:
    """s in motion, and s in all."""
    moving, total = 0.0, 0.0
    still = _CREEP / (robot.drive.front.tau * robot.wheel.r_w)
    for experiment in recordings:
        motors = experiment.channels["motor_torques"]
        names = [f"{motor}.velocity" for motor in MOTORS if f"{motor}.velocity" in motors]
        duration = sum(last - first for first, last in experiment.segments)
        total += duration
        found = [motors.series(name) for name in names]
        shares = [
            float(np.mean(np.abs(speed) > max(still, _ABOVE_NOISE * noise_of(t, speed))))
            for t, speed in found
            if len(t)
        ]
        moving += duration * max(shares, default=1.0)
    return moving, total


def _one_sided(recordings: Sequence[Experiment]) -> Iterator[str]:
    """Too little turning, or turning one way only."""
    rates = []
    for experiment in recordings:
        for first, last in experiment.segments:
            rates.append(Measured(experiment, first, last).yaw_rate()[1].ravel())
    rate = np.concatenate(rates) if rates else np.empty(0)
    if not len(rate):
        return
    typical = float(np.sqrt(np.mean(rate**2)))
    turning = rate[np.abs(rate) > 0.5 * typical]
    if typical < 0.02:
        yield "the rover hardly turns: nothing pushes its wheels sideways; drive arcs to both sides as well"
    elif min(np.mean(turning > 0.0), np.mean(turning < 0.0)) < 0.02:
        side = "left" if np.mean(rate) > 0 else "right"
        yield f"the rover turns to the {side} only: what pulls it to one side looks like soil; drive both ways"
