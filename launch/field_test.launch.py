"""A field test: a rover drives a manoeuvre and all is recorded; everything ends with the planner.

ros2 launch artibot_sim field_test.launch.py manoeuvre:=slalom out:=run7
"""

from datetime import datetime

from launch.actions import DeclareLaunchArgument, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription


def generate_launch_description():
    robot = LaunchConfiguration("robot")
    manoeuvre = LaunchConfiguration("manoeuvre")
    folder = datetime.now().strftime("run_%Y%m%d_%H%M%S")
    return LaunchDescription(
        [
            DeclareLaunchArgument("robot", default_value="agriq", description="agriq, epiq, husky, or a robot file"),
            DeclareLaunchArgument("manoeuvre", default_value="table6_agriq", description="a shipped one, or a file"),
            DeclareLaunchArgument("out", default_value=folder, description="folder of the recording"),
            Node(
                package="artibot_sim",
                executable="record",
                output="screen",
                arguments=["--out", LaunchConfiguration("out"), "--robot", robot, "--description", manoeuvre],
            ),
            Node(package="artibot_sim", executable="sim", output="screen", parameters=[{"robot": robot}]),
            Node(
                package="artibot_sim",
                executable="planner",
                output="screen",
                parameters=[{"robot": robot, "manoeuvre": manoeuvre}],
                on_exit=Shutdown(reason="the manoeuvre is over"),
            ),
        ]
    )
