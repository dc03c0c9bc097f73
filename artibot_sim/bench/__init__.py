"""Benchmarks: how fast the model, its commands and its nodes are on this machine."""
