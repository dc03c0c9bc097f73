"""Faults as a catalogue, and trials of them in a closed loop of master and simulated drives."""
