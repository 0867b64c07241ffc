"""Two virtual boards, one as the real board and one as its twin, without ROS: for trials and calibration."""

from __future__ import annotations

import math
import random
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Final, TypeVar

import numpy as np
from servo_msgs_py.board_port import reached
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.convert import AppliedCommand
from servo_msgs_py.units import PERIOD_NS, SLOW_PERIODS

from servo_msgs_py import topics
from servo_twin.board import Board, SimulationError
from servo_twin.level import Level
from servo_twin.lockstep.replica import Replica
from servo_twin.lockstep.twin import Pair, Twin
from servo_twin.plant import PlantConfig

SAMPLE_TICKS: Final = 17
"""Slow ticks between two samples: 8.5 ms, the rate of the default telemetry at 115200 baud."""

_VARIABLES: Final = (
    *("tick", "applied_tick", "applied_count", "u_dc"),
    *(
        f"{axis_name(axis)}.{name}"
        for axis in range(AXES)
        for name in (
            *("position", "speed", "i_q", "state", "substate", "faults"),
            *("position_ref", "speed_ref", "i_q_ref", "limits", "u_d", "u_q"),
        )
    ),
)
COLUMNS: Final = (*_VARIABLES, *topics.STAMP_COLUMNS)
"""Columns of a sample."""

_TIME_MAX: Final = 8.0  # from reset to closed-loop control [s]


_Self = TypeVar("_Self", bound="SampledBoard")


class SampledBoard(ABC):
    """A virtual board in the place of the real one, without a serial line; a subclass gets its samples and commands.

    Parameters
    ----------
    board : Board
        A board after power-on; closed at the end of the context.
    seed : int
        Of the times of the samples and of the losses.
    loss : float
        Fraction of lost samples, 0 .. 1.
    """

    def __init__(self, board: Board, *, seed: int, loss: float = 0.0) -> None:
        self._catalogue = board.catalogue
        self._lsb = [board.catalogue[name].lsb for name in _VARIABLES]
        self._random = random.Random(f"samples {seed}")
        self._loss = loss
        self.board = board
        self.real = Replica(board)
        self._written: list[tuple[str, tuple[int, ...], int]] = []

    def close(self) -> None:
        """Free the board."""
        self.real.close()

    def __enter__(self: _Self) -> _Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def clock(self) -> float:
        """Time of the real board since its reset [s]."""
        return self.real.clock()

    def wait(self, seconds: float) -> None:
        """Sample at least for `seconds` [s]."""
        end = self.clock() + seconds
        while self.clock() < end:
            self.sample()

    def write(self, variable: str, values: Sequence[float], mask: int = (1 << AXES) - 1) -> None:
        """Write the masked axes of a command variable, SI; the next sample reports the effect."""
        raw = tuple(self._catalogue[variable].to_raw(x) if mask >> n & 1 else 0 for n, x in enumerate(values))
        self.real.write(variable, raw, mask)
        self._written.append((variable, raw, mask))

    def sample(self) -> list[Pair]:
        """Run the real board to its next sample and pass it on; returns the new pairs with a twin, if there is one."""
        step = SAMPLE_TICKS + self._random.choice((-1, 0, 0, 1))
        self.real.run_to(self.real.tick + SLOW_PERIODS * step)
        raw = self.real.raw
        for variable, words, mask in self._written:
            self.on_command(AppliedCommand(variable, raw["applied_tick"], words, mask))
        self._written.clear()
        if self._loss and self._random.random() < self._loss:
            return []
        row = [float(raw[name] * lsb) for name, lsb in zip(_VARIABLES, self._lsb, strict=True)]
        row += divmod(self.real.tick * PERIOD_NS, 1_000_000_000)
        return self.on_sample(row)

    @abstractmethod
    def on_command(self, command: AppliedCommand) -> None:
        """Take a command that took effect."""

    @abstractmethod
    def on_sample(self, row: Sequence[float]) -> list[Pair]:
        """Take a sample with the columns `COLUMNS`, SI."""

    def ready(self) -> bool:
        """Whether both axes are in closed-loop control."""
        return set(self.labels()) == {"RUN/SPIN"}

    def labels(self) -> list[str]:
        """State of every axis of the real board."""
        return [self.real.label(axis) for axis in range(AXES)]

    def enable(self) -> None:
        """Enable both axes and wait for closed-loop control.

        Raises
        ------
        SimulationError
            On a timeout.
        """
        self.wait(0.1 - self.clock())
        self.write("cmd.enable", [1.0] * AXES)
        if not reached(self, self.ready, _TIME_MAX - self.clock()):
            raise SimulationError(f"no closed-loop control {_TIME_MAX:g} s after the reset: axes in {self.labels()}")


class BoardPair(SampledBoard):
    """A board with its twin.

    Parameters
    ----------
    plant : PlantConfig
        Of the real board.
    twin_plant : PlantConfig
        The twin's model of the plant.
    seed : int
        Of the noise of both boards and of the times of the samples.
    level : {"registers", "ideal"}, optional
        Of both boards.
    loss : float
        Fraction of lost samples, 0 .. 1.
    """

    def __init__(
        self,
        plant: PlantConfig,
        twin_plant: PlantConfig,
        *,
        seed: int,
        level: Level | None = None,
        loss: float = 0.0,
    ) -> None:
        catalogue = Catalogue.load()
        super().__init__(Board(plant, seed=2 * seed + 1, level=level, catalogue=catalogue), seed=seed, loss=loss)
        self.twin = Twin(
            lambda: Board(twin_plant, seed=2 * seed + 2, level=level, catalogue=catalogue), None, catalogue
        )

    def close(self) -> None:
        self.twin.close()
        super().close()

    def on_command(self, command: AppliedCommand) -> None:
        self.twin.add_command(command)

    def on_sample(self, row: Sequence[float]) -> list[Pair]:
        self.twin.add_samples(COLUMNS, np.array([row]))
        return self.twin.step()

    def ready(self) -> bool:
        return super().ready() and set(self.twin.labels()) == {"RUN/SPIN"}


@dataclass
class _Segment:
    """Present motion of one axis."""

    until: float  # end, board time [s]
    mode: int = 0
    speed: float = 0.0  # set-point of the mode SPEED [rad/s]


class Motion:
    """Random motion of both axes: moves of 1 to 80 rad and speeds up to 250 rad/s.

    Parameters
    ----------
    pair : SampledBoard
        With both axes in closed-loop control.
    seed : int
        Of the motion.
    """

    def __init__(self, pair: SampledBoard, seed: int) -> None:
        self._pair = pair
        self._random = random.Random(f"motion {seed}")
        modes = pair.board.catalogue.enums["control_mode_t"]
        self._position, self._speed = modes["POSITION"], modes["SPEED"]
        self._segments = [_Segment(pair.clock()) for _ in range(AXES)]
        self._repeat = pair.clock()

    def run(self, seconds: float) -> Iterator[Pair]:
        """Pairs of `seconds` of board time [s].

        Raises
        ------
        SimulationError
            If the board has a fault.
        """
        end = self._pair.clock() + seconds
        while self._pair.clock() < end:
            self._command()
            for one in self._pair.sample():
                if one.fault:
                    raise SimulationError(one.fault)
                yield one

    def _command(self) -> None:
        now = self._pair.clock()
        for axis, segment in enumerate(self._segments):
            if now >= segment.until:
                self._next(axis, segment, now)
        if now >= self._repeat:  # a velocity set-point expires after 0.5 s
            self._repeat = now + 0.2
            mask = sum(1 << axis for axis, segment in enumerate(self._segments) if segment.mode == self._speed)
            if mask:
                self._pair.write("cmd.speed", [segment.speed for segment in self._segments], mask)

    def _next(self, axis: int, segment: _Segment, now: float) -> None:
        draw, mask = self._random, 1 << axis
        segment.mode = draw.choice((self._position, self._speed))
        segment.until = now + draw.uniform(0.3, 1.2)
        self._pair.write("cmd.mode", [float(segment.mode)] * AXES, mask)
        if segment.mode == self._position:
            name = f"{axis_name(axis)}.position_ref"
            here = self._pair.real.raw[name] * self._pair.board.catalogue[name].lsb
            distance = math.exp(draw.uniform(math.log(1.0), math.log(80.0)))
            self._pair.write("cmd.position", [here + draw.choice((-1.0, 1.0)) * distance] * AXES, mask)
        else:
            segment.speed = draw.choice((-1.0, 1.0)) * draw.uniform(10.0, 250.0)
            self._pair.write("cmd.speed", [segment.speed] * AXES, mask)
