"""Test fixture: arbiter, dispatcher and follower of the bridge on a virtual board, in simulated time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_bridge.arbiter import Arbiter
from servo_bridge.dispatcher import Dispatcher
from servo_bridge.set_point_queue import CommandWrite
from servo_bridge.set_points import JointSetPoint
from servo_bridge.telemetry import AxisStatus, Snapshot
from servo_bridge.trajectory.check import require
from servo_bridge.trajectory.errors import TrajectoryError
from servo_bridge.trajectory.follower import Follower, PathEvents, Plan
from servo_bridge.trajectory.path import Path
from servo_bridge.trajectory.streamer import Streamer, stream_lead
from servo_bridge.trajectory_limits import path_limits
from servo_msgs_py.board_parameters import parameters
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name, numbers
from servo_msgs_py.convert import AppliedCommand, state_label
from servo_msgs_py.joints import DEFAULT_JOINTS, Joint, joint_names
from servo_msgs_py.robot_description import Motor
from servo_msgs_py.timed_points import periods_ahead
from servo_msgs_py.units import PERIOD, PERIOD_NS
from servo_twin.board import Board
from servo_twin.board_memory import BoardError
from servo_twin.simulation import enable

CATALOGUE: Final = Catalogue.load()
JOINTS: Final = tuple(joint_names(DEFAULT_JOINTS))
COUNT: Final = CATALOGUE["axis1.position"].lsb
SAMPLE_NS: Final = 10_000_000
"""Sample period of the telemetry [ns]."""
SENDER_TIME_OFFSET: Final = 1000.0
"""Time of the sender of a stream at board time 0 [s]."""
WRITE_NS: Final = 2_000_000
"""Time from a write to its answer [ns]."""


class PathSimulation:
    """A board and the parts of the bridge that send paths to it.

    Parameters
    ----------
    board : Board
        Board after reset.
    delay_max : float, optional
        Largest bridging delay of the streamer [s].
    joints : sequence of Joint
        Joints in the order of the axes, with the names of `JOINTS`.
    """

    def __init__(self, board: Board, delay_max: float | None = None, joints: Sequence[Joint] = DEFAULT_JOINTS) -> None:
        self.board = board
        self.errors: list[str] = []
        self.end_times: list[float] = []
        self.refusals: list[TrajectoryError] = []
        self.abandoned: list[str] = []
        self.postponed = 0  # paths that begin later because the board has refused their first points
        self.writes_lost = False  # no write reaches the board, as after a crash of the bridge
        self.write_delay = 0.0  # from the bridge to the board [s]
        self._writes_in_transit: list[tuple[float, CommandWrite]] = []
        self.log: list[NDArray[np.void]] = []
        self.arbiter = Arbiter(CATALOGUE, joints)
        self.follower = Follower(CATALOGUE, joints, self._check, clock=lambda: 0.0)
        self.arbiter.queue.follow(self.follower)
        self.streamer = Streamer(joints, self.follower, stream_lead(115_200), delay_max)
        self._unacknowledged: list[tuple[CommandWrite, str | None]] = []
        self.dispatcher = Dispatcher(self._send, self.arbiter.queue, self.errors.append, self._on_applied)
        enable(board)
        constants = [numbers(board.read(f"{axis_name(axis)}.torque_constant"))[0] for axis in range(AXES)]
        self.arbiter.set_torque_constants(constants)
        self.follower.torque_constants = constants
        currents = [numbers(board.read(f"{axis_name(axis)}.acceleration_current"))[0] for axis in range(AXES)]
        self._motors = [Motor(k, k * current) for k, current in zip(constants, currents, strict=True)]
        self.read_limits()
        self.arbiter.release()
        self.dispatcher.open()
        self.run(0.05)

    def read_limits(self) -> None:
        """Read the limits of the board."""
        raw = {v.name: self.board.read_words(v.name) for v in parameters(CATALOGUE)}
        self.limits = path_limits(CATALOGUE, raw, self.arbiter.joints, self._motors)

    def _check(self, path: Path) -> None:
        require(path, [self.limits[JOINTS.index(joint)] for joint in path.joints])

    def _send(self, write: CommandWrite) -> None:
        if not self.writes_lost:
            self._writes_in_transit.append((self.now + self.write_delay, write))
            self._deliver()

    def _deliver(self) -> None:
        """Pass the writes whose delay has elapsed to the board."""
        while self._writes_in_transit and self._writes_in_transit[0][0] <= self.now:
            self._write(self._writes_in_transit.pop(0)[1])

    def _write(self, write: CommandWrite) -> None:
        variable = CATALOGUE[write.variable]
        offset, data = variable.encode_part(write.raw, write.first)
        error = None
        try:
            self.board.write_memory(self.board.address(write.variable) + offset, data)
        except BoardError as refusal:
            error = f"{refusal}: {CATALOGUE.label('point_refusal_t', self.board.read_words('point_refusal')[0])}"
        self._unacknowledged.append((write, error))

    def follow(self, plan: Plan, joints: Sequence[str] = JOINTS, start: float = 0.0) -> None:
        """Request a path."""
        self.arbiter.admit_path("test", [JOINTS.index(joint) for joint in joints])

        def postponed() -> bool:
            self.postponed += 1
            return True

        self.follower.request(
            joints,
            plan,
            PathEvents(self.end_times.append, self.refusals.append, self.abandoned.append, postponed),
            start=start,
        )
        self.dispatcher.pump()

    def receive(self, points: Mapping[int, JointSetPoint], stamp: float) -> None:
        """Receive one message of a stream of set-points."""
        self.arbiter.admit_path("test", points)
        self.streamer.take(points, stamp, self.now, self.limits)
        self.streamer.advance(self.now)
        self.dispatcher.pump()

    def send(
        self,
        seconds: float,
        points: Callable[[float], Mapping[int, JointSetPoint]],
        *,
        period: float = 0.01,
        jitter: float = 0.0,
        loss: float = 0.0,
    ) -> float:
        """Send a stream of set-points that starts now; return its start time [s].

        Parameters
        ----------
        seconds : float
            Duration [s].
        points : callable
            Set-points by axis, at a time after the start [s].
        period, jitter : float
            Period of the messages, and largest random delay of a message [s].
        loss : float
            Fraction of the messages that is lost.
        """
        random = np.random.default_rng(7)
        begin = self.now
        sent = np.arange(round(seconds / period)) * period
        arrivals = sent + random.uniform(0.0, jitter, len(sent))
        kept = random.uniform(size=len(sent)) >= loss
        for arrival, stamp in sorted(zip(arrivals[kept], sent[kept], strict=True)):
            while begin + arrival > self.now + 1e-3:
                self.run(min(begin + arrival - self.now, SAMPLE_NS * 1e-9))
            self.receive(points(float(stamp)), SENDER_TIME_OFFSET + begin + stamp)
        return begin

    @property
    def now(self) -> float:
        """Board time [s]."""
        return self.board.time_ns * 1e-9

    def run(self, seconds: float) -> None:
        """Run the board with telemetry."""
        end = self.board.time_ns + round(seconds * 1e9)
        while self.board.time_ns < end:
            sample = min(self.board.time_ns + SAMPLE_NS, end)
            while self.board.time_ns < sample:
                rows = self.board.record(min(self.board.time_ns + WRITE_NS, sample))
                if len(rows):
                    self.log.append(rows)
                self._deliver()
                written, self._unacknowledged = self._unacknowledged, []
                for write, error in written:
                    self.dispatcher.acknowledged(write, error)
            self._sample(self.log[-1][-1])

    def _sample(self, row: np.void) -> None:
        axes = []
        for axis in range(AXES):
            name = axis_name(axis)
            label = state_label(CATALOGUE, int(row[f"{name}.state"]), int(row[f"{name}.substate"]))
            reference, position = int(row[f"{name}.position_ref"]), int(row[f"{name}.position"])
            axes.append(AxisStatus(label, label == "RUN/SPIN", label == "FAULT", position, reference))
        applied = int(row["applied_tick"]), int(row["applied_count"])
        snapshot = Snapshot(int(row["tick"]), 0, 0, {}, *applied, tuple(axes), ())
        self.arbiter.on_sample(snapshot)
        self.streamer.advance(self.now)
        self.dispatcher.on_sample(snapshot)

    def _on_applied(self, applied: AppliedCommand) -> None:
        if applied.variable == "cmd.points":
            self.streamer.arrived(periods_ahead(applied.raw, applied.tick) * PERIOD)

    def table(self) -> NDArray[np.void]:
        """All recorded rows."""
        return np.concatenate(self.log)

    def time(self) -> NDArray[np.float64]:
        """Board time of the recorded rows [s]."""
        result: NDArray[np.float64] = self.table()["tick"] * (PERIOD_NS * 1e-9)
        return result
