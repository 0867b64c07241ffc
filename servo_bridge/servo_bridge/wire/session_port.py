"""Port to the board of a session: `servo_msgs_py.board_port.BoardPort` on a serial line."""

from __future__ import annotations

from collections.abc import Sequence

from servo_msgs_py.board_port import BoardPort
from servo_msgs_py.catalogue import Catalogue

from servo_bridge.freemaster.errors import Status, StatusError
from servo_bridge.wire.session import Session


class SessionPort(BoardPort):
    """Port to the board of a session.

    Parameters
    ----------
    session : Session
        Session with a board of this contract.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._line = session.client.line

    @property
    def catalogue(self) -> Catalogue:
        return self._session.catalogue

    def clock(self) -> float:
        """Time of the clock of the line [s]."""
        return self._line.clock() * 1e-9

    def wait(self, seconds: float) -> None:
        """Wait [s] without a request."""
        self._line.rest(seconds)

    def read_words(self, name: str) -> list[int]:
        variable = self._session.variables[name]
        return self.catalogue[name].decode_raw(self._session.client.read_memory(variable.address, variable.size))

    def write_words(self, name: str, words: Sequence[int], first: int = 0) -> bool:
        offset, data = self.catalogue[name].encode_part(words, first)
        try:
            self._session.client.write_memory(self._session.variables[name].address + offset, data)
        except StatusError as error:
            if error.code != Status.OUT_OF_RANGE:
                raise
            return False
        return True
