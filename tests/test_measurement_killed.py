"""A measuring program that ends without a word: the board restores configuration, parameters and mode itself."""

from __future__ import annotations

import contextlib
import math
from pathlib import Path
from typing import Any, Final

import pytest
from line_simulation import SimulatedLine
from servo_bridge.freemaster.client import Client
from servo_bridge.freemaster.errors import FreemasterError
from servo_bridge.freemaster.line import Line
from servo_bridge.tool_commands import Context
from servo_bridge.wire.serial_port import LowLatency
from servo_bridge.wire.session import connect
from servo_measurement.access import MeasurementError
from servo_msgs_py.board_port import write_axis
from servo_msgs_py.catalogue import Catalogue
from servo_twin.board import Board

from servo_bridge import tool, tool_identify

BAUD: Final = 115_200
CATALOGUE: Final = Catalogue.load()
KEPT: Final = [
    *(name for name in CATALOGUE.variables if name.startswith("param.")),
    "config.checksum",
    "cmd.enable",
    "cmd.mode",
    "cmd.speed",
    "cmd.i_q",
]
HOST_TIMEOUT: Final = 0.5  # s, param.host_timeout after reset
REST: Final = 2.0  # s, longest time from the fault until the shaft is at rest, for these motors
OPEN: Final = CATALOGUE.enums["measurement_state_t"]["OPEN"]


class DeadLine(SimulatedLine):
    """Line that ends for ever at a time [s]; `restored` is the time at which the board has ended the session [s]."""

    def __init__(self, board: Board, end: float) -> None:
        super().__init__(board)
        self._end = end
        self.other_values = False  # values during the session differ from the initial ones
        self.restored = math.nan
        self._initial = state(board)

    def advance(self, until_ns: int) -> None:
        super().advance(until_ns)
        now = self.board.time_ns * 1e-9
        if self.plugged and now >= self._end:
            self.plugged = False
            self.other_values = state(self.board) != self._initial
        if not self.plugged and math.isnan(self.restored) and self.board.read("measurement.state") == 0:
            self.restored = now


def state(board: Board) -> dict[str, list[int]]:
    return {name: board.read_words(name) for name in KEPT}


def arguments_of(command: str, folder: Path) -> list[str]:
    if command == "identify":
        return ["identify", "--voltage", "24", "--current", "4", "--r-on", "0.03", "--out", str(folder)]
    if command in ("ripple", "resonance"):
        return [command, "axis1", "--enable"]
    if command == "autotune":
        return [command, "axis1", "--out", str(folder)]
    return ["bode", "axis1", command, "--enable"]


@pytest.mark.parametrize(
    ("command", "end"),
    [
        ("identify", 6.0),
        ("identify", 50.0),
        ("speed", 8.0),
        ("current", 3.0),
        ("ripple", 10.0),
        ("resonance", 8.0),
        ("autotune", 20.0),
    ],
)
def test_board_restores_itself_when_the_program_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str, end: float
) -> None:
    """For the board, a killed program is a line without requests."""
    monkeypatch.setattr(tool_identify, "_twin_installed", lambda: False)
    with Board(level="ideal", baud=BAUD, seed=4) as board:
        board.run(0.1)
        board.write("param.speed_limit", [150.0, 300.0])  # changed by the user, not stored
        if command == "ripple":
            write_axis(board, "cmd.home", 0, board.catalogue.enums["home_method_t"]["HERE"])
        board.run(0.01)
        before = state(board)
        line = DeadLine(board, end)
        session = connect(Client(Line(line, baud=BAUD, clock=line.clock)), CATALOGUE)
        args: Any = tool._parser().parse_args(arguments_of(command, tmp_path))
        args.check(args)
        context = Context(args, CATALOGUE, session, "line", BAUD, LowLatency(True, ""))
        with contextlib.suppress(FreemasterError, MeasurementError):
            assert args.run(context) != 0
        assert line.other_values, "the session had begun"
        assert line.restored - end < HOST_TIMEOUT + REST
        assert state(board) == before
        assert board.catalogue.label("measurement_end_t", board.read_words("measurement.ended")[0]) == "SILENT"
        assert abs(board.truth(0).omega_m) < 1.0
