"""The simulation node: a rover behind the contract's topics, paced on a steady clock.

One loop does everything: services and parameters (in the executor, every `SERVE_EVERY`), sleep until the next
absolute deadline, commands (taken from their subscriptions), publication of the instant, computation of the next
period. There is no lock and no second thread. Measured with 9 subscribers: an executor that is waited in costs 5 % of
a core more, because it builds its wait set anew for every wait; a second thread for it loses what it saves to the
interpreter's lock.

**Time.** With `publish_clock` (automatic when `rate` is not 1) simulated time begins at the first period, not at 0, and
`/clock` only increases. Without it stamps are system time; a pause, a machine that cannot keep up or a system clock
that is set forward makes them jump ahead. They never go back: after the system clock was set back they stay ahead of
it, and the node says so. What is published with stamp t is the state at t with the torques that act from t on.

**Holding.** With `wait_for_profile` time stands after the first step until a command was accepted. While time stands
(also in a pause) /clock is repeated a few times whenever the number of its subscribers changes, so that a planner on
simulated time can start and stamp its profile; nothing else is published. Where a run stands in wall time then has no
influence on it, which makes runs with `rate: 0` the same to the bit, stamps included.
"""

from __future__ import annotations

import gc
import time
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

from artibot_driver.priority import take_priority
from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.odometry import Odometry, Slip, metres_per_radian
from artibot_sim.model import load_robot
from artibot_sim.model.simulate.sensors import sensor_errors
from artibot_sim.nodes.common.pacer import Pacer, Seldom, check_stats
from artibot_sim.nodes.common.parameters import keep_types, warn_of_unknown
from artibot_sim.nodes.common.transforms import FrameNames, has_tf
from artibot_sim.nodes.sim import parameters as parameters
from artibot_sim.nodes.sim import parameters as settings
from artibot_sim.nodes.sim.actuation import Actuation, CommandedActuation
from artibot_sim.nodes.sim.engine import Diverged, Periods
from artibot_sim.nodes.sim.publishers import Published, Publishers
from artibot_sim.nodes.sim.sensors import SimulatedSensors

SERVE_EVERY = 0.05
"""How often services and parameters are served while simulated time runs, s."""

LATE_EVERY = 5.0
"""How often a machine that cannot keep up is told of, s."""

IDLE = 0.02
"""How long the executor is waited in at a time while simulated time stands, s."""

STEPPED_NS = 50_000_000
"""Stamps and system time may differ by this much before the system clock counts as set."""

ACKNOWLEDGED = 5.0
"""How long subscribers may take at the end to acknowledge what they were sent, s."""

TICKS, TICK_EVERY = 5, 0.2
"""Repetitions of a standing /clock after its subscribers changed, and their spacing (s): discovery takes a while."""


class SimNode(Node):
    """``sim``: simulates a rover (see the module's text).

    Parameters
    ----------
    overrides : dict
        Parameters set by the command line; they win over ``--ros-args``.
    asked : list
        Gets an entry when the process is asked to end (from a signal handler).

    Raises
    ------
    ArtibotError
        When a parameter or the robot file is refused.
    """

    def __init__(self, overrides: dict[str, Any] | None = None, asked: list[int] | None = None) -> None:
        given = {**(overrides or {}), "use_sim_time": False}  # it would listen to its own clock
        super().__init__("sim", parameter_overrides=[Parameter(name, value=value) for name, value in given.items()])
        name = str(parameters.declare(self, parameters.ROBOT))
        self.robot = load_robot(name)
        kappa = parameters.declare(self, parameters.KAPPA, self.robot.control.kappa)
        self.settings: dict[str, Any] = {"robot": name, "kappa": kappa}
        self.settings |= {spec.name: parameters.declare(self, spec) for spec in parameters.OTHERS}
        get = self.settings.__getitem__
        check_stats(self.settings["stats"])
        self.timing = Periods.of(get("publish_rate"), get("dt"))
        self.sensors = SimulatedSensors(settings.sensor_model(self.settings), get("seed"), sensor_errors(self.robot))
        self.actuation = self._actuation()
        slip = Slip.of(self.settings, self.robot)
        self.odometry = Odometry(metres_per_radian(self.robot), self.robot.front.i_y, slip)
        self._believe_start()
        self.out = Publishers(self, self.robot, self._published())
        self.pacer = Pacer(self.timing.period_ns, get("rate"))
        self.steps = 0
        self._asked = [] if asked is None else asked
        self.paused = False
        self._holding, self._waits = False, get("wait_for_profile")
        self._steps_due = 0
        self._serve_at = 0.0
        self._ahead = False
        self._lost_ns, self._lost_said = 0, False
        self._say_lost, self._say_late = Seldom(LATE_EVERY), Seldom(LATE_EVERY)
        self._listeners, self._ticks, self._tick_at = -1, 0, 0.0
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.create_service(Trigger, "~/step", self._on_step)
        keep_types(self)
        self.add_on_set_parameters_callback(self._on_parameters)
        warn_of_unknown(self)

    # -- settings -----------------------------------------------------------------------------------------------

    def _actuation(self) -> Actuation:
        if self.settings["with_driver"]:
            from artibot_sim.nodes.sim.driven import DrivenActuation

            return DrivenActuation(self, self.robot, self.timing, self.settings, self.sensors)
        return CommandedActuation(self, self.robot, self.timing, self.settings)

    def _published(self) -> Published:
        get = self.settings.__getitem__
        return Published(
            clock=settings.switched(self.settings, "publish_clock", get("rate") != 1),
            long_queue=settings.switched(self.settings, "reliable", get("rate") == 0),
            with_driver=get("with_driver"),
            tf=has_tf(self, get("publish_tf")),
            imu=get("imu.enabled"),
            station=get("total_station.enabled"),
            frames=FrameNames.of(get("frame_prefix"), get("map_frame")),
            gyro_deviation=settings.gyro_deviation(self.settings),
            acceleration_deviation=get("imu.acceleration_deviation") or get("imu.acceleration_noise"),
            orientation=get("imu.orientation"),
            orientation_deviation=get("imu.orientation_noise"),
        )

    def _on_parameters(self, changes: list[Parameter]) -> SetParametersResult:
        try:
            checked = {p.name: parameters.check(p.name, p.value) for p in changes if p.name in parameters.SPECS}
        except ArtibotError as error:
            return SetParametersResult(successful=False, reason=str(error))
        if checked and self.actuation.runs_on:
            return SetParametersResult(successful=False, reason="the driver commands this rover: set it there")
        self.settings |= checked
        self.actuation.adopt(self.settings)
        return SetParametersResult(successful=True)

    # -- services -----------------------------------------------------------------------------------------------

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.reset()
        response.success, response.message = True, f"{self.robot.name} is at its start, at rest"
        return response

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if self.actuation.runs_on:
            response.success, response.message = False, f"cannot be paused: {self.actuation.runs_on}"
            return response
        if request.data != self.paused:
            self.paused = request.data
            self._time_stands(self.standing)
        response.success, response.message = True, "paused" if self.paused else "running"
        return response

    def _on_step(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self.paused
        response.message = "one period" if self.paused else "not paused: call ~/pause with true first"
        self._steps_due += self.paused
        return response

    # -- time ---------------------------------------------------------------------------------------------------

    @property
    def standing(self) -> bool:
        """Whether simulated time stands: paused, or held until a command comes."""
        return self.paused or self._holding

    def _time_stands(self, standing: bool) -> None:
        self.actuation.stop_time(standing)
        if not standing:
            self.pacer.start()
            self._catch_up_with_system_time()

    def _catch_up_with_system_time(self) -> None:
        """Where stamps are system time they jump ahead over the time that was not simulated."""
        if not self.out.what.clock:
            self.actuation.t_ns = max(self.actuation.t_ns, self.pacer.due_ns())

    def reset(self) -> None:
        """Put the rover back to its start, at rest, and forget all commands; time goes on."""
        self.actuation.reset()
        self._believe_start()
        self._waits = self.settings["wait_for_profile"]
        if self._holding:  # one more step shows the rover at its start
            self._holding = False
            self._time_stands(self.standing)

    def _believe_start(self) -> None:
        start = settings.start(self.settings)
        self.odometry.reset(start.x, start.y, start.yaw)

    # -- the loop -----------------------------------------------------------------------------------------------

    def run(self, executor: SingleThreadedExecutor) -> int:
        """Simulate until asked to end, the duration is over, or the model diverges; return the exit status."""
        gc.collect()
        gc.freeze()  # what lives now lives to the end: collections stay short
        self.actuation.t_ns = self.timing.period_ns if self.out.what.clock else 0
        self.paused = self.settings["start_paused"]
        if 0 < self.settings["rate"] <= 1 and (reason := take_priority(self.settings["realtime_priority"])):
            self.get_logger().info(f"no real-time priority ({reason}): a busy machine may delay what is published")
        self._time_stands(self.paused)
        self.get_logger().info(f"{self.robot.name} is ready {self.actuation.describe()}")
        last = round(self.settings["duration"] * 1e9 / self.timing.period_ns)
        while not self._asked and not (last and self.steps >= last):
            if self.standing and not self._steps_due:
                self._stand(executor)
                continue
            try:
                self._wait(executor)
                if (self.standing and not self._steps_due) or self._asked:
                    continue
                self._step()
            except Diverged as error:
                self.get_logger().fatal(f"the model {error}; the simulation ends here")
                return 1
        return 0

    def _wait(self, executor: SingleThreadedExecutor) -> None:
        """Serve, wait for the deadline, and let come in what has come."""
        if time.monotonic() >= self._serve_at:
            self._serve_at = time.monotonic() + SERVE_EVERY
            executor.spin_once(timeout_sec=0.0)
        self.actuation.wait(0.0 if self.standing else self.pacer.remaining())

    def _stand(self, executor: SingleThreadedExecutor) -> None:
        """Take what comes while time stands, and show late subscribers where it stands."""
        listeners = self.out.clock_listeners()
        if listeners != self._listeners:
            self._listeners, self._ticks = listeners, TICKS
        if self._ticks and self.steps and time.monotonic() >= self._tick_at:
            self.out.clock(self.actuation.t_ns - self.timing.period_ns)
            self._ticks, self._tick_at = self._ticks - 1, time.monotonic() + TICK_EVERY
        executor.spin_once(timeout_sec=IDLE)
        if self._holding and self.actuation.has_command:
            self._holding = self._waits = False
            self._time_stands(self.standing)

    def finish(self) -> None:
        """Close what moves the rover; where nothing is to be lost, slow subscribers still get what was published."""
        self.actuation.close()
        if self.out.what.long_queue and not self._asked:
            self.out.wait_acknowledged(ACKNOWLEDGED)

    def statistics(self) -> dict[str, Any]:
        """How late publications were."""
        return self.pacer.statistics()

    def _step(self) -> None:
        """Publish this instant and compute the next."""
        t_ns, period = self.actuation.t_ns, self.timing.period_ns
        sample = self.actuation.step()
        every = round(1e9 / self.settings["total_station.rate"])
        due = t_ns // every != (t_ns - period) // every
        self.out.publish(t_ns, sample, self.sensors, self.odometry, due)
        self.steps += 1
        self.actuation.t_ns = t_ns + period
        self._steps_due = max(0, self._steps_due - 1)
        if self.standing:
            return
        self._note_the_time()
        if self._waits and not self.actuation.has_command:
            self._holding = True
            self._time_stands(True)

    def _note_the_time(self) -> None:
        """Go on to the next deadline; say so when this one was missed by more than a period."""
        overruns = self.pacer.overruns
        slipped = self.pacer.done()
        self._lost_ns += slipped
        if self._lost_ns and self._say_lost.due():
            self._say_what_was_lost()
        if slipped:
            self._catch_up_with_system_time()
        elif self.pacer.overruns > overruns and self._say_late.due():
            self.get_logger().warning(
                f"published more than a period late ({self.pacer.overruns} times so far); catching up"
            )
        if not slipped and not self.out.what.clock and self.pacer.rate == 1:
            self._follow_system_clock()

    def _say_what_was_lost(self) -> None:
        """Warn of all time that was lost since the last warning; the first one says what it does and what helps."""
        text = f"{self._lost_ns * 1e-9:.2f} s behind: this machine is too slow, or was held up; the schedule slips"
        if not self._lost_said and not self.out.what.clock:
            text += (
                ". Stamps jump, and the rover gets less far than it was told; no pace is asked for by --rate 0 here "
                "and --use-sim-time for the planner"
            )
        self.get_logger().warning(text)
        self._lost_ns, self._lost_said = 0, True

    def _follow_system_clock(self) -> None:
        """Set the stamps forward after the system clock was (NTP, by hand); say so when it was set back."""
        behind = self.pacer.due_ns() - self.actuation.t_ns
        if -behind > STEPPED_NS:  # or was this process held up between reading the two clocks? that would look like it
            behind = self.pacer.due_ns() - self.actuation.t_ns
        if behind > STEPPED_NS:
            self.actuation.t_ns += behind
            self.get_logger().warning(f"the system clock was set forward by {behind * 1e-9:.2f} s: stamps jump with it")
        elif -behind > STEPPED_NS and not self._ahead:
            self.get_logger().warning(
                f"the system clock was set back: stamps never go back and stay {-behind * 1e-9:.2f} s ahead of it; "
                "start the simulator anew to have them agree"
            )
        self._ahead = -behind > STEPPED_NS
