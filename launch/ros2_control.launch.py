"""Controllers of ros2_control drive a rover, simulated or real: by topics, beside its simulator or driver.

artibot export agriq --to ros2_control
ros2 launch artibot_sim ros2_control.launch.py urdf:=agriq_ros2_control.urdf controllers:=agriq_ros2_control.yaml

The description has a name of its own, for simulator and driver publish robot_description without the tag.
"""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import Command, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription

OWN = [("robot_description", "robot_description_control"), ("~/robot_description", "robot_description_control")]


def generate_launch_description():
    namespace = LaunchConfiguration("namespace")
    description = ParameterValue(Command(["cat ", LaunchConfiguration("urdf")]), value_type=str)
    return LaunchDescription(
        [
            DeclareLaunchArgument("urdf", description="what artibot export --to ros2_control wrote"),
            DeclareLaunchArgument("controllers", description="the file beside it, with the controllers' parameters"),
            DeclareLaunchArgument("namespace", default_value="", description="of the rover's topics"),
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                namespace=namespace,
                output="screen",
                parameters=[{"robot_description": description}],
                remappings=OWN[:1],
            ),
            Node(
                package="controller_manager",
                executable="ros2_control_node",
                namespace=namespace,
                output="screen",
                arguments=["--ros-args", "--params-file", LaunchConfiguration("controllers")],
                remappings=OWN,
            ),
            Node(
                package="controller_manager",
                executable="spawner",
                namespace=namespace,
                output="screen",
                arguments=["diff_drive_controller", "--param-file", LaunchConfiguration("controllers")],
            ),
        ]
    )
