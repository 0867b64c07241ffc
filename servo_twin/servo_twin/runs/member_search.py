"""Cause of a difference of the controller: the member of the configuration whose value repeats the run.

If the replay differs bit for bit from the run and no change of the plant explains it, configuration or firmware of an
axis differ. One member after the other is changed, and the run is replayed up to some seconds after the first
difference. The changes that explain the samples best are refined by secants. The member is named if what it leaves is
as small as the noise: the difference of two replays with other sensor noise. If the difference itself is not much
larger, as of most changed gains of a current or speed loop, or if several members explain it, nothing can be said. Bit
for bit the value cannot be found: a difference of one count of the encoder soon changes all variables by their noise.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.axis_config import AxisConfigTable, Member
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.convert import snapshot_table
from servo_msgs_py.units import PERIOD_NS

from servo_msgs_py import topics
from servo_twin.board import BoardError, SimulationError
from servo_twin.lockstep.blocks import TAKE
from servo_twin.runs.recorded import RecordedRun, messages_in_order
from servo_twin.runs.replay import (
    REPLAYED,
    Explained,
    MemberChange,
    Model,
    Replayed,
)
from servo_twin.servo_config import ServoConfig, servo_table

_BEFORE_MAX: Final = 30.0  # latest first difference that is searched; every replay begins at the reset [s]
_WINDOW: Final = 4.0  # replayed time from the first difference on [s]
_FACTOR: Final = 1.15  # first change of a member
_MISFIT_MAX: Final = 0.5  # largest part of the mean square that a member leaves at first, to be refined
_CANDIDATES: Final = 6  # members that are refined
_ITERATIONS: Final = 8  # of a refinement
_NOISE_MAX: Final = 2.0  # largest mean square that a cause may leave, in units of that of the noise
_CLEAR: Final = 20.0  # smallest mean square of a difference whose cause can be named, in the same units


_Array = NDArray[np.float64]


def explain(run: RecordedRun, model: Model, replayed: Replayed) -> Explained | None:
    """Search the member of the configuration that explains the first difference of a replay.

    Parameters
    ----------
    run : RecordedRun
    model : Model
        Of the replay.
    replayed : Replayed
        Of a replay.

    Returns
    -------
    Explained or None
        None if it is not the controller that differs, or another build explains it, or this cannot be told.
    """
    axes = [axis for axis in range(AXES) if axis_name(axis) == replayed.controller]
    if not axes or replayed.other_build or replayed.first is None or replayed.first * PERIOD_NS > _BEFORE_MAX * 1e9:
        return None
    search = _Search(run, model, replayed.first, axes[0])
    return None if search.reconfigured else search.find()


class _Search:
    def __init__(self, run: RecordedRun, model: Model, first: int, axis: int) -> None:
        self._model, self._axis = model, axis
        self._catalogue = Catalogue.load()
        self._servo = model.servo or ServoConfig.of_table(servo_table())
        self._members = list(AxisConfigTable.load().members.values())
        self._messages = list(_beginning(run, first + round(_WINDOW * 1e9 / PERIOD_NS)))
        self.reconfigured = any(
            name == topics.COMMANDS_APPLIED and message.layout.dim[0].label == TAKE for name, message in self._messages
        )

    def find(self) -> Explained | None:
        """Refine the members that explain the samples best; None if the difference is not beyond the noise."""
        words = self._servo.blocks[self._axis]
        own, recorded = self._replay(self._model)
        other, _ = self._replay(replace(self._model, seed=self._model.seed + 1))
        if own.shape != other.shape:
            return None
        self._scale = np.maximum((own - other).std(0), [self._catalogue[name].lsb for name in self._names])
        noise, before = _mean_square((own - other) / self._scale), (own - recorded) / self._scale
        if _mean_square(before) < _CLEAR * noise:
            return None
        found: list[tuple[float, int, int]] = []
        for place, word in enumerate(words):
            changed = _other(self._members[place], word)
            after = None if changed is None else self._difference(place, changed, before)
            if changed is not None and after is not None and (fit := _fit(before, after)) is not None:
                step, rest = fit
                if rest < _MISFIT_MAX * _mean_square(before):
                    found.append((rest, place, word + round(step * (changed - word))))
        refined = [(place, *self._refined(before, place, word)) for _, place, word in sorted(found)[:_CANDIDATES]]
        changes = [
            MemberChange(self._axis, self._members[place], words[place], word)
            for place, rest, word in refined
            if rest < _NOISE_MAX * noise
        ]
        return None if len(changes) > 1 else Explained(changes[0] if changes else None)

    def _refined(self, before: _Array, place: int, word: int) -> tuple[float, int]:
        """Smallest mean square of the difference, and the value of the member with it."""
        low, high = self._members[place].raw_range
        old = self._servo.blocks[self._axis][place]
        best = (math.inf, old)
        for _ in range(_ITERATIONS):
            word = min(max(word, low), high)
            after = None if word == old else self._difference(place, word, before)
            if after is None:
                break
            rest = _mean_square(after)
            fit = _fit(before, after)
            if rest > best[0] or fit is None:
                break
            best = (rest, word)
            old, before, word = word, after, old + round(fit[0] * (word - old))
        return best

    def _difference(self, place: int, word: int, like: _Array) -> _Array | None:
        """Twin minus board with another value of a member, in units of the noise; None if the board cannot run so."""
        words, blocks = list(self._servo.blocks[self._axis]), list(self._servo.blocks)
        words[place] = word
        blocks[self._axis] = tuple(words)
        try:
            own, recorded = self._replay(replace(self._model, servo=replace(self._servo, blocks=tuple(blocks))))
        except (BoardError, SimulationError, ValueError):
            return None
        return (own - recorded) / self._scale if own.shape == like.shape else None

    def _replay(self, model: Model) -> tuple[_Array, _Array]:
        """Samples of twin and board, (samples, variables)."""
        twin = replace(model, keeps_configuration=False).twin(self._catalogue)
        own: list[list[float]] = []
        recorded: list[list[float]] = []
        try:
            for name, message in self._messages:
                with suppress(ValueError):  # the replay has said so
                    REPLAYED[name].take(twin, message, self._catalogue)
                for pair in twin.step():
                    self._names = list(pair.twin)
                    own.append(list(pair.twin.values()))
                    recorded.append([pair.real[column] for column in pair.twin])
        finally:
            twin.close()
        return np.array(own), np.array(recorded)


def _beginning(run: RecordedRun, end: int) -> Iterator[tuple[str, Any]]:
    """Names and messages of a run up to a tick."""
    for name, _, message in messages_in_order(run, REPLAYED, Counter()):  # the replay has said what is left out
        if name == topics.WINDING_TEMPERATURES:
            continue  # those of the twin are exact, the recorded ones are rounded
        yield name, message
        if name == topics.SNAPSHOT:
            columns, table = snapshot_table(message)
            if len(table) and table[-1, columns.index("tick")] > end:
                return


def _other(member: Member, word: int) -> int | None:
    """Another value of a member; None if it has only one."""
    low, high = member.raw_range
    step = round(word * (_FACTOR - 1.0)) or max((high - low) // 256, 1)
    return next((other for other in (word + step, word - step) if member.accepts(other)), None)


def _fit(before: _Array, after: _Array) -> tuple[float, float] | None:
    """Multiple of a change that explains the samples best, and the mean square that it leaves.

    Returns None if the change has no effect.
    """
    effect = after - before
    size = float(np.vdot(effect, effect))
    if size == 0.0:
        return None
    step = -float(np.vdot(effect, before)) / size
    return step, _mean_square(before + step * effect)


def _mean_square(values: _Array) -> float:
    return float(np.mean(np.square(values)))
