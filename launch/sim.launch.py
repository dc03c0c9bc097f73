"""The simulator alone: a rover that waits for commands.

ros2 launch artibot_sim sim.launch.py robot:=epiq rate:=2.0
"""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument("robot", default_value="agriq", description="agriq, epiq, husky, or a robot file"),
            DeclareLaunchArgument("rate", default_value="1.0", description="simulated over real time; 0: all it can"),
            Node(
                package="artibot_sim",
                executable="sim",
                output="screen",
                parameters=[{"robot": LaunchConfiguration("robot"), "rate": LaunchConfiguration("rate")}],
            ),
        ]
    )
