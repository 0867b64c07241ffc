"""Test rig: a virtual board in place of the real one, and a twin that receives the messages of the bridge."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.axis_config_transfer import send_block
from servo_msgs_py.board_parameters import applied, parameters, parse
from servo_msgs_py.catalogue import AXES, Catalogue
from servo_msgs_py.convert import AppliedCommand, state_label
from servo_msgs_py.timed_points import TimedPoint, axes_of_points, encode_points
from servo_msgs_py.units import PERIOD_NS
from servo_twin.board import Board
from servo_twin.lockstep.replica import Replica
from servo_twin.lockstep.twin import Pair, Twin, TwinSettings
from servo_twin.plant import PlantConfig
from servo_twin.servo_config import ServoConfig

if TYPE_CHECKING:
    from servo_twin.robot.robot_model import RobotModel

from servo_msgs_py import topics

CATALOGUE = Catalogue.load()
AXIS_VARIABLES = (
    *("position", "speed", "i_q", "state", "substate", "faults", "limits", "home_state"),
    *("position_ref", "speed_ref", "i_q_ref", "u_d", "u_q"),
)
VARIABLES = ("tick", "applied_tick", "applied_count", "u_dc", *(f"axis{n}.{v}" for n in (1, 2) for v in AXIS_VARIABLES))
COLUMNS = (*VARIABLES, *topics.STAMP_COLUMNS)
EPOCH_NS = 1_700_000_000_000_000_123  # ROS time of tick zero
EVERY = 96  # ticks between two samples: 6 ms, as at 115200 baud


class TwinRig:
    """Runs the real board and passes its samples and commands to the twin.

    Parameters
    ----------
    real_seed, twin_seed : int
        Seeds of both boards.
    every : int
        Ticks between two samples.
    plant : PlantConfig, optional
        Plant of the real board, if it differs from the default.
    twin_plant : PlantConfig, optional
        Plant of the twin, likewise.
    servo : ServoConfig, optional
        Configuration of both boards, if it differs from the default.
    settings : TwinSettings, optional
        Settings of the twin.
    robot : RobotModel, optional
        What the shafts of the real board move.
    twin_robot : RobotModel, optional
        The twin's model of it.
    tick_base : int
        Multiple of 2^32 that is added to the ticks for the twin, as of a board in operation for days.
    """

    def __init__(
        self,
        *,
        real_seed: int = 1,
        twin_seed: int = 2,
        every: int = EVERY,
        plant: PlantConfig | None = None,
        twin_plant: PlantConfig | None = None,
        servo: ServoConfig | None = None,
        settings: TwinSettings | None = None,
        robot: RobotModel | None = None,
        twin_robot: RobotModel | None = None,
        tick_base: int = 0,
    ) -> None:
        self.every = every
        packaged = PlantConfig.load()
        new = Board if robot is None else robot.board
        self.board = new(plant or packaged, seed=real_seed, servo=servo)
        if robot is not None:
            robot.attach(self.board, {})
        self.real = Replica(self.board)
        new_twin = Board if twin_robot is None else twin_robot.board
        self.twin = Twin(
            lambda: new_twin(twin_plant or packaged, seed=twin_seed, servo=servo),
            settings,
            attach=None if twin_robot is None else twin_robot.attach,
        )
        self.pairs: list[Pair] = []
        self.reporting = True  # applied commands are reported to the twin
        self.listening = True  # samples and commands are passed to the twin
        self.held_reports: list[AppliedCommand] | None = (
            None  # collects reports of applied commands; None: passed to the twin
        )
        self.tick_base = tick_base
        self._written: list[tuple[str, tuple[int, ...], int]] = []

    def __enter__(self) -> TwinRig:
        return self

    def __exit__(self, *exception: object) -> None:
        self.twin.close()
        self.real.close()

    def reset_board(self, seed: int = 1) -> None:
        """Switch the real board off and on with its data flash."""
        flash = self.board.cut_power()
        self.real.close()
        self.board = Board(seed=seed, flash=flash)
        self.real = Replica(self.board)

    def write(self, variable: str, values: Sequence[float], mask: int = 3) -> None:
        """Write to the real board; its effect is reported with the next sample."""
        raw = [CATALOGUE[variable].to_raw(v) if mask >> n & 1 else 0 for n, v in enumerate(values)]
        self.real.write(variable, raw, mask)
        self._written.append((variable, (raw[0], raw[1]), mask))

    def write_points(self, points: Sequence[TimedPoint]) -> None:
        """Write timed points to the real board; their effect is reported with the next sample."""
        words = tuple(encode_points(CATALOGUE, points))
        self.real.write_first("cmd.points", words)
        self._written.append(("cmd.points", words, axes_of_points(words)))

    def tune(self, blocks: Mapping[int, Mapping[str, int]]) -> None:
        """Write configuration blocks to the real board; their effect is reported with the next sample."""
        mask = sum(1 << axis for axis in blocks)
        for axis, block in blocks.items():
            send_block(self.real, axis, block)
        assert self.real.write_words("config.take", [mask])
        words = [word for axis in sorted(blocks) for word in AxisConfigTable.load().words(blocks[axis])]
        self._written.append(("config.take", tuple(words), mask))

    def set_parameters(self, *texts: str, report: bool = True) -> None:
        """Set parameters of the real board, as ``NAME=VALUE``, and report all its parameters to the twin."""
        present = {v.name: self.board.read_words(v.name) for v in parameters(CATALOGUE)}
        for name, raw in applied([parse(text, CATALOGUE) for text in texts], present).items():
            self.board.write_raw(name, raw)
            present[name] = raw
        if report:
            self.twin.set_parameters(present)

    def write_parameters(self, *texts: str) -> None:
        """Set parameters of the real board as the bridge does: written like commands, then read and reported."""
        present = {v.name: self.board.read_words(v.name) for v in parameters(CATALOGUE)}
        for name, raw in applied([parse(text, CATALOGUE) for text in texts], present).items():
            self.board.write_raw(name, raw)
            padded = (*raw, *[0] * (AXES - len(raw)))
            self._written.append((name, padded, (1 << len(raw)) - 1))
            present[name] = raw
        self.sample()
        self.twin.set_parameters(present)

    def run(self, seconds: float) -> list[Pair]:
        """Run the real board with samples; return the pairs of the twin."""
        before = len(self.pairs)
        for _ in range(round(seconds * 1e9 / PERIOD_NS / self.every)):
            self.sample()
        return self.pairs[before:]

    def sample(self) -> None:
        """Run the real board to its next sample and pass it to the twin."""
        self.real.run_to(self.real.tick + self.every)
        for variable, raw, mask in self._written:
            self._report(AppliedCommand(variable, self.tick_base + self.real.raw["applied_tick"], raw, mask))
        self._written.clear()
        tick = self.tick_base + self.real.tick
        row = [float(self.real.raw[name] * CATALOGUE[name].lsb) for name in VARIABLES]
        row[0] = float(tick)
        row += divmod(EPOCH_NS + tick * PERIOD_NS, 1_000_000_000)
        if self.listening:
            self.twin.add_samples(COLUMNS, np.array([row]))
            self.pairs.extend(self.twin.step())

    def _report(self, command: AppliedCommand) -> None:
        if self.held_reports is not None:
            self.held_reports.append(command)
        elif self.reporting and self.listening:
            self.twin.add_command(command)

    def until(self, label: str, seconds: float = 3.0, axes: Sequence[int] = range(AXES)) -> None:
        """Run until both axes of the real board are in a state."""
        for _ in range(round(seconds * 1e9 / PERIOD_NS / self.every)):
            self.sample()
            if all(self.label(n) == label for n in axes):
                return
        raise AssertionError([self.label(n) for n in range(AXES)])

    def label(self, axis: int) -> str:
        prefix = f"axis{axis + 1}"
        return state_label(CATALOGUE, self.real.raw[f"{prefix}.state"], self.real.raw[f"{prefix}.substate"])

    def enable_axes(self) -> None:
        """Enable both axes and wait until they have been in SPIN for 0.15 s, and the twin is synchronised if it can be.

        The shafts swing after the rotor search: when they come to rest depends on the seed and on the load.
        """
        self.run(0.1)
        self.write("cmd.enable", [1, 1])
        self.until("RUN/SPIN")
        self.run(0.15)
        swing = 1.0  # [s]
        while self.listening and self.twin.status and swing > 0.0:
            self.run(0.05)
            swing -= 0.05

    def move(self, turns: Sequence[float], seconds: float = 0.6, mask: int = 3) -> list[Pair]:
        """Move to positions in turns from the zero of the real board."""
        self.write("cmd.position", [2.0 * math.pi * x for x in turns], mask)
        return self.run(seconds)


def worst(pairs: Sequence[Pair], name: str) -> float:
    """Largest difference of a variable over pairs; fails without pairs."""
    return max(abs(pair.real[name] - pair.twin[name]) for pair in pairs)


def worst_counts(pairs: Sequence[Pair]) -> float:
    """Largest difference of a position of both axes [counts]."""
    return max(worst(pairs, f"axis{n}.position") for n in (1, 2)) / CATALOGUE["axis1.position"].lsb


def apart(pairs: Sequence[Pair]) -> list[str]:
    """Reasons why the boards were not comparable, each once."""
    return list(dict.fromkeys(pair.difference for pair in pairs if pair.difference))
