"""The executor of nodes that answer every message by itself."""

from __future__ import annotations

from typing import Any


def light_executor() -> Any:
    """Return an executor that is told what has come, where rclpy has one: others ask every subscription each time."""
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        from rclpy.executors import SingleThreadedExecutor

        return SingleThreadedExecutor()
    return EventsExecutor()
