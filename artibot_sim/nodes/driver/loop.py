"""One SYNC period of the driver after the other: commands to the drives; what they report, to the topics.

Deadlines are absolute, on a steady clock; those that were missed are not made up for. **Time** is steady: stamps and
profiles follow the system clock as it stood when the rover last stood. A bus that was lost is opened again beside the
loop.
"""

from __future__ import annotations

import random
import threading
import time
from typing import Any

from rclpy.node import Node

from artibot_driver.bus import Bus, BusState, open_bus
from artibot_driver.config import DriverConfig
from artibot_driver.master import Master, MasterCycle, MasterStatus, Phase, StopRecord
from artibot_driver.rig import Rig
from artibot_sim.errors import ArtibotError
from artibot_sim.nodes.common.inputs import CommandInputs
from artibot_sim.nodes.common.pacer import Pacer
from artibot_sim.nodes.driver import parameters as parameters
from artibot_sim.nodes.driver.commands import CommandGate, Silence
from artibot_sim.nodes.driver.publishers import NO_REASON, DriverPublishers, Identity, diagnostics, judged
from artibot_sim.nodes.driver.services import obstacles, stop_text

# ----------------------------------------------------------------------
# The driver's bus: opened at once or not at all, and opened again beside the loop where it was lost.
# ----------------------------------------------------------------------


AGAIN = 0.2
"""Between two attempts to open a lost bus, s."""

OPENING = 1.0
"""An attempt that is under way is waited for so long at the end, s."""


class BusKeeper:
    """Opens, opens again and closes a bus.

    Parameters
    ----------
    config : DriverConfig
    """

    def __init__(self, config: DriverConfig) -> None:
        self._config = config
        self._bus: Bus | None = None
        self._search: BusSearch | None = None

    def open(self) -> Bus:
        """Open the bus.

        Raises
        ------
        ArtibotError
            When it cannot be opened, with the mend.
        """
        self._bus = opened(self._config)
        return self._bus

    def again(self) -> Bus | None:
        """A new bus in place of one that was lost, once there is one; never waits."""
        if self._search is None:
            self._search = BusSearch(self._config)
        found = self._search.take()
        if found is None:
            return None
        if self._bus is not None:
            self._bus.close()
        self._bus, self._search = found, None
        return found

    def close(self) -> None:
        """Close what is open, and what a search may still find; what was sent before still goes out."""
        if self._search is not None:
            self._search.end()
        if self._bus is not None:
            self._bus.close()
        self._bus = self._search = None


class BusSearch:
    """Tries to open a bus, in a thread of its own, until it has or is ended; what it finds then, nobody gets."""

    def __init__(self, config: DriverConfig) -> None:
        self._config = config
        self._ended = threading.Event()
        self._lock = threading.Lock()
        self._found: Bus | None = None
        self._thread = threading.Thread(target=self._run, name="bus", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._ended.is_set():
            try:
                found = opened(self._config)
            except ArtibotError:
                self._ended.wait(AGAIN)
                continue
            with self._lock:
                if self._ended.is_set():
                    found.close()
                else:
                    self._found = found
            return

    def take(self) -> Bus | None:
        """What it has found, once."""
        with self._lock:
            found, self._found = self._found, None
        return found

    def end(self) -> None:
        """Search no more, and close what was found; the thread is over by then, unless opening hangs."""
        with self._lock:
            self._ended.set()
        self._thread.join(OPENING)
        found = self.take()
        if found is not None:
            found.close()


def opened(config: DriverConfig) -> Bus:
    """The bus of a configuration; raises :class:`ArtibotError` when it cannot be opened, with the mend."""
    return open_bus(config.interface, config.channel, config.bitrate)


# ----------------------------------------------------------------------
# One SYNC period of the driver after the other: commands to the drives; what they report, to the topics.
# ----------------------------------------------------------------------


STEPPED_NS = 50_000_000
"""A system clock that is off by more was set; the stamps follow when the rover stands."""

SETTLED = 1.0
"""What is in the way of enabling is logged anew once it has been another for so long, s; setting up has brief ones."""


class Settling:
    """Tells once of a text that has become another one, when it has stayed the same for a while.

    Parameters
    ----------
    patience : float
        How long it has to stay, s.
    """

    def __init__(self, patience: float) -> None:
        self._patience = patience
        self._said = self._text = ""
        self._since = 0.0

    def said(self, text: str) -> None:
        """This text has been said by other means."""
        self._said = text

    def settles(self, text: str, now: float) -> bool:
        """Whether a text, which is so at `now` (steady s), is to be said now; an empty one is nothing to say."""
        if text != self._text:
            self._text, self._since = text, now
        if not text or text == self._said or now - self._since < self._patience:
            return False
        self._said = text
        return True


class DriverLoop:
    """Everything between the topics and the bus.

    Parameters
    ----------
    node : rclpy Node
        Has the subscriptions and publishers.
    rig : Rig
    settings : dict
        The node's parameters by name; what is in it counts at once.

    Attributes
    ----------
    master : Master or None
        None while there is no bus.
    status : MasterStatus or None
        As of the last period.
    """

    def __init__(self, node: Node, rig: Rig, settings: dict[str, Any]) -> None:
        self._rig, self._settings, self._log = rig, settings, node.get_logger()
        self._identity = Identity.of_node(rig.robot.name, node.get_fully_qualified_name())
        rules = parameters.rules(settings, rig.robot, rig.config)
        self.gate = CommandGate(CommandInputs(node, rules, settings["cmd_vel_stamped"], beside=True, aged=True))
        self._out = DriverPublishers(node, rig.robot, settings)
        self._keeper = BusKeeper(rig.config)
        self._period_ns = 1_000 * rig.config.sync_period_us
        self.pacer = Pacer(self._period_ns, 1.0)
        self._periods = 1
        self.master: Master | None = None
        self.status: MasterStatus | None = None
        self._epoch_ns = time.time_ns() - time.monotonic_ns()
        self._stop: StopRecord | None = None
        self._logged: tuple[Phase, bool] | None = None
        self._obstacles = Settling(SETTLED)
        self._warned: set[str] = set()
        self._law_name = settings["law"]
        self._law = parameters.law_of(self._law_name)

    @property
    def config(self) -> DriverConfig:
        """What bus and drives are set up with."""
        return self._rig.config

    @property
    def phase(self) -> Phase:
        """What the master is at."""
        return self.status.phase if self.status is not None else Phase.OFFLINE

    def open(self) -> None:
        """Open the bus; the drives are set up by the periods that follow.

        Raises
        ------
        ArtibotError
            When it cannot be opened, with the mend.
        """
        self.master = Master(self._keeper.open(), self._rig, delay=random.random)
        self._periods = 1
        self.pacer.start()

    def close(self) -> None:
        """Leave drives and bus."""
        if self.master is not None:
            self.master.close(time.monotonic_ns())
        self._keeper.close()
        self.master = self.status = self._stop = self._logged = None

    def refresh_rules(self) -> None:
        """Have arbitration and torque sharing go by the parameters as they are now."""
        self.gate.inputs.rules = parameters.rules(self._settings, self._rig.robot, self.config)
        if self._settings["law"] != self._law_name:  # a file's law is run anew by reading it: not for another kappa
            self._law_name = self._settings["law"]
            self._law = parameters.law_of(self._law_name)

    def step(self, master: Master, listen: bool) -> MasterStatus:
        """One SYNC period, at its deadline; with `listen` commands are followed."""
        self.gate.inputs.t_ns = t_ns = self.pacer.deadline_ns + self._epoch_ns
        self.gate.inputs.take()
        setpoints = None
        if self.status is not None and listen:
            kappa = self._settings["kappa"]
            found = self.gate.decide(self.status, t_ns, self._period_ns, self._periods, kappa, self._law)
            if isinstance(found, Silence):
                master.stop(found.reason, found.text)
            else:
                setpoints = found
        cycle = master.cycle(time.monotonic_ns(), setpoints)
        self._periods = self.pacer.skip()
        self.status = cycle.status
        self.gate.follow(cycle.status)
        self._publish(cycle)
        self._say_what_is_new(cycle.status)
        if cycle.status.bus.state is BusState.LOST and (bus := self._keeper.again()) is not None:
            master.use_bus(bus)
        if not cycle.status.phase.moves:
            self._follow_system_clock()
        return cycle.status

    def _publish(self, cycle: MasterCycle) -> None:
        self._out.feedback(cycle.feedback, self._epoch_ns)
        self._out.commanded(cycle.commanded, self._epoch_ns)

    def _say_what_is_new(self, status: MasterStatus) -> None:
        news = (status.phase, bool(status.other_driver))
        if news != self._logged:
            self._logged = news
            self._log.info("; ".join(filter(None, (status.phase.value, obstacles(status)))))
            self._obstacles.said(obstacles(status))
        elif not status.phase.moves and self._obstacles.settles(obstacles(status), time.monotonic()):
            self._log.warning(f"{status.phase.value}; {obstacles(status)}")
        stop = status.stop
        if stop is not None and stop != self._stop:
            if stop.reason.asked_for:
                self._log.info(f"stopped: {stop_text(stop)}")
            else:
                self._log.error(f"stopped: {stop_text(stop)}")
        self._stop = stop
        warned = {drive.motor: drive.emergency for drive in status.drives if drive.warns}
        for motor, emergency in warned.items():
            if motor not in self._warned:
                self._log.warning(f"drive {motor} warns (statusword, bit 7): {emergency or NO_REASON}")
        self._warned = set(warned)

    def _follow_system_clock(self) -> None:
        epoch = time.time_ns() - time.monotonic_ns()
        if abs(epoch - self._epoch_ns) > STEPPED_NS:
            self._log.warning(f"the system clock was set by {1e-9 * (epoch - self._epoch_ns):+.2f} s")
            self._epoch_ns = epoch

    def diagnose(self, lifecycle: str, fault: str, held_up: float) -> None:
        """Publish /diagnostics when it is time for that.

        Parameters
        ----------
        lifecycle : str
            The node's state.
        fault : str
            Why the driver could not be configured, or empty.
        held_up : float
            The longest callback so far, ms.
        """
        state = lifecycle, self.status and (self.status.phase, self.status.stop)
        self._out.diagnostics(
            time.monotonic_ns(), state, lambda: judged(self.status, fault),
            lambda: self._diagnostics(lifecycle, fault, held_up),
        )  # fmt: skip

    def _diagnostics(self, lifecycle: str, fault: str, held_up: float) -> Any:
        own = {
            "lifecycle": lifecycle,
            "commanded by": self.gate.source.value,
            "kappa": self._settings["kappa"],
            "law": self._settings["law"],
            "loop late p99 (ms)": 1e3 * self.pacer.recent(1000, 99),
            "loop late most (ms)": 1e3 * self.pacer.recent(1000, 100),
            "periods missed": self.pacer.overruns,
            "commands late most (ms)": 1e3 * self.gate.inputs.latest,
            "callback most (ms)": held_up,
        }
        t_ns = time.monotonic_ns() + self._epoch_ns
        return diagnostics(t_ns, self.config, self._identity, self.status, own, fault)
