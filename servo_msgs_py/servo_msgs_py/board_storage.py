"""Storage of parameters and configuration in the data flash of a board, by any access to its variables.

Each request has a token. The board executes repeated requests with the same token only once, so that a request can be
repeated when its response was lost.
"""

from __future__ import annotations

import secrets
import zlib
from collections.abc import Mapping
from typing import Final, Literal, NamedTuple

from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.board_parameters import parameters
from servo_msgs_py.board_port import BoardPort, BoardWords, reached
from servo_msgs_py.catalogue import Catalogue

Kind = Literal["SAVE", "FACTORY"]

_COPIES: Final = "AB"
_REQUEST_TIME: Final = 5.0  # timeout of a request [s]; the flash takes half a second at most

_REFUSALS: Final[Mapping[str, str]] = {
    "FORM": "malformed request; if another program also writes to the board, stop it and try again",
    "ABSENT": "the board has no data flash; store the values in files: servo-tool save, servo-tool tune --from-board",
    "BUSY": "the previous request is not done yet, or a measurement has changed the values; try again after it",
    "MOTION": "an axis is moving or enabled. Disable both axes, wait for standstill and try again. The stored values "
    "are unchanged",
    "CHANGED": "parameters or configuration changed during the request; the stored values are unchanged: try again",
    "FLASH": "verification of the data flash failed; the previously stored values are unchanged. If it happens "
    "again, the flash is worn out",
}

_COPY_TEXTS: Final[Mapping[str, str]] = {
    "EMPTY": "empty",
    "INTACT": "intact",
    "DAMAGED": "damaged (interrupted save, or worn flash)",
    "OTHER_LAYOUT": "written by another version of the firmware",
    "OUT_OF_RANGE": "with a value out of range",
    "ABSENT": "absent",
}

_WITHOUT_FAULT: Final = ("EMPTY", "INTACT", "ABSENT")


class StorageRefusedError(ValueError):
    """A request had no effect."""

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason  # name in the table of variables; empty: not reported by the board


class Storage(NamedTuple):
    """State of the data flash of a board."""

    sequence: int  # number of the newest set; 0: none stored
    source: str  # origin of the values at the last reset: ``BUILT_IN``, ``COPY_A`` or ``COPY_B``
    copies: tuple[str, ...]  # states of both copies, by their names in the table of variables

    @property
    def trouble(self) -> str:
        """Faults of the copies with remedy; empty if there is none."""
        faults = [
            f"copy {_COPIES[k]} is {_COPY_TEXTS[copy]}"
            for k, copy in enumerate(self.copies)
            if copy not in _WITHOUT_FAULT
        ]
        if not faults:
            return ""
        used = "the built-in values are" if self.source == "BUILT_IN" else f"copy {self.source[-1]} is"
        return f"{'; '.join(faults)}: {used} in use; save again to replace it"

    @property
    def text(self) -> str:
        """State in one line."""
        if self.copies[0] == "ABSENT":
            return "no data flash"
        origin = "built-in values" if self.source == "BUILT_IN" else f"values of copy {self.source[-1]}"
        newest = f"newest set {self.sequence}" if self.sequence else "nothing stored"
        return self.trouble or f"{origin} since the reset; {newest}"


def stored_layout(catalogue: Catalogue, table: AxisConfigTable) -> int:
    """CRC-32 of all properties that determine the meaning of the numbers of a stored set.

    Ranges are not part of it, because the board checks every number when it reads a set. Known bits of flag words are:
    a set stored by an older version would switch a newly added fault off.
    """
    stored = parameters(catalogue)
    lines = [f"{v.name} {v.type} {v.count} {v.lsb!r}" for v in stored]
    for name in sorted({v.enum for v in stored if v.enum}):
        lines.append(f"{name} {sorted(catalogue.enums[name].items(), key=lambda e: e[1])}")
    for name in sorted({v.flags for v in stored if v.flags}):
        lines.append(f"{name} {[(flag.name, flag.bit) for flag in catalogue.flags[name]]}")
    lines += [f"{m.name} {m.format.size} {m.format.signed} {m.lsb!r}" for m in table.members.values()]
    return zlib.crc32("\n".join(lines).encode())


def read_storage(memory: BoardWords) -> Storage:
    """Read the state of both copies."""
    catalogue = Catalogue.load()
    (sequence,), (source,) = memory.read_words("storage.sequence"), memory.read_words("storage.source")
    copies = memory.read_words("storage.copy")
    return Storage(
        sequence,
        catalogue.label("storage_source_t", source),
        tuple(catalogue.label("stored_copy_t", copy) for copy in copies),
    )


def begin_request(memory: BoardWords, kind: Kind) -> int:
    """Send a request to the board.

    Returns
    -------
    int
        Its token.

    Raises
    ------
    StorageRefusedError
        If the board refuses.
    """
    (before,) = memory.read_words("storage.answered")
    token = next(token for token in iter(lambda: 1 + secrets.randbelow(0xFFFF), None) if token != before)
    if not memory.write_words("storage.request", [Catalogue.load().bits["storage_request"][kind], token]):
        raise _refused(memory)
    return token


def request_result(memory: BoardWords, token: int) -> Storage | None:
    """State of the data flash after a request; None during its execution.

    Raises
    ------
    StorageRefusedError
        If the request had no effect.
    """
    if memory.read_words("storage.state") != [Catalogue.load().enums["storage_state_t"]["IDLE"]]:
        return None
    if memory.read_words("storage.answered") != [token]:
        raise StorageRefusedError(
            "", "the board has lost the request, possibly by a reset; check the state of the storage and try again"
        )
    if memory.read_words("storage.refusal") != [0]:
        raise _refused(memory)
    return read_storage(memory)


def execute_request(board: BoardPort, kind: Kind) -> Storage:
    """Send a request and wait for its end.

    Parameters
    ----------
    board : BoardPort
        The board.
    kind : {"SAVE", "FACTORY"}
        Store the active values, or erase the stored ones.

    Raises
    ------
    StorageRefusedError
        If the request had no effect, or did not end before the timeout.
    """
    token = begin_request(board, kind)
    results: list[Storage | None] = []

    def ended() -> bool:
        results.append(request_result(board, token))
        return results[-1] is not None

    if not reached(board, ended, _REQUEST_TIME) or (result := results[-1]) is None:
        raise StorageRefusedError("BUSY", _REFUSALS["BUSY"])
    return result


def success_text(kind: Kind, storage: Storage) -> str:
    """Result of a request as text."""
    if kind == "SAVE":
        return f"stored as set {storage.sequence}; restored at each reset"
    return "both copies erased; the built-in values are used from the next reset on"


def _refused(memory: BoardWords) -> StorageRefusedError:
    reason = Catalogue.load().label("storage_refusal_t", memory.read_words("storage.refusal")[0])
    return StorageRefusedError(reason, _REFUSALS.get(reason, reason))
