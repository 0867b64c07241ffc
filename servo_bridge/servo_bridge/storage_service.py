"""Services ``save_to_board`` and ``restore_factory``; state of the non-volatile storage for /diagnostics."""

from __future__ import annotations

import contextlib
from concurrent.futures import Future
from functools import partial

from rclpy.node import Node
from servo_msgs_py.board_storage import Kind, Storage, execute_request, read_storage, success_text
from std_srvs.srv import Trigger

from servo_bridge.board_context import BoardContext
from servo_bridge.board_requests import BoardRequests, error_text
from servo_bridge.deferred_service import DeferredService
from servo_bridge.outcome import Outcome, answered
from servo_bridge.part import Part
from servo_msgs_py import topics


class StorageService(Part):
    """Executes the storage services.

    Parameters
    ----------
    context : BoardContext
        Access to the executor and the log.
    node : Node
        Owner of the services.
    requests : BoardRequests
        Executes the requests.
    """

    def __init__(self, context: BoardContext, node: Node, requests: BoardRequests) -> None:
        self.storage: Storage | None = None  # state of the storage; None: not known
        self._context = context
        self._requests = requests
        self._waiting: Future[Outcome] | None = None  # answer of the request in progress
        self._services = [
            DeferredService(node, Trigger, topics.SAVE_TO_BOARD, lambda _: self._request("SAVE")),
            DeferredService(node, Trigger, topics.RESTORE_FACTORY, lambda _: self._request("FACTORY")),
        ]

    # ---- thread of the node
    def connected(self) -> None:
        """Read the state after a connection; the board may have been reset."""
        self._requests.put(self._refresh)

    def lost(self, reason: str) -> None:
        """Forget the state of the board, and answer a request."""
        self.storage = None
        if self._waiting is not None:
            self._done(self._waiting, (False, f"the link was lost: {reason}"))

    def _request(self, kind: Kind) -> Future[Outcome]:
        if self._waiting is not None:
            return answered(False, "a request is already in progress; call again after its response")
        self._waiting = answer = Future[Outcome]()
        self._requests.put(partial(self._execute, kind, answer))
        return answer

    def _update(self, storage: Storage) -> None:
        if storage.trouble and storage != self.storage:
            self._context.warn(f"data flash of the board: {storage.trouble}")
        self.storage = storage

    def _done(self, answer: Future[Outcome], outcome: Outcome) -> None:
        if answer is not self._waiting:
            return  # ended by the loss of the link
        self._waiting = None
        success, message = outcome
        (self._context.info if success else self._context.warn)(message)
        answer.set_result(outcome)

    # ---- thread of the requests
    def _refresh(self) -> None:
        with contextlib.suppress(Exception):  # a lost link is reported elsewhere; read again after the reconnection
            self._context.post(partial(self._update, read_storage(self._requests)))

    def _execute(self, kind: Kind, answer: Future[Outcome]) -> None:
        try:
            storage = execute_request(self._requests, kind)
            outcome = True, success_text(kind, storage)
            self._context.post(partial(self._update, storage))
        except Exception as error:  # includes internal errors: the service must respond
            outcome = False, error_text(error)
            self._refresh()
        self._context.post(partial(self._done, answer, outcome))
