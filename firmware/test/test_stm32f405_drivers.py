"""Drivers of the STM32F405 port on a fake chip: values and order of register accesses, by the reference manual."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from pathlib import Path

import pytest
from firmware_compiler import CompileC
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded_accesses import INTERRUPTS, WRITE
from stm32_board import (
    BREAK,
    DBGMCU,
    DMA1,
    DMA2,
    EDGE,
    ENCODER,
    EXTI,
    FLASH,
    GPIO,
    INIT,
    IWDG,
    TIM,
    TIM2,
    TIM5_CNT,
    USART2,
    Stm32Board,
    generated,
)
from stm32_board import M1 as M1_LOOP
from stm32_board import M2 as M2_LOOP

TOP = 5250  # half a period of 16 kHz in clocks of 168 MHz
CCR = (0x34, 0x38, 0x3C, 0x40)
MOE = 1 << 15
FAULT_PIN, FAULT_LINE = 1 << 2, 1 << 2
LIMIT = 1489  # codes of 30 A


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return generated(tmp_path_factory.mktemp("odrive36"))


@pytest.fixture
def board(compile_c: CompileC, folder: Path) -> Stm32Board:
    return Stm32Board(compile_c, folder)


def background(board: Stm32Board, seconds: float = 0.0) -> None:
    board.pass_time(seconds)
    board.lib.port_background(board.hal)


def interrupted(board: Stm32Board, at: int, call: Callable[[], object], handler: Callable[[], object]) -> bool:
    """Call something that a handler interrupts once, at the place with a number; false if there are less places.

    Places are before and behind each access of a register, and at both ends of a section without interrupts.
    """
    places = done = 0

    def interrupt(_: object) -> None:
        nonlocal places, done
        if places >= at and not done:
            done = 1
            handler()
        places += 1

    callback = board.ffi.callback("void(struct chip *)", interrupt)
    board.chip.interrupt = callback
    call()
    board.chip.interrupt = board.ffi.NULL
    return bool(done)


# ---- start ---------------------------------------------------------------------------------------------------------


def test_the_start_has_the_safe_order(compile_c: CompileC, folder: Path) -> None:
    board = Stm32Board(compile_c, folder, initialised=False)
    assert board.init()
    writes = [(a, v) for kind, a, v in board.accesses if kind == WRITE]
    order = [a for a, _ in writes]
    modes = [order.index(port + 0x00) for port in GPIO.values()]
    assert max(order.index(tim + 0x44) for tim in TIM) < min(modes)  # switches open before the pins are the timers'
    assert all(not value & MOE for tim in TIM for value in board.writes_of(tim + 0x44))
    latency, switch = order.index(FLASH), len(order) - 1 - order[::-1].index(0x4002_3808)
    assert latency < switch  # wait states before the higher clock
    assert writes[switch][1] & 3 == 2
    assert board[0x4002_3804] == 0x0740_2A04  # 8 MHz / 4 x 168 / 2, 48 MHz / 7
    kinds = [a.kind for a in board.accesses]
    assert kinds.index(INTERRUPTS) == len(kinds) - 1
    calls = [c for c, _ in board.calls]
    assert calls == [INIT]
    for register in (0xE000_E100, 0xE000_E104):  # requests of the start are dropped before interrupts are enabled
        enabled = [n for n, (a, _) in enumerate(writes) if a == register]
        assert all((register + 0x180, writes[n][1]) in writes[n - 2 : n] for n in enabled)
    # The duties that the application writes before do not start a counter.
    assert all(not value & 1 for value in board.writes_of(TIM[1]))
    started = next(n for n, (a, v) in enumerate(writes) if a == TIM[0] and v & 1)
    assert writes[started - 2 : started] == [(TIM[1] + 8, 6), (TIM[0] + 4, 1 << 4)]
    iwdg = board.writes_of(IWDG)
    assert iwdg[0] == 0xCCCC
    assert iwdg[-1] == 0xAAAA
    assert (board[IWDG + 4], board[IWDG + 8]) == (0, 400)  # 50 ms of 32 kHz / 4


def test_a_pll_that_the_boot_loader_has_left_on_gets_its_settings(compile_c: CompileC, folder: Path) -> None:
    board = Stm32Board(compile_c, folder, initialised=False)
    board[0x4002_3800], board[0x4002_3804], board[0x4002_3808] = 0x030B_0083, 0x2740_1E04, 0x100A
    assert board.init()
    assert board[0x4002_3804] == 0x0740_2A04
    assert board[0x4002_3800] & 0x030B_0003 == 0x030B_0003
    assert board[0x4002_3808] & 0xFCFF == 0x940A


def test_both_carriers_are_half_a_period_apart_and_start_together(board: Stm32Board) -> None:
    for tim in TIM:
        assert board[tim + 0x2C] == TOP
        assert board[tim + 0x00] & 0xE1 == 0xE1  # centre aligned, preload, running
        assert board[tim + 0x04] == 7 << 4  # OC4REF triggers the converters
        assert board[tim + 0x08] == 0  # no slave any more
        assert board[tim + 0x44] & 0xFF == 84  # 500 ns
        assert board[tim + 0x20] == 0x555  # three pairs
    assert board[TIM[0] + 0x18] & 0x7070 == 0x6060  # PWM mode 1
    assert board[TIM[1] + 0x18] & 0x7070 == 0x7070  # PWM mode 2
    assert board[TIM[0] + CCR[3]] == TOP - 46
    assert board[TIM[1] + CCR[3]] == 46


def test_converters_have_the_channels_of_the_board(board: Stm32Board) -> None:
    adc1, adc2, adc3 = 0x4001_2000, 0x4001_2100, 0x4001_2200
    assert board[adc2 + 0x38] == 1 << 20 | 13 << 15 | 10 << 10  # JSQ3: C0, JSQ4: C3
    assert board[adc3 + 0x38] == 1 << 20 | 12 << 15 | 11 << 10
    assert board[adc2 + 0x34] == 10 << 5 | 13
    assert board[adc3 + 0x34] == 11 << 5 | 12
    assert board[adc1 + 0x38] == 2 << 20 | 4 << 15 | 15 << 10 | 6 << 5
    assert board[adc1 + 0x34] == 6
    for adc in (adc1, adc2, adc3):
        assert board[adc + 0x08] >> 16 & 0x3F == 1 << 4 | 1  # injected: rising TIM1_TRGO
        assert board[adc + 0x08] >> 24 & 0x3F == 1 << 4 | 14  # regular: rising TIM8_TRGO
    assert [board[adc + 4] >> 7 & 1 for adc in (adc1, adc2, adc3)] == [0, 1, 0]
    assert board[DMA2 + 0x10] >> 25 == 2
    assert board[DMA2 + 0x40] >> 25 == 1
    assert [board[DMA2 + stream + 0x04] for stream in (0x10, 0x40)] == [2, 2]


# ---- duties and switches -------------------------------------------------------------------------------------------


def duties(board: Stm32Board, axis: int, *duty: int) -> list[int]:
    """Clocks of half a pulse that the compare registers stand for."""
    board.lib.hal_pwm_duty(board.hal, axis, *duty)
    values = [board[TIM[axis] + ccr] for ccr in CCR[:3]]
    return values if axis == 0 else [0 if value > TOP else TOP - value for value in values]


@pytest.mark.parametrize("axis", [0, 1])
def test_a_duty_becomes_a_pulse(board: Stm32Board, axis: int) -> None:
    assert duties(board, axis, 16384, 8192, 0) == [TOP // 2, pytest.approx(TOP / 4, abs=1), 0]
    assert duties(board, axis, 32767, 32767, 32767) == [TOP, TOP - 336, TOP - 336]  # 4 us of low side in b and c
    assert duties(board, axis, 200, 300, 0) == [0, 48, 0]  # shorter than the dead time: none


@pytest.mark.parametrize("axis", [0, 1])
def test_nothing_is_loaded_while_duties_are_written(board: Stm32Board, axis: int) -> None:
    board.lib.hal_pwm_duty(board.hal, axis, 1000, 2000, 3000)
    cr1 = TIM[axis]
    assert [a for a, _ in board.writes] == [cr1, *(TIM[axis] + ccr for ccr in CCR[:3]), cr1]
    assert [value & 2 for value in board.writes_of(cr1)] == [2, 0]


@pytest.mark.parametrize(("axis", "down", "late"), [(0, True, 0), (0, False, 1), (1, True, 1), (1, False, 0)])
def test_duties_behind_the_high_side_centre_are_late(board: Stm32Board, axis: int, down: bool, late: int) -> None:
    board[TIM[axis]] = board[TIM[axis]] | 1 << 4 if down else board[TIM[axis]] & ~(1 << 4)
    board.lib.hal_pwm_duty(board.hal, axis, 1000, 2000, 3000)
    board.lib.hal_duties_done(board.hal, axis)
    assert board.lib.hal_late_loops(board.hal) == late


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("b", "c"), [(LIMIT + 1, 0), (-LIMIT - 1, 0), (0, LIMIT + 1), (800, 800), (-800, -800)])
def test_a_current_beyond_the_limit_opens_the_switches_before_the_loop(
    board: Stm32Board, axis: int, b: int, c: int
) -> None:
    for each in (0, 1):
        board.lib.hal_pwm_enable(board.hal, each, True)
    board.forget()
    board.sample(axis, 2048 + b, 2048 + c)
    assert board.calls == [(BREAK, axis), ((M1_LOOP, M2_LOOP)[axis], axis)]
    assert not board.is_on(axis)
    assert board.is_on(1 - axis)
    assert board.lib.hal_over_current_active(board.hal, axis)
    board.lib.hal_pwm_enable(board.hal, axis, True)
    assert not board.is_on(axis)
    board.lib.hal_over_current_clear(board.hal, axis)
    board.lib.hal_pwm_enable(board.hal, axis, True)
    assert board.is_on(axis)


def test_currents_and_offsets_belong_to_their_motors(board: Stm32Board) -> None:
    board.sample(0, 2100, 1900, offsets=(2051, 2047), bus=1234)
    assert board.lib.hal_adc_bus(board.hal) == 1234
    board.sample(1, 2200, 1800, offsets=(2052, 2046), bus=1235)
    read = [board.lib.hal_adc_currents(board.hal, axis) for axis in (0, 1)]
    assert [(pair.first, pair.second) for pair in read] == [(2100, 1900), (2200, 1800)]
    read = [board.lib.hal_adc_offsets(board.hal, axis) for axis in (0, 1)]
    assert [(pair.first, pair.second) for pair in read] == [(2052, 2046), (2051, 2047)]
    assert board.lib.hal_adc_bus(board.hal) == 1235
    assert [call for call, _ in board.calls] == [M1_LOOP, M2_LOOP]


def released(board: Stm32Board) -> list[bool]:
    """Holding brakes with a current."""
    return [bool(board[GPIO[port] + 0x14] >> pin & 1) for port, pin in (("C", 4), ("B", 2))]


def test_a_missing_result_keeps_the_loop_from_running(board: Stm32Board) -> None:
    for axis in (0, 1):
        board.lib.hal_pwm_enable(board.hal, axis, True)
        board.lib.hal_holding_brake(board.hal, axis, True)
    board.lib.hal_brake_resistor(board.hal, True)
    board[0x4001_2100] = 1 << 2  # only phase b is done
    for _ in range(4):
        board.lib.port_m1(board.hal)
        assert board.is_on(0)
        assert released(board) == [True, True]
        assert board[TIM2 + CCR[3]] < 4096
    board.lib.port_m1(board.hal)
    assert not board.is_on(0)
    assert not board.is_on(1)
    assert released(board) == [False, False]
    assert (board[TIM2 + CCR[3]], board[TIM2 + CCR[2]]) == (4097, 0)  # both switches of the resistor are open
    assert not board.calls


def test_a_gap_of_loops_is_counted(board: Stm32Board) -> None:
    board.chip.clocks_per_read = 0
    board.sample(0, 2048, 2048)
    board.pass_time(62.5e-6)
    board.sample(0, 2048, 2048)
    assert board.lib.hal_late_loops(board.hal) == 0
    board.pass_time(3 * 62.5e-6)
    board.sample(0, 2048, 2048)
    assert board.lib.hal_late_loops(board.hal) == 4


# ---- gate drivers --------------------------------------------------------------------------------------------------


def test_the_drivers_have_gain_80_and_latch_at_the_lowest_threshold(board: Stm32Board) -> None:
    for driver in board.chip.driver:
        assert driver[2] == 1 << 4  # OCP_MODE 1, six inputs, 0.060 V
        assert driver[3] == 3 << 2
    assert not board.lib.hal_over_current_active(board.hal, 0)


def test_single_lost_writes_do_not_matter(compile_c: CompileC, folder: Path) -> None:
    board = Stm32Board(compile_c, folder, initialised=False)
    board.chip.lost_writes = 4
    assert board.init()
    assert not board.lib.hal_over_current_active(board.hal, 0)


def fault(board: Stm32Board) -> None:
    """The line of the drivers falls."""
    board[GPIO["D"] + 0x10] &= ~FAULT_PIN
    board[EXTI + 0x14] |= FAULT_LINE
    board.lib.port_gate_fault(board.hal)


def test_a_fault_of_a_driver_opens_both_bridges_at_once(board: Stm32Board) -> None:
    for axis in (0, 1):
        board.lib.hal_pwm_enable(board.hal, axis, True)
    board.forget()
    fault(board)
    assert [a for a, _ in board.writes[:2]] == [tim + 0x44 for tim in TIM]
    assert board.calls == [(BREAK, 0), (BREAK, 1)]
    assert not board[EXTI + 0x14] & FAULT_LINE
    for axis in (0, 1):
        board.lib.hal_over_current_clear(board.hal, axis)
        assert board.lib.hal_over_current_active(board.hal, axis)  # the drivers are not ready
        board.lib.hal_pwm_enable(board.hal, axis, True)
        assert not board.is_on(axis)


def test_the_background_clears_the_drivers_and_the_application_the_latch(board: Stm32Board) -> None:
    fault(board)
    board[GPIO["D"] + 0x10] |= FAULT_PIN
    background(board, 0.03)
    assert board.lib.hal_over_current_active(board.hal, 0)  # until it is cleared
    board.lib.hal_over_current_clear(board.hal, 0)
    assert not board.lib.hal_over_current_active(board.hal, 0)
    assert board.lib.hal_over_current_active(board.hal, 1)
    assert board[GPIO["B"] + 0x14] & 1 << 12  # the enable line has stayed high


def test_a_lasting_fault_pulses_the_enable_line_and_stays_a_fault(board: Stm32Board) -> None:
    fault(board)
    board.forget()
    background(board, 0.03)
    bsrr = board.writes_of(GPIO["B"] + 0x18)
    assert bsrr == [1 << 28, 1 << 12]
    assert board.lib.hal_over_current_active(board.hal, 0)


def short_fault(board: Stm32Board) -> None:
    fault(board)
    board[GPIO["D"] + 0x10] |= FAULT_PIN


def test_a_fault_while_the_drivers_are_set_up_is_not_lost(board: Stm32Board) -> None:
    short_fault(board)
    for at in count(2):  # behind the read of the clock: the faults before are those that the attempt is to clear
        if not interrupted(board, at, lambda: background(board, 0.03), lambda: short_fault(board)):
            break
        for axis in (0, 1):
            board.lib.hal_over_current_clear(board.hal, axis)
            assert board.lib.hal_over_current_active(board.hal, axis)
    assert at > 100
    board.lib.hal_over_current_clear(board.hal, 0)
    assert not board.lib.hal_over_current_active(board.hal, 0)


def test_a_fault_while_an_over_current_is_cleared_is_not_lost(board: Stm32Board) -> None:
    lib, hal = board.lib, board.hal
    for at in count():
        board.sample(0, 2048 + LIMIT + 1, 2048)
        if not interrupted(board, at, lambda: lib.hal_over_current_clear(hal, 0), lambda: short_fault(board)):
            break
        background(board, 0.03)
        assert hal.gate == lib.GATE_READY
        assert lib.hal_over_current_active(hal, 0)
    assert at
    assert not lib.hal_over_current_active(hal, 0)


def test_drivers_that_have_not_started_keep_the_switches_open(compile_c: CompileC, folder: Path) -> None:
    board = Stm32Board(compile_c, folder, initialised=False)
    board.chip.lost_writes = 1_000_000  # no supply of the bus
    assert board.init()
    for axis in (0, 1):
        board.lib.hal_pwm_enable(board.hal, axis, True)
        assert not board.is_on(axis)


@pytest.mark.parametrize(("register", "value"), [(0, 1 << 6), (2, 0), (3, 0), (1, 1 << 7)])
def test_registers_that_a_loss_of_supply_has_changed_are_a_fault(board: Stm32Board, register: int, value: int) -> None:
    board.chip.driver[1][register] = value
    background(board, 0.05)
    assert not board[EXTI + 0x14] & FAULT_LINE  # not yet looked at
    background(board, 0.06)
    assert board[EXTI + 0x14] & FAULT_LINE


def test_the_cause_of_a_fault_is_kept_for_a_debugger(board: Stm32Board) -> None:
    board.chip.driver[1][0] = 1 << 6
    background(board, 0.11)  # reads it
    assert board[EXTI + 0x14] & FAULT_LINE
    short_fault(board)
    background(board, 0.03)
    assert board.hal.gate == board.lib.GATE_READY
    assert list(board.hal.gate_status) == [0, 1 << 6]


def test_a_low_line_without_an_edge_is_a_fault(board: Stm32Board) -> None:
    board[GPIO["D"] + 0x10] &= ~FAULT_PIN
    background(board)
    assert board[EXTI + 0x14] & FAULT_LINE


# ---- pins ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("axis", [0, 1])
def test_an_open_enable_input_opens_its_bridge_until_it_is_armed_again(board: Stm32Board, axis: int) -> None:
    idr, lib, hal = GPIO["A"] + 0x10, board.lib, board.hal
    board[idr] = 0
    lib.hal_enable_input(hal, axis, True)
    lib.hal_pwm_enable(hal, axis, True)
    assert lib.hal_inputs(hal, axis) & 8
    (lib.port_enable_1, lib.port_enable_2)[axis](hal)
    assert not board.is_on(axis)
    assert not lib.hal_inputs(hal, axis) & 8  # although it is closed again
    lib.hal_pwm_enable(hal, axis, True)
    assert not board.is_on(axis)
    board[idr] = 1 << axis
    lib.hal_enable_input(hal, axis, True)
    lib.hal_pwm_enable(hal, axis, True)
    assert not board.is_on(axis)
    board[idr] = 0
    lib.hal_enable_input(hal, axis, True)
    lib.hal_pwm_enable(hal, axis, True)
    assert board.is_on(axis)


def test_an_enable_input_that_is_not_used_does_nothing(board: Stm32Board) -> None:
    board.lib.hal_pwm_enable(board.hal, 0, True)
    board.lib.port_enable_1(board.hal)
    assert board.is_on(0)


@pytest.mark.parametrize(("axis", "pin"), [(0, 9), (1, 15)])
def test_home_switches_are_closed_to_ground_and_limits_read_as_reached(board: Stm32Board, axis: int, pin: int) -> None:
    board[GPIO["C"] + 0x10] = 0xFFFF
    assert board.lib.hal_inputs(board.hal, axis) & 7 == 6
    board[GPIO["C"] + 0x10] = 0xFFFF & ~(1 << pin)
    assert board.lib.hal_inputs(board.hal, axis) & 7 == 7
    assert board[GPIO["C"] + 0x0C] >> 2 * pin & 3 == 1  # pulled up


@pytest.mark.parametrize(("axis", "port", "pin"), [(0, "C", 4), (1, "B", 2)])
def test_holding_brakes_are_closed_after_the_start(board: Stm32Board, axis: int, port: str, pin: int) -> None:
    assert board[GPIO[port]] >> 2 * pin & 3 == 1
    assert not board[GPIO[port] + 0x14] & 1 << pin
    board.lib.hal_holding_brake(board.hal, axis, True)
    assert board[GPIO[port] + 0x14] & 1 << pin


def test_the_debugger_keeps_its_pins(board: Stm32Board) -> None:
    assert board[GPIO["A"]] >> 26 & 0xF == 0xA  # A13, A14


# ---- brake resistor ------------------------------------------------------------------------------------------------


def test_the_brake_half_bridge_never_has_both_switches_on(board: Stm32Board) -> None:
    def low_and_high(at: int) -> tuple[bool, bool]:
        return at < board[TIM2 + CCR[2]], at >= board[TIM2 + CCR[3]]

    def check() -> None:
        for at in range(4097):
            assert low_and_high(at) != (True, True)

    assert low_and_high(4096) == (True, False)  # off: the bootstrap is charged
    for on in (True, False):
        board.forget()
        board.lib.hal_brake_resistor(board.hal, on)
        first, second, *rest = [(a, v) for a, v in board.writes if a >= TIM2]
        assert first == (TIM2 + CCR[3], 4097)
        assert second == (TIM2 + CCR[2], 0)
        kinds = [a.address for a in board.accesses]
        assert kinds[4] == TIM5_CNT  # the dead time, before the next switch
        assert rest
        check()
        board.forget()
        board.lib.hal_brake_resistor(board.hal, on)
        assert not board.accesses
    board.lib.hal_brake_resistor(board.hal, True)
    high = sum(low_and_high(at)[1] for at in range(4096)) / 4096
    assert high == pytest.approx(0.95, abs=0.002)
    assert board[TIM2 + CCR[3]] - board[TIM2 + CCR[2]] == 42  # 500 ns


def test_a_halt_by_a_debugger_does_not_keep_the_resistor_on(board: Stm32Board) -> None:
    tim5, iwdg, carriers = 1 << 3, 1 << 12, 1 << 0 | 1 << 1
    assert (board[DBGMCU + 0x08], board[DBGMCU + 0x0C]) == (tim5 | iwdg, carriers)
    board.lib.hal_brake_resistor(board.hal, True)
    order = [a for a, _ in board.writes]
    assert (board[DBGMCU + 0x08], board[DBGMCU + 0x0C]) == (tim5, carriers)
    assert order.index(DBGMCU + 0x08) < len(order) - 1 - order[::-1].index(TIM2 + CCR[3])  # before the switch closes
    board.forget()
    board.lib.hal_brake_resistor(board.hal, False)
    order = [a for a, _ in board.writes]
    assert board[DBGMCU + 0x08] == tim5 | iwdg
    assert order.index(TIM2 + CCR[3]) < order.index(DBGMCU + 0x08)


def test_monitor_outputs(board: Stm32Board) -> None:
    board.lib.hal_analog_out(board.hal, 0, 65535)
    board.lib.hal_analog_out(board.hal, 1, 16384)
    assert [board[TIM2 + ccr] for ccr in CCR[:2]] == [4095, 1024]


# ---- encoders ------------------------------------------------------------------------------------------------------


class DscCounter:
    """The quadrature counter of the DSC: reload behind the last count in either direction."""

    def __init__(self, period: int) -> None:
        self.period, self.count, self.index = period, 0, 0

    def move(self, steps: int) -> None:
        self.count += steps
        if abs(self.count) >= self.period:
            self.count -= self.period if steps > 0 else -self.period
            self.index += 1


@given(
    period=st.sampled_from([400, 4000, 32768]),
    start=st.integers(0, 0xFFFF),
    steps=st.lists(st.integers(-399, 399), max_size=200),
)
@settings(max_examples=60, deadline=None)
def test_counts_and_index_pulses_are_those_of_the_dsc(
    encoder_board: Stm32Board, period: int, start: int, steps: list[int]
) -> None:
    board, raw = encoder_board, start
    board[ENCODER[0] + 0x24] = raw
    board.lib.hal_encoder_start(board.hal, 0, period)
    before, model = board.lib.hal_index_count(board.hal, 0), DscCounter(period)
    for step in steps:
        raw = (raw + step) & 0xFFFF
        board[ENCODER[0] + 0x24] = raw
        model.move(step)
        assert board.lib.hal_encoder_count(board.hal, 0) == model.count & 0xFFFF
        assert (board.lib.hal_index_count(board.hal, 0) - before) & 0xFFFF == model.index & 0xFFFF


@pytest.fixture(scope="module")
def encoder_board(compile_c: CompileC, folder: Path) -> Stm32Board:
    return Stm32Board(compile_c, folder)


def edge(board: Stm32Board, axis: int, raw: int, clock: int) -> None:
    """Edge of channel B, if its line is open: the time is that of the interrupt."""
    line = 1 << (5, 7)[axis]
    if board[EXTI] & line:
        board[ENCODER[axis] + 0x24], board.clock = raw, clock
        board[EXTI + 0x14] |= line
        board.lib.port_stamp(board.hal)


@pytest.mark.parametrize("axis", [0, 1])
def test_the_first_edge_behind_the_arming_is_captured(board: Stm32Board, axis: int) -> None:
    board.lib.hal_encoder_start(board.hal, axis, 4000)
    capture = board.ffi.new("edge_capture_t *")
    assert not board.lib.hal_capture_take(board.hal, axis, capture)
    board.lib.hal_capture_arm(board.hal, axis)
    edge(board, axis, raw=0xFFFE, clock=0x1234_5678)
    edge(board, axis, raw=0xFFF0, clock=0x2234_5678)
    board[ENCODER[axis] + 0x24] = 0xFFE0
    assert board.lib.hal_capture_take(board.hal, axis, capture)
    assert (capture.count, capture.time) == (0xFFFE, 0x1234_5678 >> 8 & 0xFFFF)
    assert not board.lib.hal_capture_take(board.hal, axis, capture)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_pulse_that_the_timer_does_not_count_is_no_edge(board: Stm32Board, axis: int) -> None:
    capture = board.ffi.new("edge_capture_t *")
    board.lib.hal_encoder_start(board.hal, axis, 4000)
    board.lib.hal_capture_arm(board.hal, axis)
    for clock in (512, 768):
        edge(board, axis, raw=0, clock=clock)
        assert not board[EXTI + 0x14] & 3 << 14
        assert not board[EXTI] & 1 << (5, 7)[axis]  # further pulses do not interrupt
        board.sample(axis, 2048, 2048)
        assert board[EXTI] & 1 << (5, 7)[axis]
    edge(board, axis, raw=1, clock=1024)
    assert board.lib.hal_capture_take(board.hal, axis, capture)
    assert (capture.count, capture.time) == (1, 4)


@pytest.mark.parametrize("axis", [0, 1])
def test_an_edge_calls_the_application_below_the_loops(board: Stm32Board, axis: int) -> None:
    board.lib.hal_capture_arm(board.hal, axis)
    edge(board, axis, raw=3, clock=512)
    assert not board.calls
    board.chip.takes_edge = True
    board.lib.port_edge(board.hal)
    assert board.calls == [(EDGE, axis)]
    assert (board.chip.taken.count, board.chip.taken.time) == (3, 2)
    assert not board[EXTI + 0x14] & 3 << 14


def test_the_age_of_an_edge_stays_too_long_when_the_clocks_begin_anew(board: Stm32Board) -> None:
    board.chip.clocks_per_read = 0
    lib, hal = board.lib, board.hal
    assert lib.hal_edge_age(hal, 0) == 0x10000  # none yet
    lib.hal_capture_arm(hal, 0)
    edge(board, 0, raw=1, clock=1000)
    board.clock = 1000 + 256 * 0xFFFF
    assert lib.hal_edge_age(hal, 0) == 0xFFFF
    board.clock = 1000 + 256 * 0x10000
    assert lib.hal_edge_age(hal, 0) == 0x10000
    board.clock = 2**32 + 1002  # 25 s later
    assert lib.hal_edge_age(hal, 0) == 0x10000
    lib.hal_capture_arm(hal, 0)
    edge(board, 0, raw=2, clock=2000)
    assert lib.hal_edge_age(hal, 0) == 0


def test_an_edge_during_the_reads_of_the_age_makes_no_age_too_long(board: Stm32Board) -> None:
    board.chip.clocks_per_read = 0
    lib, hal, ages = board.lib, board.hal, list[int]()
    for at in count():
        for age in (100, 0):
            lib.hal_capture_arm(hal, 0)
            edge(board, 0, raw=age, clock=256 * (1000 - age))
        lib.hal_capture_arm(hal, 0)
        board.clock = 256 * 1100
        if not interrupted(
            board,
            at,
            lambda: ages.append(lib.hal_edge_age(hal, 0)),
            lambda: edge(board, 0, raw=200, clock=256 * 1103),
        ):
            break
        assert ages[-1] <= 103
        assert lib.hal_edge_age(hal, 0) <= 3
    assert at


def test_a_loop_that_interrupts_the_edge_handler_takes_the_edge_or_finds_none(board: Stm32Board) -> None:
    lib, hal = board.lib, board.hal
    capture, taken = board.ffi.new("edge_capture_t *"), list[bool]()

    def loop() -> None:
        taken.append(lib.hal_capture_take(hal, 0, capture))
        lib.hal_capture_arm(hal, 0)

    for at in count():
        taken.clear()
        lib.hal_capture_arm(hal, 0)
        edge(board, 0, raw=3, clock=512)
        if not interrupted(board, at, lambda: taken.append(lib.hal_capture_take(hal, 0, capture)), loop):
            break
        assert sorted(taken) == [False, True]
        edge(board, 0, raw=5, clock=1024)
        assert lib.hal_capture_take(hal, 0, capture)
        assert (capture.count, capture.time) == (5, 4)
    assert at


def test_an_edge_of_the_other_axis_during_arming_is_not_captured_twice(board: Stm32Board) -> None:
    board.lib.hal_capture_arm(board.hal, 1)
    edge(board, 1, raw=7, clock=256)
    board[EXTI] |= 1 << 7  # as an interrupted change of the mask leaves it
    edge(board, 1, raw=9, clock=512)
    assert not board[EXTI] & 1 << 7
    capture = board.ffi.new("edge_capture_t *")
    assert board.lib.hal_capture_take(board.hal, 1, capture)
    assert (capture.count, capture.time) == (7, 1)


# ---- serial line ---------------------------------------------------------------------------------------------------


def receive(board: Stm32Board, data: bytes, at: int) -> int:
    """DMA writes received bytes from a place of the ring on; returns the next place."""
    for byte in data:
        board.hal.dma.receive[at] = byte
        at += 1
        if at == 256:
            at = 0
            board[DMA1 + 4] |= 1 << 11  # transfer complete of stream 5
    board[DMA1 + 0x14 + 0x18 * 5] = 256 - at
    return at


def taken(board: Stm32Board) -> bytes:
    byte, data = board.ffi.new("uint8_t *"), bytearray()
    while board.lib.hal_serial_get(board.hal, byte):
        data.append(byte[0])
    return bytes(data)


def test_received_bytes_come_in_order_over_the_end_of_the_ring(board: Stm32Board) -> None:
    at, data = 0, bytes(range(256)) * 4
    for begin in range(0, len(data), 100):
        at = receive(board, data[begin : begin + 100], at)
        assert taken(board) == data[begin : begin + 100]
    assert board.lib.hal_receiver_overruns(board.hal) == 0


def test_bytes_lost_in_the_ring_are_counted(board: Stm32Board) -> None:
    at = receive(board, bytes(100), 0)
    taken(board)
    receive(board, bytes(300), at)
    assert taken(board) == b""
    assert board.lib.hal_receiver_overruns(board.hal) == 300


def test_an_overrun_of_the_interface_is_counted_and_cleared(board: Stm32Board) -> None:
    board[USART2] = 1 << 3
    board.forget()
    taken(board)
    assert board.lib.hal_receiver_overruns(board.hal) == 1
    assert [a.address for a in board.accesses][-2:] == [USART2, USART2 + 4]  # status, then data


def test_sent_bytes_leave_in_order_in_transfers_up_to_the_end_of_the_ring(board: Stm32Board) -> None:
    stream, wire, sent = DMA1 + 0x10 + 0x18 * 6, bytearray(), bytes(range(256)) * 3
    base = int(board.ffi.cast("uintptr_t", board.hal.dma.transmit)) & 0xFFFF_FFFF
    todo = list(sent)
    while len(wire) < len(sent):
        while todo and board.lib.hal_serial_put(board.hal, todo[0]):
            todo.pop(0)
        board.lib.serial_service(board.hal)
        if not board[stream] & 1:  # it has only noted the end of the last transfer
            continue
        begin, size = board[stream + 0x0C] - base, board[stream + 4]
        assert 0 < size <= 256 - begin
        board.lib.serial_service(board.hal)  # still busy: no change
        wire += bytes(board.hal.dma.transmit[begin + i] for i in range(size))
        board[stream] &= ~1
    assert wire == sent


@pytest.mark.parametrize(
    ("baud", "divider"), [(0, 0x16D), (115200, 0x16D), (1_000_000, 0x2A), (2_000_000, 0x15), (9_000_000, 0x15)]
)
def test_baud_rates(compile_c: CompileC, folder: Path, baud: int, divider: int) -> None:
    board = Stm32Board(compile_c, folder, initialised=False)
    board.hal.baud = baud
    assert board.init()
    assert board[USART2 + 8] == divider


# ---- flash ---------------------------------------------------------------------------------------------------------


def test_an_erase_and_a_word(board: Stm32Board) -> None:
    lib, hal = board.lib, board.hal
    lib.hal_flash_erase(hal, 1)
    assert board.writes_of(FLASH + 4) == [0x4567_0123, 0xCDEF_89AB]
    assert board.writes_of(FLASH + 0x10) == [2 << 8 | 2 << 3 | 2, 1 << 16 | 2 << 8 | 2 << 3 | 2]  # sector 2, 32 bits
    assert lib.hal_flash_result(hal) == lib.HAL_FLASH_BUSY
    assert board.writes_of(FLASH + 0x10)[-1] & 1 << 16  # not touched while it is busy
    board[FLASH + 0x0C] = 0
    assert lib.hal_flash_result(hal) == lib.HAL_FLASH_DONE
    assert board[FLASH + 0x10] == 1 << 31
    board.forget()
    assert lib.hal_flash_result(hal) == lib.HAL_FLASH_DONE  # asked again
    assert not board.writes
    board.forget()
    lib.hal_flash_program(hal, 4096, 0xDEAD_BEEF)
    assert board.writes[-2:] == [(FLASH + 0x10, 2 << 8 | 1), (0x0800_8000, 0xDEAD_BEEF)]
    assert lib.hal_flash_read(hal, 4096) == 0xDEAD_BEEF
    board[FLASH + 0x0C] = 1 << 4
    assert lib.hal_flash_result(hal) == lib.HAL_FLASH_FAILED
