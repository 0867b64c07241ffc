"""Values of the board that are not in the telemetry: motor data, error counters, winding temperatures, oscillations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from servo_msgs_py.catalogue import AXES, Value, axis_name, numbers
from servo_msgs_py.robot_description import Motor

from servo_bridge.board_context import BoardContext
from servo_bridge.health import BOARD_COUNTERS, CONDITION, Condition
from servo_bridge.part import Part
from servo_bridge.telemetry import Snapshot

_MOTOR: Final = ("torque_constant", "acceleration_current")


class SlowValues(Part):
    """Last values; forgotten after the loss of the link.

    Parameters
    ----------
    context : BoardContext
        Access to the board, the executor and the log.
    motors_known : callable
        Called after the motor data have been read.
    conditions_known : callable
        Called with the conditions of the axes after each reading.
    """

    def __init__(
        self,
        context: BoardContext,
        motors_known: Callable[[], None],
        conditions_known: Callable[[Sequence[Condition]], None],
    ) -> None:
        self._context = context
        self._motors_known, self._conditions_known = motors_known, conditions_known
        self._counting = False
        self._link = self._epoch = 0  # numbers of the connection and of the resets of the board
        self.counters: dict[str, int] | None = None  # of `BOARD_COUNTERS`
        self._forget()

    def connected(self) -> None:
        """Start to read the motor data."""
        self.read_motors()

    def on_sample(self, snapshot: Snapshot) -> None:
        """Forget the counters after a reset of the board."""
        if snapshot.epoch != self._epoch:
            self._epoch, self.counters = snapshot.epoch, None

    def lost(self, reason: str) -> None:
        """Forget everything."""
        self._link += 1
        self._forget()

    @property
    def torque_constants(self) -> list[float]:
        """Torque constants of the motors, by axis [N m/A]; empty until they are read."""
        return [motor.torque_constant for motor in self.motors]

    def _forget(self) -> None:
        self.motors: list[Motor] = []  # by axis; empty until they are read
        self.conditions: list[Condition | None] = [None] * AXES  # by axis
        self.counters = None

    def read_motors(self) -> None:
        """Start to read the motor data: after a connection or a change of the configuration."""

        def take(values: list[float]) -> None:
            self.motors = [Motor(k, k * current) for k, current in zip(values[::2], values[1::2], strict=True)]
            self._motors_known()

        self._start([f"{axis_name(axis)}.{name}" for axis in range(AXES) for name in _MOTOR], take)

    def read_counters(self) -> None:
        """Start to read counters and conditions, unless a reading is in progress; they would lengthen every sample."""

        def take(values: list[float]) -> None:
            self.counters = {name: int(value) for name, value in zip(BOARD_COUNTERS, values, strict=False)}
            about = values[len(BOARD_COUNTERS) :]
            size = len(CONDITION)
            found = [Condition(*about[k : k + size]) for k in range(0, len(about), size)]
            self.conditions = list(found)
            self._conditions_known(found)

        def ended() -> None:
            self._counting = False

        if not self._counting:
            self._counting = True
            names = [f"{axis_name(axis)}.{name}" for axis in range(AXES) for name in CONDITION]
            self._start([*BOARD_COUNTERS, *names], take, ended)

    def _start(
        self, names: Sequence[str], take: Callable[[list[float]], None], ended: Callable[[], None] = lambda: None
    ) -> None:
        """Read single numbers and pass them to `take`, unless the link is lost meanwhile."""
        link = self._link

        def all_read(values: list[Value], error: str | None) -> None:
            ended()
            if link == self._link and error is None:
                take([float(number) for value in values for number in numbers(value)])

        self._context.read_all(names, all_read)
