"""Statuses of /diagnostics: link, board, axes, commands, parameters, storage, executor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from diagnostic_msgs.msg import DiagnosticStatus
from servo_msgs_py.board_description import board_of
from servo_msgs_py.board_parameters import RawParameters, si
from servo_msgs_py.board_storage import Storage
from servo_msgs_py.catalogue import Catalogue, axis_name
from servo_msgs_py.convert import FAULTS, NO_FAULT, diagnostic_status, flag_texts
from servo_msgs_py.fault_record import FaultRecord
from servo_msgs_py.joints import Joint
from servo_msgs_py.value_text import value_text

from servo_bridge.callback_watch import CallbackReport
from servo_bridge.freemaster.client import BoardInfo
from servo_bridge.runs.recorder import RunReport
from servo_bridge.telemetry import Snapshot
from servo_bridge.trajectory.streamer import StreamReport
from servo_bridge.wire.link_state import LinkState, LinkStatus
from servo_bridge.wire.link_statistics import LinkStatistics

_OK: Final[bytes] = DiagnosticStatus.OK
_WARN: Final[bytes] = DiagnosticStatus.WARN
_ERROR: Final[bytes] = DiagnosticStatus.ERROR
_TROUBLE: Final = ("timeouts", "crc_errors", "damaged", "refused", "clock_disagreements")
BOARD_COUNTERS: Final = ("late_loops", "receiver_overruns")
"""Error counters of the board, modulo 65536."""

SLOW_CALLBACK: Final = 0.1
"""Duration of a callback above which there is a warning [s]; set-points and paths wait for its end."""

CONDITION: Final = ("winding_temperature", "winding_current", "oscillation")
"""Variables of an axis for `Condition`."""


@dataclass(frozen=True)
class Condition:
    """Estimated winding temperature of a motor and its effect, and the oscillation that the board has found."""

    temperature: float  # temperature of the winding [deg C]
    current: float  # derated current limit; full scale if not derated [A]
    oscillation: float  # frequency of the last oscillation since the axis was enabled; 0: none [Hz]


@dataclass
class CommandFigures:
    """Numbers of set-points since the start."""

    accepted: int = 0
    rejected: int = 0
    last_rejection: str = ""


class Health:
    """Builds the statuses; keeps the last counter values to detect new errors.

    Parameters
    ----------
    catalogue : Catalogue
        For the texts of faults and limits.
    node : str
        Name of the node with its namespace, prefix of every status name.
    port : str
        Port of the board.
    joints : sequence of Joint
        In the order of the axes.
    """

    def __init__(self, catalogue: Catalogue, node: str, port: str, joints: Sequence[Joint]) -> None:
        self._catalogue = catalogue
        self._node = node
        self._port = port
        self._hardware = "unknown"
        self._joints = list(joints)
        self._last = LinkStatistics()
        self._last_rejected = 0
        self._last_missing = 0
        self._last_lost = 0
        self._last_counts: dict[str, int] = {}

    def link(self, status: LinkStatus, figures: LinkStatistics, baud: int, low_latency: str) -> DiagnosticStatus:
        """Status of the serial link."""
        level, message = _OK, f"{figures.sample_rate:.0f} samples/s"
        fresh = [f"{count} {_words(name)}" for name in _TROUBLE if (count := self._new(name, figures))]
        self._last = figures
        if status.state is not LinkState.CONNECTED:
            level, message = _ERROR, str(status)
        elif fresh:
            level, message = _WARN, "in the last second: " + ", ".join(fresh)
        return self._status(
            "link",
            level,
            message,
            {
                "port": self._port,
                "baud": baud,
                "low latency": low_latency,
                "state": status.state.value,
                "samples/s": f"{figures.sample_rate:.1f}",
                "bytes/s out": f"{figures.bytes_out_rate:.0f}",
                "bytes/s in": f"{figures.bytes_in_rate:.0f}",
                "round trip p50 [ms]": f"{figures.round_trip_p50 * 1e3:.2f}",
                "round trip p99 [ms]": f"{figures.round_trip_p99 * 1e3:.2f}",
                "samples": figures.samples,
                "writes": figures.writes,
                "time-outs": figures.timeouts,
                "CRC errors": figures.crc_errors,
                "damaged answers": figures.damaged,
                "refused requests": figures.refused,
                "retries": figures.retries,
                "stray bytes": figures.stray_bytes,
                "connections": figures.connections,
                "board resets": figures.resets,
                "clock disagreements": figures.clock_disagreements,
                "largest clock disagreement [s]": f"{figures.clock_disagreement_max:.3f}",
                "longest silence to the board [ms]": f"{figures.silence.duration * 1e3:.0f}",
            },
        )

    def _new(self, counter: str, figures: LinkStatistics) -> int:
        return int(getattr(figures, counter)) - int(getattr(self._last, counter))

    def board(
        self, info: BoardInfo | None, snapshot: Snapshot | None, counts: Mapping[str, int] | None = None
    ) -> DiagnosticStatus:
        """Status of the board.

        Parameters
        ----------
        info : BoardInfo, optional
        snapshot : Snapshot, optional
            Newest sample; None without a board.
        counts : mapping of str to int, optional
            Last values of `BOARD_COUNTERS`; None if not read yet.
        """
        if info is None or snapshot is None:
            self._last_counts = {}
            return self._status("board", _ERROR, "not connected", {})
        self._hardware = _identification(info, self._catalogue)
        counts = counts or {}
        fresh = {name: (count - self._last_counts.get(name, count)) & 0xFFFF for name, count in counts.items()}
        self._last_counts = dict(counts)
        trouble = ", ".join(f"{more} {_words(name)}" for name, more in fresh.items() if more)
        about = f"{info.name or 'board'}, {info.description or 'no description'}"
        return self._status(
            "board",
            _WARN if trouble else _OK,
            f"in the last second: {trouble}" if trouble else about,
            {
                **{_words(name): counts.get(name, "unknown") for name in BOARD_COUNTERS},
                "name": info.name,
                "hardware": board_of(info.name) or "unknown",
                "version": info.version,
                "build": info.build,
                "catalogue hash": f"{self._catalogue.hash:08X}",
                "tick": snapshot.tick,
                "bus voltage [V]": _number(snapshot.values.get("u_dc")),
            },
        )

    def axis(
        self,
        axis: int,
        snapshot: Snapshot | None,
        record: FaultRecord | None = None,
        condition: Condition | None = None,
        current_limit: float | None = None,
    ) -> DiagnosticStatus:
        """Status of one axis; faults with cause and remedy, a warning with a derated current limit or an oscillation.

        Parameters
        ----------
        axis : int
            Index.
        snapshot : Snapshot, optional
            Newest sample; None without a board.
        record : FaultRecord, optional
            Record of the first fault.
        condition : Condition, optional
            Last values; None if not read yet.
        current_limit : float, optional
            Current limit of the axis [A].
        """
        name, prefix, used = self._joints[axis].name, axis_name(axis), self._joints[axis].used
        if snapshot is None:
            return self._status(name, _ERROR, "not connected", {})
        status = snapshot.axes[axis]
        faults = flag_texts(self._catalogue, "faults", snapshot.faults[axis])
        word = snapshot.values.get(f"{prefix}.limits")
        limits = [] if word is None else flag_texts(self._catalogue, "limits", int(word))
        remaining = 1.0 if condition is None or not current_limit else min(condition.current / current_limit, 1.0)
        oscillation = condition.oscillation if condition is not None else 0.0
        level = _ERROR if faults or status.faulted else _WARN if remaining < 1.0 or oscillation else _OK
        at_limit = f"; at limit: {'; '.join(limits)}" if limits else ""
        values: dict[str, object] = {"state": status.label}
        values |= {key: "; ".join(texts) or NO_FAULT for key, texts in ((FAULTS, faults), ("limits", limits))}
        if (home := snapshot.values.get(f"{prefix}.home_state")) is not None:
            values["home state"] = self._catalogue.label("home_state_t", int(home)).lower()
        if (pins := snapshot.values.get(f"{prefix}.inputs")) is not None:
            values["inputs"] = ", ".join(f.name for f in self._catalogue.active("inputs", int(pins))) or "none"
        if record is not None and record.fault is not None:
            values["first fault"] = record.summary()
            values["first fault tick"] = record.tick
        for column, unit in (("position", "rad"), ("speed", "rad/s"), ("i_q", "A")):
            values[f"{column} [{unit}]"] = _number(snapshot.values[f"{prefix}.{column}"])
        if condition is not None:
            values["winding [deg C]"] = _number(condition.temperature)
            values["current limit left [%]"] = _number(100.0 * remaining)
            values["oscillation [Hz]"] = _number(oscillation)
        derated = f"; hot winding: current limit derated to {100.0 * remaining:.0f} %" if remaining < 1.0 else ""
        swinging = f"; oscillation at {oscillation:.0f} Hz" if oscillation else ""
        message = "; ".join(faults) or status.label + at_limit + derated
        message += swinging
        if not used:
            level, message = _OK, "not in use (parameter used)"
        return self._status(name, level, message, values)

    def commands(
        self, figures: CommandFigures, *, armed: bool, conflict: str = "", inactive: str = ""
    ) -> DiagnosticStatus:
        """Status of the set-points."""
        fresh = figures.rejected - self._last_rejected
        self._last_rejected = figures.rejected
        level = _WARN if fresh or conflict else _OK
        message = f"rejected: {figures.last_rejection}" if fresh else "armed" if armed else inactive or "not armed"
        message = conflict or message
        return self._status(
            "commands",
            level,
            message,
            {
                "armed": armed,
                "accepted": figures.accepted,
                "rejected": figures.rejected,
                "last rejection": figures.last_rejection or "none",
            },
        )

    def stream(self, report: StreamReport | None) -> DiagnosticStatus:
        """Status of streamed set-points."""
        if report is None:
            return self._status("stream", _OK, "no stream", {})
        fresh = report.lost + report.late - self._last_missing
        self._last_missing = report.lost + report.late
        level, message = _OK, ", ".join(report.moving) or "no stream"
        if report.starved:
            level, message = _WARN, f"no messages for {', '.join(report.starved)}: stopping"
        elif fresh > 0:
            level, message = _WARN, f"in the last second: {fresh} messages lost or late"
        values = {
            "delay [ms]": f"{report.delay * 1e3:.1f}",
            "jitter [ms]": f"{report.jitter * 1e3:.1f}",
            "period [ms]": f"{report.period * 1e3:.1f}",
            "received": report.received,
            "lost": report.lost,
            "late": report.late,
        }
        return self._status("stream", level, message, values)

    def parameters(self, values: RawParameters | None, trouble: str) -> DiagnosticStatus:
        """Status of the parameters of the board, and whether they are as requested."""
        if values is None:
            return self._status("parameters", _WARN, trouble or "not read yet", {})
        known = si(values, self._catalogue)
        texts = {name: value_text(self._catalogue[name], value, self._catalogue) for name, value in known.items()}
        return self._status("parameters", _WARN if trouble else _OK, trouble or "as requested", dict(texts))

    def storage(self, storage: Storage | None) -> DiagnosticStatus:
        """Status of the non-volatile storage of the board."""
        if storage is None:
            return self._status("storage", _OK, "not read yet", {})
        values = {"newest set": storage.sequence or "none", "values since the reset": _words(storage.source)}
        values |= {f"copy {name}": _words(copy) for name, copy in zip("AB", storage.copies, strict=True)}
        return self._status("storage", _WARN if storage.trouble else _OK, storage.text, values)

    def run_recording(self, report: RunReport | None) -> DiagnosticStatus:
        """Status of the recording of the run."""
        if report is None:
            return self._status("run recording", _OK, "off", {})
        fresh = report.lost - self._last_lost
        self._last_lost = report.lost
        level, message = _OK, f"to {report.path}" if report.running else "off"
        if report.error:
            level, message = _ERROR, f"ended: {report.error}"
        elif fresh > 0:
            level, message = _WARN, f"in the last second: {fresh} messages lost"
        values = {
            "file": report.path,
            "size [MB]": f"{report.size / 1e6:.1f}",
            "messages": report.written,
            "lost": report.lost,
            "left out, type not known": ", ".join(report.unknown) or "none",
        }
        return self._status("run recording", level, message, values)

    def executor(self, report: CallbackReport) -> DiagnosticStatus:
        """Status of the thread that runs all callbacks of the node."""
        slow = report.last.wall > SLOW_CALLBACK
        return self._status(
            "executor",
            _WARN if slow else _OK,
            f"longest callback in the last second: {report.last}",
            {
                "longest callback": report.last.name,
                "longest callback [ms]": f"{report.last.wall * 1e3:.1f}",
                "longest callback, processor time [ms]": f"{report.last.cpu * 1e3:.1f}",
                "longest pause [ms]": f"{report.pause_last * 1e3:.0f}",
                "longest callback since the start": report.ever.name,
                "longest callback since the start [ms]": f"{report.ever.wall * 1e3:.1f}",
                "longest callback since the start, processor time [ms]": f"{report.ever.cpu * 1e3:.1f}",
                "longest pause since the start [ms]": f"{report.pause_ever * 1e3:.0f}",
            },
        )

    def _status(self, part: str, level: bytes, message: str, values: Mapping[str, object]) -> DiagnosticStatus:
        return diagnostic_status(f"{self._node}: {part}", level, message, self._hardware, values)


def _identification(info: BoardInfo, catalogue: Catalogue) -> str:
    """Identification of a board, with the hash of the table of variables."""
    parts = (info.name, info.version, info.build, f"table {catalogue.hash:08X}")
    return " ".join(text for text in parts if text)


def _number(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.4g}"


def _words(name: str) -> str:
    return name.replace("_", " ")
