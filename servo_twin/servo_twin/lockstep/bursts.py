"""The bursts of the real board's recorder on the twin: the same variables at the same ticks, and the difference. Pure.

The bridge says what is about to be recorded before the recorder starts. From then on a recorder of the twin's board
samples the same variables in every call of the loop, at the same point of the firmware, without trigger or divider.
When the burst comes, its ticks are cut out. Two boards that differ in nothing give the same numbers, bit for bit.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, Catalogue, Variable, axis_name
from servo_msgs_py.recorder_setup import RecorderSetup
from servo_msgs_py.units import COUNTS_PER_TURN, PERIOD_NS, SLOW_PERIODS

from servo_msgs_py import topics
from servo_twin.board_memory import BoardError
from servo_twin.lockstep.replica import Replica
from servo_twin.lockstep.samples import BY_ANGLE, COUNTED_FROM_ZERO, OWN

_TICK: Final = "tick"
_COPIED: Final = (_TICK, topics.BURST_TIME, *topics.STAMP_COLUMNS)
_LOOPS: Final = (PERIOD_NS, PERIOD_NS * SLOW_PERIODS)  # time base by recorder [ns]
_READING: Final = 30.0  # longest time from the end of a burst to its last byte, and how far a twin may lag [s]
_LATE: Final = 32_000  # ticks that sampling goes on when the recorder is idle: the burst may come after that news
_MEMORY: Final = 1 << 26  # that samples may take [bytes]
_ALIGNMENTS: Final = 1024  # changes of the alignment that are remembered
_ELEMENT: Final = re.compile(r"(.+?)(?:\[(\d+)\])?")
_SAME_ANGLE: Final = 10  # counts between two shafts whose phases have the same angle: noise of a rotor search
_WRAP: Final = 1 << 32
_NOT_TOLD: Final = "the twin was not there when the recorder was set up"


@dataclass(frozen=True)
class Alignment:
    """How the twin's board lies to the real one, from a sample of the real board on."""

    tick: int  # of that sample
    shift: int  # tick of the twin's board minus that of the real one
    offsets: tuple[int, ...]  # position of every real axis minus that of the twin's [counts]
    difference: str  # why the two cannot be compared; empty: they can


@dataclass(frozen=True)
class BurstAnswer:
    """What the twin has of a burst."""

    label: str  # of the burst
    columns: Sequence[str]  # those of the burst that the twin has, in its order
    twin: NDArray[np.float64]  # (points, columns), SI, ticks and positions of the real board; empty where it has none
    residual: NDArray[np.float64]
    """(points, columns), real minus twin, angles and positions the short way round; ticks, times and stamps as they
    are; NaN where the boards could not be compared."""
    note: str  # what is missing and why, for people; empty: nothing


@dataclass(frozen=True)
class _Burst:
    """What has come from the real board and waits."""

    label: str
    columns: Sequence[str]
    table: NDArray[np.float64]  # (points, columns), SI
    ticks: NDArray[np.int64]  # (points,), of the real board


class BurstFollower:
    """Samples what the real board is about to record, and cuts its bursts out.

    Parameters
    ----------
    catalogue : Catalogue
        Meaning of the variables.
    """

    def __init__(self, catalogue: Catalogue) -> None:
        self._catalogue = catalogue
        self._setup: RecorderSetup | None = None
        self._end: int | None = None  # real tick at which sampling ends
        self._replica: Replica | None = None  # that samples
        self._elements: dict[str, tuple[Variable, int]] = {}  # by column, in the order of a point
        self._alignments: deque[Alignment] = deque(maxlen=_ALIGNMENTS)
        self._burst: _Burst | None = None
        self._trouble = ""  # why nothing is sampled, although something is set up
        self._since = ""  # why the twin's board is not the one from before
        self._answers: list[BurstAnswer] = []

    @property
    def sampling(self) -> bool:
        """Whether the twin's board is sampled, so that `note` has to be called."""
        return self._replica is not None

    # ---- in
    def set_up(self, setup: RecorderSetup) -> None:
        """Take what is about to be recorded; `begin` samples it."""
        if self._burst is not None:
            self._refuse(self._burst, "the recorder was set up anew before the twin had run so far")
        self._stop()
        self._setup, self._end = setup, None
        self._since = ""
        self._trouble = "the twin does not follow the board yet"

    def idle(self, newest: int | None) -> None:
        """The recorder is idle; its burst may still be on its way.

        Parameters
        ----------
        newest : int or None
            Tick of the newest sample of the real board.
        """
        if self._setup is not None:
            self._end = (newest or 0) + _LATE

    def begin(self, replica: Replica, alignment: Alignment | None = None) -> None:
        """Sample a board from now on, if something is about to be recorded.

        Parameters
        ----------
        replica : Replica
            The twin's board.
        alignment : Alignment, optional
            How it lies to the real one; of a new board that is not known before the next `note`.
        """
        setup = self._setup
        if setup is None:
            return
        self._elements = {name: element for name in setup.names if (element := self._element(name)) is not None}
        room = self._room(setup)
        self._trouble = self._refusal(setup, room)
        if self._trouble:
            return
        try:
            replica.board.sample(setup.recorder, list(self._elements.values()), room)
        except BoardError as error:
            self._trouble = f"the twin's board cannot sample it: {error}"
            return
        self._replica = replica
        self._alignments.clear()
        if alignment is not None:
            self._alignments.append(alignment)

    def _refusal(self, setup: RecorderSetup, room: int) -> str:
        """Why the twin cannot sample that; empty when it can."""
        if not self._elements.keys() - {_TICK}:
            return f"the twin has none of {', '.join(setup.names)}"
        if _TICK not in self._elements or not setup.period_ns:
            return "the board does not say at which ticks it samples"
        size = room * sum(variable.element_size for variable, _ in self._elements.values())
        if size > _MEMORY:
            span = setup.points * setup.period_ns * 1e-9
            return f"every period of {span:.3g} s takes {size >> 20} MB, and the twin keeps {_MEMORY >> 20} MB"
        return ""

    def dropped(self, reason: str) -> None:
        """The twin's board is gone, and with it what was sampled."""
        self._replica = None
        self._alignments.clear()
        self._trouble, self._since = f"the twin does not follow the board: {reason}", reason
        if self._burst is not None:
            self._refuse(self._burst)
        if self._end is not None:
            self._setup = self._end = None  # it was over: ticks may count from zero now

    def note(self, alignment: Alignment) -> None:
        """Note how the boards lie to each other at a sample of the real one, up to which both have run."""
        last = self._alignments[-1] if self._alignments else None
        if last is None or replace(last, tick=alignment.tick) != alignment:
            self._alignments.append(alignment)
        self._settle(alignment.tick)

    def burst(self, label: str, columns: Sequence[str], table: NDArray[np.float64], tick: int | None) -> None:
        """Take a burst of the real board.

        Parameters
        ----------
        label : str
            What it is.
        columns : sequence of str
            With ``tick``.
        table : array of float, shape (points, columns)
            SI.
        tick : int or None
            Up to which both boards have run.

        Raises
        ------
        ValueError
            If it has no ticks.
        """
        if _TICK not in columns or not len(table):
            raise ValueError("a burst without ticks")
        if self._burst is not None:
            self._refuse(self._burst, "the next burst has come before the twin has run so far")
        self._burst = _Burst(label, columns, table, table[:, columns.index(_TICK)].astype(np.int64))
        if self._replica is None:
            self._refuse(self._burst)
        elif tick is not None:
            self._settle(tick)

    # ---- out
    def take(self) -> list[BurstAnswer]:
        """Answers that have not been taken."""
        answers, self._answers = self._answers, []
        return answers

    # ---- sampling
    def _element(self, name: str) -> tuple[Variable, int] | None:
        """Variable and element; None for what the twin does not have, and for what a host writes at any time."""
        match = _ELEMENT.fullmatch(name)
        variable = self._catalogue.variables.get(match.group(1)) if match else None
        if match is None or variable is None or variable.writable or variable.type == "block":
            return None
        element = int(match.group(2) or 0)
        if element >= variable.count or (name != _TICK and name in OWN):
            return None
        return variable, element

    @staticmethod
    def _room(setup: RecorderSetup) -> int:
        """Points of the twin for a burst and what comes until it is read."""
        period = _LOOPS[setup.recorder]
        return setup.points * max(setup.period_ns // period, 1) + round(_READING * 1e9 / period)

    def _stop(self) -> None:
        if self._replica is not None:
            self._replica.board.end_sampling()
            self._replica = None
        self._alignments.clear()

    # ---- cutting
    def _settle(self, tick: int) -> None:
        """Both boards have run up to a tick."""
        burst = self._burst
        if burst is not None and burst.ticks[-1] <= tick and self._replica is not None:
            self._burst = None
            self._answers.append(self._cut(burst, self._replica))
        if self._end is not None and tick >= self._end and self._burst is None:
            self._stop()
            self._setup = self._end = None

    def _refuse(self, burst: _Burst, reason: str = "") -> None:
        self._burst = None
        self._answers.append(_nothing(burst, reason or (self._trouble if self._setup else _NOT_TOLD)))

    def _cut(self, burst: _Burst, replica: Replica) -> BurstAnswer:
        alignments = list(self._alignments)
        begins = [alignment.tick for alignment in alignments]
        where = np.array([bisect_right(begins, tick) - 1 for tick in burst.ticks.tolist()])
        points = replica.board.sampled()
        if not len(points) or where.min() < 0:
            return self._too_late(burst, begins[0] if begins else None)
        shifts = np.array([alignment.shift for alignment in alignments])[where]
        fields = dict(zip(self._elements, points.dtype.names or (), strict=True))
        # The board counts modulo 2^32; no point is far from the tick that the replica has come to.
        own = replica.tick - _signed(replica.tick - points[fields[_TICK]].astype(np.int64))
        if burst.ticks[0] + shifts[0] < own[0]:
            return self._too_late(burst, int(own[0] - shifts[0]))
        rows = np.minimum(np.searchsorted(own, burst.ticks + shifts), len(own) - 1)
        missing = int(np.count_nonzero(own[rows] != burst.ticks + shifts))
        if missing:
            return _nothing(burst, f"the twin's board has no sample at {missing} of {len(rows)} ticks")
        raw = {name: points[field][rows].astype(np.int64) for name, field in fields.items()}
        apart = np.array([bool(alignment.difference) for alignment in alignments])[where]
        turned = _to_real_board(raw, np.array([alignment.offsets for alignment in alignments])[where])
        notes = []
        if apart.any():
            reasons = dict.fromkeys(alignments[k].difference for k in where.tolist() if alignments[k].difference)
            notes.append(f"no residual at {int(apart.sum())} of {len(apart)} points: {'; '.join(reasons)}")
        if turned:
            notes.append(f"no residual of {', '.join(turned)}: the twin's shaft is at another angle")
        return self._answer(burst, raw, apart, turned, notes)

    def _too_late(self, burst: _Burst, first: int | None) -> BurstAnswer:
        has = "none" if first is None else f"those from tick {first} on"
        why = f" ({self._since})" if self._since else ""
        return _nothing(
            burst, f"the burst begins at tick {burst.ticks[0]}, and of the twin's samples there are {has}{why}"
        )

    def _answer(
        self,
        burst: _Burst,
        raw: Mapping[str, NDArray[np.int64]],
        apart: NDArray[np.bool_],
        turned: Sequence[str],
        notes: Sequence[str],
    ) -> BurstAnswer:
        columns = [name for name in burst.columns if name in _COPIED or name in raw]
        real = burst.table[:, [burst.columns.index(name) for name in columns]]
        twin, residual = real.copy(), real.copy()
        for k, name in enumerate(columns):
            if name not in _COPIED:
                variable, _ = self._elements[name]
                twin[:, k] = raw[name] * variable.lsb
                residual[:, k] = _difference(variable, real[:, k], twin[:, k])
                residual[apart | (name in turned), k] = np.nan
        left_out = [name for name in burst.columns if name not in columns]
        missing = (
            [f"without {', '.join(left_out)}, which the host writes or the twin does not have"] if left_out else []
        )
        return BurstAnswer(burst.label, columns, twin, residual, "; ".join([*missing, *notes]))


def _to_real_board(raw: dict[str, NDArray[np.int64]], offsets: NDArray[np.int64]) -> list[str]:
    """Shift positions of the twin's board to where the real one counts from.

    Parameters
    ----------
    raw : dict
        Numbers by variable; those of positions are replaced.
    offsets : array of int, shape (points, AXES)
        Position of the real axis minus that of the twin's [counts].

    Returns
    -------
    list of str
        Variables that say nothing, because the twin's shaft is at another electrical angle.
    """
    turned: list[str] = []
    for axis in range(AXES):
        shift = offsets[:, axis]
        for name in (f"{axis_name(axis)}.{quantity}" for quantity in COUNTED_FROM_ZERO):
            if name in raw:
                raw[name] = _signed(raw[name] + shift)
        within = (shift + COUNTS_PER_TURN // 2) % COUNTS_PER_TURN - COUNTS_PER_TURN // 2
        if np.abs(within).max() > _SAME_ANGLE:
            turned += [name for name in raw if name.removeprefix(f"{axis_name(axis)}.") in BY_ANGLE]
    return turned


def _nothing(burst: _Burst, reason: str) -> BurstAnswer:
    empty = np.empty((0, 0))
    return BurstAnswer(burst.label, (), empty, empty, reason)


def _signed(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """Numbers of 32 bits with their sign."""
    return np.asarray((numbers + _WRAP // 2) % _WRAP - _WRAP // 2)


def _difference(variable: Variable, real: NDArray[np.float64], twin: NDArray[np.float64]) -> NDArray[np.float64]:
    """Real minus twin; angles and positions begin anew at the end of their range."""
    difference = real - twin
    if variable.unit != "rad":
        return difference
    turn = variable.lsb * float(1 << 8 * variable.element_size)
    return np.asarray(difference - turn * np.round(difference / turn))
