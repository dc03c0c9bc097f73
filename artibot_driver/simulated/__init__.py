"""Simulated CiA 402 drives: all of a drive but its motor, which the simulation turns."""
