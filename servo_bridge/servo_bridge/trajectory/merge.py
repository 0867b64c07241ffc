"""Merge the paths of several joints."""

from __future__ import annotations

from collections.abc import Sequence
from math import comb

import numpy as np

from servo_bridge.trajectory.path import DEGREE, Path
from servo_bridge.trajectory.waypoints import Array


def merged(paths: Sequence[Path]) -> Path:
    """Return one path with the motions and breakpoints of all paths.

    Parameters
    ----------
    paths : sequence of Path
        Of different joints.

    Returns
    -------
    Path
        Joints in the order of the paths. Each joint holds before the start and after the end of its own path.
    """
    times = np.sort(np.concatenate([path.times for path in paths]))
    times = times[
        np.concatenate(([True], np.diff(times) > 0.0))
    ]  # the first call of np.unique takes 100 ms for imports
    begins = times[:-1]
    return Path(
        [joint for path in paths for joint in path.joints],
        times,
        np.concatenate([_pieces(path, begins) for path in paths], axis=1),
        np.concatenate([path.end for path in paths]),
        np.concatenate([path.state(times).effort for path in paths], axis=1),
    )


def _pieces(path: Path, begins: Array) -> Array:
    """Coefficients of a path for pieces that begin at these times, shape (times, joints, 6)."""
    last = len(path.times) - 2
    piece = np.clip(np.searchsorted(path.times, begins, side="right") - 1, 0, last)
    shifted = path.coefficients[piece]
    within = np.flatnonzero(begins != path.times[piece])  # the others keep their coefficients
    old, s = shifted[within], (begins - path.times[piece])[within, None]
    moved = np.zeros_like(old)
    for k in range(DEGREE + 1):
        for j in range(k, DEGREE + 1):
            moved[..., k] += comb(j, k) * old[..., j] * s ** (j - k)
    shifted[within] = moved
    outside = (begins < path.start_time) | (begins >= path.end_time)
    shifted[outside] = 0.0
    shifted[outside, :, 0] = path.state(begins[outside]).position
    return shifted
