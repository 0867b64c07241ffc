"""Recordings (bursts) of the twin for those of the real board: same variables, same ticks, and the residual.

The bridge publishes the set-up of the recorder before the recorder starts. From then on a recorder of the twin's board
samples the same variables in every call of the loop, at the same point of the firmware, without trigger or divider.
When the recording of the board arrives, the same ticks are extracted. Identical boards give identical numbers.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, Catalogue, Variable, axis_name
from servo_msgs_py.recorder_setup import RecorderSetup
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import COUNTS_PER_TURN, PERIOD_NS, TICK_NS
from servo_msgs_py.value_text import parse_element

from servo_msgs_py import topics
from servo_twin.board_memory import BoardError
from servo_twin.lockstep.replica import Replica
from servo_twin.lockstep.samples import ANGLE_DEPENDENT, PER_BOARD, ROTOR_REFERENCED

_TICK: Final = "tick"
_UNCHANGED: Final = (_TICK, topics.BURST_TIME, *topics.STAMP_COLUMNS)
_LOOPS: Final = (PERIOD_NS, TICK_NS)  # time base by recorder [ns]
_READING: Final = 30.0  # longest time for reading a burst, and largest lag of the twin [s]
_LATE: Final = 32_000  # sampling continues after "recorder idle", as the burst may arrive later [ticks]
_MEMORY: Final = 1 << 26  # largest memory of the samples [bytes]
_ALIGNMENTS: Final = 1024  # stored changes of the alignment
_SAME_ANGLE: Final = 10  # largest difference of equal electrical angles [counts]: noise of a rotor search ..
_SAME_ANGLE_ENCODER: Final = 3  # .. or, with few lines, counts of the encoder
_WRAP: Final = 1 << 32
_NO_SETUP: Final = "the twin was started after the set-up of the recorder"


@dataclass(frozen=True)
class Alignment:
    """Tick shift and position offsets between both boards, valid from a sample of the real board on."""

    tick: int  # tick of the sample
    shift: int  # tick of the twin's board minus that of the real one
    offsets: tuple[int, ...]  # per axis, position of the real axis minus that of the twin [counts]
    difference: str  # reason why the boards are not comparable; empty: comparable


@dataclass(frozen=True)
class BurstAnswer:
    """Recording of the twin for a burst of the board."""

    label: str  # label of the burst
    twin: Trace | None
    """The columns of the burst that the twin has, SI, in ticks and positions of the real board; None: no samples."""
    residual: Trace | None
    """Real minus twin, angles and positions wrapped to half their range; ticks, times and stamps unchanged; NaN where
    the boards are not comparable; None as `twin`."""
    note: str  # missing parts and reasons; empty: complete


@dataclass(frozen=True)
class _Burst:
    """Received burst that waits for the twin."""

    label: str
    points: Trace
    ticks: NDArray[np.int64]  # (points,), of the real board


class BurstSampler:
    """Samples the variables of the recorder on the twin's board and extracts the bursts.

    Parameters
    ----------
    catalogue : Catalogue
        Table of variables.
    resolution : sequence of int
        Position counts per count of the encoder, by axis; the owner may change them.
    """

    def __init__(self, catalogue: Catalogue, resolution: Sequence[int] = (1,) * AXES) -> None:
        self._catalogue = catalogue
        self._resolution = resolution
        self._setup: RecorderSetup | None = None
        self._end: int | None = None  # real tick at which sampling ends
        self._replica: Replica | None = None  # board that is sampled
        self._elements: dict[str, tuple[Variable, int]] = {}  # by column, in the order of a point
        self._alignments: deque[Alignment] = deque(maxlen=_ALIGNMENTS)
        self._burst: _Burst | None = None
        self._problem = ""  # reason why a set-up is not sampled
        self._drop_reason = ""  # reason why the previous board of the twin was discarded
        self._answers: list[BurstAnswer] = []

    @property
    def sampling(self) -> bool:
        """True if the twin's board is sampled; then `note` must be called."""
        return self._replica is not None

    # ---- in
    def set_up(self, setup: RecorderSetup) -> None:
        """Store the set-up of the next recording; `begin` starts the sampling."""
        if self._burst is not None:
            self._refuse(
                self._burst,
                "the twin lags: the recorder was set up again before the twin reached the end of the previous burst",
            )
        self._stop()
        self._setup, self._end = setup, None
        self._drop_reason = ""
        self._problem = "the twin does not follow the board yet"

    def idle(self, newest: int | None) -> None:
        """The recorder is idle; its burst may arrive later.

        Parameters
        ----------
        newest : int or None
            Tick of the newest sample of the real board.
        """
        if self._setup is not None:
            self._end = (newest or 0) + _LATE

    def begin(self, replica: Replica, alignment: Alignment | None = None) -> None:
        """Start sampling a board if a recording is set up.

        Parameters
        ----------
        replica : Replica
            The twin's board.
        alignment : Alignment, optional
            Alignment with the real board; for a new board unknown until the next `note`.
        """
        setup = self._setup
        if setup is None:
            return
        self._elements = {name: element for name in setup.names if (element := self._element(name)) is not None}
        capacity = self._capacity(setup)
        self._problem = self._refusal(setup, capacity)
        if self._problem:
            return
        try:
            replica.board.sample(setup.recorder, list(self._elements.values()), capacity)
        except BoardError as error:
            self._problem = f"the twin's board cannot sample the variables: {error}"
            return
        self._replica = replica
        self._alignments.clear()
        if alignment is not None:
            self._alignments.append(alignment)

    def _refusal(self, setup: RecorderSetup, capacity: int) -> str:
        """Reason why the twin cannot sample this set-up; empty: possible."""
        if not self._elements.keys() - {_TICK}:
            return f"the twin has none of {', '.join(setup.names)}"
        if _TICK not in self._elements or not setup.period_ns:
            return "the recording contains no ticks or has an unknown sampling period"
        size = capacity * sum(variable.element_size for variable, _ in self._elements.values())
        if size > _MEMORY:
            span = setup.points * setup.period_ns * 1e-9
            return f"{span:.3g} s at full rate need {size >> 20} MB; the limit of the twin is {_MEMORY >> 20} MB"
        return ""

    def dropped(self, reason: str) -> None:
        """The twin's board has been discarded, with its samples."""
        self._replica = None
        self._alignments.clear()
        self._problem, self._drop_reason = f"the twin does not follow the board: {reason}", reason
        if self._burst is not None:
            self._refuse(self._burst)
        if self._end is not None:
            self._setup = self._end = None  # the recording had ended; ticks may restart at zero

    def note(self, alignment: Alignment) -> None:
        """Store the alignment at a sample of the real board, up to which both boards have run."""
        last = self._alignments[-1] if self._alignments else None
        if last is None or replace(last, tick=alignment.tick) != alignment:
            self._alignments.append(alignment)
        self._settle(alignment.tick)

    def add_burst(self, label: str, points: Trace, tick: int | None) -> None:
        """Process a burst of the real board.

        Parameters
        ----------
        label : str
            Label of the burst.
        points : Trace
            Values [SI] with the column ``tick``.
        tick : int or None
            Tick up to which both boards have run.

        Raises
        ------
        ValueError
            If there are no ticks.
        """
        if _TICK not in points.columns or not len(points):
            raise ValueError("recording without ticks")
        if self._burst is not None:
            self._refuse(self._burst, "the twin lags: a new burst arrived before the twin had sampled the previous one")
        self._burst = _Burst(label, points, points[_TICK].astype(np.int64))
        if self._replica is None:
            self._refuse(self._burst)
        elif tick is not None:
            self._settle(tick)

    # ---- out
    def take(self) -> list[BurstAnswer]:
        """Return and clear the pending answers."""
        answers, self._answers = self._answers, []
        return answers

    # ---- sampling
    def _element(self, name: str) -> tuple[Variable, int] | None:
        """Variable and element; None if the twin does not have it or the host can write it at any time."""
        whole, index = parse_element(name)
        variable = self._catalogue.variables.get(whole)
        if variable is None or variable.writable or variable.type == "block":
            return None
        element = index or 0
        if element >= variable.count or (name != _TICK and name in PER_BOARD):
            return None
        return variable, element

    @staticmethod
    def _capacity(setup: RecorderSetup) -> int:
        """Capacity for a burst and for the time until it has been read [points]."""
        period = _LOOPS[setup.recorder]
        return setup.points * max(setup.period_ns // period, 1) + round(_READING * 1e9 / period)

    def _stop(self) -> None:
        if self._replica is not None:
            self._replica.board.end_sampling()
            self._replica = None
        self._alignments.clear()

    # ---- extraction
    def _settle(self, tick: int) -> None:
        """Extract the waiting burst if both boards have run past it; end the sampling if due."""
        burst = self._burst
        if burst is not None and burst.ticks[-1] <= tick and self._replica is not None:
            self._burst = None
            self._answers.append(self._extract(burst, self._replica))
        if self._end is not None and tick >= self._end and self._burst is None:
            self._stop()
            self._setup = self._end = None

    def _refuse(self, burst: _Burst, reason: str = "") -> None:
        self._burst = None
        self._answers.append(_empty_answer(burst, reason or (self._problem if self._setup else _NO_SETUP)))

    def _extract(self, burst: _Burst, replica: Replica) -> BurstAnswer:
        alignments = list(self._alignments)
        begins = [alignment.tick for alignment in alignments]
        where = np.array([bisect_right(begins, tick) - 1 for tick in burst.ticks.tolist()])
        points = replica.board.sampled()
        if not len(points) or where.min() < 0:
            return self._not_covered(burst, begins[0] if begins else None)
        shifts = np.array([alignment.shift for alignment in alignments])[where]
        fields = dict(zip(self._elements, points.dtype.names or (), strict=True))
        # The board counts modulo 2^32; all points are close to the present tick of the replica.
        own = replica.tick - _signed(replica.tick - points[fields[_TICK]].astype(np.int64))
        if burst.ticks[0] + shifts[0] < own[0]:
            return self._not_covered(burst, int(own[0] - shifts[0]))
        rows = np.minimum(np.searchsorted(own, burst.ticks + shifts), len(own) - 1)
        missing = int(np.count_nonzero(own[rows] != burst.ticks + shifts))
        if missing:
            return _empty_answer(burst, f"no samples of the twin at {missing} of {len(rows)} ticks")
        raw = {name: points[field][rows].astype(np.int64) for name, field in fields.items()}
        not_comparable = np.array([bool(alignment.difference) for alignment in alignments])[where]
        offsets = np.array([alignment.offsets for alignment in alignments])[where]
        other_angle = _to_real_board(raw, offsets, self._resolution)
        notes = []
        if not_comparable.any():
            reasons = dict.fromkeys(alignments[k].difference for k in where.tolist() if alignments[k].difference)
            notes.append(
                f"no residual at {int(not_comparable.sum())} of {len(not_comparable)} points: {'; '.join(reasons)}"
            )
        if other_angle:
            notes.append(f"no residual of {', '.join(other_angle)}: the twin's shaft has another electrical angle")
        return self._answer(burst, raw, not_comparable, other_angle, notes)

    def _not_covered(self, burst: _Burst, first: int | None) -> BurstAnswer:
        range_text = "the twin has none" if first is None else f"the twin has samples from tick {first} on"
        why = f" ({self._drop_reason})" if self._drop_reason else ""
        return _empty_answer(burst, f"the burst starts at tick {burst.ticks[0]}; {range_text}{why}")

    def _answer(
        self,
        burst: _Burst,
        raw: Mapping[str, NDArray[np.int64]],
        not_comparable: NDArray[np.bool_],
        other_angle: Sequence[str],
        notes: Sequence[str],
    ) -> BurstAnswer:
        twin: dict[str, NDArray[Any]] = {}
        residual: dict[str, NDArray[Any]] = {}
        omitted: list[str] = []
        for name, real in burst.points.columns.items():
            if name in _UNCHANGED:
                twin[name] = residual[name] = real
            elif name in raw:
                variable, _ = self._elements[name]
                twin[name] = raw[name] * variable.lsb
                residual[name] = _difference(variable, real, twin[name])
                residual[name][not_comparable | (name in other_angle)] = np.nan
            else:
                omitted.append(name)
        missing = (
            [f"without {', '.join(omitted)} (written by the host or not available in the twin)"] if omitted else []
        )
        return BurstAnswer(burst.label, Trace(0.0, twin), Trace(0.0, residual), "; ".join([*missing, *notes]))


def _to_real_board(
    raw: dict[str, NDArray[np.int64]], offsets: NDArray[np.int64], resolution: Sequence[int]
) -> list[str]:
    """Convert positions of the twin to the coordinates of the real board.

    Parameters
    ----------
    raw : dict
        Raw values by variable; positions are replaced.
    offsets : array of int, shape (points, AXES)
        Position of the real axis minus that of the twin [counts].
    resolution : sequence of int
        Position counts per count of the encoder, by axis.

    Returns
    -------
    list of str
        Variables that are not comparable because of another electrical angle of the twin's shaft.
    """
    other_angle: list[str] = []
    for axis in range(AXES):
        shift = offsets[:, axis]
        for name in (f"{axis_name(axis)}.{quantity}" for quantity in ROTOR_REFERENCED):
            if name in raw:
                raw[name] = _signed(raw[name] + shift)
        within = (shift + COUNTS_PER_TURN // 2) % COUNTS_PER_TURN - COUNTS_PER_TURN // 2
        if np.abs(within).max() > max(_SAME_ANGLE, _SAME_ANGLE_ENCODER * resolution[axis]):
            other_angle += [name for name in raw if name.removeprefix(f"{axis_name(axis)}.") in ANGLE_DEPENDENT]
    return other_angle


def _empty_answer(burst: _Burst, reason: str) -> BurstAnswer:
    return BurstAnswer(burst.label, None, None, reason)


def _signed(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """Convert numbers modulo 2^32 to signed 32-bit numbers."""
    return np.asarray((numbers + _WRAP // 2) % _WRAP - _WRAP // 2)


def _difference(variable: Variable, real: NDArray[np.float64], twin: NDArray[np.float64]) -> NDArray[np.float64]:
    """Real minus twin; angles and positions wrap at the end of their range."""
    difference = real - twin
    if variable.unit != "rad":
        return difference
    span = variable.lsb * float(1 << 8 * variable.element_size)
    return np.asarray(difference - span * np.round(difference / span))
