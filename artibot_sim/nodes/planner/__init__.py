"""The `planner` node: a manoeuvre as profile, path and sign of life."""
