"""The `record` node: topics and CAN frames to a recording that survives a crash."""
