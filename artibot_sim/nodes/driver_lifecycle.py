"""The ``driver`` node: commands in, frames out, feedback back, all in one loop of one thread.

**States.** Unconfigured: no bus. Inactive: the bus is open, the drives are found and set up again and again until all
are there; nothing moves. Active: the drives are being enabled, or are. Whatever stops the rover makes the node
inactive again; only ``~/enable`` or the lifecycle's activate leads back.

**The loop** is paced by absolute deadlines on a steady clock; deadlines that were missed are not made up for. In every
period: subscriptions are taken without an executor, the arbitration decides, the master sends set-points and SYNC,
what came back is published. Services are served in between; they only set wishes, whose outcome is looked at once a
period. **Time** is steady: stamps and profiles follow the system clock as it stood when the rover last stood.
"""

from __future__ import annotations

import gc
import time
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter

from artibot_driver.bus_health import BusState
from artibot_driver.config import DriverConfig, config_from_parameters
from artibot_driver.master import Cycle, Master, Phase, Status, Stop
from artibot_driver.rig import Rig, load_rig
from artibot_sim.errors import ArtibotError
from artibot_sim.nodes import driver_parameters as parameters
from artibot_sim.nodes.driver_answers import obstacles
from artibot_sim.nodes.driver_bus import BusKeeper
from artibot_sim.nodes.driver_commands import CommandDesk, Silence
from artibot_sim.nodes.driver_diagnostics import diagnostics
from artibot_sim.nodes.driver_publishers import DriverPublishers
from artibot_sim.nodes.driver_services import Services
from artibot_sim.nodes.inputs import Inputs
from artibot_sim.nodes.pacer import Pacer
from artibot_sim.nodes.parameters import warn_of_unknown

SERVE_EVERY = 0.02
"""How often services and parameters are served, s."""

IDLE = 0.05
"""How long the executor is waited in at a time while there is no bus, s."""

FAREWELL = 2.0
"""Beyond the ramp to standstill, how long the drives are given to switch off at the end, s."""

STEPPED_NS = 50_000_000
"""A system clock that is off by more was set; the stamps follow when the rover stands."""

DONE, FAILED = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class DriverNode(LifecycleNode):
    """``driver`` (see the module's text).

    Parameters
    ----------
    overrides : dict
        Parameters set by the command line; they win over ``--ros-args``.
    asked : list of int
        Gets an entry when the process is asked to end (from a signal handler).

    Raises
    ------
    ArtibotError
        When a parameter, the robot or the drives' data are refused.
    """

    def __init__(self, overrides: dict[str, Any], asked: list[int]) -> None:
        given = {**overrides, "use_sim_time": False}  # drives know one time only
        super().__init__("driver", parameter_overrides=[Parameter(name, value=value) for name, value in given.items()])
        self.robot, self.settings = parameters.declare_all(self)
        self.config: DriverConfig = config_from_parameters(parameters.of_drives(self.settings))
        self.rig: Rig = load_rig(self.config)
        warn_of_unknown(self)
        get = self.settings.__getitem__
        rules = parameters.rules(self.settings, self.robot, self.config)
        self.desk = CommandDesk(Inputs(self, rules, get("cmd_vel_stamped")))
        self.out = DriverPublishers(self, self.robot, get("odom_frame"), get("base_frame"))
        self.period_ns = 1_000 * self.config.sync_period_us
        self.pacer = Pacer(self.period_ns, 1.0)
        self.master: Master | None = None
        self._keeper = BusKeeper(self.config)
        self._cycle: Cycle | None = None
        self._fault = ""
        self._asked, self._ended_at = asked, 0.0
        self._wish = self._by_itself = False
        self._epoch_ns = time.time_ns() - time.monotonic_ns()
        self._periods, self._serve_at = 1, 0.0
        self._stop: Stop | None = None
        self.services_of_own = Services(self, self._request)
        self.add_on_set_parameters_callback(self._on_parameters)

    # -- lifecycle ----------------------------------------------------------------------------------------------

    def configure(self) -> None:
        """Open the bus; the drives are set up by the loop.

        Raises
        ------
        ArtibotError
            When it cannot be opened, with the mend.
        """
        self.master = Master(self._keeper.open(), self.rig)
        self._wish = self.settings["enable_on_start"]
        self.pacer.start()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the bus."""
        try:
            self.configure()
        except ArtibotError as error:
            self._fault = str(error)
            self.get_logger().error(self._fault)
            return FAILED
        self._fault = ""
        return DONE

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Enable the drives; the node is inactive again should that fail."""
        if self._by_itself:
            return DONE
        if self.master is None or self._cycle is None or self._cycle.status.phase is not Phase.READY:
            self.get_logger().error(f"cannot be activated: {self._phase().value}: {self._in_the_way()}")
            return FAILED
        self.master.enable()
        return DONE

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Bring the rover to standstill and disable the drives."""
        if not self._by_itself and self.master is not None:
            self.master.disable()
        return DONE

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the bus, unless the rover is still coming to rest."""
        if self._phase().moves:
            self.get_logger().error("cannot be cleaned up: the rover is still coming to standstill")
            return FAILED
        self._close()
        return DONE

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the process as a signal does."""
        self._asked.append(0)
        return DONE

    def _follow_phase(self, phase: Phase) -> None:
        """Active while the drives are enabled, or being so; inactive otherwise."""
        label = self._state_machine.current_state[1]
        enabled = phase in (Phase.ENABLING, Phase.ENABLED)
        if (label, enabled) not in (("inactive", True), ("active", False)):
            return
        self._by_itself = True
        try:
            (self.trigger_activate if enabled else self.trigger_deactivate)()
        finally:
            self._by_itself = False

    # -- services and parameters --------------------------------------------------------------------------------

    def _request(self, name: str) -> int | str:
        """Make a request of the master; returns how many it had answered, or why none can be made."""
        if self.master is None or self._cycle is None:
            return self._fault or "not configured; use the lifecycle's configure first"
        if self._ended_at:
            return "the driver is ending"
        self._wish = False
        getattr(self.master, name)()
        return self._cycle.status.requests

    def _on_parameters(self, changes: list[Parameter]) -> SetParametersResult:
        try:
            checked = {
                p.name: parameters.check(p.name, p.value, self.robot) for p in changes if p.name in self.settings
            }
        except ArtibotError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self.settings |= checked
        self.desk.inputs.rules = parameters.rules(self.settings, self.robot, self.config)
        return SetParametersResult(successful=True)

    # -- the loop -----------------------------------------------------------------------------------------------

    def run(self, executor: SingleThreadedExecutor) -> int:
        """Drive until asked to end, then stop, disable, close the bus and return the exit status.

        Raises
        ------
        ArtibotError
            When the bus cannot be opened at the start.
        """
        if self.settings["autoconfigure"] and self.trigger_configure() is not DONE:
            raise ArtibotError(self._fault)
        gc.collect()
        gc.freeze()  # what lives now lives to the end: collections stay short
        self.get_logger().info(f"{self.robot.name}: driver on {self.config.interface} {self.config.channel}")
        while not self._over():
            if self.master is None:
                self.out.diagnostics(time.monotonic_ns(), self._diagnostics)
                executor.spin_once(timeout_sec=IDLE)
                continue
            if time.monotonic() >= self._serve_at:
                self._serve_at = time.monotonic() + SERVE_EVERY
                executor.spin_once(timeout_sec=0.0)
                continue
            time.sleep(max(0.0, self.pacer.remaining()))
            self._step(self.master)
        self._close()
        return 0

    def _over(self) -> bool:
        """Whether all is done after the process was asked to end."""
        if not self._asked:
            return False
        if not self._ended_at:
            self._ended_at = time.monotonic()
            self.services_of_own.end("the driver is ending")
            if self.master is not None:
                self.master.disable()
            return self.master is None or not self._phase().moves
        patience = self.config.max_speed / self.config.stop_deceleration + FAREWELL
        return not self._phase().moves or time.monotonic() > self._ended_at + patience

    def _step(self, master: Master) -> None:
        """One SYNC period."""
        self.desk.inputs.take()
        t_ns = self.pacer.deadline_ns + self._epoch_ns
        setpoints = None
        if self._cycle is not None and not self._ended_at:
            kappa = self.settings["kappa"]
            found = self.desk.decide(self._cycle.status, t_ns, self.period_ns, self._periods, kappa)
            if isinstance(found, Silence):
                master.stop(found.reason, found.text)
            else:
                setpoints = found
        self._cycle = cycle = master.cycle(time.monotonic_ns(), setpoints)
        self._periods = self.pacer.skip()
        self.desk.follow(cycle.status)
        self.out.feedback(cycle.feedback, self._epoch_ns)
        self.out.commanded(cycle.commanded, self._epoch_ns)
        self._look_after(master, cycle.status)

    def _look_after(self, master: Master, status: Status) -> None:
        """All that follows from how the drives are now."""
        if self._wish and status.phase is Phase.READY:
            self._wish = False
            master.enable()
        self._follow_phase(status.phase)
        self.services_of_own.answer(status)
        if status.stop is not None and status.stop != self._stop:
            log = self.get_logger()
            (log.info if status.stop.reason.asked_for else log.error)(
                f"stopped: {status.stop.reason.value}: {status.stop.text}"
            )
        self._stop = status.stop
        if status.bus.state is BusState.LOST and (bus := self._keeper.again()) is not None:
            master.use_bus(bus)
        if not status.phase.moves:
            self._follow_system_clock()
        self.out.diagnostics(time.monotonic_ns(), self._diagnostics)

    def _follow_system_clock(self) -> None:
        epoch = time.time_ns() - time.monotonic_ns()
        if abs(epoch - self._epoch_ns) > STEPPED_NS:
            self.get_logger().warning(f"the system clock was set by {1e-9 * (epoch - self._epoch_ns):+.2f} s")
            self._epoch_ns = epoch

    # -- the bus ------------------------------------------------------------------------------------------------

    def _close(self) -> None:
        """Leave drives and bus."""
        if self.master is not None:
            self.master.close(time.monotonic_ns())
        self._keeper.close()
        self.master = self._cycle = self._stop = None

    # -- what is said -------------------------------------------------------------------------------------------

    def _phase(self) -> Phase:
        return self._cycle.status.phase if self._cycle is not None else Phase.OFFLINE

    def _in_the_way(self) -> str:
        return obstacles(self._cycle.status) if self._cycle is not None else self._fault or "not configured"

    def _diagnostics(self) -> Any:
        own = {
            "lifecycle": self._state_machine.current_state[1],
            "commanded by": self.desk.source.value,
            "kappa": self.settings["kappa"],
            "loop late p99 (ms)": 1e3 * self.pacer.recent(1000, 99),
            "loop late most (ms)": 1e3 * self.pacer.recent(1000, 100),
            "periods missed": self.pacer.overruns,
        }
        status = self._cycle.status if self._cycle is not None else None
        t_ns = time.monotonic_ns() + self._epoch_ns
        return diagnostics(t_ns, self.config, self.robot.name, status, own, self._fault)
