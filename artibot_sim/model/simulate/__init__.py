"""Simulations: commands, states, rollouts, batches, windows, a stepper, sensors."""
