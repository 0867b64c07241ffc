"""How closely a shaft follows a path in time, next to positions that are sent one by one: part of ``make bench``.

The same motion, 2 Hz and 1 rad on both axes, once as a trajectory through the bridge's follower and once as position
set-points at 100 Hz, on the virtual board in simulated time.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path as File
from typing import Final, get_args

import numpy as np
from numpy.typing import NDArray
from servo_bridge.setpoints import Mode, Request
from servo_bridge.trajectory.path import Path
from servo_bridge.trajectory.shapes import lissajous
from servo_twin.board import Board
from servo_twin.level import Level

sys.path.insert(0, str(File(__file__).parents[1]))
from path_world import COUNT, JOINTS, SAMPLE_NS, PathWorld

FREQUENCY: Final = 2.0
AMPLITUDE: Final = 1.0
SECONDS: Final = 4.0
STEADY: Final = (1.0, 3.0)
"""Part of the motion that is looked at for the lag: whole periods [s]."""


def circle(world: PathWorld, start: float) -> Path:
    """Both axes on a circle, from where they are."""
    shape = lissajous(JOINTS, [0.0] * 2, [AMPLITUDE] * 2, [FREQUENCY] * 2, SECONDS).shifted(start)
    at = world.follower.running().state(world.now).position
    coefficients = shape.coefficients.copy()
    coefficients[..., 0] += at
    return Path(shape.joints, shape.times, coefficients, shape.end + at)


def as_trajectory(world: PathWorld) -> Path:
    """Follow it as a trajectory; returns the path."""
    paths: list[Path] = []

    def plan(running: Path, now: float) -> Path:
        paths.append(circle(world, now))
        return paths[-1]

    world.follow(plan)
    world.run(SECONDS + 0.5)
    assert not world.refusals
    return paths[-1]


def as_positions(world: PathWorld) -> Path:
    """Send a position with every sample, 100 Hz; returns the path that they are of."""
    path = circle(world, world.now + 0.05)
    while world.now < path.end_time + 0.2:
        position = path.state(world.now).position
        world.arbiter.submit(Request("bench", Mode.POSITION, {axis: float(x) for axis, x in enumerate(position)}))
        world.dispatcher.pump()
        world.run(SAMPLE_NS * 1e-9)
    return path


def figures(world: PathWorld, path: Path) -> tuple[float, float]:
    """Largest error [rad], and lag of the fundamental [s]."""
    time, table = world.time(), world.table()
    rows = (time >= path.start_time) & (time <= path.end_time)
    wanted = path.state(time[rows]).position
    real = np.stack([table[f"{joint}.position"][rows] * COUNT for joint in JOINTS], axis=-1)
    error = float(np.abs(real - wanted).max())
    steady = (time[rows] >= path.start_time + STEADY[0]) & (time[rows] < path.start_time + STEADY[1])
    lags = [_lag(time[rows][steady], real[steady, k], wanted[steady, k]) for k in range(len(JOINTS))]
    return error, max(lags)


def _lag(t: NDArray[np.float64], real: NDArray[np.float64], wanted: NDArray[np.float64]) -> float:
    omega = 2.0 * np.pi * FREQUENCY
    wave = np.exp(-1j * omega * t)
    return float(np.angle((wanted * wave).sum() / (real * wave).sum()) / omega)


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    seed = parser.parse_args().seed
    print("| 2 Hz x 1 rad on both axes | level | largest error [rad] | lag [ms] |")
    print("| --- | --- | ---: | ---: |")
    print("| aim | | 0.0200 | 1.00 |")
    for level in get_args(Level):
        for name, run in (("positions at 100 Hz", as_positions), ("trajectory", as_trajectory)):
            with Board(seed=seed, level=level) as board:
                world = PathWorld(board)
                error, lag = figures(world, run(world))
            print(f"| {name} | {level} | {error:.4f} | {1e3 * lag:.2f} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
