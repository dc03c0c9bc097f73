"""The `sim` node: a rover simulated behind the topics of a real one."""
