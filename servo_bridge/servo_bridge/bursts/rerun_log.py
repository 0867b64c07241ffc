"""Curves for the rerun viewer, used by recording files of bursts and by ``scope``.

rerun is imported at its first use: other functions work without it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def entity_of(parts: Sequence[str]) -> str:
    """Path of an entity; names of variables may contain any character."""
    import rerun

    return rerun.new_entity_path(list(parts))


def send_curve(stream: Any, entity: str, index: Any, values: NDArray[Any]) -> None:
    """Append points to a curve; NaN is a gap.

    Parameters
    ----------
    stream : rerun.RecordingStream
        Destination.
    entity : str
        Path of the curve.
    index : rerun.TimeColumn
        Times of the points.
    values : array, shape (n,)
        One per time.
    """
    import rerun

    columns = rerun.Scalars.columns(scalars=values.astype(np.float64))
    stream.send_columns(entity, indexes=[index], columns=columns)
