"""The `driver` node: commands from topics, four CiA 402 drives over CAN, their feedback to topics."""
