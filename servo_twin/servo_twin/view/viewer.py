"""Writes messages to a recording: messages are queued, a separate thread writes them. Does not use ROS or rerun.

Writing may block for half a second. Callers do not wait for it: the queue is bounded, and messages beyond its capacity
are dropped and counted.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, Catalogue
from servo_msgs_py.convert import AppliedCommand, flag_texts, state_label
from servo_msgs_py.joints import DEFAULT_JOINTS, Joint
from servo_msgs_py.topics import BURST_TIME, STAMP_COLUMNS
from servo_msgs_py.trace import Trace

from servo_twin.view import scene
from servo_twin.view.board_time import BoardTime
from servo_twin.view.curves import Curves, ShaftAngle
from servo_twin.view.path_span import PathSpan

_Job = Callable[[], None]

_NS: Final = 1_000_000_000
_TOLERANCE: Final = 1e-6  # of equal times [s]
_REPEAT_NS: Final = 10_000_000_000  # shortest time between texts of a status at the same level
_NORMAL: Final = ("CONNECTED", "HEALTHY", *scene.PATH_STATES, *scene.HOME_STATES.values())  # states without a warning
Estimates = Mapping[tuple[str, str], Mapping[str, float]]
_LEVELS: Final = ("INFO", "WARN", "ERROR", "ERROR")  # of the diagnostic levels OK, WARN, ERROR, STALE


@dataclass(frozen=True)
class Change:
    """A finding of the diagnosis; equal to another one about the same change."""

    source: str  # ``axis1`` .. or ``bus``
    kind: str  # kind of the finding
    names: str  # what has changed
    text: str = field(compare=False)


class Recorder(Protocol):
    """Interface of `servo_twin.view.recording.Recording` for the viewer."""

    def scalars(self, entity: str, times: NDArray[np.float64], values: NDArray[np.float64]) -> None:
        """Write points of a curve: times [s] and values [SI], each (points,)."""

    def angles(self, entity: str, times: NDArray[np.float64], angles: NDArray[np.float64]) -> None:
        """Write angles [rad] of a shaft at times [s], each (points,)."""

    def strip(self, entity: str, time: float, points: NDArray[np.float64]) -> None:
        """Write a line strip of the path view at a time [s], (samples, 2)."""

    def state(self, name: str, time: float, state: str) -> None:
        """Write a change of state at `time` [s]."""

    def text(self, source: str, time: float, level: str, text: str) -> None:
        """Write a line of the log at a time [s]."""

    def close(self) -> None: ...


class Viewer:
    """Writes a recording in a separate thread.

    Parameters
    ----------
    recording : Recorder
        Used by the thread only; closed at the end.
    catalogue : Catalogue
        For names of states and texts of faults.
    start_ns : int
        ROS time of the start of the recording [ns].
    capacity : int
        Capacity of the queue [messages].
    period : float
        Interval of writing [s].
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
        self._pending: deque[_Job] = deque()
        self._following: deque[_Job] = deque()
        self._condition = threading.Condition()
        self._closing = False
        self._dropped = 0
        self._dropped_logged = 0
        self._failure = ""
        # Used by the thread only:
        self._delayed: list[_Job] = []
        self._time = BoardTime(start_ns)
        self._joints: Sequence[Joint] = DEFAULT_JOINTS
        self._curves = {source: Curves() for source in (scene.BOARD, scene.TWIN, scene.RESIDUAL, scene.ESTIMATE)}
        self._bursts = {source: Curves() for source in (scene.BOARD, scene.TWIN, scene.RESIDUAL)}
        self._shaft_angles = [{source: ShaftAngle() for source in (scene.BOARD, scene.TWIN)} for _ in range(AXES)]
        self._span = PathSpan(catalogue)
        self._drawn: dict[str, NDArray[np.float64]] = {}  # end points of the strips of a path
        self._labels: list[str] = [""] * AXES
        self._faults = [0] * AXES
        self._states: dict[str, str] = {}
        self._findings: Sequence[Change] = []  # of the diagnosis
        self._diagnoses: dict[str, tuple[int, str, int]] = {}  # level, text and stamp [ns] of the last line in the log
        self._warnings: set[str] = set()
        self._thread = threading.Thread(target=self._run, name="viewer", daemon=True)

    # ---- from any thread
    def start(self) -> None:
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Number of messages dropped because of a full queue."""
        return self._dropped

    @property
    def failure(self) -> str:
        """Reason for the end of the thread; empty: running."""
        return self._failure

    def joints(self, joints: Sequence[Joint]) -> None:
        """Set the joints, whose units apply to the following telemetry."""
        self._post(lambda: self._set_joints(joints))

    def board(self, samples: Trace) -> None:
        """Add telemetry of the board: SI, motor values."""
        self._post(lambda: self._board(samples))

    def twin(self, samples: Trace) -> None:
        """Add telemetry of the twin, at ticks of the board."""
        self._post(lambda: self._rows(scene.TWIN, samples), follows=True)

    def burst(self, source: str, points: Trace) -> None:
        """Add a burst with its ticks; `source` is `scene.BOARD`, `scene.TWIN` or `scene.RESIDUAL`."""
        self._post(lambda: self._burst(source, points), follows=True)

    def applied(self, command: AppliedCommand) -> None:
        """Add an applied command of the board; timed points define the span of a path."""
        self._post(lambda: self._span.applied(command))

    def residual(self, stamp_ns: int, fields: Mapping[str, Sequence[float]]) -> None:
        """Add a residual at `stamp_ns` [ns]: per field of `scene.RESIDUALS` one number [SI] per axis."""
        self._post(lambda: self._residual(stamp_ns, fields), follows=True)

    def link(self, stamp_ns: int, lost: str) -> None:
        """Add whether a board is connected: `lost` is the reason why not, empty if one is."""
        self._post(lambda: self._link(stamp_ns, lost))

    def healthy(self, stamp_ns: int, healthy: bool) -> None:
        """Add the state `healthy` of the twin."""
        self._post(lambda: self._state(self._time.of_stamp(stamp_ns), "twin", "HEALTHY" if healthy else "NOT HEALTHY"))

    def diagnosis(self, stamp_ns: int, name: str, level: int, message: str) -> None:
        """Add a diagnostic status; `level` as in diagnostic_msgs."""
        self._post(lambda: self._diagnosis(stamp_ns, name, level, message))

    def changes(self, stamp_ns: int, found: Sequence[Change], estimates: Estimates) -> None:
        """Add findings and estimates of the diagnosis.

        Parameters
        ----------
        stamp_ns : int
            ROS time [ns].
        found : sequence of Change
        estimates : mapping
            Values by the names of `scene.ESTIMATES`, by source and name, such as ``axis1`` and ``inertia``.
        """
        self._post(lambda: self._changes(stamp_ns, found, estimates))

    def close(self, timeout: float = 4.0) -> bool:
        """Write pending data and close the recording; False on a timeout [s]."""
        with self._condition:
            self._closing = True
            self._condition.notify()
        if self._thread.is_alive():
            self._thread.join(timeout)
        return not self._thread.is_alive()

    def _post(self, job: _Job, *, follows: bool = False) -> None:
        """Queue a job; with `follows` it is delayed by one period, as it needs telemetry of the board for its time."""
        with self._condition:
            if self._closing or self._failure:
                return
            if len(self._pending) + len(self._following) >= self._capacity:
                self._dropped += 1
                return
            (self._following if follows else self._pending).append(job)
            # The thread polls; a notification per message is not necessary.

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
            self._work()  # the delayed jobs
        except Exception as error:
            self._failure = f"the recording cannot be written: {error}"
        try:
            self._recording.close()
        except Exception as error:
            self._failure = self._failure or str(error)

    def _work(self) -> None:
        """Process and write all pending messages."""
        with self._condition:
            jobs, following, dropped = list(self._pending), list(self._following), self._dropped
            self._pending.clear()
            self._following.clear()
        # Topics are not in order: delay these jobs by one period, until the telemetry has arrived.
        jobs += self._delayed
        self._delayed = following
        for job in jobs:
            try:
                job()
            except (KeyError, ValueError) as error:
                self._warn_once(str(error))
        if dropped != self._dropped_logged:
            self._log(
                "viewer", self._time.newest, "WARN", f"{dropped - self._dropped_logged} messages dropped: too slow"
            )
            self._dropped_logged = dropped
        for curves in (*self._curves.values(), *self._bursts.values()):
            for entity, (times, values) in curves.take().items():
                self._recording.scalars(entity, times, values)
        for axis, shaft_angles in enumerate(self._shaft_angles):
            for source, shaft_angle in shaft_angles.items():
                times, angles = shaft_angle.take()
                if len(times):
                    self._recording.angles(scene.shaft_entity(axis, source), times, angles)

    def _warn_once(self, text: str) -> None:
        """Log an invalid message, once per reason."""
        if text not in self._warnings and len(self._warnings) < 100:
            self._warnings.add(text)
            self._log("viewer", self._time.newest, "WARN", f"invalid message ignored: {text}")

    # ---- telemetry
    def _set_joints(self, joints: Sequence[Joint]) -> None:
        self._joints = joints

    def _board(self, samples: Trace) -> None:
        if not len(samples):
            return
        ticks, stamps = _clocks(samples)
        resets = self._time.resets
        times = self._time.telemetry(ticks, stamps)
        if self._time.resets != resets:
            self._log("board", float(times[-1]), "WARN", "the board was reset: ticks and positions restart")
        self._plot(scene.BOARD, times, samples)
        self._path(times, samples, self._span.contains(ticks))
        for axis, name in scene.axes():
            names = [f"{name}.{column}" for column in ("state", "substate", "faults")]
            if samples.columns.keys() >= set(names):
                self._states_of(axis, times, samples.table(names).astype(int))
            if (home := f"{name}.home_state") in samples.columns:
                self._home_states(name, times, samples[home].astype(int))

    def _rows(self, source: str, samples: Trace) -> None:
        """Add telemetry that does not define the time line."""
        if not len(samples) or math.isinf(self._time.first):
            return
        ticks, stamps = _clocks(samples)
        times = self._time.of_ticks(ticks) if stamps is None else self._time.of_stamps(stamps)
        # A twin lags behind the board: its first rows may precede the recording.
        known = times > self._time.first - _TOLERANCE
        if known.any():
            later = {name: column[known] for name, column in samples.columns.items()}
            self._plot(source, times[known], samples.changed(**later))

    def _plot(self, source: str, times: NDArray[np.float64], samples: Trace) -> None:
        points: dict[str, NDArray[np.float64]] = {}
        for axis, _ in scene.axes():
            for quantity in (*scene.QUANTITIES, *scene.EXTRAS):
                for curve in (scene.SET_POINT, source) if source == scene.BOARD else (source,):
                    if (column := samples.columns.get(quantity.column(curve, axis))) is not None:
                        values = quantity.of_joint(self._joints[axis], column)
                        points[scene.series_entity(axis, quantity.name, curve)] = values
            angles = points.get(scene.series_entity(axis, scene.QUANTITIES[0].name, source))
            if angles is not None:
                self._shaft_angles[axis][source].add(times, angles)
        self._curves[source].add(times, points)

    def _burst(self, source: str, points: Trace) -> None:
        if not len(points) or math.isinf(self._time.first):
            return
        ticks, _ = _clocks(points)
        omitted = ("tick", BURST_TIME, *STAMP_COLUMNS)
        curves = {
            scene.burst_entity(name, source): values for name, values in points.columns.items() if name not in omitted
        }
        self._bursts[source].add(self._time.of_ticks(ticks), curves)

    def _path(self, times: NDArray[np.float64], samples: Trace, inside: NDArray[np.bool_]) -> None:
        """Draw one axis over the other during a path."""
        for part in np.split(np.arange(len(times)), np.flatnonzero(np.diff(inside)) + 1):
            on_path = bool(inside[part[0]])
            self._state(float(times[part[0]]), "path", scene.PATH_STATES[on_path])
            if not on_path:
                self._drawn.clear()
                continue
            for source in (scene.SET_POINT, scene.BOARD):
                position = scene.QUANTITIES[0]
                names = [position.column(source, axis) for axis, _ in scene.axes()]
                if samples.columns.keys() >= set(names):
                    motors = (samples[name][part] for name in names)
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
        """Write the changes of state and faults of an axis."""
        changes = np.flatnonzero(np.any(np.diff(words, axis=0) != 0, axis=1)) + 1
        for row in (0, *changes.tolist()):
            state, substate, faults = words[row].tolist()
            moment, name = float(times[row]), f"axis{axis + 1}"
            label, before = state_label(self._catalogue, state, substate), self._labels[axis]
            if label != before:
                self._labels[axis] = label
                self._recording.state(name, moment, label)
                self._log(name, moment, "INFO", f"{before} -> {label}" if before else label)
            new, gone = faults & ~self._faults[axis], self._faults[axis] & ~faults
            self._faults[axis] = faults
            for text in flag_texts(self._catalogue, "faults", new):
                self._log(name, moment, "ERROR", text)
            for flag in self._catalogue.active("faults", gone):
                self._log(name, moment, "INFO", f"{flag.name} cleared")

    def _home_states(self, name: str, times: NDArray[np.float64], words: NDArray[np.int_]) -> None:
        """Write the changes of the homing of an axis."""
        for row in (0, *(np.flatnonzero(np.diff(words)) + 1).tolist()):
            label = scene.HOME_STATES[self._catalogue.label("home_state_t", int(words[row]))]
            self._state(float(times[row]), scene.home_state(name), label)

    def _link(self, stamp_ns: int, lost: str) -> None:
        moment = self._time.of_stamp(stamp_ns)
        self._state(moment, "link", "DISCONNECTED" if lost else "CONNECTED", f"DISCONNECTED {lost}" if lost else "")
        if lost:
            self._faults = [0] * AXES
            for axis, name in scene.axes():
                if self._labels[axis] not in ("", "DISCONNECTED"):
                    self._labels[axis] = "DISCONNECTED"
                    self._recording.state(name, moment, "DISCONNECTED")

    def _state(self, moment: float, name: str, state: str, text: str = "") -> None:
        """Write a changed state of link, twin or path."""
        if self._states.get(name) != state:
            self._states[name] = state
            self._recording.state(name, moment, state)
            self._log(name, moment, "INFO" if state in _NORMAL else "WARN", text or state)

    def _diagnosis(self, stamp_ns: int, name: str, level: int, message: str) -> None:
        """Log a status if its level has changed; above OK also a new text, but not more often than `_REPEAT_NS`."""
        last_level, last_text, last_ns = self._diagnoses.get(name, (0, "", 0))
        news = level and message != last_text and stamp_ns - last_ns >= _REPEAT_NS
        if level != last_level or news:
            self._diagnoses[name] = level, message, stamp_ns
            self._log("diagnostics", self._time.of_stamp(stamp_ns), _LEVELS[min(level, 3)], f"{name}: {message}")

    def _changes(self, stamp_ns: int, found: Sequence[Change], estimates: Estimates) -> None:
        moment = self._time.of_stamp(stamp_ns)
        if moment < self._time.first - _TOLERANCE:
            return
        text = "; ".join(f"{one.source}: {one.text}" for one in found)
        state = "CHANGED" if found else "NOTHING CHANGED"
        if self._states.get("diagnosis") != state or self._findings != found:
            self._states["diagnosis"], self._findings = state, found
            self._recording.state("diagnosis", moment, state)
            self._log("diagnosis", moment, "WARN" if found else "INFO", text or "nothing has changed")
        points = {
            scene.estimate_entity(source, name, curve): np.array([numbers[curve]])
            for (source, name), numbers in estimates.items()
            for curve in scene.ESTIMATES
        }
        if points:
            self._curves[scene.ESTIMATE].add(np.array([moment]), points)

    def _log(self, source: str, moment: float, level: str, text: str) -> None:
        self._recording.text(source, moment, level, text)


def _clocks(samples: Trace) -> tuple[NDArray[np.int64], NDArray[np.int64] | None]:
    """Ticks of samples, and ROS stamps [ns] if available."""
    if "tick" not in samples.columns:
        raise ValueError("telemetry without the column tick")
    ticks = samples["tick"]
    if not np.isfinite(ticks).all():
        raise ValueError("telemetry with an invalid tick")
    if not samples.columns.keys() >= set(STAMP_COLUMNS):
        return ticks.astype(np.int64), None
    seconds, nanoseconds = (samples[name].astype(np.int64) for name in STAMP_COLUMNS)
    return ticks.astype(np.int64), seconds * _NS + nanoseconds
