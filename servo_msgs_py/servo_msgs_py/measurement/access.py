"""What a measurement needs of a board: variables in SI, board time, and its recorder. Pure.

The same measurement runs on a virtual board in simulated time and on a board at a serial line.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from servo_msgs_py.axis_config_transfer import AppliedBlocks, BlockMemory, send_block, take_blocks
from servo_msgs_py.catalogue import Catalogue, Variable, axis_name
from servo_msgs_py.units import PERIOD_NS, SLOW_PERIODS

RECORDER_BYTES: Final = 7680
"""Samples that the recorder of a board keeps [bytes]."""

TRIGGER_TIMEOUT: Final = 2.0
"""In which the trigger of a recording has to come after its start [s]."""

_TAKE_TIME: Final = 1.0  # in which blocks are taken [s]
_TAKE_STEP: Final = 0.001
_ELEMENT: Final = re.compile(r"(?P<name>[^\[\]]+)(\[(?P<index>\d+)\])?")


class MeasurementError(RuntimeError):
    """The measurement cannot be made or has no result; the message says why and what to do."""


@dataclass(frozen=True)
class Recording:
    """Samples of some variables at common instants."""

    step: float  # time between two samples [s]
    columns: Mapping[str, NDArray[np.float64]]  # SI values by name, each of shape (samples,)

    @property
    def time(self) -> NDArray[np.float64]:
        """Since the first sample [s], shape (samples,)."""
        size = next(iter(self.columns.values())).size
        return self.step * np.arange(size, dtype=np.float64)


class BoardAccess(BlockMemory, Protocol):
    """A board to measure on. Implementations derive from it."""

    @property
    def catalogue(self) -> Catalogue:
        """Of its variables."""

    def write_words(self, name: str, words: Sequence[int], first: int = 0) -> bool:
        """Elements of a variable from `first` on, in one write; False if the board finds them out of range."""

    def read(self, name: str) -> list[float]:
        """All elements of a variable [SI]."""
        variable = self.catalogue[name]
        return [float(variable.scale(raw)) for raw in self.read_words(name)]

    def write(self, name: str, values: Sequence[float], first: int = 0) -> None:
        """Write elements of a variable [SI], from element `first` on; for the firmware the others were not written.

        Raises
        ------
        ValueError
            If a value is outside the limits of the variable.
        MeasurementError
            If the board refuses.
        """
        variable = self.catalogue[name]
        if not self.write_words(name, [variable.to_raw(value) for value in values], first):
            raise MeasurementError(f"{name}: the board refuses {', '.join(f'{value:g}' for value in values)}")

    def clock(self) -> float:
        """Time that has passed, exchanges included [s]; only differences mean something."""

    def wait(self, seconds: float) -> None:
        """Let board time pass [s]; the board does not miss its host meanwhile."""

    def capacity(self, names: Sequence[str]) -> int:
        """How many samples of these variables fit one recording; elements of arrays as ``name[k]``."""

    def record(
        self,
        names: Sequence[str],
        samples: int,
        every: int,
        slow: bool,
        start: Callable[[], None] | None = None,
        *,
        trigger: str | None = None,
        lead: float = 0.0,
        meanwhile: Callable[[bool], None] | None = None,
    ) -> Recording:
        """Record some variables.

        Parameters
        ----------
        names : sequence of str
            Variables of one number, or elements of arrays as ``name[k]``.
        samples : int
            How many to take; see `capacity`.
        every : int
            Take every so many-th call of the loop.
        slow : bool
            Sample the slow loop instead of every PWM period.
        start : callable, optional
            Called when the recorder is armed; it writes what is to be recorded.
        trigger : str, optional
            Variable: the first sample is the one at which it is above zero; on a serial line it takes as long as the
            recording, less `lead`, until `start` is called, because the memory has to be full once. By default the
            recording begins before `start` is called, on a serial line by up to 0.3 s.
        lead : float, optional
            Time that `start` takes at least before the trigger comes [s].
        meanwhile : callable, optional
            Called again and again, on a serial line some ten times a second, from before `start` until the samples
            have been read. Its argument says whether the memory is full: then nothing depends on the axis any more,
            while a serial line may take seconds to read the samples.

        Raises
        ------
        MeasurementError
            If it cannot be recorded, or the trigger does not come within `TRIGGER_TIMEOUT`.
        """


def step_of(every: int, slow: bool) -> float:
    """Time between two samples of `BoardAccess.record` [s]."""
    return every * PERIOD_NS * (SLOW_PERIODS if slow else 1) * 1e-9


def element_of(catalogue: Catalogue, name: str) -> tuple[Variable, int]:
    """Variable and element that a name of a recorded number means.

    Raises
    ------
    MeasurementError
        If there is no such number.
    """
    match = _ELEMENT.fullmatch(name)
    variable = None if match is None else catalogue.variables.get(match["name"])
    if match is None or variable is None or variable.type == "block":
        raise MeasurementError(f"{name!r} is no variable that a recorder can sample")
    if match["index"] is None and variable.count > 1:
        raise MeasurementError(f"{name} is an array; name one element, such as {name}[0]")
    index = int(match["index"] or 0)
    if index >= variable.count:
        raise MeasurementError(f"{variable.name} has elements 0 .. {variable.count - 1}")
    return variable, index


def send_configuration(access: BoardAccess, blocks: Mapping[int, Mapping[str, int]]) -> AppliedBlocks:
    """Let the board take configuration blocks, all with the same slow tick.

    Parameters
    ----------
    access : BoardAccess
        The board.
    blocks : mapping
        Members by path (`servo_msgs_py.axis_config.AxisConfigTable`), by index of the axis.

    Raises
    ------
    AxisConfigError, BlockRefusedError
        If the board cannot take them, or refuses.
    """
    for axis, block in blocks.items():
        send_block(access, axis, block)
    left = round(_TAKE_TIME / _TAKE_STEP)

    def wait() -> bool:
        nonlocal left
        left -= 1
        access.wait(_TAKE_STEP)
        return left > 0

    return take_blocks(access, sorted(blocks), wait)


def refuse_faults(access: BoardAccess, axis: int) -> None:
    """Raise a `MeasurementError` with cause and remedy if an axis has a fault."""
    name = f"{axis_name(axis)}.faults"
    flags = access.catalogue[name].flags
    assert flags is not None
    faults = access.catalogue.active(flags, int(access.read(name)[0]))
    if faults:
        text = "; ".join(f"{fault.name}: {fault.cause}. {fault.remedy}".rstrip(". ") for fault in faults)
        raise MeasurementError(f"{axis_name(axis)} has a fault. {text}")


@contextmanager
def faults_refused(access: BoardAccess, axis: int) -> Iterator[None]:
    """A fault of the axis at the end of the block, or behind an error in it, is the error: see `refuse_faults`."""
    try:
        yield
    except MeasurementError:
        refuse_faults(access, axis)
        raise
    refuse_faults(access, axis)
