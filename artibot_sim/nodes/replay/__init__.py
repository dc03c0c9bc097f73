"""The `replay` node: a recording published, driven or simulated again."""
