"""The simulator alone: a rover that waits for commands.

ros2 launch artibot_sim sim.launch.py robot:=epiq rate:=2.0
ros2 launch artibot_sim sim.launch.py params:=sim_noisy kappa:=0.8 namespace:=rover1

An argument that is left empty is not given: the parameter file's value holds, or the node's default.
"""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription


def generate_launch_description():
    options = {
        "robot": "agriq, epiq, husky, or a robot file; empty: agriq, or as in params",
        "rate": "simulated over real time; 0: all it can; empty: 1, or as in params",
        "kappa": "front share of the traction torque, in (0, 1]; empty: the robot's, or as in params",
        "params": "parameter file: a path, or a shipped one by name (sim_noisy); empty: none",
    }
    return LaunchDescription(
        [
            *(DeclareLaunchArgument(name, default_value="", description=text) for name, text in options.items()),
            DeclareLaunchArgument("namespace", default_value="", description="of all topics but /clock and /tf"),
            Node(
                package="artibot_sim",
                executable="sim",
                namespace=LaunchConfiguration("namespace"),
                output="screen",
                arguments=[word for name in options for word in (f"--{name}", LaunchConfiguration(name))],
            ),
        ]
    )
