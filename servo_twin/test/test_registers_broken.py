"""The running servo with one wrong register at a time: each has the effect that it has on silicon."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from buffered_registers import poke_buffered
from servo_msgs_py.catalogue import numbers
from servo_twin.board import Board, ChipError
from servo_twin.simulation import enable
from servo_twin.validation.experiments.named_faults import faults

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


# As in chip/trace.h.
KINDS = (
    "cycle", "match", "load", "gates", "trigger", "sync", "sample", "scan_end", "enter", "leave", "write", "capture",
)  # fmt: skip


class Event(NamedTuple):
    """An event as a logic analyser on the chip would show it."""

    clock: int
    kind: str
    a: int
    b: int


def trace(board: Board, seconds: float) -> list[Event]:
    log = board.trace(board.time_ns + round(seconds * 1e9))
    return [Event(int(e["clock"]), KINDS[e["kind"]], int(e["a"]), int(e["b"])) for e in log]


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


def test_sync_compare_shifts_the_phase(board: Board) -> None:
    before = lag(trace(board, 5 * PERIOD_S))
    poke_pwm(board, PWMA, 0, VAL0, -800)
    assert lag(trace(board, 5 * PERIOD_S)) == before - 800


def test_second_carrier_drifts_without_sync(board: Board) -> None:
    board.poke(0xE35A, 0)
    board.poke(0xE35B, 0)
    events = trace(board, 20 * PERIOD_S)
    assert len(clocks(events, "cycle", 0)) == 20
    assert len(clocks(events, "cycle", 4)) <= 2  # 16 bits are 10 periods
    assert resets_by_watchdog(board)


def test_sample_compare_moves_the_sample(board: Board) -> None:
    def instant() -> int:
        events = trace(board, 3 * PERIOD_S)
        return (clocks(events, "sample", 0)[0] - clocks(events, "cycle", 0)[0]) % PERIOD

    before = instant()
    poke_pwm(board, PWMA, 1, VAL4, -HALF + 55 - 25)
    assert abs(instant() - (before - 25)) <= 5  # the converter's clock has 5


def test_late_trigger_leaves_m1_without_results(board: Board) -> None:
    poke_pwm(board, PWMA, 1, VAL4, -HALF + 400)
    assert M1 in loops(trace(board, 3 * PERIOD_S))
    assert resets_by_watchdog(board)


def test_early_interrupt_leaves_m1_without_results(board: Board) -> None:
    (tick,) = board.read_raw("tick")
    poke_pwm(board, PWMA, 1, VAL5, HALF - 300)
    board.run(0.02)
    assert board.read_raw("tick")[0] <= tick + 8
    assert resets_by_watchdog(board)


def test_without_pause_all_pairs_are_sampled_in_one_scan(board: Board) -> None:
    board.poke(SCTRL, 0)
    events = trace(board, 4 * PERIOD_S)
    trigger = clocks(events, "cycle", 0)[-2]
    window = [e for e in events if e.kind == "sample" and trigger <= e.clock < trigger + HALF and e.a < 6]
    assert [e.a for e in window] == [0, 1, 2, 3, 4, 5]
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


def test_a_full_cycle_reload_is_half_a_period_later(board: Board) -> None:
    """New duties are loaded half a period later."""

    def reload() -> int:
        board.poke(PWMA + MCTRL, LOAD_ALL)
        events = trace(board, 3 * PERIOD_S)
        return (clocks(events, "load", 0)[0] - clocks(events, "cycle", 0)[0]) % PERIOD

    assert reload() == HALF
    for submodule in range(3):
        board.poke(sm(PWMA, submodule, CTRL), 0x0400)
    assert reload() == 0


def test_a_wrong_channel_causes_a_fault_of_its_axis_only(spinning: Board) -> None:
    """The bus voltage in place of a current."""
    set_speed(spinning, 20.0)
    spinning.run(0.1)
    spinning.poke(CLIST1, (spinning.peek(CLIST1) & 0xFFF0) | 6)
    spinning.run(0.1)
    assert faults(spinning, 0)
    assert not faults(spinning, 1)


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
    assert 1 <= board.read_raw("late_loops")[0] <= 4
    assert not resets_by_watchdog(board)


def test_interrupt_disabled_in_the_controller_is_not_restored(board: Board) -> None:
    """An interrupt disabled in the interrupt controller is not enabled again by the port."""
    board.poke(0xE309, board.peek(0xE309) & ~0x0300)
    assert M1 not in loops(trace(board, 4 * PERIOD_S))
    assert resets_by_watchdog(board)


def test_locked_watchdog_cannot_be_stopped(board: Board) -> None:
    board.poke(0xE320, 0)
    assert board.peek(0xE320) == 0x0303


# ---- inverter -------------------------------------------------------------------------------------------------------


def blanking(events: list[Event]) -> set[int]:
    """Clocks for which both switches of phase a are off between two pulses."""
    changes = [e for e in events if e.kind == "gates" and e.a == 0]
    return {b.clock - a.clock for a, b in pairwise(changes) if a.b == 0}


@pytest.mark.parametrize("dead_time", [100, 250])
def test_gates_keep_the_dead_time_of_the_registers(board: Board, dead_time: int) -> None:
    for submodule in range(3):
        board.poke(sm(PWMA, submodule, DTCNT0), dead_time)
        board.poke(sm(PWMA, submodule, DTCNT1), dead_time)
    board.poke(PWMA + OUTEN, 0x0770)
    assert blanking(trace(board, 4 * PERIOD_S)) == {dead_time}


def pulses(board: Board) -> list[int]:
    """Enable phase a without dead time; return the clocks between the following changes of its gates."""
    for register in (DTCNT0, DTCNT1):
        board.poke(sm(PWMA, 0, register), 0)
    board.poke(PWMA + OUTEN, 0x0770)
    events = trace(board, 2 * PERIOD_S)
    return [b - a for a, b in pairwise(clocks(events, "gates", 0))]


def test_no_dead_time_shorts_the_bus(board: Board) -> None:
    """The comparator opens the switches after its filter of 100 ns, without software."""
    assert pulses(board) == [10]
    assert board.stats().breaks == 1
    board.run(0.005)
    assert faults(board, 0) == {"OVER_CURRENT"}
    assert board.peek(PWMA + OUTEN) == 0


def test_a_fault_that_is_not_mapped_waits_for_software(board: Board) -> None:
    board.poke(PWMA + FCTRL0, 0x1010)  # without an interrupt
    for submodule in range(3):
        board.poke(sm(PWMA, submodule, DISMAP0), 0xFF00)
    assert pulses(board)[0] > 100  # until a loop reads the flag
    assert board.peek(PWMA + FSTS0) & 1
    board.run(0.005)
    assert faults(board, 0) == {"OVER_CURRENT"}  # by polling


def test_a_wrong_fault_level_is_an_over_current_of_its_axis(board: Board) -> None:
    board.poke(PWMA + FCTRL0, 0x0011)
    board.run(0.005)
    assert faults(board, 0) == {"OVER_CURRENT"}
    assert not faults(board, 1)
    assert board.stats().breaks == 0  # the comparator has never tripped


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


def test_the_other_compare_does_not_matter(spinning: Board) -> None:
    spinning.poke(TMRA + 1, 0xF062)  # matters only when the shaft reverses
    assert abs(lost(spinning, 0.3)) < 4


def test_without_index_pulses_the_position_is_no_longer_plausible(spinning: Board) -> None:
    spinning.poke(TMRA + 0x26, 0)
    spinning.run(0.1)
    assert faults(spinning, 0) == {"ENCODER"}


def test_index_that_is_never_cleared_stops_after_one(spinning: Board) -> None:
    """OFLAG set on compare and not cleared by the B edge has one rising edge only."""
    spinning.poke(TMRA + 6, 0x80A2)
    spinning.run(0.2)
    assert faults(spinning, 0) == {"ENCODER"}


def test_time_stamps_at_twice_the_clock_halve_the_speed(spinning: Board) -> None:
    spinning.poke(TMRA + 0x16, 0x3C80)
    spinning.run(0.01)
    assert spinning.read("axis1.speed") == pytest.approx(0.5 * spinning.truth(0).omega_m, rel=0.2)


def test_without_reload_on_capture_a_slow_shaft_seems_slower(spinning: Board) -> None:
    """TMRA3 no longer measures the age of the last edge; the enhanced M/T method reports standstill."""
    set_speed(spinning, 2.0)
    spinning.run(0.3)

    def speed() -> tuple[float, float]:
        log = spinning.si(spinning.record(spinning.time_ns + 100_000_000))
        return float(np.mean(log["axis1.speed"])), float(np.mean(log["axis2.speed"]))

    before = speed()
    spinning.poke(TMRA + 0x3A, 0)
    after = speed()
    assert before[0] == pytest.approx(2.0, rel=0.2)
    assert after[0] < 0.7 * before[0]
    assert after[1] == pytest.approx(2.0, rel=0.2)


def test_filter_that_is_too_slow_hides_the_edges(spinning: Board) -> None:
    """Ten samples, 255 clocks apart: levels shorter than 25.5 us, above some 120 rad/s."""
    set_speed(spinning, 200.0)
    spinning.run(0.1)
    for channel in (0, 1):
        spinning.poke(TMRA + 0x10 * channel + 0xB, 0x07FF)
    spinning.run(0.002)
    before = spinning.peek(TMRA + 5)
    spinning.run(0.002)
    assert spinning.peek(TMRA + 5) == before
    assert spinning.truth(0).omega_m > 150.0


# ---- host and clocks ------------------------------------------------------------------------------------------------

GET_TABLE = bytes.fromhex("2B 29 01 00 6C")


def answer(board: Board) -> bytes:
    board.serial_in(GET_TABLE)
    board.run(0.01)
    return board.serial_out()


def test_a_wrong_baud_rate_gives_no_answer(board: Board) -> None:
    assert answer(board)[:1] == b"+"
    board.poke(0xE080, 0x01B2 + 30)  # 7 %
    assert answer(board)[:1] != b"+"


def test_access_without_clock_is_reported(board: Board) -> None:
    board.poke(0xE40F, 0x006E)
    with pytest.raises(ChipError, match="PWMA"):
        board.run(0.001)


def test_unmodelled_access_is_reported(board: Board) -> None:
    with pytest.raises(ChipError, match="SCTRL"):
        board.poke(SCTRL, 0x0010)
