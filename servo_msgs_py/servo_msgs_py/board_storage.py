"""Keep parameters and configuration of a board in its data flash, over any way to its variables. Pure.

A request carries a token. One that is repeated because its answer got lost has the same token, and the board carries it
out once.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Mapping
from typing import Final, Literal, NamedTuple

from servo_msgs_py.axis_config_transfer import BlockMemory
from servo_msgs_py.catalogue import Catalogue

Kind = Literal["SAVE", "FACTORY"]

_COPIES: Final = "AB"

_REFUSALS: Final[Mapping[str, str]] = {
    "FORM": "malformed request; if another program also writes to the board, stop it and try again",
    "ABSENT": "the board has no data flash; keep the values in files: servo-tool save, servo-tool tune --from-board",
    "BUSY": "the board is still busy with the previous request; try again",
    "MOTION": "only at rest with the outputs off: disable both axes and wait until they stand, then ask again; what "
    "was stored before is still there",
    "CHANGED": "parameters or configuration were changed meanwhile; the stored values are unchanged: try again",
    "FLASH": "verification of the data flash failed; the previously stored values are unchanged. If it happens "
    "again, the flash is worn out",
}

_COPY_TEXTS: Final[Mapping[str, str]] = {
    "EMPTY": "empty",
    "INTACT": "intact",
    "DAMAGED": "damaged (a save that was cut off, or worn flash)",
    "OTHER_LAYOUT": "of another version of the firmware",
    "OUT_OF_RANGE": "with a value that the board does not take",
    "ABSENT": "absent",
}

_FINE: Final = ("EMPTY", "INTACT", "ABSENT")


class StorageRefusedError(ValueError):
    """A request had no effect."""

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason  # name in the contract; empty: not stated by the board


class Storage(NamedTuple):
    """What the data flash of a board has."""

    sequence: int  # number of the newest set; 0: there is none
    source: str  # origin of the values at the last reset: ``BUILT_IN``, ``COPY_A`` or ``COPY_B``
    copies: tuple[str, ...]  # validity of both copies, by their names in the contract

    @property
    def trouble(self) -> str:
        """What is wrong with a copy, and what to do; empty if nothing is."""
        wrong = [f"copy {_COPIES[k]} is {_COPY_TEXTS[copy]}" for k, copy in enumerate(self.copies) if copy not in _FINE]
        if not wrong:
            return ""
        used = "the built-in values are" if self.source == "BUILT_IN" else f"copy {self.source[-1]} is"
        return f"{'; '.join(wrong)}: {used} used; save again to replace it"

    @property
    def text(self) -> str:
        """One line for people."""
        if self.copies[0] == "ABSENT":
            return "no data flash"
        origin = "built-in values" if self.source == "BUILT_IN" else f"values of copy {self.source[-1]}"
        newest = f"newest set {self.sequence}" if self.sequence else "nothing stored"
        return self.trouble or f"{origin} since the reset; {newest}"


def read_storage(memory: BlockMemory) -> Storage:
    """What the data flash of a board has."""
    catalogue = Catalogue.load()
    (sequence,), (source,) = memory.read_words("storage.sequence"), memory.read_words("storage.source")
    copies = memory.read_words("storage.copy")
    return Storage(
        sequence,
        catalogue.label("storage_source_t", source),
        tuple(catalogue.label("stored_copy_t", copy) for copy in copies),
    )


def begin_request(memory: BlockMemory, kind: Kind) -> int:
    """Have a board begin a request.

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


def request_result(memory: BlockMemory, token: int) -> Storage | None:
    """What the board has after a request; None while that is under way.

    Raises
    ------
    StorageRefusedError
        If it had no effect.
    """
    if memory.read_words("storage.state") != [Catalogue.load().enums["storage_state_t"]["IDLE"]]:
        return None
    if memory.read_words("storage.answered") != [token]:
        raise StorageRefusedError(
            "", "the board has lost the request, probably by a reset; check its state and try again"
        )
    if memory.read_words("storage.refusal") != [0]:
        raise _refused(memory)
    return read_storage(memory)


def carry_out(memory: BlockMemory, kind: Kind, wait: Callable[[], bool]) -> Storage:
    """Begin a request and wait for its end.

    Parameters
    ----------
    memory : BlockMemory
        The board.
    kind : {"SAVE", "FACTORY"}
        Keep what is in force, or erase what is kept.
    wait : callable
        Lets time pass; False when the board has had enough of it.

    Raises
    ------
    StorageRefusedError
        If it had no effect, or the board does not end it.
    """
    token = begin_request(memory, kind)
    while (result := request_result(memory, token)) is None:
        if not wait():
            raise StorageRefusedError("BUSY", _REFUSALS["BUSY"])
    return result


def success_text(kind: Kind, storage: Storage) -> str:
    """What a request has done, for people."""
    if kind == "SAVE":
        return f"stored as set {storage.sequence}: a reset brings these parameters and this configuration back"
    return "both copies are erased; the built-in values come into force at the next reset"


def _refused(memory: BlockMemory) -> StorageRefusedError:
    reason = Catalogue.load().label("storage_refusal_t", memory.read_words("storage.refusal")[0])
    return StorageRefusedError(reason, _REFUSALS.get(reason, reason))
