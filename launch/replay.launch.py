"""Publish a recording again.

ros2 launch artibot_sim replay.launch.py bag:=run7 rate:=2.0
"""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument("bag", description="folder of the recording, or an .mcap file"),
            DeclareLaunchArgument("rate", default_value="1.0", description="recorded seconds a second"),
            DeclareLaunchArgument("namespace", default_value="", description="of all topics but /clock and /tf"),
            Node(
                package="artibot_sim",
                executable="replay",
                namespace=LaunchConfiguration("namespace"),
                output="screen",
                arguments=[LaunchConfiguration("bag"), "--rate", LaunchConfiguration("rate")],
            ),
        ]
    )
