"""The driver's services: each sets a auto_enable, and answers once it is known what came of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from artibot_driver.master import Status
from artibot_sim.nodes.driver_answers import PATIENCE, Answer, Pending, answer


class Services:
    """``~/enable``, ``~/disable``, ``~/quick_stop`` and ``~/reset_fault``.

    Parameters
    ----------
    node : rclpy Node
    request : callable
        Takes a service's name and makes the request of the master; returns how many requests the master had answered
        before, or why none can be made.
    """

    def __init__(self, node: Node, request: Callable[[str], int | str]) -> None:
        self._request, self._log = request, node.get_logger()
        self._pending: list[Pending] = []
        group = ReentrantCallbackGroup()  # a call that waits for its answer keeps no other waiting
        for name in PATIENCE:
            node.create_service(Trigger, f"~/{name}", self._handler(name), callback_group=group)

    def _handler(self, name: str) -> Any:
        async def handle(_request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            answered: Future = Future()
            before = self._request(name)
            if isinstance(before, str):
                answered.set_result((False, before))
            else:
                self._pending.append(Pending(name, before, time.monotonic(), answered.set_result))
            response.success, response.message = await answered
            self._log.info(f"~/{name}: {response.message}")
            return response

        return handle

    def answer(self, status: Status) -> None:
        """Answer the calls of which it is known now what came of them."""
        now = time.monotonic()
        for pending in list(self._pending):
            found: Answer | None = answer(pending, status, now)
            if found is not None:
                self._pending.remove(pending)
                pending.reply(found)

    def end(self, why: str) -> None:
        """Answer all calls that still wait."""
        for pending in self._pending:
            pending.reply((False, why))
        self._pending.clear()
