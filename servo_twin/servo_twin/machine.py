"""Speed at which this machine simulates boards, and the level that it can keep up with."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from typing import Final

from servo_msgs_py.catalogue import AXES

from servo_twin.board import Board
from servo_twin.level import DEFAULT_LEVEL, FAST_LEVEL, Level
from servo_twin.plant import PlantConfig
from servo_twin.simulation import enable

SPEED_MIN: Final = 2.0
"""Simulated per real time that boards need side by side: bridge, viewer and other programs run beside them."""

_SPAN: Final = 1.0  # simulated time of a measurement [s]
_STEP: Final = 0.05  # simulated time between two looks at the clock [s]
_LONGEST: Final = 1.0  # real time after which a measurement ends [s]


def simulation_speed(level: Level, boards: int) -> float:
    """Simulated time per real time of boards with turning shafts, side by side: the slowest one."""
    with ThreadPoolExecutor(boards) as pool:
        return min(pool.map(lambda seed: _speed(level, seed), range(boards)))


def _speed(level: Level, seed: int) -> float:
    with Board(PlantConfig.load(), seed=seed, level=level) as board:
        enable(board)
        board.write("cmd.mode", [1] * AXES)
        board.write("cmd.speed", [100.0, -50.0])
        done, begin = 0.0, time.monotonic()
        while done < _SPAN and time.monotonic() - begin < _LONGEST:
            board.run(_STEP)
            done += _STEP
        return done / (time.monotonic() - begin)


def level_for(speed: float) -> Level:
    """Level of boards on a machine with this speed at `DEFAULT_LEVEL`."""
    return DEFAULT_LEVEL if speed >= SPEED_MIN else FAST_LEVEL
