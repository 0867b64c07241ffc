"""Log messages about new faults and expired set-points in a sample."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from servo_msgs_py.board_parameters import RawParameters
from servo_msgs_py.catalogue import Catalogue, axis_name
from servo_msgs_py.convert import flag_texts

from servo_bridge.telemetry import Snapshot
from servo_bridge.wire.link_statistics import Silence

_TIMEOUT: Final = "param.command_timeout"


class SnapshotEvents:
    """Compares consecutive samples.

    Parameters
    ----------
    catalogue : Catalogue
        Names of faults and limits.
    joints : sequence of str
        Names, in the order of the axes.
    """

    def __init__(self, catalogue: Catalogue, joints: Sequence[str]) -> None:
        self._catalogue = catalogue
        self._joints = joints
        self._expired = catalogue.flag("limits", "EXPIRED").mask
        self._silent = catalogue.flag("faults", "HOST_SILENT").mask

    def faults(self, before: Snapshot | None, now: Snapshot) -> list[str]:
        """One message per new fault."""
        words = before.faults if before is not None else [0] * len(now.faults)
        return [
            f"{joint}: {text}"
            for joint, old, new in zip(self._joints, words, now.faults, strict=True)
            for text in flag_texts(self._catalogue, "faults", new & ~old)
        ]

    def host_silent(self, before: Snapshot | None, now: Snapshot, silence: Silence) -> str:
        """Text of a new fault HOST_SILENT: which program was late; empty if there is none."""
        words = before.faults if before is not None else now.faults
        if not any(new & ~old & self._silent for old, new in zip(words, now.faults, strict=True)):
            return ""
        return f"HOST_SILENT: {silence.duration:.2f} s without a command or a keep-alive; {silence.cause}"

    def expired(self, before: Snapshot | None, now: Snapshot, parameters: RawParameters | None) -> list[str]:
        """One message per axis whose set-point has expired; the timeout is from the parameters."""
        timeout = _TIMEOUT
        if parameters is not None:
            timeout = f"{parameters[_TIMEOUT][0] * self._catalogue[_TIMEOUT].lsb:g} s"
        return [
            f"{joint}: no velocity or effort set-point for {timeout}; the axis stops"
            for axis, joint in enumerate(self._joints)
            if self._has_expired(now, axis) and not (before is not None and self._has_expired(before, axis))
        ]

    def _has_expired(self, snapshot: Snapshot, axis: int) -> bool:
        return bool(int(snapshot.values.get(f"{axis_name(axis)}.limits", 0)) & self._expired)
