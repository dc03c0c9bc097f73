"""``artibot drives``: four simulated CiA 402 drives on a CAN bus, on the simulated rover or on a bench. Without ROS."""

from __future__ import annotations

import gc
import sys
import time
from collections.abc import Sequence

import click

from artibot_driver.priority import take_priority
from artibot_driver.rig import load_rig
from artibot_sim.errors import ArtibotError
from artibot_sim.model import MOTORS, load_robot
from artibot_sim.nodes.child_processes import noted_signals
from artibot_sim.nodes.common.options import BoundedNumber
from artibot_sim.nodes.common.pacer import Pacer
from artibot_sim.nodes.common.process import node_main
from artibot_sim.nodes.drives.loop import DriveLoop, drive_config, drive_states, open_drive_loop
from artibot_sim.nodes.drives.motors import Flywheels, RoverShafts
from artibot_sim.nodes.sim.engine import Diverged, Periods, StartPose

TIMING = Periods.of(100.0, 1e-3)


@click.command("drives", context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.option("--robot", default="agriq", show_default=True, help="Robot: agriq, or the path of a robot file.")
@click.option("--bench", is_flag=True, help="Four flywheels instead of the rover.")
@click.option("--params", default="driver", show_default=True, help="The driver's parameters: a name, or a path.")
@click.option("--interface", default="", help="python-can's name of the CAN interface.  [by the channel]")
@click.option("--channel", default="", help="CAN channel: vcan0, can0, ws://….  [that in the parameters]")
@click.option("--duration", type=BoundedNumber(0), default=0.0, help="End after so many seconds.  [default: at Ctrl-C]")
@click.option("--priority", type=click.IntRange(0, 99), default=50, show_default=True, help="Real-time; 0: as others.")
@click.option(
    "--every", type=BoundedNumber(0, min_open=True), default=5.0, show_default=True, help="Print so often, s."
)
def command(
    robot: str, bench: bool, params: str, interface: str, channel: str, duration: float, priority: int, every: float
) -> int:
    """Put four simulated CiA 402 drives on a CAN bus, to be commanded by a driver or by any CANopen master.

    Their shafts are the motors of the simulated rover. There is no ROS in this: `artibot sim --with-driver` puts the
    same drives on the same rover and publishes where it really is.

    \b
    Examples:
      artibot drives
      artibot drives --bench --channel can0
      artibot drives --channel ws://127.0.0.1:40000/
    """
    plant = Flywheels() if bench else RoverShafts(load_robot(robot), TIMING, StartPose())
    if isinstance(plant, RoverShafts):
        plant.warm_up()
    with noted_signals() as asked:
        loop = open_drive_loop(load_rig(drive_config(robot, params, interface, channel)), plant)
        try:
            if reason := take_priority(priority):
                print(f"no real-time priority ({reason}): a busy machine may delay the drives", flush=True)
            return _run(loop, asked, duration, every)
        except Diverged as error:
            raise ArtibotError(f"the model {error}") from error
        finally:
            loop.close()


def _run(loop: DriveLoop, asked: list[int], duration: float, every: float) -> int:
    """Run until asked to end, in real time."""
    config, slices = loop.rig.config, TIMING.period_ns // loop.plant.slice_ns
    print(f"drives {_nodes(loop)} on {config.interface} {config.channel}; Ctrl-C ends them", flush=True)
    loop.switch_on()
    gc.collect()
    gc.freeze()
    pacer, said, begin, due = Pacer(TIMING.period_ns, 1.0), "", time.monotonic(), 0.0
    pacer.start()
    while not asked and not (duration and time.monotonic() - begin >= duration):
        notice = loop.run_until(time.monotonic_ns() + round(pacer.remaining() * 1e9), slices)
        pacer.done()
        states, now = drive_states(loop.drives), time.monotonic() - begin
        if notice:
            print(f"{now:8.2f} s  {notice}", flush=True)
        if states != said or now >= due:
            print(f"{now:8.2f} s  {states}; {_motion(loop)}", flush=True)
            said, due = states, now + every
    return 0


def _nodes(loop: DriveLoop) -> str:
    return ", ".join(f"{loop.rig.codec.nodes[motor]} {motor}" for motor in MOTORS)


def _motion(loop: DriveLoop) -> str:
    """What the motors do, and where the rover is."""
    states = [shaft.state() for shaft in loop.plant.shafts.values()]
    text = "motors at " + " ".join(_plain(state.velocity, 1) for state in states) + " rad/s with "
    text += " ".join(_plain(state.torque, 3) for state in states) + " N m"
    if isinstance(loop.plant, RoverShafts):
        x, y, yaw = (_plain(value, 3) for value in loop.plant.pose)
        text += f"; rover at {x} m, {y} m, {yaw} rad"
    return text


def _plain(value: float, digits: int) -> str:
    """A rounded number; zero has no sign."""
    return f"{round(value, digits) + 0.0:.{digits}f}"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (by default the process's own) and return the exit status."""
    return node_main(command, "drives", argv)  # a launch file adds arguments of ROS to whatever it starts


if __name__ == "__main__":
    sys.exit(main())
