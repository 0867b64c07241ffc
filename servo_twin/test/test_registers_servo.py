"""The whole servo on registers and switching plant: power-on, moves compared with the ideal level, reset."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from servo_msgs_py.catalogue import numbers
from servo_twin.board import Board
from servo_twin.level import Level
from servo_twin.simulation import enable

PERIOD_NS = 62_500
HALF, PERIOD = 3125, 6250  # clocks
M1, M2, START = 85, 30, 87
SAMPLE, ENTER, LEAVE, CYCLE, LOAD, GATES = 6, 8, 9, 0, 2, 3  # kinds of trace entries
COP_RESET = 0x0020
IPR_M1 = 0xE309
SPIN, STOP = 3, 2
COUNT = 2 * np.pi / 4000


@pytest.fixture
def board() -> Iterator[Board]:
    with Board(seed=7, level="registers") as board:
        yield board


@pytest.fixture
def holding(board: Board) -> Board:
    enable(board)
    return board


def of(log: NDArray[np.void], kind: int, a: int) -> NDArray[np.uint64]:
    chosen: NDArray[np.uint64] = log["clock"][(log["kind"] == kind) & (log["a"] == a)]
    return chosen


# ---- start (DRM 4.3.3) ----------------------------------------------------------------------------------------------


def test_start_sequence_runs_once_after_power_on(board: Board) -> None:
    """The start interrupt runs once, after motor 2's sampling point; the first sample is motor 1's."""
    log = board.trace(20 * PERIOD_NS)
    start = of(log, ENTER, START)
    assert start.size == 1
    order = [int(a) for a in log["a"][(log["kind"] == ENTER)] if a in (M1, M2, START)]
    assert order == [START, *[M1, M2] * 20]
    samples = log[log["kind"] == SAMPLE]
    assert samples["a"][0] == 0
    assert samples["clock"][0] > start[0]
    in_period = int(start[0] - of(log, CYCLE, 0)[of(log, CYCLE, 0) < start[0]][-1])
    assert HALF + 100 < in_period < PERIOD - 500
    assert not (log["kind"] == GATES).any()  # no switch has changed


def test_simulated_time_begins_with_the_loops(board: Board) -> None:
    assert board.time_ns == 0
    board.run(0.001)
    assert board.read("tick") == 16


def test_each_handler_ends_before_the_samples_of_the_other_motor(holding: Board) -> None:
    """F38: no handler delays the next one, which begins as soon as its samples are ready."""
    log = holding.trace(holding.time_ns + 40 * PERIOD_NS)
    begins = [of(log, ENTER, vector).astype(np.int64) for vector in (M1, M2)]
    intervals = np.diff(np.sort(np.concatenate(begins)))
    assert intervals.size > 70
    assert np.ptp(intervals[::2]) <= 4
    assert np.ptp(intervals[1::2]) <= 4
    for vector in (M1, M2):
        ends, begin = of(log, LEAVE, vector).astype(np.int64), of(log, ENTER, vector).astype(np.int64)
        lasted = [end - begin[begin < end][-1] for end in ends[ends > begin[0]]]
        assert max(lasted) < intervals.min()


# ---- moves ----------------------------------------------------------------------------------------------------------


def travel(level: Level) -> NDArray[np.void]:
    with Board(seed=7, level=level) as board:
        board.run(0.05)
        board.write("cmd.enable", [1, 1])
        board.run(0.85)
        assert [board.read(f"axis{n}.substate") for n in (1, 2)] == [SPIN, SPIN]
        start = [board.read_words(f"axis{n}.position")[0] for n in (1, 2)]
        board.write("param.features", [0x4F, 0x4F])
        for n, turns in ((1, 4), (2, -3)):
            raw = board.read_words("cmd.position")
            raw[n - 1] = start[n - 1] + 4000 * turns
            board.write_raw("cmd.position", raw)
        log = board.record(board.time_ns + 400_000_000)
        for n, turns in ((1, 4), (2, -3)):
            assert abs(int(log[f"axis{n}.position"][-1]) - start[n - 1] - 4000 * turns) <= 4
            log[f"axis{n}.position"] -= start[n - 1]
        return log


def test_moves_agree_with_the_ideal_level() -> None:
    registers, ideal = travel("registers"), travel("ideal")
    assert registers.size == ideal.size
    for n in (1, 2):
        apart = registers[f"axis{n}.position"].astype(np.int64) - ideal[f"axis{n}.position"].astype(np.int64)
        assert np.abs(apart).max() <= 40  # of a move of 16000 counts; 1 ms is 200 counts


@pytest.mark.parametrize("speed", [250.0, -250.0])
def test_measured_current_is_the_mean_current(holding: Board, speed: float) -> None:
    """Sampled in the middle of the low-side conduction; an error of 0.5 us would be 8 mA of the wrong sign."""
    holding.write("cmd.mode", [1, 1])
    holding.write("cmd.speed", [speed, speed])
    for axis in (0, 1):
        holding.set_load(axis, np.copysign(0.02, speed))
    holding.run(0.4)
    measured, true = [], []
    for _ in range(500):
        holding.advance(holding.time_ns + 3 * PERIOD_NS + 1710)
        measured.append([numbers(holding.read(f"axis{n}.i_q"))[0] for n in (1, 2)])
        true.append([holding.truth(axis).i_q for axis in (0, 1)])
    assert np.mean(measured, axis=0) == pytest.approx(np.mean(true, axis=0), abs=0.007)


def test_position_is_that_of_the_shaft(holding: Board) -> None:
    holding.write("cmd.mode", [1, 1])
    holding.write("cmd.speed", [200.0, -150.0])
    before = [(numbers(holding.read(f"axis{n}.position"))[0], holding.truth(n - 1).theta_m) for n in (1, 2)]
    holding.run(0.7)
    holding.write("cmd.speed", [0.0, 0.0])
    holding.run(0.4)
    for n, (position, theta) in zip((1, 2), before, strict=True):
        moved = numbers(holding.read(f"axis{n}.position"))[0] - position
        assert abs(moved) > 60.0
        assert moved == pytest.approx(holding.truth(n - 1).theta_m - theta, abs=3 * COUNT)


def test_no_trigger_is_ever_lost(holding: Board) -> None:
    """Full speed in both directions, all features on: the sequence never restarts."""
    holding.write("param.features", [0x4F, 0x4F])
    holding.write("cmd.mode", [1, 1])
    for speed in (300.0, -300.0):
        holding.write("cmd.speed", [speed, -speed])
        log = holding.trace(holding.time_ns + 200_000_000)
        assert of(log, ENTER, START).size == 0
        assert of(log, ENTER, M1).size == of(log, ENTER, M2).size == 3200
    assert holding.stats().breaks == 0


# ---- reset ----------------------------------------------------------------------------------------------------------


def test_servo_restarts_after_a_watchdog_reset(holding: Board) -> None:
    holding.poke(IPR_M1, holding.peek(IPR_M1) & ~0x0300)
    holding.run(0.1)
    assert holding.peek(0xE401) & COP_RESET
    watchdog = holding.catalogue.flag("faults", "WATCHDOG").mask
    assert [holding.read_words(f"axis{n}.faults") for n in (1, 2)] == [[watchdog], [watchdog]]
    assert holding.peek(0xE6C0) == holding.peek(0xE7C0) == 0  # outputs off
    holding.write("cmd.clear_faults", [1, 1])
    holding.run(0.05)
    assert [holding.read(f"axis{n}.state") for n in (1, 2)] == [STOP, STOP]
    enable(holding)
    start = holding.read_words("axis1.position")[0]
    holding.write_raw("cmd.position", [start + 1000, holding.read_words("axis2.position")[0]])
    holding.run(0.4)
    assert abs(holding.read_words("axis1.position")[0] - start - 1000) <= 4
