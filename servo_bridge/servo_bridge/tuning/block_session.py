"""Access to configuration blocks with an open session."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Final

from servo_bridge.freemaster.errors import Status, StatusError
from servo_bridge.wire.session import Session

_TIMEOUT: Final = 1.0


class BlockSession:
    """`servo_msgs_py.axis_config_transfer.BlockMemory` of a board.

    Parameters
    ----------
    session : Session
        Session with a board of this contract.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._until: float | None = None

    def read_words(self, name: str) -> list[int]:
        variable = self._session.variables[name]
        assert variable.contract is not None
        return variable.contract.decode_raw(self._session.client.read_memory(variable.address, variable.size))

    def write_words(self, name: str, words: Sequence[int]) -> bool:
        variable = self._session.variables[name]
        assert variable.contract is not None
        data = variable.contract.pack(words)
        try:
            self._session.client.write_memory(variable.address, data)
        except StatusError as error:
            if error.code != Status.OUT_OF_RANGE:
                raise
            return False
        return True

    def wait(self) -> bool:
        """Check the timeout; the next request itself takes longer than a slow tick. False after the timeout."""
        now = time.monotonic()
        if self._until is None:
            self._until = now + _TIMEOUT
        return now < self._until
