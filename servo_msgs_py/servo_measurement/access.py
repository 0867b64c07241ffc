"""Interface of a board for measurements: variables in SI, board time, and the recorder.

The same measurement runs on a virtual board in simulated time and on a board at a serial line.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final, Protocol

from servo_msgs_py.board_port import BoardPort
from servo_msgs_py.catalogue import Catalogue, Variable, axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import PERIOD_NS, SLOW_PERIODS
from servo_msgs_py.value_text import parse_element, value_text
from servo_tuning.errors import Remedy

RECORDER_BYTES: Final = 7680
"""Memory of the recorder of a board [bytes]."""

FAULT: Final = "fault"
"""What the refusals because of a fault are about."""

OSCILLATION: Final = "oscillation"
"""What the refusals because of an oscillation are about."""

TRIGGER_TIMEOUT: Final = 2.0
"""Timeout from the start of a recording to its trigger [s]."""


class MeasurementError(RuntimeError):
    """The measurement is not possible or has no result; the message contains cause and remedy.

    Parameters
    ----------
    text : str
        Cause.
    *remedies : Remedy or str
        Changes of options; each of them alone is accepted. A text is for what is not a value of an option.
    about : str, optional
        What is refused, such as the name of a value.
    """

    def __init__(self, text: str, *remedies: Remedy | str, about: str = "") -> None:
        changes = ", or ".join(one if isinstance(one, str) else one.text() for one in remedies)
        super().__init__(f"{text}: {changes}" if changes else text)
        self.remedies = tuple(one for one in remedies if isinstance(one, Remedy))
        self.about = about


@dataclass(frozen=True)
class Capture:
    """What `BoardAccess.record` records, from when on, and what happens meanwhile.

    Parameters
    ----------
    names : sequence of str
        Scalar variables, or elements of arrays as ``name[k]``.
    samples : int
        Number of samples; see `BoardAccess.capacity`.
    every : int
        Calls of the loop per sample.
    slow : bool
        Sample the slow loop instead of every PWM period.
    start : callable, optional
        Called when the recorder is armed; starts the process to be recorded.
    trigger : str, optional
        Variable: the first sample is the one at which it is above zero. On a serial line the call of `start` is
        delayed by the recording time minus `lead`, so that the buffer is full before the trigger. By default the
        recording begins before the call of `start`, on a serial line by up to 0.3 s.
    lead : float, optional
        Minimum time from the call of `start` to the trigger [s].
    meanwhile : callable, optional
        Called repeatedly, on a serial line about ten times a second, from before `start` until the samples have
        been read. Its argument is True once the memory is full: from then on the motion of the axis does not affect
        the recording, while reading the samples over a serial line can take seconds.
    """

    names: Sequence[str]
    samples: int
    every: int = 1
    slow: bool = False
    start: Callable[[], None] = lambda: None
    trigger: str | None = None
    lead: float = 0.0
    meanwhile: Callable[[bool], None] = lambda full: None

    @property
    def step(self) -> float:
        """Sampling period [s]."""
        return step_of(self.every, self.slow)

    @property
    def seconds(self) -> float:
        """Duration of all samples [s]."""
        return self.samples * self.step


class BoardAccess(BoardPort, Protocol):
    """A board under measurement. Implementations are derived from it."""

    def read(self, name: str) -> list[float]:
        """All elements of a variable [SI]."""
        variable = self.catalogue[name]
        return [float(variable.scale(raw)) for raw in self.read_words(name)]

    def write(self, name: str, values: Sequence[float], first: int = 0) -> None:
        """Write elements of a variable [SI] from element `first` on; the other elements are not written.

        Raises
        ------
        ValueError
            If a value is outside the limits of the variable.
        MeasurementError
            If the board refuses.
        """
        variable = self.catalogue[name]
        if not self.write_words(name, [variable.to_raw(value) for value in values], first):
            raise MeasurementError(f"{name}: the board refuses {value_text(variable, list(values), self.catalogue)}")

    def capacity(self, names: Sequence[str]) -> int:
        """Number of samples of these variables in one recording; elements of arrays as ``name[k]``."""

    def record(self, capture: Capture) -> Trace:
        """Record several variables.

        Raises
        ------
        MeasurementError
            If the recording is not possible, or the trigger does not occur within `TRIGGER_TIMEOUT`.
        """


def step_of(every: int, slow: bool) -> float:
    """Sampling period of a recorder [s]."""
    return every * PERIOD_NS * (SLOW_PERIODS if slow else 1) * 1e-9


def element_of(catalogue: Catalogue, name: str) -> tuple[Variable, int]:
    """Variable and index of the element from the name of a recorded number.

    Raises
    ------
    MeasurementError
        If it does not exist.
    """
    whole, element = parse_element(name)
    variable = catalogue.variables.get(whole)
    if variable is None or variable.type == "block":
        raise MeasurementError(f"{name!r} is not a variable that can be recorded")
    if element is None and variable.count > 1:
        raise MeasurementError(f"{name} is an array; write one element, such as {name}[0]")
    index = element or 0
    if index >= variable.count:
        raise MeasurementError(f"{variable.name} has elements 0 .. {variable.count - 1}")
    return variable, index


def refuse_faults(access: BoardAccess, axis: int, *accepted: str) -> None:
    """Raise a `MeasurementError` with cause and remedy if an axis has a fault, except for `accepted` ones."""
    name = f"{axis_name(axis)}.faults"
    flags = access.catalogue[name].flags
    assert flags is not None
    active = access.catalogue.active(flags, int(access.read(name)[0]))
    faults = [fault for fault in active if fault.name not in accepted]
    if faults:
        text = "; ".join(f"{fault.name}: {fault.cause}. {fault.remedy}".rstrip(". ") for fault in faults)
        clear = f"cmd.clear_faults[{axis}] = 1 clears it, if its cause is gone"
        raise MeasurementError(f"{axis_name(axis)} has a fault. {text}; {clear}", about=FAULT)


@contextmanager
def faults_refused(access: BoardAccess, axis: int) -> Iterator[None]:
    """Call `refuse_faults` at the end of the block; its error replaces a `MeasurementError` of the block."""
    try:
        yield
    except MeasurementError:
        refuse_faults(access, axis)
        raise
    refuse_faults(access, axis)
