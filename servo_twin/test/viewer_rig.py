"""Telemetry of a move of both shafts, in the format of bridge and twin."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.convert import AppliedCommand
from servo_msgs_py.timed_points import TimedPoint, encode_points
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import PERIOD_NS

from servo_msgs_py import topics

CATALOGUE = Catalogue.load()
START_NS = 1_700_000_000_000_000_123  # ROS time at which the recordings begin
EVERY = 64  # ticks between two samples: 4 ms
STOP, SPIN, FAULT = (2, 0), (3, 3), (0, 0)
QUANTITIES = ("position", "position_ref", "speed", "speed_ref", "i_q", "i_q_ref", "state", "substate", "faults")
COLUMNS = ["tick", *(f"axis{n}.{name}" for n in (1, 2) for name in QUANTITIES), *topics.STAMP_COLUMNS]


def stamp(tick: int, start_ns: int = START_NS) -> int:
    """ROS time of a tick [ns]; tick 0 is the start of the recording."""
    return start_ns + tick * PERIOD_NS


def move(
    first: int = 0, samples: int = 1000, *, lag: float = 0.0, error: float = 0.0, start_ns: int = START_NS
) -> NDArray[np.float64]:
    """Rows of `COLUMNS`: a smooth move of 5 turns of axis 1 and -2 turns of axis 2, from 1 s to 3 s.

    Parameters
    ----------
    first : int
        Tick of the first row.
    samples : int
        Number of rows.
    lag : float
        Lag of the measured values behind the set-points [s].
    error : float
        Offset of the measured positions [rad].
    start_ns : int
        ROS time of tick 0 [ns].
    """
    ticks = first + EVERY * np.arange(samples)
    times = ticks * PERIOD_NS * 1e-9
    parts = [ticks.astype(np.float64)[:, None]]
    for turns in (5.0, -2.0):

        def phase(late: float) -> NDArray[np.float64]:
            return np.clip((times - late - 1.0) / 2.0, 0.0, 1.0)

        amplitude = 2.0 * np.pi * turns
        position = [amplitude * (3 * phase(late) ** 2 - 2 * phase(late) ** 3) for late in (lag, 0.0)]
        speed = [amplitude * 3.0 * (phase(late) - phase(late) ** 2) for late in (lag, 0.0)]
        current = [np.full(samples, 0.1 * turns), np.full(samples, 0.12 * turns)]
        words = [np.where(times < 0.5, stop, spin) for stop, spin in zip(STOP, SPIN, strict=True)]
        parts.append(np.column_stack([position[0] + error, position[1], *speed, *current, *words, np.zeros(samples)]))
    stamps = [divmod(stamp(int(tick), start_ns), 1_000_000_000) for tick in ticks]
    return np.column_stack([*parts, np.array(stamps, dtype=np.float64)])


def telemetry(table: NDArray[np.float64], columns: Sequence[str] = COLUMNS) -> Trace:
    """Samples of a table."""
    return Trace(0.0, dict(zip(columns, table.T, strict=True)))


def points(first_tick: int, last_tick: int, *, replaces: bool) -> AppliedCommand:
    """Applied points of both axes at two ticks."""
    chosen = [
        TimedPoint(axis, tick, 0.0, 0.0, replaces=replaces and tick == first_tick)
        for tick in (first_tick, last_tick)
        for axis in (0, 1)
    ]
    return AppliedCommand("cmd.points", first_tick - 100, tuple(encode_points(CATALOGUE, chosen)), 3)


def verify(path: Path) -> subprocess.CompletedProcess[str]:
    """Result of ``rerun rrd verify`` for a file."""
    beside = Path(sys.executable).with_name("rerun")
    command = str(beside) if beside.exists() else shutil.which("rerun")
    assert command
    return subprocess.run([command, "rrd", "verify", str(path)], capture_output=True, text=True, timeout=60)
