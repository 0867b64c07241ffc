"""Context of the parts of the supervisor, without a link and without an executor."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from servo_bridge.board_context import BoardContext
from servo_msgs_py.catalogue import Catalogue, Value


def _not_available(function: Any) -> Any:
    raise AssertionError("not expected in this test")


def board_context(
    read: Callable[[str], Future[Value]] = _not_available,
    post: Callable[[Callable[[], None]], None] = lambda function: function(),
    log: Callable[[str], None] = _not_available,
) -> BoardContext:
    """Context whose log has all levels; posted functions are called at once, unless `post` does otherwise."""
    return BoardContext(Catalogue.load(), read, _not_available, post, log, log)
