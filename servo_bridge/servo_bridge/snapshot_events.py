"""Logs new faults and expired set-points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from servo_msgs_py.board_parameters import RawParameters
from servo_msgs_py.catalogue import Catalogue, axis_name
from servo_msgs_py.convert import flag_texts

from servo_bridge.part import Part
from servo_bridge.telemetry import Snapshot
from servo_bridge.wire.link_statistics import Silence

_TIMEOUT: Final = "param.command_timeout"


class SnapshotEvents(Part):
    """Compares consecutive samples.

    Parameters
    ----------
    catalogue : Catalogue
        Names of faults and limits.
    joints : sequence of str
        Names, in the order of the axes.
    error, warn : callable
        Receive messages for the log.
    silence : callable
        Longest time without a request to the board.
    parameters : callable
        Parameters of the board; None if not known.
    """

    def __init__(
        self,
        catalogue: Catalogue,
        joints: Sequence[str],
        error: Callable[[str], None],
        warn: Callable[[str], None],
        silence: Callable[[], Silence],
        parameters: Callable[[], RawParameters | None],
    ) -> None:
        self._error, self._warn = error, warn
        self._silence, self._parameters = silence, parameters
        self._before: Snapshot | None = None
        self._catalogue = catalogue
        self._joints = joints
        self._expired = catalogue.flag("limits", "EXPIRED").mask
        self._silent = catalogue.flag("faults", "HOST_SILENT").mask

    def on_sample(self, snapshot: Snapshot) -> None:
        """Log what is new in a sample."""
        before, self._before = self._before, snapshot
        known = before.faults if before is not None else [0] * len(snapshot.faults)
        for joint, old, word in zip(self._joints, known, snapshot.faults, strict=True):
            for text in flag_texts(self._catalogue, "faults", word & ~old):
                self._error(f"{joint}: {text}")
        if before is not None and any(
            word & ~old & self._silent for old, word in zip(known, snapshot.faults, strict=True)
        ):
            silence = self._silence()
            self._error(f"HOST_SILENT: {silence.duration:.2f} s without a command or a keep-alive; {silence.cause}")
        for axis, joint in enumerate(self._joints):
            if self._has_expired(snapshot, axis) and not (before is not None and self._has_expired(before, axis)):
                self._warn(f"{joint}: no velocity or effort set-point for {self._timeout()}; the axis stops")

    def lost(self, reason: str) -> None:
        """Forget the sample."""
        self._before = None

    def _timeout(self) -> str:
        parameters = self._parameters()
        return _TIMEOUT if parameters is None else f"{parameters[_TIMEOUT][0] * self._catalogue[_TIMEOUT].lsb:g} s"

    def _has_expired(self, snapshot: Snapshot, axis: int) -> bool:
        return bool(int(snapshot.values.get(f"{axis_name(axis)}.limits", 0)) & self._expired)
