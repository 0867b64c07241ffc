"""Waypoints of several joints, with checks of sizes, times and numbers."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from servo_msgs_py.quantity import VALUE_MAX

from servo_bridge.trajectory.errors import ErrorCode, TrajectoryError

Array = NDArray[np.float64]

WAYPOINTS_MAX: Final = 100_000
"""Largest number of waypoints of a path: 1000 s at 100 Hz, planned in 1 s of processor time."""

DURATION_MAX: Final = 1.0e5
"""Longest path [s]; above it, times of board and path have rounding errors of a PWM period."""


@dataclass(frozen=True, eq=False)
class Rows:
    """One row per waypoint; a waypoint that does not have the quantity has an empty row."""

    sizes: NDArray[np.int64]  # (n,), values in each row
    values: Array  # of all rows, one after the other

    @classmethod
    def of(cls, rows: Sequence[ArrayLike | None] | Array) -> Rows:
        """Rows of any sizes; None for an empty one."""
        if isinstance(rows, np.ndarray):
            table = rows.reshape(len(rows), -1)
            return cls(np.full(len(rows), table.shape[1]), table.astype(np.float64).reshape(-1))
        arrays = [np.asarray(() if row is None else row, dtype=np.float64).reshape(-1) for row in rows]
        sizes = np.array([len(array) for array in arrays], dtype=np.int64)
        return cls(sizes, np.concatenate(arrays) if arrays else np.zeros(0))


_Table = Rows | Sequence[ArrayLike | None] | Array


@dataclass(frozen=True, eq=False)
class Waypoints:
    """Waypoints of several joints; created by `of`."""

    joints: tuple[str, ...]  # different names
    times: Array  # (n,), strictly increasing, n >= 1 [s]
    positions: Array  # (n, joints) [rad]
    velocities: Array  # (n, joints) [rad/s]; rows of NaN if not given
    accelerations: Array  # (n, joints) [rad/s^2]; rows of NaN if not given
    efforts: Array  # (n, joints), torque added to that of the controller [N m]; 0 if not given

    @classmethod
    def of(
        cls,
        joints: Sequence[str],
        times: ArrayLike,
        positions: _Table,
        velocities: _Table | None = None,
        accelerations: _Table | None = None,
        efforts: _Table | None = None,
    ) -> Waypoints:
        """Check the arguments and create waypoints.

        Parameters
        ----------
        joints : sequence of str
            Names.
        times : (n,) array_like
            Times [s].
        positions, velocities, accelerations, efforts : n rows of one value per joint
            [rad], [rad/s], [rad/s^2], [N m]. All except the positions may be None, or contain None.

        Raises
        ------
        TrajectoryError
            If a joint occurs twice, a size is wrong, a number is not finite or above `VALUE_MAX`, times do not increase
            strictly, or a waypoint has an acceleration without a velocity.
        """
        check_joints(joints)
        instants = np.array(times, dtype=np.float64).reshape(-1)
        count = len(instants)
        if not count:
            raise TrajectoryError("there are no waypoints; write at least one")
        check_count(count)
        _check_times(instants)
        tables = [
            _table(joints, count, name, rows)
            for name, rows in (
                ("positions", positions),
                ("velocities", velocities),
                ("accelerations", accelerations),
                ("efforts", efforts),
            )
        ]
        missing = np.isnan(tables[0]).any(axis=1)
        if missing.any():
            raise TrajectoryError(f"point #{int(np.argmax(missing))} has no positions; write one per joint")
        alone = (np.isnan(tables[1]) & ~np.isnan(tables[2])).any(axis=1)
        if alone.any():
            k = int(np.argmax(alone))
            raise TrajectoryError(f"point #{k} has accelerations but no velocities; write both, or omit both")
        return cls(tuple(joints), instants, tables[0], tables[1], tables[2], np.nan_to_num(tables[3]))

    def unwrapped(self, place: Array, reference: Array, wrapping: Collection[str]) -> Waypoints:
        """Return the waypoints moved by whole turns, for joints whose positions are angles.

        Parameters
        ----------
        place, reference : (joints,) array
            A place of the path, and the position to which it shall be moved closest [rad].
        wrapping : collection of str
            Joints whose positions are angles; the others are not moved.
        """
        turns = np.round((reference - place) / math.tau)
        turns[[joint not in wrapping for joint in self.joints]] = 0.0
        return replace(self, positions=self.positions + math.tau * turns)


def _check_times(times: Array) -> None:
    infinite = ~np.isfinite(times)
    if infinite.any():
        k = int(np.argmax(infinite))
        raise TrajectoryError(f"time of point #{k} is {times[k]:g}; write a finite number")
    backwards = np.diff(times) <= 0.0
    if backwards.any():
        k = int(np.argmax(backwards))
        raise TrajectoryError(
            f"time between points {k} and {k + 1} is not strictly increasing ({times[k]:g} s, {times[k + 1]:g} s); "
            "times of points must increase"
        )
    check_duration(times)


def check_duration(times: Array) -> None:
    """Raise `TrajectoryError` for a longer path than is possible; `times` of its points in order [s]."""
    duration = float(times[-1] - times[0])
    if duration > DURATION_MAX:
        raise TrajectoryError(f"the trajectory takes {duration:g} s, more than {DURATION_MAX:g} s; send it in parts")


def check_count(count: int) -> None:
    """Raise `TrajectoryError` for more waypoints than a path may have."""
    if count > WAYPOINTS_MAX:
        raise TrajectoryError(
            f"there are {count} waypoints, more than {WAYPOINTS_MAX}; send the path in parts or with fewer points"
        )


def check_joints(joints: Sequence[str]) -> None:
    """Check that there are joints, without repetition.

    Raises
    ------
    TrajectoryError
        If there are none, or one occurs twice.
    """
    if not joints:
        raise TrajectoryError("there are no joint names; write the joints to move", ErrorCode.INVALID_JOINTS)
    for joint in joints:
        if list(joints).count(joint) > 1:
            raise TrajectoryError(f"joint {joint} occurs twice; write each joint once", ErrorCode.INVALID_JOINTS)


def _table(joints: Sequence[str], count: int, name: str, table: _Table | None) -> Array:
    """Rows as an array; missing rows are NaN."""
    if table is None:
        return np.full((count, len(joints)), np.nan)
    rows = table if isinstance(table, Rows) else Rows.of(table)
    if len(rows.sizes) != count:
        raise TrajectoryError(f"there are {len(rows.sizes)} rows of {name} for {count} points; write one per point")
    given = rows.sizes > 0
    wrong = given & (rows.sizes != len(joints))
    if wrong.any():
        k = int(np.argmax(wrong))
        raise TrajectoryError(
            f"mismatch between joint_names size ({len(joints)}) and {name} ({rows.sizes[k]}) at point #{k}; "
            "write one value per joint"
        )
    values = np.full((count, len(joints)), np.nan)
    values[given] = rows.values.reshape(-1, len(joints))
    infinite = given[:, None] & ~np.isfinite(values)
    if infinite.any():
        k, axis = divmod(int(np.argmax(infinite)), len(joints))
        raise TrajectoryError(f"{name} of {joints[axis]} at point #{k} is {values[k, axis]:g}; write a finite number")
    large = np.abs(values) > VALUE_MAX
    if large.any():
        k, axis = divmod(int(np.argmax(large)), len(joints))
        raise TrajectoryError(
            f"{name} of {joints[axis]} at point #{k} is {values[k, axis]:g}; write a number of at most {VALUE_MAX:g}"
        )
    return values
