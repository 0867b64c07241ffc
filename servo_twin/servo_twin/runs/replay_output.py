"""Files of a replay with both runs and their residual: MCAP as the bridge and the live twin publish, or .rrd."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from servo_msgs_py.convert import joint_state, snapshot_message
from servo_msgs_py.joints import DEFAULT_JOINTS
from servo_msgs_py.run_file.definitions import encoded
from servo_msgs_py.run_file.topic import Topic, type_of
from servo_msgs_py.run_file.writer import RunWriter
from servo_msgs_py.units import PERIOD_NS

from servo_msgs_py import topics
from servo_twin.lockstep.residual import COMPARED, residual
from servo_twin.lockstep.twin import Pair
from servo_twin.view import scene
from servo_twin.view.recording import Recording

_BLOCK: Final = 1 << 12  # pairs that are written together


class McapOutput:
    """MCAP file with ``/servo/snapshot``, ``/twin/snapshot`` and ``/twin/residual``.

    Parameters
    ----------
    path : Path
        Must not exist.
    """

    def __init__(self, path: Path) -> None:
        self._writer = RunWriter(path)
        self._count = 0

    def watch(self, pair: Pair, torque_constants: Sequence[float]) -> None:
        """Write a pair."""
        self._write(f"/servo/{topics.SNAPSHOT}", pair, snapshot_message(list(pair.real), [list(pair.real.values())]))
        stamp = divmod(pair.stamp_ns, 1_000_000_000)
        own = snapshot_message([*pair.twin, *topics.STAMP_COLUMNS], [[*pair.twin.values(), *stamp]])
        self._write(f"/twin/{topics.SNAPSHOT}", pair, own)
        if not pair.difference:
            one = residual(pair.tick, pair.real, pair.twin, torque_constants)
            message = joint_state(one.joints, pair.stamp_ns, one.position, one.velocity, one.effort)
            self._write(f"/twin/{topics.RESIDUAL}", pair, message)
        self._count += 1
        if not self._count % _BLOCK:
            self._writer.flush()

    def close(self) -> None:
        """Complete the file."""
        self._writer.close()

    def _write(self, name: str, pair: Pair, message: Any) -> None:
        self._writer.write(Topic(name, type_of(type(message))), encoded(message), pair.stamp_ns)


class RrdOutput:
    """Recording with the layout of the viewer; its time is that of the board since its reset.

    Raises
    ------
    RecordingError
        If rerun is not installed, or the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._recording = Recording(path)
        self._pairs: list[Pair] = []
        self._constants: Sequence[float] = ()

    def watch(self, pair: Pair, torque_constants: Sequence[float]) -> None:
        """Take a pair."""
        self._pairs.append(pair)
        self._constants = torque_constants
        if len(self._pairs) == _BLOCK:
            self._write()

    def close(self) -> None:
        """Complete the file."""
        if self._pairs:
            self._write()
        self._recording.close()

    def _write(self) -> None:
        pairs, self._pairs = self._pairs, []
        time = np.array([pair.tick for pair in pairs]) * (PERIOD_NS * 1e-9)
        for axis, _ in scene.axes():
            for quantity in scene.QUANTITIES:
                for source, values in (
                    (scene.BOARD, [pair.real for pair in pairs]),
                    (scene.SET_POINT, [pair.real for pair in pairs]),
                    (scene.TWIN, [pair.twin for pair in pairs]),
                ):
                    name = quantity.column(source, axis)
                    if name in values[0]:
                        curve = np.array([each.get(name, np.nan) for each in values])
                        self._recording.scalars(scene.series_entity(axis, quantity.name, source), time, curve)
        if all(name in pairs[0].real for name in COMPARED):
            found = [residual(pair.tick, pair.real, pair.twin, self._constants, DEFAULT_JOINTS) for pair in pairs]
            for field in scene.RESIDUALS:
                table = np.array([getattr(one, field) for one in found])
                for axis, _ in scene.axes():
                    self._recording.scalars(scene.residual_entity(axis, field), time, table[:, axis])
