"""Benchmarks: how fast the model, its commands and its nodes are on this machine."""

from artibot_sim.bench.cli import command

__all__ = ["command"]
