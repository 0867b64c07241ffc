"""``servo-tool tune`` and a virtual board in simulated time: gains in motion, another motor without a compiler."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from line_simulation import SimulatedLine
from numpy.typing import NDArray
from servo_bridge.freemaster.client import Client
from servo_bridge.freemaster.line import Line
from servo_bridge.tool_commands import CommandFunction, Context
from servo_bridge.tool_values import UsageError
from servo_bridge.wire.serial_port import LowLatency
from servo_bridge.wire.session import Session, connect
from servo_msgs_py.board_port import choose, write_axis, write_word
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.units import PERIOD_NS
from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.simulation import enable
from servo_twin.validation.experiments.rig import features

from servo_bridge import tool

CONFIG: Final = Path(__file__).resolve().parents[1] / "firmware" / "config" / "servo.toml"
BAUD: Final = 1_000_000
MOVE: Final = 8000  # counts: two turns
U_Q: Final = 24.2 / 2**15  # V
LINES: Final = 16384, 512  # of the encoders of the other motors
MOTORS: Final[dict[str, dict[str, float]]] = {
    "axis1": {"r_s": 1.4, "l_d": 1.6e-3, "l_q": 1.9e-3, "psi_m": 0.0085, "pole_pairs": 4, "inertia": 4.5e-5},
    "axis2": {"r_s": 0.9, "l_d": 0.9e-3, "l_q": 1.1e-3, "psi_m": 0.0102, "pole_pairs": 3, "inertia": 2.0e-5},
}


class ToolBench:
    """A board with the tool on its serial line."""

    def __init__(self, board: Board) -> None:
        self.board = board
        self.line = SimulatedLine(board)
        self.session: Session | None = None

    def tool(self, *arguments: str | Path) -> int:
        args = tool._parser().parse_args([str(argument) for argument in arguments])
        if self.session is None:
            client = Client(Line(self.line, baud=BAUD, clock=self.line.clock))
            self.session = connect(client, Catalogue.load())
        args.check(args)
        run: CommandFunction = args.run
        return run(Context(args, Catalogue.load(), self.session, "line", BAUD, LowLatency(True, "")))

    def raw(self, name: str) -> list[int]:
        return self.board.read_words(name)


def edited(folder: Path, name: str, **groups: dict[str, Any]) -> Path:
    """servo.toml with replaced entries of groups: ``control`` of [defaults], ``axis1__motor`` of [axis1]."""
    text = CONFIG.read_text(encoding="utf-8")
    for group, entries in groups.items():
        owner = group.replace("__", ".") if "__" in group else f"defaults.{group}"
        start = text.index(f"[{owner}]")
        end = text.find("\n[", start)
        part = text[start:end]
        for key, value in entries.items():
            part, count = re.subn(rf"^{key}\s*=\s*\S+", f"{key} = {value}", part, flags=re.MULTILINE)
            assert count == 1, (owner, key)
        text = text[:start] + part + text[end:]
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@contextmanager
def spinning() -> Iterator[Board]:
    """A board with both axes in SPIN."""
    with Board(level="ideal", baud=BAUD, seed=4) as board:
        enable(board)
        yield board


@pytest.fixture
def bench() -> Iterator[ToolBench]:
    with Board(level="ideal", baud=BAUD, seed=4) as board:
        board.run(0.1)
        yield ToolBench(board)


def test_file_is_shown_compared_sent_and_read_back(
    bench: ToolBench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = bench.raw("config.checksum")
    file = edited(tmp_path, "mine.toml", axis1__motor={"psi_m": 0.012}, control={"position_gain": 50.0})
    assert bench.tool("tune", CONFIG) == 0
    out, err = capsys.readouterr()
    assert "no change" in out
    assert all(f"[board.{group}] is compiled into the firmware" in err for group in ("brake", "regeneration"))
    for flag, status in (("--dry-run", 0), ("--diff", 1)):
        assert bench.tool("tune", file, flag) == status
        assert bench.raw("config.checksum") == own
        out = capsys.readouterr().out
        assert re.search(r"axis1 +torque_constant +0\.0462\S* N m/A +0\.036\S* N m/A +at rest", out)
        assert re.search(r"axis2 +position_gain +\S+ rad/s +\S+ rad/s +in motion", out)
    assert bench.tool("tune", file, "--axis", "1") == 0
    assert f"axis1 applied at tick {bench.raw('config.taken_tick')[0]}" in capsys.readouterr().out
    assert (bench.raw("config.checksum")[0] == own[0], bench.raw("config.checksum")[1] == own[1]) == (False, True)
    assert bench.tool("tune", file) == 0
    taken = bench.raw("config.checksum")
    assert bench.tool("tune", file, "--diff") == 0

    back = tmp_path / "back.toml"
    assert bench.tool("tune", "--from-board", "-o", back) == 0
    assert "psi_m 0.012 V s" in back.read_text(encoding="utf-8")
    assert bench.tool("tune", back, "--diff") == 0
    assert bench.tool("tune", CONFIG) == 0
    assert bench.raw("config.checksum") == own
    assert bench.tool("tune", back) == 0
    assert bench.raw("config.checksum") == taken


def test_configuration_refused_by_the_tuning_code_is_not_sent(bench: ToolBench, tmp_path: Path) -> None:
    own = bench.raw("config.checksum")
    with pytest.raises(UsageError, match="speed_bandwidth"):
        bench.tool("tune", edited(tmp_path, "bad.toml", control={"speed_bandwidth": 4000.0}))
    assert bench.raw("config.checksum") == own
    for arguments in ((), ("--from-board", CONFIG), (CONFIG, "-o", "x.toml")):
        with pytest.raises(UsageError):
            bench.tool("tune", *arguments)


def test_another_motor_is_configured_without_a_compiler(tmp_path: Path) -> None:
    plant = PlantConfig.load()
    for axis, motor in enumerate(MOTORS.values()):
        plant = plant.with_axis(axis, **motor, encoder_lines=float(LINES[axis]))
    file = edited(
        tmp_path,
        "motors.toml",
        axis1__motor=MOTORS["axis1"],
        axis2__motor=MOTORS["axis2"],
        control={"speed_bandwidth": 50.0, "position_gain": 45.0},
        axis2__control={"speed_bandwidth": 50.0},
        limits={"speed": 230.0},
    )
    with file.open("a", encoding="utf-8") as text:
        text.writelines(f"[axis{n}.encoder]\nlines = {lines}\n" for n, lines in enumerate(LINES, 1))
    with Board(plant=plant, level="ideal", baud=BAUD, seed=4) as board:
        board.run(0.1)
        bench = ToolBench(board)
        assert bench.tool("tune", file) == 0
        board.write("param.command_timeout", 0.0)
        board.write("cmd.enable", [1, 1])
        for _ in range(100):
            board.run(0.05)
            if all(board.read(f"axis{k}.substate") == 3 for k in (1, 2)):
                break
        assert [board.read(f"axis{k}.substate") for k in (1, 2)] == [3, 3]
        start = [bench.raw(f"axis{k}.position")[0] for k in (1, 2)]
        write_word(board, "cmd.position", 0, start[0] + MOVE)
        write_word(board, "cmd.position", 1, start[1] - MOVE)
        peak = [0, 0]
        for _ in range(60):
            board.run(0.05)
            distances = [bench.raw(f"axis{k}.position")[0] - start[k - 1] for k in (1, 2)]
            peak = [max(peak[0], distances[0]), max(peak[1], -distances[1])]
        assert [board.read(f"axis{k}.faults") for k in (1, 2)] == [0, 0]
        assert peak == pytest.approx([MOVE, MOVE], abs=3)
        assert distances == pytest.approx([MOVE, -MOVE], abs=3)


def test_no_loop_is_late_when_both_axes_take_blocks(tmp_path: Path) -> None:
    """At level `registers`, where code takes time, with every feature that uses a block."""
    on = ("FRICTION", "SPEED_OBSERVER", "SPEED_FORWARD", "ACCELERATION_FORWARD", "FOLLOWING_ERROR", "ANGLE_CHECK")
    changes = {"speed_bandwidth": 60.0, "position_gain": 50.0, "current_bandwidth": 900.0, "path_current_use": 0.4}
    file = edited(tmp_path, "gains.toml", control=changes, axis1__motor={"inertia": 0.9e-5})
    with Board(level="registers", baud=BAUD, seed=4) as board:
        enable(board)
        bench = ToolBench(board)
        for axis in range(2):
            features(board, axis, **dict.fromkeys(on, True))
            write_word(board, "cmd.position", axis, bench.raw(f"axis{axis + 1}.position")[0] + 200_000)
        board.run(0.1)
        for number, source in enumerate((file, CONFIG, file), 1):
            assert bench.tool("tune", source) == 0
            assert bench.raw("config.answers") == [number]
        board.run(0.02)
        assert (bench.raw("late_loops"), bench.raw("axis1.faults"), bench.raw("axis2.faults")) == (
            [0],
            [0],
            [0],
        )


class RecordingLine(SimulatedLine):
    """Line that records axis 1 in every PWM period: true i_q, and u_q of the last snapshot."""

    def __init__(self, board: Board) -> None:
        super().__init__(board)
        self.seen: list[tuple[float, float]] = []

    def advance(self, until_ns: int) -> None:
        while self.board.time_ns < until_ns:
            self.board.advance(min(until_ns, (self.board.time_ns // PERIOD_NS + 1) * PERIOD_NS))
            if self.board.time_ns % PERIOD_NS == 0:
                self.seen.append((self.board.truth(0).i_q, self.board.read_words("axis1.u_q")[0] * U_Q))

    def around(self, tick: int, periods: int) -> NDArray[np.float64]:
        """Rows of `periods` periods before and after a tick."""
        middle = len(self.seen) - (self.board.time_ns // PERIOD_NS - tick)
        return np.array(self.seen[middle - periods : middle + periods])


@pytest.mark.parametrize("what", ["ramp", "speed", "position"])
def test_gains_change_in_motion_without_a_step(tmp_path: Path, what: str) -> None:
    """Changes of current and voltage per period, and their means, are as without a change of gains."""
    file = edited(
        tmp_path, "gains.toml",
        control={"current_bandwidth": 700.0, "speed_bandwidth": 55.0, "position_gain": 45.0, "speed_ratio": 6.0},
        friction={"smooth": 2.0}, axis1__friction={"coulomb": 2.5e-3},
        axis2__control={"speed_bandwidth": 45.0},
    )  # fmt: skip
    with spinning() as board:
        bench = ToolBench(board)
        bench.line = line = RecordingLine(board)
        features(board, 0, FRICTION=True)
        board.write("param.acceleration_limit", [400.0 if what == "ramp" else 4000.0] * 2)
        board.run(0.01)
        assert bench.tool("tune", CONFIG, "--dry-run") == 0  # read the table of variables before the motion
        if what == "position":
            write_word(board, "cmd.position", 0, bench.raw("axis1.position")[0] + 200_000)
        else:
            choose(board, "cmd.mode", 0, "SPEED")
            write_axis(board, "cmd.speed", 0, 280.0 if what == "ramp" else 120.0)
        board.set_load(0, 0.03)
        line.advance(board.time_ns + 300_000_000)
        line.seen.clear()
        assert bench.tool("tune", file) == 0
        tick = bench.raw("config.taken_tick")[0]
        line.advance(board.time_ns + 100_000_000)
        assert (bench.raw("axis1.limits"), bench.raw("axis1.faults")) == ([0], [0]), "the shafts can move"
        for column, name in enumerate(("i_q", "u_q")):
            seen = line.around(tick, 320)[:, column]
            before, after = seen[:320], seen[320:]
            slope = float(np.polyfit(np.arange(320), before, 1)[0])  # periods of a ramp
            by_itself = float(np.abs(np.diff(before)).max())
            assert float(np.abs(np.diff(seen[312:344])).max()) <= 1.5 * by_itself, name
            shift = float(after[:32].mean() - before[-32:].mean()) - 32 * slope
            assert abs(shift) <= float(np.ptp(before - slope * np.arange(320))), name
