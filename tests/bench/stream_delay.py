"""Delay of a stream of ros2_control in simulated time, per line speed and update rate; the table of ros2_control.md.

    PYTHONPATH=tests .venv/bin/python tests/bench/stream_delay.py

A trajectory controller moves both joints by 20 rad in 2 s, with positions and velocities, on the virtual board,
after it has held them for 25 s. In a part of the rows messages are up to 5 ms late.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from command_sequences import CommandSequence, Setup, Step
from sensor_msgs.msg import JointState
from servo_bridge.trajectory.streamer import StreamReport
from servo_msgs_py.catalogue import AXES
from servo_msgs_py.units import PERIOD
from simulated_bridge import START_NS, WALL_NS

_BAUDS = (115_200, 1_000_000)
_RATES = (50.0, 100.0, 200.0, 500.0)
_JITTERS = (0.0, 0.005)  # s
_SETTLE = 25.0  # time for the lead to adapt [s]
_GOAL = Step("goal", 0.3, distance=20.0, time=2.0, velocities=True)
_SPEED = 1.5 * 20.0 / 2.0  # largest one of the goal, a cubic [rad/s]


@dataclass(frozen=True)
class Delay:
    """Figures of one goal."""

    delay: float  # of the stream, from the arrival of a message to the motion [s]
    late: int  # messages that came too late
    states: float  # states that the controller receives [1/s]
    age: float  # mean age of a state at its arrival, by its stamp [s]
    stamp_error: float  # largest distance of a stamp from the time of the state [s]
    lag: float  # largest error of the joint that the controller sees, over the largest speed [s]


class _Measured(CommandSequence):
    """A sequence that measures its goal."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup, [Step("cancel", _SETTLE), _GOAL])
        self.report: StreamReport | None = None  # at the end of the goal
        self.measures = False
        self.arrivals: list[float] = []  # of states [s]
        self.ages: list[float] = []
        self.stamp_errors: list[float] = []
        self.errors: list[float] = []

    def _goal(self, step: Step) -> Iterator[float]:
        self.measures = step is _GOAL
        yield from super()._goal(step)
        if self.measures:
            yield 2.2
            self.measures, self.report = False, self.sim.supervisor.parts.streamer.report

    def _on_states(self, message: JointState) -> None:
        super()._on_states(message)
        snapshot = self.sim.supervisor._snapshot
        if self.measures and snapshot is not None:
            stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec - WALL_NS
            self.arrivals.append(self.sim.now)
            self.ages.append((self._world.now_ns - stamp) * 1e-9)
            self.stamp_errors.append(abs((stamp - START_NS) * 1e-9 - snapshot.tick * PERIOD))

    def _cycle(self, process: int) -> None:
        super()._cycle(process)
        if self.measures:
            self.errors.append(max(abs(self.trajectory.error(k)[0]) for k in range(AXES)))


def measure(baud: int, rate: float, jitter: float = 0.0) -> Delay:
    """Run the goal over a line [bit/s] with messages at a rate [Hz] and with a jitter [s]."""
    sequence = _Measured(Setup(rate, jitter, baud=baud))
    violations, report = sequence.run(), sequence.report
    if violations or report is None:
        sys.exit(f"{baud} baud, {rate:g} Hz: {violations}")
    return Delay(
        report.delay,
        report.late,
        (len(sequence.arrivals) - 1) / (sequence.arrivals[-1] - sequence.arrivals[0]),
        float(np.mean(sequence.ages)),
        max(sequence.stamp_errors),
        max(sequence.errors) / _SPEED,
    )


def main() -> int:
    print("| line [baud] | update rate [Hz] | jitter [ms] | delay [ms] | late | states [1/s] | age [ms] | lag [ms] |")
    print("|---|---|---|---|---|---|---|---|")
    for baud, jitter, rate in itertools.product(_BAUDS, _JITTERS, _RATES):
        one = measure(baud, rate, jitter)
        print(
            f"| {baud} | {rate:g} | {1e3 * jitter:g} | {1e3 * one.delay:.0f} | {one.late} | {one.states:.0f} "
            f"| {1e3 * one.age:.1f} | {1e3 * one.lag:.0f} |",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
