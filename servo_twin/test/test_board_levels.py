"""The two levels of a board: selection, equal results, and properties of level registers."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from numpy.typing import NDArray
from servo_msgs_py.board_port import active
from servo_msgs_py.catalogue import AXES
from servo_msgs_py.units import PERIOD_NS
from servo_twin.board import TRACE_ENTRY, Board, BoardError, ChipError, SimulationError
from servo_twin.core_speed import CoreSpeed
from servo_twin.fault_injection import StalledCore
from servo_twin.level import Level
from servo_twin.plant import PlantConfig
from servo_twin.simulation import enable, move

LEVELS: tuple[Level, ...] = ("registers", "ideal")
ENTER, LEAVE, LOAD, WRITE = 8, 9, 2, 10
M1, M2, START = 85, 30, 87
HALF_PERIOD_US = PERIOD_NS / 2000
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
    def test_an_unknown_level_is_refused(self, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
        monkeypatch.setenv("SERVO_TWIN_LEVEL", name)
        with pytest.raises(ValueError, match="levels: registers, ideal"):
            Board()

    def test_the_ideal_level_has_no_registers(self) -> None:
        with Board(level="ideal") as board:
            with pytest.raises(BoardError, match="no registers"):
                board.peek(PWMA_MCTRL)
            assert board.trace(1_000_000).size == 0
            assert board.time_ns == 1_000_000


def test_both_levels_heat_the_power_stages_alike() -> None:
    """Heated by reversals: the current changes between its limit and the friction current."""
    heat = []
    for level in LEVELS:
        plant = PlantConfig.load()
        for axis in range(AXES):
            plant = plant.with_axis(axis, sink_capacity=1.0, sink_resistance=1e6)
        with Board(plant, level=level, seed=1) as board:
            enable(board)
            before = [board.truth(axis).t_sink for axis in range(AXES)]
            board.write("cmd.mode", [1] * AXES)
            for n in range(8):
                board.write("cmd.speed", [150.0 * (-1) ** n] * AXES)
                board.run(0.2)
            heat.append([board.truth(axis).t_sink - t for axis, t in enumerate(before)])  # [J]
    registers, ideal = heat
    assert min(registers) > 0.5
    assert ideal == pytest.approx(registers, rel=0.035)


def test_both_levels_heat_the_windings_alike() -> None:
    """Heated by 2 A, with the resistance of warm copper."""
    ends = []
    for level in LEVELS:
        plant = PlantConfig.load()
        for axis in range(AXES):
            plant = plant.with_axis(axis, winding_capacity=0.5, winding_resistance=20.0)
        with Board(plant, level=level, seed=1) as board:
            enable(board)
            for axis in range(AXES):
                board.lock_shaft(axis)
                board.set_winding(axis, 60.0)
            board.write("cmd.mode", [2] * AXES)
            board.write("cmd.i_q", [2.0, -2.0])
            board.run(0.4)
            ends.append([board.truth(axis).t_winding for axis in range(AXES)])
    registers, ideal = ends
    for axis, motor in enumerate(PlantConfig.load().axes):
        loss = 1.5 * motor.r_s * (1.0 + 3.93e-3 * 35.0) * 4.0
        assert ideal[axis] == pytest.approx(60.0 + 0.4 * (loss - 35.0 / 20.0) / 0.5, abs=0.15)
    assert ideal == pytest.approx(registers, abs=0.1)


@pytest.mark.parametrize("level", LEVELS)
def test_board_in_use_starts_with_a_warm_winding_model(level: Level) -> None:
    with Board(level=level, seed=1) as board:
        board.run(0.02)
        board.set_winding(1, 87.5)
        assert board.truth(1).t_winding == 87.5
        board.run(0.01)
        assert board.read("axis2.winding_temperature") == pytest.approx(87.5, abs=0.02)
        assert board.truth(0).t_winding == pytest.approx(25.0, abs=0.1)
        with pytest.raises(ValueError, match="300 deg C is not within -256"):
            board.set_winding(0, 300.0)


def test_run_suspended_in_a_handler_continues_in_another_thread() -> None:
    """Each part runs in its own thread, while another board runs in this one."""
    with Board(level="registers", seed=2) as plain, Board(level="registers", seed=2) as moved:
        plain.advance(20_000_000)
        for until in range(10_000, 20_000_001, 70_000):
            thread = threading.Thread(target=moved.advance, args=(until,))
            thread.start()
            thread.join()
        moved.advance(20_000_000)
        assert plain.record(40_000_000).tobytes() == moved.record(40_000_000).tobytes()


class TestTrace:
    def test_begins_at_power_on(self) -> None:
        with Board(level="registers") as board:
            log = board.trace(5_000_000)
            assert log.dtype == TRACE_ENTRY
            first = log[0]
            assert (first["kind"], hex(first["a"])) == (WRITE, "0xe320")  # the watchdog is written first
            assert first["clock"] < 300
            assert len(handlers(log, START)) == 1
            assert np.all(np.diff(log["clock"].astype(np.int64)) >= 0)

    def test_trace_does_not_exceed_its_size(self) -> None:
        with Board(level="registers") as board:
            assert board.trace(5_000_000, capacity=10).size == 10
            assert board.time_ns == 5_000_000

    def test_trace_does_not_change_the_run(self) -> None:
        with Board(level="registers", seed=4) as plain, Board(level="registers", seed=4) as traced:
            plain.advance(20_000_000)
            traced.trace(20_000_000)
            assert plain.record(40_000_000).tobytes() == traced.record(40_000_000).tobytes()


def spinning(core: CoreSpeed) -> Board:
    board = Board(level="registers", core=core)
    enable(board)
    return board


class TestCore:
    def test_handlers_last_as_long_as_their_instructions(self) -> None:
        """The shortest run of the fast loop takes a fixed number of instructions, plus the entry."""
        shortest = {}
        for cycles, entry in ((1.0, 30), (2.0, 30), (2.0, 50)):
            with spinning(CoreSpeed(cycles, entry)) as board:
                log = board.trace(board.time_ns + 5_000_000)
            shortest[cycles, entry] = [min(end - begin for begin, end in handlers(log, v)) for v in (M1, M2)]
        for one, two, three in zip(*shortest.values(), strict=True):
            assert two - 30 == pytest.approx(2 * (one - 30), abs=5)
            assert three == pytest.approx(two + 20, abs=5)
            assert 200 < one < 800

    def test_writes_of_a_handler_are_spread_over_it(self) -> None:
        with spinning(CoreSpeed.load()) as board:
            log = board.trace(board.time_ns + 500_000)
        for begin, end in handlers(log, M1):
            writes = [int(e["clock"]) - begin for e in log if e["kind"] == WRITE and begin < e["clock"] < end]
            assert len(set(writes)) > 8
            assert writes[0] >= 30

    def test_slow_core_causes_late_loops(self) -> None:
        """Late loops are counted, and the fault LATE_LOOP keeps the switches open."""
        for cycles in (2.0, 7.0):
            with Board(level="registers", core=CoreSpeed(cycles, 30)) as board:
                board.run(0.02)
                assert (board.read_words("late_loops")[0] > 0) == (cycles > 2.0)
                assert [active(board, axis) for axis in range(2)] == [{"LATE_LOOP"} if cycles > 2.0 else set()] * 2

    @pytest.mark.parametrize("level", LEVELS)
    @pytest.mark.parametrize("stall_us", [60, 80, 300, 990])
    def test_each_loop_omitted_by_a_core_stall_is_counted_once(self, level: Level, stall_us: int) -> None:
        """At level registers up to two more loops are omitted until the sequence restarts."""
        begin = int(stall_us // HALF_PERIOD_US)
        for k in range(12):
            with Board(level=level) as board:
                board.run(0.02)
                board.advance(board.time_ns + k * PERIOD_NS // 12)
                board.inject(StalledCore(stall_us * 1e-6))
                board.run(0.01)
                late = board.read_words("late_loops")[0]
                assert begin <= late <= begin + (2 if level == "registers" else 1)

    def test_a_bad_core_speed_is_refused(self) -> None:
        with pytest.raises(ValueError, match="expected the values"):
            CoreSpeed.parse({"entry_cycles": 10})
        with pytest.raises(ValueError, match="cycles_per_instruction"):
            CoreSpeed(0.0, 30)
        with pytest.raises(ValueError, match="entry_cycles = -1"):
            CoreSpeed(1.0, -1)


class TestErrors:
    def test_use_of_unmodelled_functions_raises_an_error(self) -> None:
        with Board(level="registers") as board:
            board.run(0.005)
            with pytest.raises(ChipError, match=r"ADC GC1 = 0001h: .* \(at \d+\.\d\d us\)"):
                board.poke(ADC_GC1, 1)
            with pytest.raises(SimulationError, match="ADC GC1"):
                board.run(0.001)

    def test_error_of_one_board_does_not_stop_the_others(self) -> None:
        with Board(level="registers", seed=1) as good, Board(level="registers", seed=1) as bad:
            with pytest.raises(ChipError):
                bad.peek(0x0100)
            good.run(0.01)
            assert good.read_words("tick")[0] > 100


@pytest.mark.parametrize("seed", range(1, 7))
def test_no_encoder_edge_is_lost(seed: int) -> None:
    """The shaft oscillates about an edge during the rotor search, rests on it, and then accelerates."""
    with Board(level="registers", seed=seed) as board:
        enable(board)
        begin = [(board.truth(axis).theta_m, board.read_words(f"axis{axis + 1}.position")[0]) for axis in (0, 1)]
        move(board, {0: 3000, 1: -2000}, 0.5)
        for axis, (angle, position) in enumerate(begin):
            rotation = (board.truth(axis).theta_m - angle) * 4000 / (2 * np.pi)
            assert board.read_words(f"axis{axis + 1}.position")[0] - position == pytest.approx(rotation, abs=2.5)
