"""What is doubtful about the recordings themselves: clocks, wheels, gaps, sensors."""
