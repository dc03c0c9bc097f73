"""A field test: a rover drives a manoeuvre over CAN and all is recorded; everything ends with the planner.

ros2 launch artibot_sim field_test.launch.py manoeuvre:=slalom out:=run7
ros2 launch artibot_sim field_test.launch.py simulated:=false channel:=can0 driver_params:=rover.yaml

The second is a real rover, described by the `robot` of its driver's parameter file; one that is no Agri.q is given as
`robot:=` too, for the plan. Look that all is well, then `ros2 service call /driver/enable std_srvs/srv/Trigger`; the
planner waits for that and begins.
"""

from datetime import datetime

from launch.actions import DeclareLaunchArgument, Shutdown
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription


def generate_launch_description():
    robot, manoeuvre = LaunchConfiguration("robot"), LaunchConfiguration("manoeuvre")
    # launch reads the text of a parameter as YAML unless its type is stated: a file's name may look like a number
    robot_text, manoeuvre_text = ParameterValue(robot, value_type=str), ParameterValue(manoeuvre, value_type=str)
    channel, driver_params = LaunchConfiguration("channel"), LaunchConfiguration("driver_params")
    simulated, enable = LaunchConfiguration("simulated"), LaunchConfiguration("enable")
    namespace = LaunchConfiguration("namespace")
    driver = {"package": "artibot_sim", "executable": "driver", "output": "screen", "namespace": namespace}
    driver["arguments"] = ["--params", driver_params, "--channel", channel, "--kappa", LaunchConfiguration("kappa")]
    return LaunchDescription(
        [
            *arguments(simulated),
            Node(
                package="artibot_sim",
                executable="record",
                namespace=namespace,
                output="screen",
                arguments=[
                    *("--out", LaunchConfiguration("out"), "--can", channel),
                    *("--robot", robot, "--description", manoeuvre),
                ],
            ),
            Node(
                package="artibot_sim",
                executable="sim",
                namespace=namespace,
                output="screen",
                condition=IfCondition(simulated),
                arguments=["--driver-params", driver_params, "--channel", channel],
                parameters=[{"robot": robot_text, "with_driver": True}],
            ),
            Node(
                **driver,
                condition=IfCondition(simulated),
                parameters=[{"robot": robot_text, "enable_on_start": enable}],
            ),
            # a default of this file must not change whose motors a real rover's driver believes to drive
            Node(**driver, condition=UnlessCondition(simulated), parameters=[{"enable_on_start": enable}]),
            Node(
                package="artibot_sim",
                executable="planner",
                namespace=namespace,
                output="screen",
                parameters=[{"robot": robot_text, "manoeuvre": manoeuvre_text, "subscriber_timeout": 600.0}],
                on_exit=Shutdown(reason="the manoeuvre is over"),
            ),
        ]
    )


def arguments(simulated):
    folder = datetime.now().strftime("run_%Y%m%d_%H%M%S")
    return [
        DeclareLaunchArgument("robot", default_value="agriq", description="agriq, epiq, or a robot file"),
        DeclareLaunchArgument("manoeuvre", default_value="table6_agriq", description="a shipped one, or a file"),
        DeclareLaunchArgument("out", default_value=folder, description="folder of the recording"),
        DeclareLaunchArgument("channel", default_value="vcan0", description="CAN channel: vcan0, can0, ws://…"),
        DeclareLaunchArgument("driver_params", default_value="driver", description="the driver's parameter file"),
        DeclareLaunchArgument(
            "kappa",
            default_value="",
            description="front share of the traction torque; empty: as in driver_params, or the robot's",
        ),
        DeclareLaunchArgument("namespace", default_value="", description="of all topics but /clock and /tf"),
        DeclareLaunchArgument("simulated", default_value="true", description="false: the rover is a real one"),
        DeclareLaunchArgument(
            "enable",
            default_value=simulated,
            description="false: wait for ~/enable, as real rovers do unless told otherwise",
        ),
    ]
