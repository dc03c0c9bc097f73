"""CiA 402 (CANopen) drives: state machine, scaling, PDOs and the bus, without ROS."""
