"""Tracking error of a trajectory, of single positions and of a stream: part of ``make bench``.

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
from path_simulation import COUNT, JOINTS, SAMPLE_NS, PathSimulation

FREQUENCY: Final = 2.0
AMPLITUDE: Final = 1.0
SECONDS: Final = 4.0
STEADY: Final = (1.0, 3.0)
"""Interval of the evaluation of the lag, a multiple of the period [s]."""


def circle(sim: PathSimulation, start: float) -> Path:
    """Circle of both axes from their present positions."""
    shape = lissajous(JOINTS, [0.0] * 2, [AMPLITUDE] * 2, [FREQUENCY] * 2, SECONDS).shifted(start)
    at = sim.follower.running().state(sim.now).position
    coefficients = shape.coefficients.copy()
    coefficients[..., 0] += at
    return Path(shape.joints, shape.times, coefficients, shape.end + at)


def as_trajectory(sim: PathSimulation) -> Path:
    """Follow the circle as a trajectory; return the path."""
    paths: list[Path] = []

    def plan(running: Path, now: float) -> Path:
        paths.append(circle(sim, now))
        return paths[-1]

    sim.follow(plan)
    sim.run(SECONDS + 0.5)
    assert not sim.refusals
    return paths[-1]


def as_positions(sim: PathSimulation) -> Path:
    """Send positions of the circle at 100 Hz; return the path."""
    path = circle(sim, sim.now + 0.05)
    while sim.now < path.end_time + 0.2:
        position = path.state(sim.now).position
        sim.arbiter.submit(SetPointRequest("bench", Mode.POSITION, {axis: float(x) for axis, x in enumerate(position)}))
        sim.dispatcher.pump()
        sim.run(SAMPLE_NS * 1e-9)
    return path


def figures(sim: PathSimulation, path: Path) -> tuple[float, float]:
    """Largest error [rad], and lag of the fundamental [s]."""
    time, table = sim.time(), sim.table()
    rows = (time >= path.start_time) & (time <= path.end_time)
    reference = path.state(time[rows]).position
    real = np.stack([table[f"{joint}.position"][rows] * COUNT for joint in JOINTS], axis=-1)
    error = float(np.abs(real - reference).max())
    steady = (time[rows] >= path.start_time + STEADY[0]) & (time[rows] < path.start_time + STEADY[1])
    lags = [_lag(time[rows][steady], real[steady, k], reference[steady, k]) for k in range(len(JOINTS))]
    return error, max(lags)


def _lag(t: NDArray[np.float64], real: NDArray[np.float64], reference: NDArray[np.float64]) -> float:
    omega = 2.0 * np.pi * FREQUENCY
    wave = np.exp(-1j * omega * t)
    return float(np.angle((reference * wave).sum() / (real * wave).sum()) / omega)


def _wave(t: float) -> dict[int, JointSetPoint]:
    """Streamed position and velocity of both axes."""
    omega = 2.0 * math.pi * FREQUENCY
    rise = min(2.0 * t, 1.0)
    speed = (2.0 * math.sin(omega * t) if t < 0.5 else 0.0) + rise * omega * math.cos(omega * t)
    point = JointSetPoint(AMPLITUDE * rise * math.sin(omega * t), AMPLITUDE * speed)
    return dict.fromkeys(range(AXES), point)


def streamed(sim: PathSimulation, jitter: float, loss: float) -> tuple[float, float, float, int]:
    """Error after compensation of the lag [rad], lag and bridging delay [s], number of faults and errors."""
    begin = sim.send(SECONDS, _wave, jitter=jitter, loss=loss)
    time, table = sim.time(), sim.table()
    rows = (time >= begin + STEADY[0]) & (time < begin + STEADY[1])
    t = time[rows] - begin
    omega = 2.0 * np.pi * FREQUENCY
    lags, errors = [], []
    for joint in JOINTS:
        real = table[f"{joint}.position"][rows] * COUNT
        lags.append(_lag(t, real, np.sin(omega * t)))
        errors.append(float(np.abs(real - AMPLITUDE * np.sin(omega * (t - lags[-1]))).max()))
    report = sim.streamer.report
    assert report is not None
    faults = sum(int(np.count_nonzero(table[f"{joint}.faults"])) for joint in JOINTS)
    return max(errors), max(lags), report.delay, faults + len(sim.errors)


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
                sim = PathSimulation(board)
                error, lag = figures(sim, run(sim))
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
                error, lag, delay, faults = streamed(PathSimulation(board, delay_max), jitter, loss)
            print(f"| {name} | {level} | {error:.4f} | {1e3 * lag:.2f} | {1e3 * delay:.2f} | {faults} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
