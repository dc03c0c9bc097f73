"""From command messages to set-points for the master, or the reason to stop."""

from __future__ import annotations

from dataclasses import dataclass

from artibot_driver.master import MasterStatus, Phase, Setpoints, StopReason
from artibot_sim.nodes.common.arbiter import TOPICS, Commanding, CommandSource, PeriodCommands
from artibot_sim.nodes.common.inputs import CommandInputs
from artibot_sim.sharing import Law

NOT_ENABLED = "the drives are not enabled; call ~/enable first, then command anew"
STOPPED = "the rover was stopped; call ~/enable, then command anew"


@dataclass(frozen=True)
class Silence:
    """A source that asked for motion says nothing more: why the rover is to be stopped."""

    reason: StopReason
    text: str


class CommandGate:
    """Takes commands while the drives are enabled, and only those that came after the enable.

    Parameters
    ----------
    inputs : CommandInputs
    """

    def __init__(self, inputs: CommandInputs) -> None:
        self.inputs = inputs
        self._armed_ns: int | None = None
        self._received = 0.0
        self.source = CommandSource.NONE
        self._close(NOT_ENABLED)

    def _close(self, why: str) -> None:
        self.inputs.closed = why
        self.inputs.drop((0.0, 0.0))
        self.inputs.listen_for_profiles(False)
        self.source = CommandSource.NONE

    def follow(self, status: MasterStatus) -> None:
        """Open with an enable, close with a stop; every enable drops what was received before it."""
        armed = status.armed_ns if status.phase in (Phase.ENABLING, Phase.ENABLED) else None
        if armed == self._armed_ns:
            return
        self._armed_ns = armed
        if armed is None:
            self._close(STOPPED if status.stop else NOT_ENABLED)
            return
        self.inputs.drop((0.0, 0.0))
        self.inputs.closed = ""
        self.inputs.listen_for_profiles(True)

    def decide(
        self, status: MasterStatus, t_ns: int, period_ns: int, periods: int, kappa: float, law: Law | None = None
    ) -> Setpoints | Silence | None:
        """Set-points for the SYNC now, or why to stop; None where nobody commands.

        Parameters
        ----------
        t_ns : int
            Time of the SYNC, that of the stamps; whole periods after that of the last call.
        period_ns, periods : int
            Since the last call so many SYNC periods have passed, mostly one.
        """
        self.inputs.t_ns = t_ns - (periods - 1) * period_ns
        if status.phase is not Phase.ENABLED or self.inputs.closed:
            return None
        before = self.inputs.state
        decision = self.inputs.decide(period_ns, periods)
        self.source = decision.source
        if decision.silenced:
            silence = self._silence(before, decision)
            self._close(STOPPED)
            return silence
        if decision.source is not CommandSource.NONE:
            self._received = _received(before, decision.source)
        velocity = decision.velocity[-1]
        if decision.source is CommandSource.NONE and velocity == (0.0, 0.0):
            return None
        return Setpoints(velocity, round(self._received * 1e9), decision.effort, kappa, law)

    def _silence(self, before: Commanding, decision: PeriodCommands) -> Silence:
        topic = TOPICS[before.source]
        refused = self.inputs.refusals.get(before.source)
        if refused:
            return Silence(StopReason.INVALID_COMMAND, f"{topic} refused: {refused}")
        return Silence(StopReason.COMMAND_SILENCE, decision.notice or f"{topic} is silent: ramp to standstill")


def _received(state: Commanding, source: CommandSource) -> float:
    """When the message came that a source's command rests on (steady s)."""
    if source is CommandSource.LIVE and state.live:
        return state.live.at
    if source is CommandSource.CMD_VEL and state.twist:
        return state.twist.at
    return state.pending.accepted if state.pending else 0.0
