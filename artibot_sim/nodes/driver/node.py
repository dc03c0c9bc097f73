"""The ``driver`` node: its lifecycle, services and parameters around the loop that drives.

**States.** Unconfigured: no bus. Inactive: the bus is open, the drives are found and set up again and again until all
are there; nothing moves. Active: the drives are being enabled, or are. Whatever stops the rover makes the node
inactive again; only ``~/enable`` or the lifecycle's activate leads back.

**One thread** does everything: a period of the loop, and between two periods the services, which only set wishes whose
outcome is checked once a period.
"""

from __future__ import annotations

import gc
import sys
import time
from collections.abc import Iterable
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter

from artibot_driver.config import LAW, config_from_parameters
from artibot_driver.master import Master, MasterStatus, Phase
from artibot_driver.priority import take_priority
from artibot_driver.rig import load_rig
from artibot_sim.errors import ArtibotError
from artibot_sim.nodes.common.pacer import Server, check_stats
from artibot_sim.nodes.common.parameters import keep_types, refuse_unknown
from artibot_sim.nodes.driver import parameters as parameters
from artibot_sim.nodes.driver.loop import DriverLoop
from artibot_sim.nodes.driver.services import AutoEnable, Services, obstacles
from artibot_sim.sharing import is_file

SERVE_EVERY = 0.05
"""How often services and parameters are served, s."""

IDLE = 0.05
"""How long the executor is waited in at a time while there is no bus, s."""

SHUTDOWN_TIME = 2.0
"""Beyond the ramp to standstill, how long the drives are given to switch off at the end, s."""

SWITCH = 5e-4
"""How long another thread (that reads a profile) may keep the loop waiting, s."""

REPLY_TIME = 0.1
"""How long the process stays for its last answers, s."""

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
        rig = load_rig(config_from_parameters(parameters.of_drives(self.settings)))
        check_stats(self.settings["stats"])
        self.loop = DriverLoop(self, rig, self.settings)
        refuse_unknown(self)  # now that those are declared which override the topics' quality of service
        self._fault, self._started = "", False
        self._asked, self._ended_at = asked, 0.0
        self._auto_enable = AutoEnable()
        self._by_itself = False
        self._server = Server()
        self._serve_at = 0.0
        self._requests = Services(self, self._request)
        self._refuse_wrong_transitions()
        keep_types(self)
        self.add_on_set_parameters_callback(self._on_parameters)

    # -- lifecycle ----------------------------------------------------------------------------------------------

    @property
    def label(self) -> str:
        """The lifecycle's state."""
        return str(self._state_machine.current_state[1])

    def _refuse_wrong_transitions(self) -> None:
        """Answer a transition that the state does not have with a refusal: rclpy raises, which ended the process."""
        change = self._service_change_state.callback

        def answer(request: Any, response: Any) -> Any:
            try:
                return change(request, response)
            except rclpy_implementation.RCLError:
                wanted = request.transition.label or request.transition.id
                name = self.get_fully_qualified_name()
                self.get_logger().warning(
                    f"transition {wanted} refused: '{self.label}' has none such; ros2 lifecycle list {name} shows which"
                )
                response.success = False
                return response

        self._service_change_state.callback = answer

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the bus."""
        try:
            self.loop.open()
        except ArtibotError as error:
            self._fault = str(error)
            if self._started:
                self.get_logger().error(self._fault)
            return FAILED
        self._fault = ""
        if self.settings["enable_on_start"]:
            self._auto_enable.begin(time.monotonic())
        return DONE

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Enable the drives; the node is inactive again should that fail."""
        if self._by_itself:
            return DONE
        master, status = self.loop.master, self.loop.status
        if master is None or status is None or status.phase is not Phase.READY:
            why = obstacles(status) if status is not None else "the bus was opened only now"
            self.get_logger().error(f"cannot be activated: {self.loop.phase.value}: {why}")
            return FAILED
        master.enable()
        return DONE

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Bring the rover to standstill and disable the drives."""
        if not self._by_itself and self.loop.master is not None:
            self.loop.master.disable()
        return DONE

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the bus, unless the rover is still coming to rest."""
        if self.loop.phase.moves:
            self.get_logger().error("cannot be cleaned up: the rover is still coming to standstill")
            return FAILED
        self._auto_enable.end()
        self._requests.end("the bus was closed")
        self.loop.close()
        return DONE

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the process as a signal does."""
        self._asked.append(0)
        return DONE

    def _follow_phase(self, phase: Phase) -> None:
        """Active while the drives are enabled, or being so; inactive otherwise."""
        enabled = phase in (Phase.ENABLING, Phase.ENABLED)
        if (self.label, enabled) not in (("inactive", True), ("active", False)):
            return
        self._by_itself = True
        try:
            (self.trigger_activate if enabled else self.trigger_deactivate)()
        finally:
            self._by_itself = False

    # -- services and parameters --------------------------------------------------------------------------------

    def _request(self, name: str) -> int | str:
        """Make a request of the master; returns how many it had answered, or why none can be made."""
        if self.loop.master is None or self.loop.status is None:
            return self._fault or "not configured; use the lifecycle's configure first"
        if self._ended_at:
            return "the driver is ending"
        self._auto_enable.end()
        getattr(self.loop.master, name)()
        return self.loop.status.requests

    def _on_parameters(self, changes: list[Parameter]) -> SetParametersResult:
        try:
            ours = [change for change in changes if change.name in self.settings]
            self._refuse_to_wait(ours)
            checked = {each.name: parameters.check(each.name, each.value, self.robot) for each in ours}
        except ArtibotError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self.settings |= checked
        self.loop.refresh_rules()
        return SetParametersResult(successful=True)

    def _refuse_to_wait(self, changes: Iterable[Parameter]) -> None:
        """Refuse what would hold the loop up while the rover may move: a user's file may take long to run."""
        if self.loop.phase.moves and any(each.name == LAW.name and is_file(str(each.value)) for each in changes):
            raise ArtibotError("parameter law: a law from a file is read while the drives are disabled; disable first")

    # -- running ------------------------------------------------------------------------------------------------

    def run(self, executor: SingleThreadedExecutor) -> int:
        """Drive until asked to end, then stop, disable, close the bus and return the exit status.

        Raises
        ------
        ArtibotError
            When the bus cannot be opened at the start.
        """
        if self.settings["autoconfigure"] and self.trigger_configure() is not DONE:
            raise ArtibotError(self._fault)
        self._started = True
        sys.setswitchinterval(SWITCH)
        gc.collect()
        gc.freeze()  # what lives now lives to the end: collections stay short
        if refused := take_priority(self.settings["realtime_priority"]):
            self.get_logger().info(f"no real-time priority ({refused}): a busy machine may delay the loop")
        self.loop.pacer.start()
        self.get_logger().info(f"{self.robot.name}: driver on {self.loop.config.interface} {self.loop.config.channel}")
        try:
            while not self._over():
                self._go_on(executor)
        finally:
            self.loop.close()
        self._let_answers_leave(executor)
        return 0

    def finish(self) -> None:
        """Nothing is left open: :meth:`run` closes the bus."""

    def destroy_node(self) -> None:
        """Destroy the lifecycle's services with the rest."""
        self._state_machine.destroy_when_not_in_use()
        super().destroy_node()

    def statistics(self) -> dict[str, Any]:
        """How late the loop was, and how long callbacks held it up."""
        return self.loop.pacer.statistics() | self._server.statistics()

    def _let_answers_leave(self, executor: SingleThreadedExecutor) -> None:
        """The last answers of services take a moment to get away."""
        until = time.monotonic() + REPLY_TIME
        while time.monotonic() < until:
            executor.spin_once(timeout_sec=0.02)

    def _go_on(self, executor: SingleThreadedExecutor) -> None:
        """Serve when it is time for that, else one period."""
        master = self.loop.master
        if master is None:
            self.loop.diagnose(self.label, self._fault, self._server.most_ms)
            executor.spin_once(timeout_sec=IDLE)
        elif time.monotonic() >= self._serve_at:
            self._serve_at = time.monotonic() + SERVE_EVERY
            self._server.turn(executor)
        else:
            time.sleep(max(0.0, self.loop.pacer.remaining()))
            status = self.loop.step(master, listen=not self._ended_at)
            self._enable_if_wished(master, status)
            self._follow_phase(status.phase)
            self._requests.answer(status)
            self.loop.diagnose(self.label, self._fault, self._server.most_ms)

    def _enable_if_wished(self, master: Master, status: MasterStatus) -> None:
        auto_enable = self._auto_enable.check(status, time.monotonic())
        if auto_enable.enable:
            master.enable()
        elif auto_enable.lapsed:
            self.get_logger().warning(f"enable_on_start has lapsed: {auto_enable.lapsed}; call ~/enable")

    def _over(self) -> bool:
        """Whether all is done after the process was asked to end."""
        if not self._asked:
            return False
        if not self._ended_at:
            self._ended_at = time.monotonic()
            self._requests.end("the driver is ending")
            if self.loop.master is not None:
                self.loop.master.disable()
        config = self.loop.config
        patience = config.max_speed / config.stop_deceleration + SHUTDOWN_TIME
        return not self.loop.phase.moves or time.monotonic() > self._ended_at + patience
