"""From messages to a recording: what arrives is queued, one thread of its own writes it. Knows neither ROS nor rerun.

Writing can stall for half a second at a time. Callers of these methods never wait for it: the queue is bounded,
and what does not fit is dropped and counted.
"""

from __future__ import annotations

import math
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, Catalogue
from servo_msgs_py.convert import AppliedCommand, flag_texts, state_label
from servo_msgs_py.joints import DEFAULT_JOINTS, Joint
from servo_msgs_py.topics import BURST_TIME, STAMP_COLUMNS

from servo_twin.view import scene
from servo_twin.view.board_time import BoardTime
from servo_twin.view.curves import Curves, Hand
from servo_twin.view.path_span import PathSpan

_Job = Callable[[], None]
_Table = NDArray[np.float64]

_NS: Final = 1_000_000_000
_TOLERANCE: Final = 1e-6  # of times that are meant to be the same [s]
_NUMBER: Final = re.compile(r"\d+(\.\d+)?")
_HOME_STATES: Final = Catalogue.load().enums["home_state_t"]
_USUAL: Final = ("CONNECTED", "FOLLOWS", *scene.PATH_STATES, *_HOME_STATES)  # states that are no trouble
_LEVELS: Final = ("INFO", "WARN", "ERROR", "ERROR")  # of diagnostics: OK, WARN, ERROR, STALE


class Recorder(Protocol):
    """What the viewer needs of a `servo_twin.view.recording.Recording`."""

    def scalars(self, entity: str, times: NDArray[np.float64], values: NDArray[np.float64]) -> None:
        """Points of a curve: times [s] and values [SI], each (points,)."""

    def angles(self, entity: str, times: NDArray[np.float64], angles: NDArray[np.float64]) -> None:
        """Angles [rad] of a shaft at times [s], each (points,)."""

    def strip(self, entity: str, time: float, points: NDArray[np.float64]) -> None:
        """Piece of a curve in the plane at a time [s], (samples, 2)."""

    def state(self, name: str, time: float, state: str) -> None:
        """A state from `time` [s] on."""

    def text(self, source: str, time: float, level: str, text: str) -> None:
        """Line of the log at a time [s]."""

    def close(self) -> None: ...


class Viewer:
    """Writes a recording in a thread of its own.

    Parameters
    ----------
    recording : Recorder
        Used from the thread only; closed at the end.
    catalogue : Catalogue
        For the names of states and the texts of faults.
    start_ns : int
        ROS time that is second 0 of the recording [ns].
    capacity : int
        Messages that may wait.
    period : float
        Between two writes [s].
    """

    def __init__(
        self,
        recording: Recorder,
        catalogue: Catalogue,
        start_ns: int,
        *,
        capacity: int = 2000,
        period: float = 0.2,
    ) -> None:
        self._recording = recording
        self._catalogue = catalogue
        self._capacity = capacity
        self._period = period
        self._waiting: deque[_Job] = deque()
        self._following: deque[_Job] = deque()
        self._condition = threading.Condition()
        self._closing = False
        self._dropped = 0
        self._dropped_said = 0
        self._failure = ""
        # Of the thread alone:
        self._held: list[_Job] = []
        self._time = BoardTime(start_ns)
        self._joints: Sequence[Joint] = DEFAULT_JOINTS
        self._curves = {source: Curves() for source in (scene.BOARD, scene.TWIN, scene.RESIDUAL, scene.ESTIMATE)}
        self._bursts = {source: Curves() for source in (scene.BOARD, scene.TWIN, scene.RESIDUAL)}
        self._hands = [{source: Hand() for source in (scene.BOARD, scene.TWIN)} for _ in range(AXES)]
        self._span = PathSpan(catalogue)
        self._drawn: dict[str, NDArray[np.float64]] = {}  # where the strips of a path end
        self._labels: list[str] = [""] * AXES
        self._faults = [0] * AXES
        self._states: dict[str, str] = {}
        self._found = ""  # by the diagnosis, without its numbers
        self._diagnoses: dict[str, tuple[int, str]] = {}
        self._complaints: set[str] = set()
        self._thread = threading.Thread(target=self._run, name="viewer", daemon=True)

    # ---- from any thread
    def start(self) -> None:
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Messages that did not fit into the queue so far."""
        return self._dropped

    @property
    def failure(self) -> str:
        """Why writing has ended; empty while it goes on."""
        return self._failure

    def joints(self, joints: Sequence[Joint]) -> None:
        """What the axes move: telemetry from now on is shown in the units of these joints."""
        self._post(lambda: self._set_joints(joints))

    def board(self, columns: Sequence[str], table: _Table) -> None:
        """Telemetry of the board: samples by columns, SI, of the motors."""
        self._post(lambda: self._board(columns, table))

    def twin(self, columns: Sequence[str], table: _Table) -> None:
        """Telemetry of the twin, at ticks of the board."""
        self._post(lambda: self._rows(scene.TWIN, columns, table), follows=True)

    def burst(self, source: str, columns: Sequence[str], table: _Table) -> None:
        """What a recorder has sampled, with its ticks; `source` is `scene.BOARD`, `scene.TWIN` or `scene.RESIDUAL`."""
        self._post(lambda: self._burst(source, columns, table), follows=True)

    def applied(self, command: AppliedCommand) -> None:
        """A command took effect on the board; timed points tell when it follows a path."""
        self._post(lambda: self._span.applied(command))

    def residual(self, stamp_ns: int, fields: Mapping[str, Sequence[float]]) -> None:
        """Residual at `stamp_ns` [ns]: per field of `scene.RESIDUALS` one number [SI] per axis."""
        self._post(lambda: self._residual(stamp_ns, fields), follows=True)

    def board_state(self, stamp_ns: int, text: str) -> None:
        """State of the board as its node says it."""
        self._post(lambda: self._board_state(stamp_ns, text))

    def healthy(self, stamp_ns: int, healthy: bool) -> None:
        """Whether the twin follows the board."""
        self._post(lambda: self._state(self._time.of_stamp(stamp_ns), "twin", "FOLLOWS" if healthy else "APART"))

    def diagnosis(self, stamp_ns: int, name: str, level: int, message: str) -> None:
        """Status of one subsystem; `level` as in diagnostic_msgs."""
        self._post(lambda: self._diagnosis(stamp_ns, name, level, message))

    def changes(self, stamp_ns: int, found: Sequence[str], estimates: Mapping[str, Mapping[str, float]]) -> None:
        """What has changed on the board, in words, and all estimates.

        Parameters
        ----------
        stamp_ns : int
            ROS time [ns].
        found : sequence of str
            One sentence per place where something has changed.
        estimates : mapping
            Numbers by the names of `scene.ESTIMATES`, by entity below ``/plot``: place and name, as ``axis1/inertia``.
        """
        self._post(lambda: self._changes(stamp_ns, found, estimates))

    def close(self, timeout: float = 4.0) -> bool:
        """Write what waits and close the recording; returns False when that is not over in time [s]."""
        with self._condition:
            self._closing = True
            self._condition.notify()
        if self._thread.is_alive():
            self._thread.join(timeout)
        return not self._thread.is_alive()

    def _post(self, job: _Job, *, follows: bool = False) -> None:
        """Queue a job; one that `follows` is placed by telemetry of the board, which may still be on its way."""
        with self._condition:
            if self._closing or self._failure:
                return
            if len(self._waiting) + len(self._following) >= self._capacity:
                self._dropped += 1
                return
            (self._following if follows else self._waiting).append(job)
            # The thread looks by itself in time; it need not be woken for every message.

    # ---- in the thread
    def _run(self) -> None:
        try:
            while not self._closing:
                begun = time.monotonic()
                self._work()
                with self._condition:
                    rest = begun + self._period - time.monotonic()
                    self._condition.wait_for(lambda: self._closing, max(rest, 0.0))
            self._work()
            self._work()  # and what was held back
        except Exception as error:
            self._failure = f"the recording cannot be written: {error}"
        finally:
            self._recording.close()

    def _work(self) -> None:
        """Deal with everything that waits and write it."""
        with self._condition:
            jobs, following, dropped = list(self._waiting), list(self._following), self._dropped
            self._waiting.clear()
            self._following.clear()
        # Topics overtake each other: what follows the board waits for one more round of its telemetry.
        jobs += self._held
        self._held = following
        for job in jobs:
            try:
                job()
            except (KeyError, ValueError) as error:
                self._complain(str(error))
        if dropped != self._dropped_said:
            self._say("viewer", self._time.newest, "WARN", f"{dropped - self._dropped_said} messages dropped: too slow")
            self._dropped_said = dropped
        for curves in (*self._curves.values(), *self._bursts.values()):
            for entity, (times, values) in curves.take().items():
                self._recording.scalars(entity, times, values)
        for axis, hands in enumerate(self._hands):
            for source, hand in hands.items():
                times, angles = hand.take()
                if len(times):
                    self._recording.angles(scene.shaft_entity(axis, source), times, angles)

    def _complain(self, text: str) -> None:
        """Say what is wrong with messages, once per reason."""
        if text not in self._complaints and len(self._complaints) < 100:
            self._complaints.add(text)
            self._say("viewer", self._time.newest, "WARN", f"a message was left out: {text}")

    # ---- telemetry
    def _set_joints(self, joints: Sequence[Joint]) -> None:
        self._joints = joints

    def _board(self, columns: Sequence[str], table: _Table) -> None:
        if not len(table):
            return
        ticks, stamps = _clocks(columns, table)
        resets = self._time.resets
        times = self._time.telemetry(ticks, stamps)
        if self._time.resets != resets:
            self._say("board", float(times[-1]), "WARN", "the board was reset: its ticks and positions begin anew")
        self._plot(scene.BOARD, times, columns, table)
        self._path(times, columns, table, self._span.contains(ticks))
        for axis, name in scene.axes():
            wanted = [f"{name}.{column}" for column in ("state", "substate", "faults")]
            if all(column in columns for column in wanted):
                self._states_of(axis, times, table[:, [columns.index(column) for column in wanted]].astype(int))
            if (home := f"{name}.home_state") in columns:
                self._home_states(name, times, table[:, columns.index(home)].astype(int))

    def _rows(self, source: str, columns: Sequence[str], table: _Table) -> None:
        """Telemetry that does not carry the time line itself."""
        if not len(table) or math.isinf(self._time.first):
            return
        ticks, stamps = _clocks(columns, table)
        times = self._time.of_ticks(ticks) if stamps is None else self._time.of_stamps(stamps)
        # A twin works a little behind the board: its first rows belong to what was before the recording.
        known = times > self._time.first - _TOLERANCE
        if known.any():
            self._plot(source, times[known], columns, table[known])

    def _plot(self, source: str, times: NDArray[np.float64], columns: Sequence[str], table: _Table) -> None:
        where = {name: k for k, name in enumerate(columns)}
        points: dict[str, NDArray[np.float64]] = {}
        for axis, _ in scene.axes():
            for quantity in (*scene.QUANTITIES, *scene.EXTRAS):
                for curve in (scene.SET_POINT, source) if source == scene.BOARD else (source,):
                    if (column := where.get(quantity.column(curve, axis))) is not None:
                        values = quantity.of_joint(self._joints[axis], table[:, column])
                        points[scene.series_entity(axis, quantity.name, curve)] = values
            angles = points.get(scene.series_entity(axis, scene.QUANTITIES[0].name, source))
            if angles is not None:
                self._hands[axis][source].add(times, angles)
        self._curves[source].add(times, points)

    def _burst(self, source: str, columns: Sequence[str], table: _Table) -> None:
        if not len(table) or math.isinf(self._time.first):
            return
        ticks, _ = _clocks(columns, table)
        left_out = ("tick", BURST_TIME, *STAMP_COLUMNS)
        points = {
            scene.burst_entity(name, source): table[:, k] for k, name in enumerate(columns) if name not in left_out
        }
        self._bursts[source].add(self._time.of_ticks(ticks), points)

    def _path(
        self, times: NDArray[np.float64], columns: Sequence[str], table: _Table, inside: NDArray[np.bool_]
    ) -> None:
        """Draw the axes against each other while they follow a path."""
        for part in np.split(np.arange(len(times)), np.flatnonzero(np.diff(inside)) + 1):
            on_path = bool(inside[part[0]])
            self._state(float(times[part[0]]), "path", scene.PATH_STATES[on_path])
            if not on_path:
                self._drawn.clear()
                continue
            for source in (scene.SET_POINT, scene.BOARD):
                position = scene.QUANTITIES[0]
                wanted = [position.column(source, axis) for axis, _ in scene.axes()]
                if all(column in columns for column in wanted):
                    motors = (table[part, columns.index(column)] for column in wanted)
                    points = np.column_stack(list(map(position.of_joint, self._joints, motors)))
                    strip = np.vstack([self._drawn.get(source, points[:1]), points])
                    self._drawn[source] = points[-1:]
                    self._recording.strip(scene.path_entity(source), float(times[part[-1]]), strip)

    def _residual(self, stamp_ns: int, fields: Mapping[str, Sequence[float]]) -> None:
        moment = self._time.of_stamp(stamp_ns)
        if moment < self._time.first - _TOLERANCE:
            return
        points = {
            scene.residual_entity(axis, field): np.array([numbers[axis]])
            for field, numbers in fields.items()
            for axis in range(min(AXES, len(numbers)))
        }
        self._curves[scene.RESIDUAL].add(np.array([moment]), points)

    # ---- states and faults
    def _states_of(self, axis: int, times: NDArray[np.float64], words: NDArray[np.int_]) -> None:
        """Note where state and faults of an axis change."""
        changes = np.flatnonzero(np.any(np.diff(words, axis=0) != 0, axis=1)) + 1
        for row in (0, *changes.tolist()):
            state, substate, faults = words[row].tolist()
            moment, name = float(times[row]), f"axis{axis + 1}"
            label, before = state_label(self._catalogue, state, substate), self._labels[axis]
            if label != before:
                self._labels[axis] = label
                self._recording.state(name, moment, label)
                self._say(name, moment, "INFO", f"{before} -> {label}" if before else label)
            new, gone = faults & ~self._faults[axis], self._faults[axis] & ~faults
            self._faults[axis] = faults
            for text in flag_texts(self._catalogue, "faults", new):
                self._say(name, moment, "ERROR", text)
            for flag in self._catalogue.active("faults", gone):
                self._say(name, moment, "INFO", f"{flag.name} cleared")

    def _home_states(self, name: str, times: NDArray[np.float64], words: NDArray[np.int_]) -> None:
        """Note where the worth of an axis's position changes."""
        for row in (0, *(np.flatnonzero(np.diff(words)) + 1).tolist()):
            label = self._catalogue.label("home_state_t", int(words[row]))
            self._state(float(times[row]), scene.position_state(name), label)

    def _board_state(self, stamp_ns: int, text: str) -> None:
        moment = self._time.of_stamp(stamp_ns)
        lost = text.startswith("DISCONNECTED")
        self._state(moment, "link", "DISCONNECTED" if lost else "CONNECTED", text if lost else "")
        if lost:
            self._faults = [0] * AXES
            for axis, name in scene.axes():
                if self._labels[axis] not in ("", "DISCONNECTED"):
                    self._labels[axis] = "DISCONNECTED"
                    self._recording.state(name, moment, "DISCONNECTED")

    def _state(self, moment: float, name: str, state: str, text: str = "") -> None:
        """State of the link, of the twin or of the path."""
        if self._states.get(name) != state:
            self._states[name] = state
            self._recording.state(name, moment, state)
            self._say(name, moment, "INFO" if state in _USUAL else "WARN", text or state)

    def _diagnosis(self, stamp_ns: int, name: str, level: int, message: str) -> None:
        """Note a status when its level changes, and trouble also when it becomes another one."""
        # Numbers in a text change all the time; it is the same trouble.
        now = level, _NUMBER.sub("#", message) if level else ""
        before = self._diagnoses.get(name, (0, ""))
        self._diagnoses[name] = now
        if now != before and not self._known(message):
            self._say("diagnostics", self._time.of_stamp(stamp_ns), _LEVELS[min(level, 3)], f"{name}: {message}")

    def _changes(self, stamp_ns: int, found: Sequence[str], estimates: Mapping[str, Mapping[str, float]]) -> None:
        moment = self._time.of_stamp(stamp_ns)
        if moment < self._time.first - _TOLERANCE:
            return
        text = "; ".join(found)
        state = "CHANGED" if found else "NOTHING CHANGED"
        # Numbers in a text change all the time; it is the same change.
        if self._states.get("diagnosis") != state or self._found != _NUMBER.sub("#", text):
            self._states["diagnosis"], self._found = state, _NUMBER.sub("#", text)
            self._recording.state("diagnosis", moment, state)
            self._say("diagnosis", moment, "WARN" if found else "INFO", text or "nothing has changed")
        points = {
            scene.estimate_entity(place, name, curve): np.array([numbers[curve]])
            for (place, _, name), numbers in ((key.partition("/"), numbers) for key, numbers in estimates.items())
            for curve in scene.ESTIMATES
        }
        if points:
            self._curves[scene.ESTIMATE].add(np.array([moment]), points)

    def _known(self, message: str) -> bool:
        """Whether a text tells only of faults that the telemetry has told of, to the tick."""
        texts = {text for word in self._faults for text in flag_texts(self._catalogue, "faults", word)}
        return bool(texts) and set(message.split("; ")) <= texts

    def _say(self, source: str, moment: float, level: str, text: str) -> None:
        self._recording.text(source, moment, level, text)


def _clocks(columns: Sequence[str], table: _Table) -> tuple[NDArray[np.int64], NDArray[np.int64] | None]:
    """Ticks and, where there are any, ROS stamps [ns] of the rows of a table."""
    if "tick" not in columns:
        raise ValueError("telemetry without the column tick")
    ticks = table[:, columns.index("tick")]
    if not np.isfinite(ticks).all():
        raise ValueError("telemetry with a tick that is no number")
    if not all(column in columns for column in STAMP_COLUMNS):
        return ticks.astype(np.int64), None
    seconds, nanoseconds = (table[:, columns.index(column)].astype(np.int64) for column in STAMP_COLUMNS)
    return ticks.astype(np.int64), seconds * _NS + nanoseconds
