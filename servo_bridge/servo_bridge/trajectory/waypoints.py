"""Waypoints of several joints, with checks of sizes, times and numbers."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servo_bridge.trajectory.errors import ErrorCode, TrajectoryError

Array = NDArray[np.float64]

Rows = Sequence[ArrayLike | None] | Array | None
"""One row per waypoint; None if a waypoint, or all of them, do not have the quantity."""


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
        positions: Rows,
        velocities: Rows = None,
        accelerations: Rows = None,
        efforts: Rows = None,
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
            If a joint occurs twice, a size is wrong, a number is not finite, times do not increase strictly, or a
            waypoint has an acceleration without a velocity.
        """
        check_joints(joints)
        instants = np.array(times, dtype=np.float64).reshape(-1)
        if not len(instants):
            raise TrajectoryError("there are no waypoints; write at least one")
        for k, time in enumerate(instants):
            if not np.isfinite(time):
                raise TrajectoryError(f"time of point #{k} is {time:g}; write a finite number")
            if k and time <= instants[k - 1]:
                raise TrajectoryError(
                    f"time between points {k - 1} and {k} is not strictly increasing ({instants[k - 1]:g} s, "
                    f"{time:g} s); times of points must increase"
                )
        count = len(instants)
        tables = [
            _table(joints, count, name, rows)
            for name, rows in (
                ("positions", [None] * count if positions is None else positions),
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


def _table(joints: Sequence[str], count: int, name: str, rows: Rows) -> Array:
    """Rows as an array; missing rows are NaN."""
    table = np.full((count, len(joints)), np.nan)
    if rows is None:
        return table
    if len(rows) != count:
        raise TrajectoryError(f"there are {len(rows)} rows of {name} for {count} points; write one per point")
    for k, row in enumerate(rows):
        if row is None:
            continue
        values = np.array(row, dtype=np.float64).reshape(-1)
        if len(values) != len(joints):
            raise TrajectoryError(
                f"mismatch between joint_names size ({len(joints)}) and {name} ({len(values)}) at point #{k}; "
                "write one value per joint"
            )
        for joint, value in zip(joints, values, strict=True):
            if not np.isfinite(value):
                raise TrajectoryError(f"{name} of {joint} at point #{k} is {value:g}; write a finite number")
        table[k] = values
    return table
