"""Curves for the rerun viewer: what a recording file of a burst and the command ``scope`` have in common.

rerun is imported when it is first used: everything else works without.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from servo_bridge.tool_values import UsageError

if TYPE_CHECKING:
    from types import ModuleType


def import_rerun(what: str) -> ModuleType:
    """Import rerun.

    Parameters
    ----------
    what : str
        What needs it, for the message.

    Raises
    ------
    UsageError
        If it is not installed.
    """
    os.environ.setdefault("RERUN_ANALYTICS", "false")  # a computer without a network must not wait for it
    try:
        import rerun
    except ImportError as error:
        raise UsageError(f"{what} needs rerun ({error}): pip install 'rerun-sdk==0.41.*'") from None
    return rerun


def entity_of(parts: Sequence[str]) -> str:
    """Path of an entity; names of variables may hold any character."""
    import rerun

    return rerun.new_entity_path(list(parts))


def send_curve(stream: Any, entity: str, index: Any, values: NDArray[Any]) -> None:
    """Append points to a curve; NaN draws a gap.

    Parameters
    ----------
    stream : rerun.RecordingStream
        Where to.
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
