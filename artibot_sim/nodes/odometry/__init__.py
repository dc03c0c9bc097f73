"""Odometry through the identified model: the node, and the command that measures it on a recording."""
