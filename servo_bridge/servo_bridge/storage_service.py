"""The services ``save_to_board`` and ``restore_factory``, and the state of the non-volatile storage for /diagnostics.

Each access is a separate job of the link, so that set-points and telemetry continue in between.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from typing import Final, TypeVar

from rclpy.node import Node
from servo_msgs_py.board_storage import (
    Kind,
    Storage,
    StorageRefusedError,
    begin_request,
    read_storage,
    request_result,
    success_text,
)
from std_srvs.srv import Trigger

from servo_bridge.board_context import BoardContext
from servo_bridge.deferred_service import DeferredService
from servo_bridge.outcome import Outcome, answered
from servo_bridge.part import Part
from servo_bridge.wire.session_port import SessionPort
from servo_msgs_py import topics

_TIMEOUT: Final = 5.0
"""Timeout of a request [s]; the flash takes half a second at most."""

T = TypeVar("T")


class StorageService(Part):
    """Executes the storage services. All methods run in the thread of the node.

    Parameters
    ----------
    context : BoardContext
        Access to the board, the executor and the log.
    node : Node
        Owner of the services.
    """

    def __init__(self, context: BoardContext, node: Node) -> None:
        self.storage: Storage | None = None  # state of the storage; None: not known
        self._context = context
        self._waiting: Future[Outcome] | None = None  # answer of the request in progress
        self._services = [
            DeferredService(node, Trigger, topics.SAVE_TO_BOARD, lambda _: self._request("SAVE")),
            DeferredService(node, Trigger, topics.RESTORE_FACTORY, lambda _: self._request("FACTORY")),
        ]

    def connected(self) -> None:
        """Read the state after a connection; the board may have been reset."""
        self._job(lambda memory: read_storage(memory), self._update, lambda _: None)

    def lost(self, reason: str) -> None:
        """Forget the state of the board, and answer a request."""
        self.storage = None
        if self._waiting is not None:
            self._done(self._waiting, (False, f"the link was lost: {reason}"))

    def _update(self, storage: Storage) -> None:
        if storage.trouble and storage != self.storage:
            self._context.warn(f"data flash of the board: {storage.trouble}")
        self.storage = storage

    def _request(self, kind: Kind) -> Future[Outcome]:
        if self._waiting is not None:
            return answered(False, "a request is already in progress; call again after its response")
        self._waiting = answer = Future[Outcome]()
        until = time.monotonic() + _TIMEOUT
        failed = partial(self._failed, kind, answer)
        self._job(lambda memory: begin_request(memory, kind), partial(self._poll, kind, answer, until), failed)
        return answer

    def _poll(self, kind: Kind, answer: Future[Outcome], until: float, token: int) -> None:
        def seen(storage: Storage | None) -> None:
            if answer is not self._waiting:
                return  # ended by the loss of the link
            if storage is not None:
                self._update(storage)
                self._done(answer, (True, success_text(kind, storage)))
            elif time.monotonic() > until:
                self._failed(kind, answer, StorageRefusedError("", f"no result of the board within {_TIMEOUT:g} s"))
            else:
                self._poll(kind, answer, until, token)

        self._job(lambda memory: request_result(memory, token), seen, partial(self._failed, kind, answer))

    def _failed(self, kind: Kind, answer: Future[Outcome], error: BaseException) -> None:
        if answer is self._waiting:
            self._done(answer, (False, str(error) or type(error).__name__))
            self.connected()

    def _done(self, answer: Future[Outcome], outcome: Outcome) -> None:
        self._waiting = None
        success, message = outcome
        (self._context.info if success else self._context.warn)(message)
        answer.set_result(outcome)

    def _job(
        self,
        work: Callable[[SessionPort], T],
        then: Callable[[T], None],
        failed: Callable[[BaseException], None],
    ) -> None:
        """Call `work` in the thread of the link, and `then` with its result in the thread of the node."""

        def done(future: Future[T]) -> None:
            error = future.exception()
            if error is None:
                then(future.result())
            else:
                failed(error)

        self._context.when_done(self._context.call(lambda session: work(SessionPort(session))), done)
