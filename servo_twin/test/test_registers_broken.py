"""The running servo with one wrong register at a time: each has the effect that it has on silicon."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise

import numpy as np
import pytest
from buffered_registers import poke_buffered
from chip_events import Event, event
from servo_msgs_py.board_port import active
from servo_msgs_py.catalogue import numbers
from servo_twin.board import Board
from servo_twin.simulation import enable

HALF = 3125  # clocks of half a PWM period
PERIOD = 2 * HALF
PERIOD_S = 62.5e-6
M1, M2, START = 85, 30, 87
COP_RESET = 0x0020

PWMA, PWMB = 0xE600, 0xE700
INIT, CTRL, VAL0, VAL4, VAL5, INTEN, TCTRL, DISMAP0, DTCNT0, DTCNT1 = 1, 3, 5, 0xD, 0xF, 0x13, 0x15, 0x16, 0x18, 0x19
OUTEN, MCTRL, FCTRL0, FSTS0 = 0xC0, 0xC4, 0xC6, 0xC7
LOAD_ALL = 0x0707
TMRA = 0xE140
ADC_CTRL1, ADC_CTRL2, CLIST1, SDIS, RDY, SCTRL = 0xE500, 0xE501, 0xE504, 0xE508, 0xE50A, 0xE552
RSTAT = 0xE401


def trace(board: Board, seconds: float) -> list[Event]:
    log = board.trace(board.time_ns + round(seconds * 1e9))
    return [event(*e.tolist()) for e in log]


def sm(module: int, submodule: int, register: int) -> int:
    return module + 0x30 * submodule + register


@pytest.fixture
def board() -> Iterator[Board]:
    """Running loops, outputs off."""
    with Board(seed=5, level="registers") as board:
        board.run(0.005)
        yield board


@pytest.fixture
def spinning() -> Iterator[Board]:
    """Both axes under control, 100 rad/s."""
    with Board(seed=5, level="registers") as board:
        enable(board)
        set_speed(board, 100.0)
        board.run(0.15)
        yield board


def set_speed(board: Board, speed: float) -> None:
    board.write("cmd.mode", [1, 1])
    board.write("cmd.speed", [speed, speed])


def clocks(events: Iterable[Event], kind: str, a: int, b: int | None = None) -> list[int]:
    return [e.clock for e in events if e.kind == kind and e.a == a and b in (None, e.b)]


def poke_pwm(board: Board, module: int, submodule: int, register: int, value: int) -> None:
    """Write a buffered register; the value is effective after the next reload."""
    poke_buffered(board, sm(module, submodule, register), value)
    board.poke(module + MCTRL, LOAD_ALL)
    board.run(2 * PERIOD_S)


def loops(events: Iterable[Event]) -> list[int]:
    """Vectors of the loops and the start interrupt, in the order of their runs."""
    return [e.a for e in events if e.kind == "enter" and e.a in (M1, M2, START)]


def lag(events: list[Event]) -> int:
    """Clocks from the beginning of PWMA's period to that of PWMB's."""
    first, second = clocks(events, "cycle", 0)[1], clocks(events, "cycle", 4)[1]
    return (second - first) % PERIOD


def resets_by_watchdog(board: Board) -> bool:
    board.run(0.06)
    return bool(board.peek(RSTAT) & COP_RESET)


# ---- as it should be ------------------------------------------------------------------------------------------------


def test_loops_run_on_time_with_correct_registers(board: Board) -> None:
    events = trace(board, 10 * PERIOD_S)
    assert abs(lag(events) - HALF) <= 3
    assert loops(events) in ([M1, M2] * 10, [M2, M1] * 10)
    assert not resets_by_watchdog(board)


# ---- carriers and sampling ------------------------------------------------------------------------------------------


def test_late_trigger_leaves_m1_without_results(board: Board) -> None:
    poke_pwm(board, PWMA, 1, VAL4, -HALF + 400)
    assert M1 in loops(trace(board, 3 * PERIOD_S))
    assert resets_by_watchdog(board)


def test_early_interrupt_leaves_m1_without_results(board: Board) -> None:
    (tick,) = board.read_words("tick")
    poke_pwm(board, PWMA, 1, VAL5, HALF - 300)
    board.run(0.02)
    assert board.read_words("tick")[0] <= tick + 8
    assert resets_by_watchdog(board)


def test_too_few_pairs_end_in_a_watchdog_reset(board: Board) -> None:
    board.poke(SDIS, 0xF0F0)
    assert {e.a for e in trace(board, 2 * PERIOD_S) if e.kind == "sample"} <= {0, 1, 2, 3, 8, 9, 10, 11}
    assert resets_by_watchdog(board)


@pytest.mark.parametrize("term", [0x00DF, 0x7F00])
def test_trigger_of_one_motor_only_ends_in_a_watchdog_reset(board: Board, term: int) -> None:
    board.poke(0xE380, term)
    assert resets_by_watchdog(board)


def test_wrong_converter_clock_is_corrected(board: Board) -> None:
    """The sample interval is four times as long; M1 detects the unfinished scan and restarts with the right divider."""
    board.poke(ADC_CTRL2, 0x0053)
    events = trace(board, 3 * PERIOD_S)
    samples = [e.clock for e in events if e.kind == "sample" and e.a < 8]
    apart = {b - a for a, b in pairwise(samples)}
    assert 120 in apart
    assert START in loops(events)
    assert board.peek(ADC_CTRL2) == 0x0044
    assert not resets_by_watchdog(board)


def test_a_wrong_channel_causes_a_fault_of_its_axis_only(spinning: Board) -> None:
    """The bus voltage in place of a current."""
    set_speed(spinning, 20.0)
    spinning.run(0.1)
    spinning.poke(CLIST1, (spinning.peek(CLIST1) & 0xFFF0) | 6)
    spinning.run(0.1)
    assert active(spinning, 0)
    assert not active(spinning, 1)


# ---- interrupts -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("register", "value"),
    [(sm(PWMA, 1, INTEN), 0), (sm(PWMA, 1, TCTRL), 0), (sm(PWMB, 0, TCTRL), 0), (ADC_CTRL1, 0x1005)],
)
def test_a_lost_interrupt_or_trigger_restarts_the_sequence_without_a_reset(
    board: Board, register: int, value: int
) -> None:
    board.poke(register, value)
    order = loops(trace(board, 12 * PERIOD_S))
    assert order.count(START) == 1
    after = order[order.index(START) + 1 :]
    assert after[0] == M1
    assert after in ([M1, M2] * (len(after) // 2), [*[M1, M2] * (len(after) // 2), M1])
    assert len(after) >= 14
    board.run(0.002)
    assert 1 <= board.read_words("late_loops")[0] <= 4
    assert not resets_by_watchdog(board)


def test_interrupt_disabled_in_the_controller_is_not_restored(board: Board) -> None:
    """An interrupt disabled in the interrupt controller is not enabled again by the port."""
    board.poke(0xE309, board.peek(0xE309) & ~0x0300)
    assert M1 not in loops(trace(board, 4 * PERIOD_S))
    assert resets_by_watchdog(board)


# ---- encoder timers -------------------------------------------------------------------------------------------------


def lost(board: Board, seconds: float) -> float:
    """Counts of axis 1 that are missing relative to the shaft."""
    (position,), theta = numbers(board.read("axis1.position")), board.truth(0).theta_m
    board.run(seconds)
    count = 2.0 * np.pi / 4000.0
    moved = board.truth(0).theta_m - theta
    return float((moved - (numbers(board.read("axis1.position"))[0] - position)) / count)


@pytest.mark.parametrize(("speed", "comp1", "comp2"), [(100.0, 0x0F9E, 0xF061), (-100.0, 0x0F9F, 0xF062)])
def test_wrong_compare_loses_a_count_per_turn(spinning: Board, speed: float, comp1: int, comp2: int) -> None:
    set_speed(spinning, speed)
    spinning.run(0.2)
    assert abs(lost(spinning, 0.1)) < 4
    spinning.poke(TMRA, comp1)
    spinning.poke(TMRA + 1, comp2)
    turns = speed * 0.4 / (2 * np.pi)
    assert lost(spinning, 0.4) == pytest.approx(-turns, abs=4)


def test_without_index_pulses_the_position_is_no_longer_plausible(spinning: Board) -> None:
    spinning.poke(TMRA + 0x26, 0)
    spinning.run(0.1)
    assert active(spinning, 0) == {"ENCODER"}
