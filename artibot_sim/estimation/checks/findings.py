"""What is wrong with a recording's clocks, signs and units, each with evidence, an interval and its mend.

No soil is fitted for it: the streams are held against each other (`estimation.streams`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.estimation.checks.clocks import delays, late_articulation, or_smoothed, skews
from artibot_sim.estimation.checks.comparisons import AGREES, Finding, StreamComparisons, agreeing, compare_streams
from artibot_sim.estimation.streams import (
    BLOCK,
    Delay,
    RunningSums,
    StreamSegment,
    advancing,
    agreement_beside_chance,
    delay_of,
    holding,
    reach,
    segments_of,
    turning,
)
from artibot_sim.experiment import Channel, Experiment
from artibot_sim.model import MOTORS, Robot

Array = NDArray[np.float64]

HELD_REPORTED = 0.2
"""Share of repeated samples from which on it is said."""
SCALE_REPORTED = 0.04
"""Gyroscope's scale beside 1, at the least."""
BIAS_REPORTED = 0.01
"""rad/s, of a gyroscope."""
TILT_REPORTED = 0.05
"""rad by which an accelerometer must lean, at the least that its interval allows."""
TURNED = 0.5
"""rad of lean from which another axis than z points up or down."""
UNIT_REPORTED = 1.5
"""Factor between rolled and gone."""
_ALIKE = 0.3
"""Known factors within this, as a logarithm, are named."""
_LEAP, _JITTER = 0.25, 0.25
"""m that a pose may move farther than the wheels' rims could, with stamps wrong by so many s."""
SHORTEST = 2.0
"""s between two leaps that are worth keeping."""
_CREPT = 0.05
"""m/s from which on a pose counts as moving."""
_SURE = 3.0
"""Standard deviations from which a coefficient has a sign."""
_AIR_WAY, _AIR_SHARE = 3.0, 0.15
"""m that wheels rolled while the rover went less than this share of it."""


def findings(experiment: Experiment, robot: Robot, streams: StreamComparisons | None = None) -> list[Finding]:
    """What is wrong with a recording, the serious first.

    Parameters
    ----------
    experiment : Experiment
    robot : Robot
    streams : StreamComparisons, optional
        What `compare_streams` found between its leaps.
    """
    of = streams or compare_streams(without_leaps(experiment, robot))
    found = [*_held(of), *_air(of, robot)]
    if not any(one.name == "in_air" for one in found):
        of, wrong = with_signs(of)
        found += [*wrong, *_units(of, robot), *_unrelated(of)]
    found += [*_gyro(of), *imu_tilt(experiment), *(or_smoothed(of, one) for one in delays(of)), *skews(of)]
    found += [*_leaps(experiment, of.pose_topic, robot), *_set_points(of)]
    if not any(one.serious or one.name == "set_points" for one in found):
        found += late_articulation(of, found)
    return sorted(found, key=lambda one: not one.serious)


# ----------------------------------------------------------------------
# Held samples, set-points for speeds, poses that leap.
# ----------------------------------------------------------------------

COLUMNS = {
    "motor_torques": tuple(f"{motor}.{what}" for motor in MOTORS[:2] for what in ("velocity", "position")),
    "ground_truth_odom": ("x", "y", "yaw"),
    "total_station": ("x", "y"),
    "imu": ("yaw_rate",),
    "joint_states": ("articulation_yaw.position",),
}


def _held(of: StreamComparisons) -> Iterator[Finding]:
    for key, names in COLUMNS.items():
        channel = of.experiment.channels.get(key)
        if channel is None:
            continue
        found = holding(channel, names)
        if found is not None and found.share > HELD_REPORTED:
            yield Finding(
                "held_samples", channel.topic, found.share, None, "-",
                f"{channel.topic}: {100 * found.share:.0f} % of its samples repeat the one before",
                f"it changes every {found.period:.2f} s and is written every {found.stamped:.3f} s",
                "each value counts once, when it changed",
            )  # fmt: skip


def _set_points(of: StreamComparisons) -> Iterator[Finding]:
    motors, command = of.experiment.channels.get("motor_torques"), of.experiment.channels.get("motor_command")
    if motors is None or command is None or f"{MOTORS[0]}.position" in motors:
        return
    equal = []
    for motor in MOTORS[:2]:
        name = f"{motor}.velocity"
        if name not in motors or name not in command:
            return
        asked, got = np.unique(command.series(name)[1]), motors.series(name)[1]
        got = got[np.abs(got) > 1e-3 * max(float(np.abs(got).max(initial=0.0)), 1e-9)]
        if len(got) < 50 or len(asked) < 5:
            return
        near = np.clip(np.searchsorted(asked, got), 1, len(asked) - 1)
        away = np.minimum(np.abs(asked[near] - got), np.abs(asked[near - 1] - got))
        equal.append(float(np.mean(away < 1e-6 * np.abs(got))))
    if min(equal) > 0.9:
        yield Finding(
            "set_points", motors.topic, min(equal), None, "-",
            f"{motors.topic} holds set-points, not measured speeds",
            f"{100 * min(equal):.0f} % of its values stand in {command.topic} as well, digit for digit",
            "record what the encoders measure",
        )  # fmt: skip


def _leaps(experiment: Experiment, topic: str, robot: Robot) -> Iterator[Finding]:
    leaps = leaps_of(segments_of(experiment), robot)
    if leaps:
        when = ", ".join(f"{after:.1f}" for _, after, _ in leaps[:4]) + (" …" if len(leaps) > 4 else "")
        yield Finding(
            "pose_leap", topic, float(len(leaps)), None, "-",
            f"{topic} leaps {len(leaps)} time{'s' if len(leaps) > 1 else ''}, "
            f"by up to {max(step for *_, step in leaps):.2g} m",
            f"at {when} s it moves farther than the wheels' rims",
            "leave those windows out; the localisation lost its place there",
        )  # fmt: skip


def leaps_of(segments: Sequence[StreamSegment], robot: Robot) -> list[tuple[float, float, float]]:
    """Where a pose moves farther than the wheels' rims: the times before and after (s), and by how much (m).

    None where it does so most of the time that it moves: then units or robot are wrong.
    """
    rim = robot.wheel.r_w * robot.drive.front.tau
    found: list[tuple[float, float, float]] = []
    moving = 0
    for segment in segments:
        points, wheels = segment.points, segment.wheels
        if points is None or len(points.t) < 3:
            continue
        step, dt = np.hypot(*np.diff(points.values, axis=0).T), np.diff(points.t)
        rolled = _rolled(wheels, points.t[:-1] - _JITTER, points.t[1:] + _JITTER) * rim if wheels is not None else 0.0
        noise = 8.0 * float(np.median(step)) if wheels is None else 0.0
        over = step - np.maximum(rolled * UNIT_REPORTED, noise) - _LEAP
        moved = step > 4.0 * np.median(step) if len(step) > 20 else np.ones(len(step), bool)
        for i in np.flatnonzero((over > 0.0) & moved & (dt < 1.0)).tolist():
            found.append((float(points.t[i]), float(points.t[i + 1]), float(step[i])))
        moving += len(np.unique(np.floor(points.t[1:][step > _CREPT * dt] / BLOCK)))
    return found if 2 * len({int(after / BLOCK) for _, after, _ in found}) < max(moving, 4) else []


def without_leaps(experiment: Experiment, robot: Robot) -> Experiment:
    """A recording whose segments end where its pose leaps: it has no relation to the one before.

    Pieces shorter than `SHORTEST` are left out.
    """
    leaps = leaps_of(segments_of(experiment), robot)
    found: list[tuple[float, float]] = []
    for first, last in experiment.segments:
        inside = [(before, after) for before, after, _ in leaps if first <= before < last]
        begins, ends = [first, *(after for _, after in inside)], [*(before for before, _ in inside), last]
        pieces = list(zip(begins, ends, strict=True))
        found += [(a, b) for a, b in pieces if b - a >= SHORTEST] if inside else pieces
    return replace(experiment, segments=tuple(found)) if leaps and found else experiment


def _rolled(wheels: RunningSums, begin: Array, end: Array) -> Array:
    """The larger angle that a wheel turned through between times (n,), back and forth counted both."""
    way = RunningSums(
        wheels.t, np.vstack([np.zeros((1, 2)), np.cumsum(np.abs(np.diff(wheels.values, axis=0)), axis=0)])
    )
    return np.asarray((way.at(end) - way.at(begin)).max(axis=1))


def _air(of: StreamComparisons, robot: Robot) -> Iterator[Finding]:
    rim = robot.wheel.r_w * robot.drive.front.tau
    rolled = gone = 0.0
    for segment in of.segments:
        points, wheels = segment.points, segment.wheels
        if points is None or wheels is None:
            continue
        at = np.arange(max(points.t[0], wheels.t[0]), min(points.t[-1], wheels.t[-1]), 1.0)
        if len(at) < 2:
            continue
        rolled += rim * float(np.abs(np.diff(wheels.at(at), axis=0)).mean(axis=1).sum())
        gone += float(np.hypot(*np.diff(points.at(at), axis=0).T).sum())
    explained = max((d.agreement for d in (of.turn, of.forward) if d is not None), default=1.0)
    if rolled > _AIR_WAY and gone < _AIR_SHARE * rolled and explained < 0.4:
        yield Finding(
            "in_air", of.pose_topic, gone / rolled, None, "-",
            "the wheels do not move the robot: it is lifted off the ground, or stuck",
            f"they rolled {rolled:.3g} m, {of.pose_topic} moved {gone:.3g} m, and not as they did",
            "record on the ground", serious=True,
        )  # fmt: skip


def _unrelated(of: StreamComparisons) -> Iterator[Finding]:
    """Neither places nor headings follow the wheels better than they follow the wheels' motion at other times."""
    if of.turn is None or of.forward is None or max(of.turn.agreement, of.forward.agreement) >= AGREES:
        return
    _, most = reach(of.segments)
    for pieces in (advancing(of.segments), turning(of.segments, "heading", "wheels")):
        agreement, chance = agreement_beside_chance(list(pieces), most, np.random.default_rng(of.seed))
        if agreement > chance.max():
            return
    both = agreeing(of.gyro_wheels)
    gyro = f"; gyroscope and wheels agree in {100 * both.agreement:.0f} %" if both else ""
    yield Finding(
        "unrelated_pose", of.pose_topic, max(of.turn.agreement, of.forward.agreement), None, "-",
        f"{of.pose_topic} does not move as the wheels do: headings in degrees, another robot's pose, or another time's",
        f"wheels explain {100 * of.forward.agreement:.0f} % of its positions, {100 * of.turn.agreement:.0f} % of its "
        f"turning, no more than of another time's{gyro}",
        "mend the units, or name the right topic with --topic", serious=True,
    )  # fmt: skip


# ----------------------------------------------------------------------
# Signs and units of the wheels and of the pose.
# ----------------------------------------------------------------------


def _pattern(delay: Delay) -> str | None:
    """Signs of the right and the left coefficient, such as "+-"; None where one is not sure."""
    pair, sd = delay.coefficients[:2], delay.spread[:2]
    sure = (np.abs(pair) > _SURE * sd) & (np.abs(pair) > 0.2 * np.abs(pair).max())
    return "".join("+" if c > 0 else "-" for c in pair) if sure.all() else None


def _signs(of: StreamComparisons) -> Iterator[Finding]:
    forward, turn = agreeing(of.forward), agreeing(of.turn) or agreeing(of.gyro_wheels)
    ahead = _pattern(forward) if forward else None
    about = _pattern(turn) if turn else None
    topic = of.experiment.require("motor_torques").topic
    shown = [f"of the positions {100 * forward.agreement:.0f} %" if forward else "",
             f"of the turning {100 * turn.agreement:.0f} %" if turn else ""]  # fmt: skip
    evidence = "so they explain " + " and ".join(word for word in shown if word)
    reversed_ = {("-+", "--"): [0], ("+-", "++"): [1], ("--", "-+"): [0, 1]}.get((ahead or "", about or ""))
    if reversed_:
        side = "both sides'" if len(reversed_) == 2 else f"the {('right', 'left')[reversed_[0]]} side's"
        yield Finding(
            "reversed_wheel", topic, -1.0, None, "-", f"{side} rotations have the wrong sign", evidence,
            "turn the sign in the recording, or with drive.front.polarity where it comes from the drive", serious=True,
            columns=_turned_back(of, reversed_),
        )  # fmt: skip
    elif about == "-+" and ahead in ("++", None):
        yield from _swapped(of, topic, evidence)
    elif about == "+-" and forward is None and (bend := _course(of)) is not None and bend < -0.5:
        yield _flipped_pose(of, f"its path turns against its own heading (correlation {bend:.2f})", "y")


def _swapped(of: StreamComparisons, topic: str, evidence: str) -> Iterator[Finding]:
    """Turning is against the wheels: either their sides or the sensor's sign are the wrong way round."""
    gyro, pose = agreeing(of.gyro), of.pose_topic
    if gyro is not None and gyro.coefficients[0] < 0 and of.gyro_wheels and _pattern(of.gyro_wheels) == "+-":
        # a heading that agrees with its own path is of a frame whose y points to the right
        frame = agreeing(of.forward) is not None
        yield (
            _flipped_pose(of, "gyroscope and wheels turn the other way", "y", "yaw")
            if frame
            else _flipped_pose(of, "gyroscope and wheels turn the other way", "yaw")
        )
    elif gyro is None and (bend := _course(of)) is not None and bend < -0.5:
        yield _flipped_pose(of, f"its own path turns the other way (correlation {bend:.2f})", "yaw")
    else:
        unseen = f", or y of {pose} points to the right; this recording looks the same" if gyro is None else ""
        yield Finding(
            "side_swap", topic, -1.0, None, "-", f"left and right wheels are taken for each other{unseen}", evidence,
            "exchange the two sides", serious=True, columns=_exchanged(of),
        )  # fmt: skip


_MIRRORED = {"y": ("y", "vy"), "yaw": ("yaw", "yaw_rate")}
"""Columns of a pose that change their sign with its y, or with its yaw."""


def _flipped_pose(of: StreamComparisons, evidence: str, *wrong: str) -> Finding:
    """The finding that a pose's y, its yaw or both have the wrong sign."""
    topic, channel = of.pose_topic, of.experiment.channels["ground_truth_odom"]
    said = {
        ("yaw",): f"the heading of {topic} has the wrong sign", ("y",): f"y of {topic} has the wrong sign",
        ("y", "yaw"): f"y and heading of {topic} have the wrong sign: its frame's z points down",
    }[wrong]  # fmt: skip
    columns = {name: (name, -1.0) for one in wrong for name in _MIRRORED[one] if name in channel.columns}
    return Finding(
        "pose_flip", topic, -1.0, None, "-", said, evidence, f"turn the sign of its {' and its '.join(wrong)}",
        serious=True, columns={"ground_truth_odom": columns},
    )  # fmt: skip


def _exchanged(of: StreamComparisons) -> dict[str, dict[str, tuple[str, float]]]:
    """Columns of the front motors under the other side's name, in all channels that have the rotations' sides.

    Commands have them unless rotations follow the other side's commands.
    """
    follows, other = _commanded(of), dict(zip(MOTORS[:2], MOTORS[1::-1], strict=True))
    keys = ["motor_torques", "motor_currents", *(["motor_command"] if np.trace(follows) >= follows.sum() / 2.0 else [])]
    return {
        key: {
            name: (f"{other[motor]}.{what}", 1.0)
            for name in channel.columns
            for motor, _, what in [name.partition(".")]
            if motor in other and f"{other[motor]}.{what}" in channel.columns
        }
        for key in keys if (channel := of.experiment.channels.get(key)) is not None
    }  # fmt: skip


def _turned_back(of: StreamComparisons, sides: Sequence[int]) -> dict[str, dict[str, tuple[str, float]]]:
    """Columns of the front motors of some sides (0 right, 1 left) with the other sign.

    Commands have it where rotations follow them with their sign.
    """
    follows = _commanded(of)
    wrong = {"motor_torques": sides, "motor_command": [side for side in sides if follows[side, side] > 0.0]}
    return {
        key: {
            name: (name, -1.0) for name in channel.columns if name.startswith(tuple(f"{MOTORS[i]}." for i in those))
        }
        for key, those in wrong.items() if those and (channel := of.experiment.channels.get(key)) is not None
    }  # fmt: skip


def _commanded(of: StreamComparisons) -> Array:
    """How the rotations of each side follow each side's commands: (2, 2), covariances of what they turn in a second."""
    found = np.zeros((2, 2))
    for segment in of.segments:
        wheels, command = segment.wheels, segment.command
        if wheels is not None and command is not None:
            at = np.arange(max(wheels.t[0], command.t[0]), min(wheels.t[-1], command.t[-1]), 1.0)
            turned, asked = (np.diff(one.at(at), axis=0) for one in (wheels, command))
            found += turned.T @ asked
    return found


def with_columns(experiment: Experiment, found: Sequence[Finding]) -> Experiment:
    """A recording with the columns that findings say it should have."""
    if not any(one.columns for one in found):
        return experiment
    channels = dict(experiment.channels)
    for one in found:
        for key, columns in one.columns.items():
            was = channels[key].columns
            channels[key] = replace(
                channels[key],
                columns={**was, **{name: factor * was[source] for name, (source, factor) in columns.items()}},
            )
    return replace(experiment, channels=channels)


def with_signs(of: StreamComparisons) -> tuple[StreamComparisons, list[Finding]]:
    """Comparisons of streams whose signs and sides are as they should be, and what was wrong with these."""
    wrong = list(_signs(of))
    if not any(one.columns for one in wrong):
        return of, wrong
    return compare_streams(with_columns(of.experiment, wrong), of.seed), wrong


def _course(of: StreamComparisons) -> float | None:
    """Correlation of how a pose's path turns with how its heading does; None where it hardly moves."""
    pairs = []
    for segment in of.segments:
        if segment.points is None or segment.heading is None:
            continue
        at = np.arange(segment.points.t[0], segment.points.t[-1], 0.5)
        if len(at) < 4:
            continue
        step = np.diff(segment.points.at(at), axis=0)
        far = np.hypot(*step.T) > 0.05
        way = np.arctan2(step[:, 1], step[:, 0])
        bend = np.arctan2(np.sin(np.diff(way)), np.cos(np.diff(way)))
        turned = 0.5 * np.diff(segment.heading.at(at)[:, 0])
        turned = turned[1:] + turned[:-1]
        used = far[1:] & far[:-1] & (np.abs(bend) < 1.0)
        pairs.append(np.column_stack([bend[used], turned[used]]))
    table = np.concatenate(pairs) if pairs else np.empty((0, 2))
    if len(table) < 30 or not table.std(axis=0).all():
        return None
    return float(np.corrcoef(table.T)[0, 1])


def _units(of: StreamComparisons, robot: Robot) -> Iterator[Finding]:
    forward = agreeing(of.forward)
    if forward is None:
        return
    tau, topic = robot.drive.front.tau, of.experiment.require("motor_torques").topic
    expected = robot.wheel.r_w * tau
    fitted = float(np.abs(forward.coefficients[:2]).sum())
    factor = expected / max(fitted, 1e-12)
    if 1.0 / UNIT_REPORTED < factor < UNIT_REPORTED:
        return
    known = {
        1.0 / tau: "these are speeds of wheels, not of motors", tau: "these are speeds of motors, not of wheels",
        60.0 / (2.0 * np.pi): "they are in rpm", 180.0 / np.pi: "they are in degrees",
        1.0 / (2.0 * np.pi): "they are in turns", 1e-3: "positions are in millimetres",
        1e-2: "positions are in centimetres",
    }  # fmt: skip
    away = {f: abs(float(np.log(factor / f))) for f in known if abs(np.log(f)) > _ALIKE}
    nearest = min(away, key=lambda f: away[f])
    sd = float(np.hypot(*forward.spread[:2])) / max(fitted, 1e-12)
    said = known[nearest] if away[nearest] < _ALIKE else "a wrong gear ratio, a wrong wheel radius or another robot"
    yield Finding(
        "wheel_units", topic, factor, (factor * (1 - 2 * sd), factor * (1 + 2 * sd)), "-",
        f"the wheels roll {factor:.3g} times as far as the robot goes: {said}",
        f"{1e3 * fitted:.3g} mm a radian fit, robot '{robot.name}' has {1e3 * expected:.3g}",
        "mend the units, or give the right robot with --robot", serious=True,
    )  # fmt: skip


# ----------------------------------------------------------------------
# The gyroscope.
# ----------------------------------------------------------------------


def _gyro(of: StreamComparisons) -> Iterator[Finding]:
    imu = of.experiment.channels.get("imu")
    if imu is None or not of.segments:
        return
    topic, direct, by_wheels = imu.topic, agreeing(of.gyro), agreeing(of.gyro_wheels)
    if direct is None and by_wheels is None:
        yield from _other_axis(of, topic)
        return
    if direct is not None:
        scale, sd = float(direct.coefficients[0]), max(float(direct.spread[0]), 0.003)
        turned = agreeing(of.turn)
        if scale < 0 and not (turned and _pattern(turned) == "-+"):
            yield _flipped(topic, f"{of.pose_topic} turns the other way, by {-scale:.3g} times as much")
        size = 1.0 / max(abs(scale), 1e-9)
        low, high = size * (1 - 2 * sd / abs(scale)), size * (1 + 2 * sd / abs(scale))
        if low > 1.0 + SCALE_REPORTED or high < 1.0 - SCALE_REPORTED:
            unit = ": it is in degrees" if 0.8 < size / (180 / np.pi) < 1.25 else ""
            yield Finding(
                "gyro_scale", topic, size, (low, high), "-", f"the gyroscope shows {size:.3g} times the yaw rate{unit}",
                f"against the heading of {of.pose_topic}", "divide its rates by this", serious=bool(unit),
            )  # fmt: skip
        bias = -float(direct.coefficients[1]) / scale
        wide = 2.0 * float(direct.spread[1]) / abs(scale) + 5e-4
        if abs(bias) - wide > BIAS_REPORTED:
            yield Finding(
                "gyro_bias", topic, bias, (bias - wide, bias + wide), "rad/s",
                f"the gyroscope shows {bias:.3g} rad/s too much", f"against the heading of {of.pose_topic}",
                "take it off",
            )  # fmt: skip
    elif by_wheels is not None and _pattern(by_wheels) == "-+" and not _heading_against_wheels(of):
        yield _flipped(topic, "the wheels turn the other way")


def _heading_against_wheels(of: StreamComparisons) -> bool:
    turn = agreeing(of.turn)
    return turn is not None and _pattern(turn) == "-+"


GYRO_TURNED = {"imu": {"yaw_rate": ("yaw_rate", -1.0)}}
"""Columns of a gyroscope that is upside down as they should be."""


def _flipped(topic: str, evidence: str) -> Finding:
    return Finding(
        "gyro_flip", topic, -1.0, None, "-", "the gyroscope's yaw rate has the wrong sign: it is upside down", evidence,
        "turn its sign", serious=True, columns=GYRO_TURNED,
    )  # fmt: skip


def _other_axis(of: StreamComparisons, topic: str) -> Iterator[Finding]:
    """The axis of the IMU that does show the turning, where z does not."""
    axes = of.segments[0].gyro_axes
    for i, name in enumerate(axes[:-1]):
        _, most = reach(of.segments)
        pieces = [
            type(p)(p.end, p.begin, p.y, RunningSums(s.gyro.t, s.gyro.values[:, [i]]))
            for s in of.segments if s.gyro is not None for p in turning([s], "heading", "gyro")
        ]  # fmt: skip
        found = agreeing(delay_of(pieces, most, np.random.default_rng(of.seed), trend=True)) if pieces else None
        if found is not None and found.agreement > 0.8:
            sign = "" if found.coefficients[0] > 0 else ", with its sign turned"
            yield Finding(
                "gyro_axis", topic, float(found.coefficients[0]), None, "-",
                f"the yaw rate stands in the gyroscope's {name}{sign}, not in its yaw_rate: the IMU is turned",
                f"it explains {100 * found.agreement:.0f} % of the turning", "turn the IMU's axes", serious=True,
            )  # fmt: skip
            return


RATES, ACCELERATIONS = ("roll_rate", "pitch_rate", "yaw_rate"), ("ax", "ay", "az")
_GRAVITY = (8.5, 11.1)
"""m/s² between which a mean specific force lies that is gravity's."""
_STRAIGHT = 0.1
"""rad/s of an IMU that does not turn."""
_SPACED = 10.0
"""s that count as one independent piece of a recording's accelerations."""


def upward(imu: Channel) -> tuple[Array, float] | None:
    """Where up is in an accelerometer's axes, as its mean says: a unit vector (3,), and how well it is known, rad.

    The mean is that of samples without a turn: a centripetal acceleration would not average out. Nor does the mean
    slope of the ground. None without accelerations, or where their mean is not as long as gravity.
    """
    if not set(ACCELERATIONS) <= set(imu.columns):
        return None
    force = np.column_stack([imu[name] for name in ACCELERATIONS])
    turning = np.nansum([imu[name] ** 2 for name in RATES if name in imu], axis=0) ** 0.5
    known = np.isfinite(force).all(axis=1) & (turning < _STRAIGHT)
    t, force = imu.t[known], force[known]
    block = np.floor(t / _SPACED)
    pieces = [force[block == one].mean(axis=0) for one in np.unique(block)]
    if len(pieces) < 2:
        return None
    mean = np.mean(pieces, axis=0)
    length = float(np.linalg.norm(mean))
    if not _GRAVITY[0] < length < _GRAVITY[1]:
        return None
    sd = float(np.linalg.norm(np.std(pieces, axis=0, ddof=1))) / length / len(pieces) ** 0.5
    return mean / length, sd


def imu_tilt(experiment: Experiment) -> Iterator[Finding]:
    """An IMU that is mounted at an angle, by the direction of gravity in its axes."""
    imu = experiment.channels.get("imu")
    seen = upward(imu) if imu is not None else None
    if imu is None or seen is None:
        return
    up, sd = seen
    tilt = float(np.arccos(np.clip(up[2], -1.0, 1.0)))
    low, high = max(tilt - 2.0 * sd, 0.0), tilt + 2.0 * sd
    if low < TILT_REPORTED:
        return
    i = int(np.argmax(np.abs(up)))
    axis = f"{'-' if up[i] < 0 else ''}{'xyz'[i]}"
    if tilt < TURNED:
        said = f"the accelerometer leans by {tilt:.2f} rad ({low:.2f}–{high:.2f}): it, or the robot, is not level"
        mend = "turn its axes until gravity is along z"
    else:
        said = f"the IMU's {axis} axis points up: it is " + ("upside down" if axis == "-z" else "turned")
        mend = "turn the IMU's axes"
    yield Finding(
        "imu_tilt", imu.topic, tilt, (low, high), "rad", said,
        f"up is ({up[0]:.2f}, {up[1]:.2f}, {up[2]:.2f}) in its axes by the mean of its specific force", mend,
        serious=tilt >= TURNED,
    )  # fmt: skip


def level(imu: Channel) -> Channel:
    """An IMU's channel in axes of which z points up, as its accelerometer says; as it is where that cannot be said.

    Turned the shortest way, so that x stays ahead where the IMU leans a little; rates are turned along where all three
    were measured. One that is upside down stays as it is: which way it was turned over nothing here tells, and the sign
    of its yaw rate shows by itself.
    """
    seen = upward(imu)
    if seen is None or seen[0][2] < -np.cos(TURNED):
        return imu
    up, _ = seen
    if up[2] < np.cos(TURNED) and not all(np.isfinite(imu[name]).any() for name in RATES if name in imu):
        return imu
    about = np.array([up[1], -up[0], 0.0])  # turns `up` into z
    cross = np.array([[0.0, 0.0, about[1]], [0.0, 0.0, -about[0]], [-about[1], about[0], 0.0]])
    turn = np.eye(3) + cross + cross @ cross / (1.0 + up[2])
    columns = dict(imu.columns)
    for names in (RATES, ACCELERATIONS):
        if set(names) <= set(columns) and all(np.isfinite(columns[name]).any() for name in names):
            turned = np.column_stack([columns[name] for name in names]) @ turn.T
            columns |= {name: turned[:, i] for i, name in enumerate(names)}
    return replace(imu, columns=columns)
