"""Waypoints of several joints, checked for form: sizes, order of times, finite numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servo_bridge.trajectory.errors import ErrorCode, TrajectoryError

Array = NDArray[np.float64]

Rows = Sequence[ArrayLike | None] | Array | None
"""One row per waypoint; None where a waypoint, or all of them, does not have the quantity."""


@dataclass(frozen=True, eq=False)
class Waypoints:
    """Waypoints of several joints; make them with `of`."""

    joints: tuple[str, ...]  # different names
    times: Array  # (n,), strictly increasing, n >= 1 [s]
    positions: Array  # (n, joints) [rad]
    velocities: Array  # (n, joints) [rad/s]; a row of NaN where they are not given
    accelerations: Array  # (n, joints) [rad/s^2]; a row of NaN where they are not given
    efforts: Array  # (n, joints), torque added to that of the controller [N m]; 0 where it is not given

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
        """Waypoints with everything checked.

        Parameters
        ----------
        joints : sequence of str
            Names.
        times : (n,) array_like
            [s]
        positions, velocities, accelerations, efforts : n rows of one value per joint
            [rad], [rad/s], [rad/s^2], [N m]. All but the positions may be None, or be None in single rows.

        Raises
        ------
        TrajectoryError
            If a joint is named twice, a size is wrong, a number is not finite, times do not increase strictly, or a
            waypoint has an acceleration and no velocity.
        """
        check_joints(joints)
        instants = np.array(times, dtype=np.float64).reshape(-1)
        if not len(instants):
            raise TrajectoryError("there are no waypoints; give at least one")
        for k, time in enumerate(instants):
            if not np.isfinite(time):
                raise TrajectoryError(f"time of point #{k} is {time:g}; give a finite number")
            if k and time <= instants[k - 1]:
                raise TrajectoryError(
                    f"time between points {k - 1} and {k} is not strictly increasing ({instants[k - 1]:g} s, "
                    f"{time:g} s); give each point a later time than the one before"
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
            raise TrajectoryError(f"point #{int(np.argmax(missing))} has no positions; give one per joint")
        alone = (np.isnan(tables[1]) & ~np.isnan(tables[2])).any(axis=1)
        if alone.any():
            k = int(np.argmax(alone))
            raise TrajectoryError(f"point #{k} has accelerations but no velocities; give both, or leave out both")
        return cls(tuple(joints), instants, tables[0], tables[1], tables[2], np.nan_to_num(tables[3]))


def check_joints(joints: Sequence[str]) -> None:
    """Check that there are joints and that they differ.

    Raises
    ------
    TrajectoryError
        If not.
    """
    if not joints:
        raise TrajectoryError("no joint is named; name the joints to move", ErrorCode.INVALID_JOINTS)
    for joint in joints:
        if list(joints).count(joint) > 1:
            raise TrajectoryError(f"joint {joint} is named twice; name each joint once", ErrorCode.INVALID_JOINTS)


def _table(joints: Sequence[str], count: int, name: str, rows: Rows) -> Array:
    """Rows as one array, NaN in the rows that are not given."""
    table = np.full((count, len(joints)), np.nan)
    if rows is None:
        return table
    if len(rows) != count:
        raise TrajectoryError(f"there are {len(rows)} rows of {name} for {count} points; give one per point")
    for k, row in enumerate(rows):
        if row is None:
            continue
        values = np.array(row, dtype=np.float64).reshape(-1)
        if len(values) != len(joints):
            raise TrajectoryError(
                f"mismatch between joint_names size ({len(joints)}) and {name} ({len(values)}) at point #{k}; "
                "give one value per joint"
            )
        for joint, value in zip(joints, values, strict=True):
            if not np.isfinite(value):
                raise TrajectoryError(f"{name} of {joint} at point #{k} is {value:g}; give a finite number")
        table[k] = values
    return table
