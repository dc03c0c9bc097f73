"""`artibot drives`: simulated CiA 402 drives on a CAN bus, with the motors of the model or flywheels. No ROS."""
