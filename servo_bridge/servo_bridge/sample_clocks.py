"""Times of the samples of a board: ticks, the steady clock of the host and ROS time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rclpy.clock import ROSClock
from servo_msgs_py.units import PERIOD_NS, unwrap_u32

from servo_bridge.wire.board_clock import BoardClock, WallClock
from servo_bridge.wire.scope import Sample


class SampleClocks:
    """Converts between ticks of the board and the clocks of the host.

    Parameters
    ----------
    clock : ROSClock
        ROS time.
    minimum_delay_ns : int
        Transmission time of a sample [ns].
    """

    def __init__(self, clock: ROSClock, minimum_delay_ns: int) -> None:
        self._clock = clock
        self._board = BoardClock(minimum_delay_ns)
        self._wall = WallClock(lambda: int(clock.now().nanoseconds))
        self._epoch = 0
        self._simulated = False  # whether `_board` maps to simulated ROS time instead of the steady clock
        self._tick = 0  # of the newest sample

    def refresh(self) -> None:
        """Compare the clocks of the host again; about once a second."""
        self._wall.refresh()

    def stamp(self, sample: Sample) -> int:
        """ROS time of the tick of a new sample [ns]."""
        if sample.epoch != self._epoch:
            self._epoch = sample.epoch
            self._board.reset()
        self._tick = sample.tick
        if self._clock.ros_time_is_active != self._simulated:
            self._simulated = not self._simulated
            self._board.reset()
        if self._simulated:  # the board keeps this time, at any rate
            self._wall.refresh()
            return self._board.update(sample.tick, self._wall.wall_ns(sample.response_ns))
        return self._wall.stamp(self._board.update(sample.tick, sample.response_ns))

    @property
    def origin_ns(self) -> int | None:
        """ROS time at tick 0 [ns]; None before the first sample."""
        offset = self._board.offset_ns
        if offset is None or self._simulated:
            return None if offset is None else round(offset)
        return self._wall.wall_ns(round(offset))

    def board_time(self, steady_ns: int) -> float | None:
        """Time since tick 0 at a time of the steady clock [s]; None before the first sample."""
        offset = self._board.offset_ns
        if offset is None:
            return None
        return ((self._wall.wall_ns(steady_ns) if self._simulated else steady_ns) - offset) * 1e-9

    def times(self, ticks: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Extended ticks of uint32 ticks close to the newest sample, and their ROS times [ns]."""
        origin_ns = self.origin_ns
        assert origin_ns is not None
        extended = np.array([unwrap_u32(tick, self._tick) for tick in ticks.tolist()])
        return extended, origin_ns + extended * PERIOD_NS
