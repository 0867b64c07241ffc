"""ROS service with a deferred response; the executor continues meanwhile.

The events executor passes the return value of a service callback directly to ``Service.send_response`` and does not
support coroutines. The callback therefore returns an empty response, and this class delays its transmission until the
future of the handler is done. It works with the other executors of rclpy, too.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from rclpy.node import Node

from servo_bridge.outcome import Outcome


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
        Called with the request; returns a future of the outcome, which must be completed in the executor's thread.
    """

    def __init__(self, node: Node, service_type: Any, name: str, handler: Callable[[Any], Future[Outcome]]) -> None:
        self._handler = handler
        self._held: dict[int, Future[Outcome]] = {}
        self._service = node.create_service(service_type, name, self._called)
        self._send: Callable[[Any, Any], None] = self._service.send_response
        # rclpy looks up the method of the object at every call; there is no other way to delay a response.
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
