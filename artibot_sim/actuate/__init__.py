"""Torque-sharing laws compared on a trajectory."""
