"""A ROS service whose answer may come later, while the executor goes on.

The events executor calls a service's callback and hands what it returns straight to ``Service.send_response``; it knows
no coroutines. So the callback returns an empty response at once, and this class holds that one back until the handler's
future is done. It works the same under every other executor of rclpy.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from rclpy.node import Node

Outcome = tuple[bool, str]
"""Success and message, the two fields of SetBool and Trigger responses."""


class DeferredService:
    """A SetBool or Trigger service.

    Parameters
    ----------
    node : Node
        Owner.
    service_type : type
        ``std_srvs.srv.SetBool`` or ``Trigger``.
    name : str
        Relative name.
    handler : callable
        Gets the request and returns a future of the outcome, which has to be completed in the executor's thread.
    """

    def __init__(self, node: Node, service_type: Any, name: str, handler: Callable[[Any], Future[Outcome]]) -> None:
        self._handler = handler
        self._held: dict[int, Future[Outcome]] = {}
        self._service = node.create_service(service_type, name, self._called)
        self._send: Callable[[Any, Any], None] = self._service.send_response
        # rclpy looks the method up on the object at every call; this is its only place to hold an answer back.
        setattr(self._service, "send_response", self._respond)  # noqa: B010

    def _called(self, request: Any, response: Any) -> Any:
        self._held[id(response)] = self._handler(request)
        return response

    def _respond(self, response: Any, header: Any) -> None:
        future = self._held.pop(id(response))

        def answer(done: Future[Outcome]) -> None:
            response.success, response.message = done.result()
            self._send(response, header)

        future.add_done_callback(answer)
