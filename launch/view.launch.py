"""See a rover, simulated, real or replayed: its links on /tf, and RViz where that is installed.

ros2 launch artibot_sim view.launch.py robot:=epiq
ros2 launch artibot_sim view.launch.py namespace:=rover1 frame_prefix:=rover1/ use_sim_time:=true

Start it beside a simulator, a driver or a replay; use_sim_time with the last, or at a simulator's rate other than 1.
"""

from ament_index_python.packages import get_packages_with_prefixes
from launch.actions import DeclareLaunchArgument
from launch.substitutions import Command, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description():
    namespace, sim_time = LaunchConfiguration("namespace"), LaunchConfiguration("use_sim_time")
    urdf = Command(["ros2 run artibot_sim urdf ", LaunchConfiguration("robot")])
    prefix = LaunchConfiguration("frame_prefix")
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        namespace=namespace,
        output="log",
        arguments=["-d", PathJoinSubstitution([FindPackageShare("artibot_sim"), "config", "viewer", "rover.rviz"])],
        parameters=[{"use_sim_time": sim_time}],
    )
    return LaunchDescription(
        [
            DeclareLaunchArgument("robot", default_value="agriq", description="agriq, epiq, husky, or a robot file"),
            DeclareLaunchArgument("namespace", default_value="", description="of the rover's topics"),
            DeclareLaunchArgument("frame_prefix", default_value="", description="of its frames: rover1/"),
            DeclareLaunchArgument("use_sim_time", default_value="false", description="true: time comes from /clock"),
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                namespace=namespace,
                output="screen",
                parameters=[
                    {
                        "robot_description": ParameterValue(urdf, value_type=str),
                        "frame_prefix": ParameterValue(prefix, value_type=str),
                        "use_sim_time": sim_time,
                    }
                ],
            ),
            *([rviz] if "rviz2" in get_packages_with_prefixes() else []),
        ]
    )
