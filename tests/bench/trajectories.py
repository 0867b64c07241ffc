"""How closely a shaft follows a path in time, next to positions that are sent one by one: part of ``make bench``.

The same motion, 2 Hz and 1 rad on both axes, as a trajectory, as position set-points at 100 Hz, and streamed with
velocities, through the parts of the bridge, on the virtual board in simulated time.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path as File
from typing import Final, get_args

import numpy as np
from numpy.typing import NDArray
from servo_bridge.set_points import JointSetPoint, Mode, SetPointRequest
from servo_bridge.trajectory.path import Path
from servo_bridge.trajectory.shapes import lissajous
from servo_msgs_py.catalogue import AXES
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
        world.arbiter.submit(
            SetPointRequest("bench", Mode.POSITION, {axis: float(x) for axis, x in enumerate(position)})
        )
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


def _wave(t: float) -> dict[int, JointSetPoint]:
    """Position and velocity of both axes, as they are streamed."""
    omega = 2.0 * math.pi * FREQUENCY
    rise = min(2.0 * t, 1.0)
    speed = (2.0 * math.sin(omega * t) if t < 0.5 else 0.0) + rise * omega * math.cos(omega * t)
    point = JointSetPoint(AMPLITUDE * rise * math.sin(omega * t), AMPLITUDE * speed)
    return dict.fromkeys(range(AXES), point)


def streamed(world: PathWorld, jitter: float, loss: float) -> tuple[float, float, float, int]:
    """Error besides the lag [rad], lag and bridging delay [s], and faults."""
    begin = world.send(SECONDS, _wave, jitter=jitter, loss=loss)
    time, table = world.time(), world.table()
    rows = (time >= begin + STEADY[0]) & (time < begin + STEADY[1])
    t = time[rows] - begin
    omega = 2.0 * np.pi * FREQUENCY
    lags, errors = [], []
    for joint in JOINTS:
        real = table[f"{joint}.position"][rows] * COUNT
        lags.append(_lag(t, real, np.sin(omega * t)))
        errors.append(float(np.abs(real - AMPLITUDE * np.sin(omega * (t - lags[-1]))).max()))
    report = world.streamer.report
    assert report is not None
    faults = sum(int(np.count_nonzero(table[f"{joint}.faults"])) for joint in JOINTS)
    return max(errors), max(lags), report.delay, faults + len(world.troubles)


def main() -> int:
    """Print the tables."""
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
    print()
    print("| streamed at 100 Hz with velocity | level | error besides the lag [rad] | lag [ms] | delay [ms] | faults |")
    print("| --- | --- | ---: | ---: | ---: | ---: |")
    print("| aim | | 0.0400 | delay + 2 | | 0 |")
    cases = (
        ("no jitter", 0.0, 0.0, None),
        ("50 ms of jitter, 5 % lost", 0.05, 0.05, None),
        ("the same, stream_delay_max 0.1", 0.05, 0.05, 0.1),
    )
    for level in get_args(Level):
        for name, jitter, loss, delay_max in cases:
            with Board(seed=seed, level=level) as board:
                error, lag, delay, faults = streamed(PathWorld(board, delay_max), jitter, loss)
            print(f"| {name} | {level} | {error:.4f} | {1e3 * lag:.2f} | {1e3 * delay:.2f} | {faults} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
