"""The two levels of a board: how one is chosen, what both have in common, what only the registers have."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from servo_twin.board import TRACE_ENTRY, Board, BoardError, ChipError, SimulationError
from servo_twin.core_load import DEFAULT_FILE, CoreLoad
from servo_twin.level import Level
from servo_twin.simulation import enable, move

COST_TABLE = Path(__file__).resolve().parents[2] / "tests" / "bench" / "firmware_cost.md"
LEVELS: tuple[Level, ...] = ("registers", "ideal")
ENTER, LEAVE, LOAD, WRITE = 8, 9, 2, 10
M1, M2, START = 85, 30, 87
PERIOD = 6250
HANDLERS = ("m1", "m2", "m1_slow", "m2_slow", "m1_watch", "m2_watch")  # in the order of the cost table
ADC_GC1, SIM_RSTAT, PWMA_MCTRL, INTC_IPR9 = 0xE550, 0xE401, 0xE6C4, 0xE309


def handlers(log: NDArray[np.void], vector: int) -> list[tuple[int, int]]:
    """First and last clock of each complete run of a handler."""
    spans, begun = [], None
    for entry in log:
        if entry["a"] == vector and entry["kind"] == ENTER:
            begun = int(entry["clock"])
        elif entry["a"] == vector and entry["kind"] == LEAVE and begun is not None:
            spans.append((begun, int(entry["clock"])))
    return spans


class TestChoice:
    def test_by_argument_and_by_environment(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.delenv("SERVO_TWIN_LEVEL", raising=False)
        assert Board().level == "registers"
        monkeypatch.setenv("SERVO_TWIN_LEVEL", "ideal")
        assert Board().level == "ideal"
        assert Board(level="registers").level == "registers"

    @pytest.mark.parametrize("name", ["register", ""])
    def test_unknown(self, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
        monkeypatch.setenv("SERVO_TWIN_LEVEL", name)
        with pytest.raises(ValueError, match="a board has the levels registers, ideal"):
            Board()

    def test_the_ideal_level_has_no_registers(self) -> None:
        with Board(level="ideal") as board:
            with pytest.raises(BoardError, match="no registers"):
                board.peek(PWMA_MCTRL)
            assert board.trace(1_000_000).size == 0
            assert board.time_ns == 1_000_000


def test_both_levels_do_the_same_move() -> None:
    reached = {}
    for level in LEVELS:
        with Board(level=level, seed=3) as board:
            enable(board)
            results, _ = move(board, {0: 4000, 1: -2000}, 0.6)
            reached[level] = results
    for registers, ideal in zip(reached["registers"], reached["ideal"], strict=True):
        assert abs(registers.reached - registers.target) <= 4
        assert registers.speed_most == pytest.approx(ideal.speed_most, rel=0.03)
        assert registers.i_q_most == pytest.approx(ideal.i_q_most, rel=0.1)


def test_same_calls_same_bits() -> None:
    def run() -> tuple[bytes, bytes]:
        with Board(level="registers", seed=11) as board:
            trace = board.trace(20_000_000)
            return trace.tobytes(), enable(board).tobytes()

    assert run() == run()


def test_how_time_is_cut_changes_nothing() -> None:
    ends = []
    for step in (3_000_000, 777_770, 62_500):
        with Board(level="registers", seed=2) as board:
            for until in range(step, 30_000_001, step):
                board.advance(until)
            board.advance(30_000_000)
            ends.append(board.record(60_000_000).tobytes())
    assert ends[0] == ends[1] == ends[2]


class TestTrace:
    def test_begins_at_power_on(self) -> None:
        with Board(level="registers") as board:
            log = board.trace(5_000_000)
            assert log.dtype == TRACE_ENTRY
            first = log[0]
            assert (first["kind"], hex(first["a"])) == (WRITE, "0xe320")  # the watchdog, before all else
            assert first["clock"] < 300
            assert len(handlers(log, START)) == 1
            assert np.all(np.diff(log["clock"].astype(np.int64)) >= 0)

    def test_room_is_kept(self) -> None:
        with Board(level="registers") as board:
            assert board.trace(5_000_000, room=10).size == 10
            assert board.time_ns == 5_000_000

    def test_looking_changes_nothing(self) -> None:
        with Board(level="registers", seed=4) as plain, Board(level="registers", seed=4) as traced:
            plain.advance(20_000_000)
            traced.trace(20_000_000)
            assert plain.record(40_000_000).tobytes() == traced.record(40_000_000).tobytes()


class TestCore:
    def test_handlers_last_as_the_core_load_says(self) -> None:
        core = CoreLoad(
            m1=700,
            m1_slow=2400,
            m1_watch=1500,
            m2=600,
            m2_slow=1900,
            m2_watch=1300,
            start=99,
            edge=150,
            fault=120,
            receive=110,
        )
        with Board(level="registers", core=core) as board:
            log = board.trace(10_000_000)
        assert {end - begin for begin, end in handlers(log, M1)} == {700, 2400, 1500}
        assert {end - begin for begin, end in handlers(log, M2)} == {600, 1900, 1300}
        assert {end - begin for begin, end in handlers(log, START)} == {99}

    def test_a_handler_that_is_too_long_is_late_by_a_period(self) -> None:
        """Its duties miss the reload half a period after the sample, and wait for the next one."""
        delay = {}
        for length in (700, 3200):
            core = dataclasses.replace(CoreLoad.load(), m1=length, m1_slow=length, m1_watch=length)
            with Board(level="registers", core=core) as board:
                board.run(0.02)
                board.write("cmd.enable", [1, 1])
                board.run(0.15)
                log = board.trace(board.time_ns + 2_000_000)
            begin, end = handlers(log, M1)[0]
            loads = [int(e["clock"]) for e in log if e["kind"] == LOAD and e["a"] == 0 and e["clock"] > end]
            delay[length] = loads[0] - begin
        assert delay[700] < PERIOD // 2
        assert delay[3200] == delay[700] + PERIOD

    def test_packaged_instructions_are_those_of_the_cost_table(self) -> None:
        """Position mode at -O2, mean, plus the drivers."""
        text = COST_TABLE.read_text(encoding="utf-8")
        section = text.split("## Instructions, -O2\n")[1]
        row = re.search(r"^\| position \|(.*)\|$", section, re.MULTILINE)
        assert row is not None
        means = [float(cell.split()[1]) for cell in row.group(1).split("|")]
        core = CoreLoad.load()
        text = DEFAULT_FILE.read_text(encoding="utf-8").split("[instructions_most]")[0]
        table = dict(re.findall(r"^(\w+)\s*=\s*([\d.]+)", text, re.MULTILINE))
        for name, mean in zip(HANDLERS, means[2:], strict=True):
            drivers = 240 if name.endswith("slow") else 140
            assert mean + drivers <= float(table[name]) <= mean + drivers + 50
            cycles = float(table["entry_cycles"]) + float(table["cycles_per_instruction"]) * float(table[name])
            assert getattr(core, name) == round(cycles)

    def test_longest_instructions_are_those_of_the_cost_table(self) -> None:
        """The most of any mode with every feature on, plus the drivers."""
        section = COST_TABLE.read_text(encoding="utf-8").split("## Instructions, -O2, every feature on\n")[1]
        rows = re.findall(r"^\| [a-z ]+ \|(.*\d \|)$", section.split("\n## ")[0], re.MULTILINE)
        most = np.array([[float(cell.split()[2]) for cell in row.split("|")[2:8]] for row in rows]).max(axis=0)
        usual, longest = CoreLoad.load(), CoreLoad.longest()
        text = DEFAULT_FILE.read_text(encoding="utf-8")
        table = dict(re.findall(r"^(\w+)\s*=\s*([\d.]+)", text.split("[instructions_most]")[1], re.MULTILINE))
        for name, instructions in zip(HANDLERS, most, strict=True):
            drivers = 240 if name.endswith("slow") else 140
            assert instructions + drivers <= float(table[name]) <= instructions + drivers + 50
            assert getattr(longest, name) > getattr(usual, name)
        assert longest.edge == usual.edge

    def test_refusals(self) -> None:
        table = {"entry_cycles": 10, "cycles_per_instruction": 1.0, "instructions": {"m1": 1}}
        with pytest.raises(ValueError, match="handlers are"):
            CoreLoad.parse(table)
        names = [field.name for field in dataclasses.fields(CoreLoad)]
        table["instructions"] = dict.fromkeys(names, -11)
        with pytest.raises(ValueError, match="lasts -1 clocks"):
            CoreLoad.parse(table)


class TestErrors:
    def test_what_is_not_modelled_reaches_python(self) -> None:
        with Board(level="registers") as board:
            board.run(0.005)
            with pytest.raises(ChipError, match=r"ADC GC1 = 0001h: .* \(at \d+\.\d\d us\)"):
                board.poke(ADC_GC1, 1)
            with pytest.raises(SimulationError, match="ADC GC1"):
                board.run(0.001)

    def test_one_board_that_stops_leaves_the_others_running(self) -> None:
        with Board(level="registers", seed=1) as good, Board(level="registers", seed=1) as bad:
            with pytest.raises(ChipError):
                bad.peek(0x0100)
            good.run(0.01)
            assert good.read_raw("tick")[0] > 100


def test_the_watchdog_starts_the_firmware_anew() -> None:
    """M1 comes no more, so nobody serves the watchdog: reset, and the sequence runs again."""
    with Board(level="registers") as board:
        board.run(0.02)
        (ticks,) = board.read_raw("tick")
        served = board.stats().watchdog_services
        assert served > 10
        board.poke(INTC_IPR9, board.peek(INTC_IPR9) & ~0x0300)  # priority of PWMA_CMP1: off
        board.run(0.04)
        assert board.stats().watchdog_services == served
        board.run(0.05)
        assert board.peek(SIM_RSTAT) & 0x0020
        assert 0 < board.read_raw("tick")[0] < ticks + 16 * 50
        assert board.stats().watchdog_services > served


@pytest.mark.parametrize("seed", range(1, 7))
def test_no_encoder_edge_is_lost(seed: int) -> None:
    """A shaft that trembles about an edge while its rotor is searched, rests on it, and then leaves fast."""
    with Board(level="registers", seed=seed) as board:
        enable(board)
        begin = [(board.truth(axis).theta_m, board.read_raw(f"axis{axis + 1}.position")[0]) for axis in (0, 1)]
        move(board, {0: 3000, 1: -2000}, 0.5)
        for axis, (angle, position) in enumerate(begin):
            turned = (board.truth(axis).theta_m - angle) * 4000 / (2 * np.pi)
            assert board.read_raw(f"axis{axis + 1}.position")[0] - position == pytest.approx(turned, abs=2.5)
