"""The paper's model, equations 1 to 30: no ROS, no CAN, no wall clock.

>>> from artibot_sim.model import Commands, load_robot, rollout
>>> robot = load_robot("agriq")
>>> result = rollout(robot, Commands(0.01, velocity))     # velocity (n, 4), motor side
>>> result.pose[-1], result["F_t_front_right_front"].max()
"""

from artibot_sim.model.equations.transmission import Mode
from artibot_sim.model.ground import Ground, load_ground, random_ground
from artibot_sim.model.robot.file import load_robot, save_robot
from artibot_sim.model.robot.robot import MOTORS, WHEEL_JOINTS, WHEELS, Robot
from artibot_sim.model.simulate.commands import Commands
from artibot_sim.model.simulate.rollout import Rollout, Status, rollout
from artibot_sim.model.simulate.state import State, initial_state

__all__ = [
    "MOTORS",
    "WHEELS",
    "WHEEL_JOINTS",
    "Commands",
    "Ground",
    "Mode",
    "Robot",
    "Rollout",
    "State",
    "Status",
    "initial_state",
    "load_ground",
    "load_robot",
    "random_ground",
    "rollout",
    "save_robot",
]
