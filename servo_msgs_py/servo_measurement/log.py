"""Record of the calls and recordings of a measurement, stored in a file, and its replay on another board.

A file is a numpy archive: ``log`` is JSON with the calls in order, ``r0``, ``r1`` .. are the recordings, one column per
variable. A missing sample is NaN.
"""

from __future__ import annotations

import json
import math
import zipfile
import zlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import numpy as np
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.output_file import write_file
from servo_msgs_py.text_file import TextFileError, read_bytes
from servo_msgs_py.trace import Trace
from servo_msgs_py.value_text import parse_element

from servo_measurement.access import BoardAccess, Capture, MeasurementError
from servo_measurement.motor_values import Limits

FORMAT: Final = 1

_BYTES_MAX: Final = 200_000_000
"""Largest file, packed and unpacked [bytes]; the recordings of a measurement need about a quarter."""

_MALFORMED: Final = (
    KeyError,
    ValueError,
    IndexError,
    TypeError,
    AttributeError,
    EOFError,
    zipfile.BadZipFile,
    zlib.error,
)


@dataclass(frozen=True)
class Call:
    """One call of a `BoardAccess`."""

    kind: str  # ``write``, ``wait`` or ``record``
    arguments: tuple[Any, ...]  # of `BoardAccess.write_words`; seconds; names, samples, every, slow, trigger
    inner: tuple[Call, ...] = ()  # calls made by ``start`` of a recording
    label: str = ""  # purpose of a recording
    stage: str = ""  # part of the measurement


@dataclass
class MeasurementLog:
    """Calls and recordings in order."""

    axis: int  # index of the measured axis
    calls: list[Call] = field(default_factory=list)
    recordings: list[Trace] = field(default_factory=list)  # one per ``record`` call
    notes: dict[str, Any] = field(default_factory=dict)  # additional data: limits, first estimates, board time

    def labelled(self, label: str) -> list[Trace]:
        """Recordings with a label, in order."""
        calls = [call for call in self.calls if call.kind == "record"]
        return [recording for call, recording in zip(calls, self.recordings, strict=True) if call.label == label]

    @property
    def labels(self) -> list[str]:
        """Label of each recording."""
        return [call.label for call in self.calls if call.kind == "record"]

    @property
    def seconds(self) -> float:
        """Minimum board time of all calls [s]."""
        return sum(map(_seconds, self.calls))

    def save(self, path: Path) -> None:
        """Write a file."""
        arrays: dict[str, Any] = {}
        heads = []
        for k, recording in enumerate(self.recordings):
            arrays[f"r{k}"] = np.column_stack(list(recording.columns.values()))
            heads.append({"step": recording.step, "names": list(recording.columns)})
        text = {
            "format": FORMAT,
            "axis": self.axis,
            "calls": [_as_json(call) for call in self.calls],
            "recordings": heads,
            "notes": self.notes,
        }
        write_file(path, lambda file: np.savez_compressed(file, log=np.array(json.dumps(text)), **arrays))

    @classmethod
    def load(cls, path: Path) -> MeasurementLog:
        """Read a file.

        Raises
        ------
        MeasurementError
            If its contents are malformed, or larger than a measurement.
        OSError
            If it cannot be read.
        """
        try:
            with np.load(BytesIO(read_bytes(path, _BYTES_MAX)), allow_pickle=False) as archive:
                if sum(member.file_size for member in archive.zip.infolist()) > _BYTES_MAX:
                    raise MeasurementError(f"{path} has more than {_BYTES_MAX} bytes unpacked; choose a smaller file")
                text: Mapping[str, Any] = json.loads(str(archive["log"]))
                if text["format"] != FORMAT:
                    raise MeasurementError(f"{path} has the format {text['format']}, not {FORMAT}: measure again")
                recordings = []
                for k, head in enumerate(text["recordings"]):
                    table = np.asarray(archive[f"r{k}"], dtype=np.float64)
                    columns = {name: table[:, column] for column, name in enumerate(head["names"])}
                    recordings.append(Trace(float(head["step"]), columns))
                calls, notes = [_of_json(call) for call in text["calls"]], dict(text["notes"])
                log = cls(int(text["axis"]), calls, recordings, notes)
                _check(log)
                return log
        except TextFileError as error:
            raise MeasurementError(f"{path}: {error}") from None
        except _MALFORMED:
            raise MeasurementError(
                f"{path} is not a complete measurement of identify: use its measurement.npz, or measure again"
            ) from None


def _check(log: MeasurementLog) -> None:
    """Raise one of `_MALFORMED` unless all that evaluations and repetitions read is there, with its type."""
    _require(log.axis in range(AXES))
    log.notes["limits"] = asdict(Limits(**log.notes["limits"]))
    for name in ("seconds", "boot"):
        _require(0.0 <= log.notes.get(name, 0.0) < math.inf)
    bias = log.notes.get("bias", {"l_d": 0.0, "l_d_low": 0.0})
    _require(math.isfinite(bias["l_d"]) and math.isfinite(bias["l_d_low"]))
    for call in log.calls:
        _check_call(call)
    asked = [set(call.arguments[0]) for call in log.calls if call.kind == "record"]
    _require(asked == [set(recording.columns) for recording in log.recordings])
    _require(all(any(name.startswith(axis_name(log.axis)) for name in names) for names in asked))


def _check_call(call: Call) -> None:
    _require(all(isinstance(text, str) for text in (call.label, call.stage)))
    catalogue = Catalogue.load()
    if call.kind == "wait":
        (seconds,) = call.arguments
        _require(0.0 <= seconds < math.inf)
    elif call.kind == "write":
        name, words, first = call.arguments
        catalogue[name].encode_part(words, first)
    else:
        names, samples, every, slow, trigger = call.arguments
        _require(call.kind == "record" and isinstance(slow, bool) and isinstance(trigger, str | None))
        _require(samples > 0 and every > 0)
        for name in names:
            catalogue[parse_element(name)[0]]
    for one in call.inner:
        _check_call(one)


def _require(holds: bool) -> None:
    if not holds:
        raise ValueError("not as `MeasurementLog.save` writes it")


def _seconds(call: Call) -> float:
    if call.kind == "wait":
        return float(call.arguments[0])
    inner = sum(map(_seconds, call.inner))
    if call.kind == "record":
        names, samples, every, slow, _ = call.arguments
        return max(inner, Capture(names, samples, every, slow).seconds)
    return inner


def _as_json(call: Call) -> dict[str, Any]:
    result: dict[str, Any] = {"kind": call.kind, "arguments": list(call.arguments)}
    if call.inner:
        result["inner"] = [_as_json(one) for one in call.inner]
    if call.label:
        result["label"] = call.label
    if call.stage:
        result["stage"] = call.stage
    return result


def _of_json(entry: Mapping[str, Any]) -> Call:
    inner = tuple(_of_json(one) for one in entry.get("inner", ()))
    return Call(entry["kind"], tuple(entry["arguments"]), inner, entry.get("label", ""), entry.get("stage", ""))


class LoggedAccess(BoardAccess):
    """Access that logs all calls.

    Parameters
    ----------
    access : BoardAccess
        The board.
    log : MeasurementLog
        The log.
    """

    def __init__(self, access: BoardAccess, log: MeasurementLog) -> None:
        self._access = access
        self.log = log
        self.stage = ""  # part of the measurement in progress
        self.label = ""  # purpose of the next recording
        self._calls = log.calls

    @property
    def catalogue(self) -> Catalogue:
        return self._access.catalogue

    def read_words(self, name: str) -> list[int]:
        return self._access.read_words(name)

    def write_words(self, name: str, words: Sequence[int], first: int = 0) -> bool:
        self._calls.append(Call("write", (name, [int(word) for word in words], first), stage=self.stage))
        return self._access.write_words(name, words, first)

    def clock(self) -> float:
        """Time of the access [s]."""
        return self._access.clock()

    def wait(self, seconds: float) -> None:
        """Let board time elapse [s], and log it."""
        self._calls.append(Call("wait", (seconds,), stage=self.stage))
        self._access.wait(seconds)

    def capacity(self, names: Sequence[str]) -> int:
        return self._access.capacity(names)

    def record(self, capture: Capture) -> Trace:
        """Record with `label`, which applies to one recording; calls in `meanwhile` are not logged."""
        outer, label = self._calls, self.label
        inner: list[Call] = []
        self.label = ""

        def logged_start() -> None:
            self._calls = inner
            try:
                capture.start()
            finally:
                self._calls = outer

        def unlogged(full: bool) -> None:
            self._calls = []
            try:
                capture.meanwhile(full)
            finally:
                self._calls = outer

        recording = self._access.record(replace(capture, start=logged_start, meanwhile=unlogged))
        arguments = (list(capture.names), capture.samples, capture.every, capture.slow, capture.trigger)
        outer.append(Call("record", arguments, tuple(inner), label, self.stage))
        self.log.recordings.append(recording)
        return recording


def repeat(log: MeasurementLog, access: BoardAccess, skipped: Collection[str] = ()) -> list[Trace]:
    """Replay the calls of a log on another board.

    Parameters
    ----------
    skipped : collection of str
        Stages to omit; their recordings are copied from the log.

    Returns
    -------
    list of Trace
        One recording for each one in the log.

    Raises
    ------
    MeasurementError
        If a recording is not possible.
    """
    recordings: list[Trace] = []
    for call in log.calls:
        if call.stage not in skipped:
            _repeat(call, access, recordings)
        elif call.kind == "record":
            recordings.append(log.recordings[len(recordings)])
    return recordings


def _repeat(call: Call, access: BoardAccess, recordings: list[Trace]) -> None:
    if call.kind == "write":
        name, words, first = call.arguments
        access.write_words(name, words, first)
    elif call.kind == "wait":
        access.wait(call.arguments[0])
    else:
        names, samples, every, slow, trigger = call.arguments

        def start() -> None:
            for one in call.inner:
                _repeat(one, access, recordings)

        recordings.append(access.record(Capture(names, samples, every, slow, start, trigger)))
