"""The command view: how measured motor speeds and torques follow their commands, and what between the two explains it.

Rotations that were measured have delays, lags, dead bands and torque limits behind them, so a model that is turned by
them knows nothing of these effects; what encoders and torque sensors say is held here against what was commanded. The
evidence of both views adds up. It takes the stamps of commands and measurements to agree to a few milliseconds only.
What recorded angles say of the speeds recorded beside them needs no commands, and is known before these are asked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from artibot_sim.diagnose.commands.data import command_data
from artibot_sim.diagnose.commands.encoders import encoder_evidence
from artibot_sim.diagnose.commands.fit import EFFECTS, NEEDED, CommandFits, ViewEvidence, lost
from artibot_sim.diagnose.commands.mixing import Mixing, unlike
from artibot_sim.diagnose.commands.model import FILTER, response_of
from artibot_sim.diagnose.commands.noise import sensor_noise
from artibot_sim.diagnose.commands.series import CommandedLevel
from artibot_sim.diagnose.policy import UNFOLLOWED
from artibot_sim.diagnose.records import ErrorSeries, SlowResidual
from artibot_sim.experiment import Experiment
from artibot_sim.model import Robot

__all__ = ["EFFECTS", "CommandView", "ViewEvidence", "command_view", "view_with"]


@dataclass(frozen=True)
class CommandView:
    """What recordings with commands say; empty where no recording has any.

    Attributes
    ----------
    found : tuple of str
        Effects that together explain what is plainly there, the largest first.
    levels : mapping of str to CommandedLevel
        ``front_velocity``: how far measured speeds are from commanded ones, and their noise.
    series : mapping of str to ErrorSeries
        By recording: errors of the front motors' speeds, (n, 2), as commanded and with `found`.
    followed : bool
        Whether motors do what they are commanded, but for what these effects explain. Otherwise commands say nothing.
    mixing : Mixing or None
        Whether each side follows its own command alone; None where not both sides are commanded.
    encoders : ViewEvidence or None
        What recorded angles and speeds say of a low-pass on the speeds; None where they say nothing.
    """

    found: tuple[str, ...] = ()
    levels: Mapping[str, CommandedLevel] = field(default_factory=dict)
    series: Mapping[str, ErrorSeries] = field(default_factory=dict)
    followed: bool = False
    mixing: Mixing | None = None
    encoders: ViewEvidence | None = None
    _work: CommandFits | None = field(default=None, repr=False, compare=False)
    _left: float = 0.0

    @cached_property
    def evidence(self) -> Mapping[str, ViewEvidence]:
        """By effect, each alone; made when it is first asked for, for who predicts with what is named needs none."""
        found = {} if self.encoders is None else {FILTER: self.encoders}
        if self._work is None:
            return found
        if self.followed:
            return {effect: self._work.evidence(effect) for effect in EFFECTS} | found
        return {effect: ViewEvidence(0.0, {}, {}, self.why) for effect in EFFECTS} | found

    @property
    def plausible(self) -> bool:
        """Whether these may be the commands that the motors were given: each side follows its own alone."""
        return self.mixing is None or not self.mixing.mixed

    @property
    def why(self) -> str:
        """Why commands say nothing; empty where they are followed, or none are recorded."""
        if self.followed or self._work is None:
            return ""
        if self.mixing is not None and not self.plausible:
            return unlike(self.mixing)
        return (
            f"motors do not follow their commands: {100 * self._left:.0f} % of their speed is left whatever explains it"
        )

    def given(self, *effects: str) -> dict[str, ViewEvidence]:
        """Evidence of every other effect on top of `effects`, all at their best together."""
        if self._work is None or not self.followed:
            return {effect: one for effect, one in self.evidence.items() if effect not in effects}
        found = {} if self.encoders is None or FILTER in effects else {FILTER: self.encoders}
        beside = tuple(effect for effect in effects if effect != FILTER)
        return {e: self._work.evidence(e, beside) for e in EFFECTS if e not in effects} | found

    def nats(self, robot: Robot) -> float:
        """Log-likelihood that a robot's effects gain as they are, negative where commands speak against them.

        Zero for effects that are not the view's, and where no commands are recorded or followed.
        """
        return 0.0 if self._work is None or not self.followed else self._work.gained(robot)

    def remainder(self, robot: Robot) -> SlowResidual | None:
        """What a robot's effects leave of the front motors' speeds; None where nothing is commanded and measured."""
        return None if self._work is None else self._work.remainder(robot)

    def for_robot(self, robot: Robot) -> tuple[Mapping[str, CommandedLevel], Mapping[str, ErrorSeries]]:
        """`levels` and `series` with a robot's effects in place of `found`; none where commands are not the motors'."""
        return ({}, {}) if self._work is None or not self.plausible else self._work.shown_by(robot)


def command_view(recordings: Sequence[Experiment], robot: Robot, *, needed: float = NEEDED) -> CommandView:
    """Hold what motors did against what they were commanded.

    Parameters
    ----------
    recordings : sequence of Experiment
        Those without `/motor_command` are passed over; their order does not matter.
    robot : Robot
        Its effects are what is already known.
    needed : float
        Nats that an effect has to gain to be named, for the sizes that are excluded.
    """
    encoders = encoder_evidence(recordings, robot, lost(needed))
    work = _work(recordings, robot, needed, encoders)
    if work is None:
        return CommandView(encoders=encoders)
    for _ in range(2):  # the noise that is left beside what was found changes what is found
        found = work.plain()
        noise = work.noise_beside(found)
        if noise.like(work.noise):
            break
        work = replace(work, noise=noise)
    left, mixing = work.left(found), work.mixing(found)
    if left > UNFOLLOWED or (mixing is not None and mixing.mixed):
        return CommandView((), *work.shown(response_of(work.robot.effects), None), False, mixing, encoders, work, left)
    best = work.fit(found)
    return CommandView(found, *work.shown(best.best.response, best.limit), True, mixing, encoders, work, left)


def view_with(found: CommandView, recordings: Sequence[Experiment], robot: Robot) -> CommandView:
    """Other recordings held against what a view found: they are to judge it, and nothing is searched in them.

    Where that view knows no commands they are searched like any.
    """
    if found._work is None:
        return command_view(recordings, robot)
    work = _work(recordings, robot, found._work.needed, found.encoders)
    if work is None:
        return CommandView(encoders=found.encoders)
    work = replace(work, noise=work.noise_beside(found.found))
    left = work.left(found.found)
    followed = found.followed and left <= UNFOLLOWED
    best = work.fit(found.found)
    return CommandView(
        found.found, *work.shown(best.best.response, best.limit), followed, found.mixing, found.encoders, work, left
    )


def _work(
    recordings: Sequence[Experiment], robot: Robot, needed: float, encoders: ViewEvidence | None
) -> CommandFits | None:
    """Fits of these recordings, whatever their order; None where nothing is commanded and measured.

    A low-pass that angles show (`encoders`) is known then: no command can be blamed for it.
    """
    if encoders is not None and encoders.nats >= needed:
        robot = replace(robot, effects={**robot.effects, FILTER: dict(encoders.values)})
    ordered = sorted(recordings, key=lambda r: (r.name, len(r.channels.get("motor_torques") or ())))
    data = command_data(ordered)
    if data is None:
        return None
    return CommandFits(ordered, robot, data, command_data(ordered, "effort"), sensor_noise(data), needed)
