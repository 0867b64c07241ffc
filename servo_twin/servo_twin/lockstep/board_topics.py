"""Topics of a board that drive a twin, for the live node and for recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.blocks_message import blocks_from_message
from servo_msgs_py.board_parameters import RawParameters
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.convert import (
    AppliedCommand,
    applied_from_message,
    parameters_from_message,
    snapshot_table,
    trace_from_message,
)
from servo_msgs_py.recorder_setup import RecorderSetup, setup_from_message
from servo_msgs_py.trace import Trace
from std_msgs.msg import Float64MultiArray, Int64MultiArray

from servo_msgs_py import topics
from servo_twin.lockstep.blocks import Blocks


class BoardInput(Protocol):
    """What receives the messages: `Twin`, or its thread."""

    def add_samples(self, columns: Sequence[str], table: NDArray[np.float64]) -> None: ...

    def add_command(self, command: AppliedCommand) -> None: ...

    def set_parameters(self, values: RawParameters) -> None: ...

    def set_blocks(self, blocks: Blocks) -> None: ...

    def set_windings(self, temperatures: Sequence[float]) -> None: ...

    def set_recorder(self, setup: RecorderSetup | None) -> None: ...

    def add_burst(self, label: str, points: Trace) -> None: ...


@dataclass(frozen=True)
class BoardTopic:
    """One topic."""

    name: str  # relative to the namespace of the bridge
    message: type[Any]  # class of its messages
    latched: bool  # the last message is delivered to new subscribers
    take: Callable[[BoardInput, Any, Catalogue], None]  # passes a message on; ValueError if it is not valid


def _snapshot(board: BoardInput, message: Float64MultiArray, _: Catalogue) -> None:
    board.add_samples(*snapshot_table(message))


def _applied(board: BoardInput, message: Int64MultiArray, _: Catalogue) -> None:
    board.add_command(applied_from_message(message))


def _parameters(board: BoardInput, message: Float64MultiArray, catalogue: Catalogue) -> None:
    board.set_parameters(parameters_from_message(message, catalogue))


def _tuning(board: BoardInput, message: Int64MultiArray, _: Catalogue) -> None:
    if blocks := blocks_from_message(message):  # else the bridge could not read them
        board.set_blocks(blocks)


def _windings(board: BoardInput, message: Float64MultiArray, catalogue: Catalogue) -> None:
    span = catalogue[f"{axis_name(0)}.winding_temperature"]
    values = [float(value) for value in message.data]
    if len(values) != AXES or not all(span.minimum <= value <= span.maximum for value in values):
        raise ValueError(f"{values} are not {AXES} valid temperatures")
    board.set_windings(values)


def _recorder(board: BoardInput, message: Float64MultiArray, _: Catalogue) -> None:
    board.set_recorder(setup_from_message(message))


def _recording(board: BoardInput, message: Float64MultiArray, _: Catalogue) -> None:
    points = trace_from_message(message)
    if "tick" not in points.columns or not len(points) or not np.isfinite(points["tick"]).all():
        raise ValueError("recording without ticks")
    board.add_burst(message.layout.dim[0].label, points)


BOARD_TOPICS: Final = (
    BoardTopic(topics.SNAPSHOT, Float64MultiArray, False, _snapshot),
    BoardTopic(topics.COMMANDS_APPLIED, Int64MultiArray, False, _applied),
    BoardTopic(topics.PARAMETERS, Float64MultiArray, True, _parameters),
    BoardTopic(topics.TUNING, Int64MultiArray, True, _tuning),
    BoardTopic(topics.WINDING_TEMPERATURES, Float64MultiArray, True, _windings),
    BoardTopic(topics.RECORDER, Float64MultiArray, True, _recorder),
    BoardTopic(topics.RECORDING, Float64MultiArray, True, _recording),
)
