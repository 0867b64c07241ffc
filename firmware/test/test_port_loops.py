"""Interrupts of the MC56F84789 port: start sequence, both loops, over-current; ADC and PWM of hal.h."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from port_board import BREAK, M1, M2, PWM, FakeBoard
from recorded_accesses import READ, SERVO, WRITE

START, ISR_M1, ISR_M2, FAULT = 87, 85, 30, (77, 63)
FIRST, SECOND = 0x0707, 0x3838
TAKEN = 0x0105 | 0x0828  # currents and bus; the others are read where they are used
RDY = 0xE50A
TIME_STAMP = 0xE155  # counter of channel 1 of TMRA


def servo_calls(board: FakeBoard) -> list[tuple[int, int]]:
    return [(a.address, a.value) for a in board.accesses if a.kind == SERVO]


def run_m1(board: FakeBoard, codes: dict[int, int] | None = None) -> None:
    board.results(FIRST, codes or {})
    board.isr(ISR_M1)


def run_m2(board: FakeBoard, codes: dict[int, int] | None = None) -> None:
    board.results(SECOND, codes or {})
    board.isr(ISR_M2)


# ---- start (DRM 4.3.3) ----------------------------------------------------------------------------------------------


def test_start_sequence_in_the_order_of_the_reference(board: FakeBoard) -> None:
    board.isr(START)
    assert board.writes == [
        (0xE642, 0x0020),  # clear SM1 VAL5's flag
        (0xE645, 0x0010),  # its VAL4 triggers
        (0xE643, 0x0020),  # its VAL5 interrupts
        (0xE715, 0x0010),  # PWMB SM0's VAL4 triggers
        (0xE612, 0x0020),  # clear the flag of the start interrupt
        (0xE613, 0x0000),  # and disable it
    ]


# ---- t1 and t3 ------------------------------------------------------------------------------------------------------


def test_m1_clears_its_flag_and_calls_the_loop_once(board: FakeBoard) -> None:
    board[0xE642] = 0x0020
    run_m1(board)
    assert board[0xE642] == 0
    assert servo_calls(board) == [(M1, 0)]
    assert not board[RDY] & TAKEN


def test_m2_calls_the_loop_and_clears_the_end_of_scan_last(board: FakeBoard) -> None:
    board[0xE509] = 0x0800
    run_m2(board)
    kinds = [(a.kind, a.address) for a in board.accesses]
    assert kinds.index((SERVO, M2)) < kinds.index((WRITE, 0xE509))
    assert board[0xE509] == 0
    assert not board[RDY] & TAKEN


@pytest.mark.parametrize(("run", "pin"), [(run_m1, 0x0040), (run_m2, 0x0080)])
def test_scope_pin_is_high_for_the_length_of_the_handler(
    board: FakeBoard, run: Callable[[FakeBoard], None], pin: int
) -> None:
    run(board)
    assert board.writes[0] == (0xE251, pin)
    assert board.writes[-1] == (0xE251, 0)


# Results of the six pairs: converter A, converter B.
CODES = {pair: 100 + pair for pair in range(6)} | {8 + pair: 200 + pair for pair in range(6)}


def test_results_of_the_first_half_are_read(board: FakeBoard) -> None:
    run_m1(board, CODES)
    currents, offsets = board.lib.hal_adc_currents(board.hal, 0), board.lib.hal_adc_offsets(board.hal, 1)
    assert (currents.first, currents.second) == (100, 200)
    assert (offsets.first, offsets.second) == (101, 201)
    assert board.lib.hal_adc_bus(board.hal) == 102


def test_results_of_the_second_half_are_read(board: FakeBoard) -> None:
    run_m2(board, CODES)
    currents, offsets = board.lib.hal_adc_currents(board.hal, 1), board.lib.hal_adc_offsets(board.hal, 0)
    assert (currents.first, currents.second) == (103, 203)
    assert (offsets.first, offsets.second) == (104, 204)
    assert board.lib.hal_adc_bus(board.hal) == 105


def test_codes_have_12_bits_without_sign(board: FakeBoard) -> None:
    run_m1(board, {0: 4095, 8: 0, 2: 0x1FFF})  # the last one with the sign bit set
    currents = board.lib.hal_adc_currents(board.hal, 0)
    assert (currents.first, currents.second) == (4095, 0)
    assert board.lib.hal_adc_bus(board.hal) == 4095


# Phase of each channel code: ANA0 1 4 5 and ANB0 1 4 5.
PHASE = {0: "a", 1: "b", 8: "b", 9: "c", 4: "a", 5: "b", 12: "b", 13: "c"}


@pytest.mark.parametrize(("pair", "phases"), [(0, "ab"), (1, "bc"), (2, "ca")])
@pytest.mark.parametrize("axis", [0, 1])
def test_every_selected_phase_is_sampled(board: FakeBoard, axis: int, pair: int, phases: str) -> None:
    """Every selected phase is returned in the order of hal.h, by either converter."""
    board.lib.hal_adc_select(board.hal, axis, pair)
    lists = [board[0xE504 + n] for n in range(4)]
    channel = {n: lists[n // 4] >> 4 * (n % 4) & 0xF for n in range(16)}
    # Each converter has its own channels.
    assert all(channel[n] < 8 for n in range(6))
    assert all(channel[n] >= 8 for n in range(8, 14))
    assert (channel[2], channel[5]) == (6, 6)
    own = range(8) if axis == 0 else range(4, 16)
    codes = {n: ord(PHASE.get(channel[n], "-")) for n in range(16)}
    run_m1(board, codes)
    run_m2(board, codes)
    for reading in (board.lib.hal_adc_currents(board.hal, axis), board.lib.hal_adc_offsets(board.hal, axis)):
        assert chr(reading.first) + chr(reading.second) == phases
    other = board.lib.hal_adc_currents(board.hal, 1 - axis)
    assert chr(other.first) + chr(other.second) == "ab"
    currents = (0, 8) if axis == 0 else (3, 11)
    assert all((channel[n] % 8 in own) == (n in currents or axis == 0) for n in currents)


def test_motors_have_different_channels(board: FakeBoard) -> None:
    seen: dict[int, set[int]] = {0: set(), 1: set()}
    for pair in range(3):
        for axis, samples in ((0, (0, 4, 8, 12)), (1, (1, 3, 9, 11))):
            board.lib.hal_adc_select(board.hal, axis, pair)
            seen[axis] |= {board[0xE504 + n // 4] >> 4 * (n % 4) & 0xF for n in samples}
    assert seen == {0: {0, 1, 8, 9}, 1: {4, 5, 12, 13}}


def test_selecting_the_same_pair_again_causes_no_access(board: FakeBoard) -> None:
    board.lib.hal_adc_select(board.hal, 0, 2)
    board.forget()
    board.lib.hal_adc_select(board.hal, 0, 2)
    assert board.accesses == []


# ---- a lost trigger -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("vector", "ready"),
    [(ISR_M1, ready) for ready in (0, SECOND, FIRST | SECOND, 0x0303)]
    + [(ISR_M2, ready) for ready in (0, FIRST, FIRST | SECOND, 0x3830)],
)
def test_a_wrong_scan_restarts_the_sequence(board: FakeBoard, vector: int, ready: int) -> None:
    board.lib.hal_pwm_enable(board.hal, 0, True)
    board.isr(START)
    board[0xE612] = 0x0020  # VAL5 of SM0 has matched in every period
    board[0xE509] = 0x0800
    board.results(ready, {})
    board.isr(vector)
    assert servo_calls(board) == []
    assert (board[0xE645], board[0xE643], board[0xE715]) == (0, 0, 0)  # triggers and M1 off
    assert board[0xE613] == 0x0020  # the start interrupt is enabled again
    assert board[0xE612] == 0  # for the next match
    assert board.writes_of(0xE500) == [0x5005, 0x1805]
    assert board.writes_of(0xE501) == [0x4044, 0x0044]
    assert not board[0xE509]
    assert not board[RDY] & 0x3F3F
    assert board[0xE6C0] == 0x0770  # the outputs stay on


def test_repeated_wrong_scans_open_the_switches(board: FakeBoard) -> None:
    for axis in (0, 1):
        board.lib.hal_pwm_enable(board.hal, axis, True)
    for _ in range(5):
        assert board[0xE6C0] == board[0xE7C0] == 0x0770
        run_m1(board)
        run_m2(board)  # some scans are valid
        board.results(0, {})
        board.isr(ISR_M1)
    assert board[0xE6C0] == board[0xE7C0] == 0
    assert board[0xE613] == board[0xE643] == 0  # no loops: the watchdog is not serviced


def test_rare_wrong_scans_are_tolerated(board: FakeBoard) -> None:
    board.lib.hal_pwm_enable(board.hal, 0, True)
    for _ in range(8):
        board.results(0, {})
        board.isr(ISR_M1)
        for _ in range(64):
            run_m1(board)
            run_m2(board)
    assert board[0xE6C0] == 0x0770


# ---- omitted loops -------------------------------------------------------------------------------------------------

PERIOD_STAMPS = 6250 / 128


@pytest.mark.parametrize(
    ("periods", "m2_runs", "pairs"),
    [
        (1, 1, 0),
        (1, 0, 0),  # an omitted M2 is detected by servo.c
        (2, 2, 0),  # and an omitted M1
        (2, 1, 1),
        (2, 0, 1),
        (3, 2, 1),
        (3, 1, 2),
        (640, 1, 639),
    ],
)
def test_pairs_of_omitted_loops_are_counted(board: FakeBoard, periods: int, m2_runs: int, pairs: int) -> None:
    """The next M1 runs `periods` after the last one, 0.3 periods early or late."""
    now = 65500.0
    board[TIME_STAMP] = round(now)
    run_m1(board)
    for early in (0.0, -0.3, 0.3):
        before = board.lib.hal_late_loops(board.hal)
        for _ in range(m2_runs):
            run_m2(board)
        now += (periods + early) * PERIOD_STAMPS
        board[TIME_STAMP] = round(now) & 0xFFFF
        run_m1(board)
        assert board.lib.hal_late_loops(board.hal) - before == 2 * pairs


# ---- duties ---------------------------------------------------------------------------------------------------------


def signed(value: int) -> int:
    return value - 0x10000 if value & 0x8000 else value


@pytest.mark.parametrize("axis", [0, 1])
def test_duties_are_symmetrical_pulses(board: FakeBoard, axis: int) -> None:
    duties = (8192, 16384, 24576)
    board.lib.hal_pwm_duty(board.hal, axis, *duties)
    for sm, duty in enumerate(duties):
        on, off = (signed(board[PWM[axis] + 0x30 * sm + offset]) for offset in (9, 0xB))
        assert on == -off
        assert abs((off - on) - 6250 * duty / 32768) <= 1


@pytest.mark.parametrize(("duty", "half"), [(32767, 3125), (21, 2), (32, 3)])
def test_duties_of_0_and_100_percent(board: FakeBoard, duty: int, half: int) -> None:
    """100 % is never switched off: VAL3 is beyond the period."""
    board.lib.hal_pwm_duty(board.hal, 0, duty, duty, duty)
    assert signed(board[0xE60B]) == half
    assert signed(board[0xE609]) == -half


@pytest.mark.parametrize("duty", [0, 1, 15, -1, -32768])
def test_no_pulse_leaves_the_low_side_on(board: FakeBoard, duty: int) -> None:
    """VAL2 is beyond the range of the counter; VAL3, after a load at 0, ends a pulse in progress."""
    board.lib.hal_pwm_duty(board.hal, 0, duty, duty, duty)
    assert signed(board[0xE609]) > 3125
    assert signed(board[0xE60B]) == 2


def test_ldok_is_the_last_write(board: FakeBoard) -> None:
    board[0xE6C4] = 0x0700  # loaded
    board.forget()
    board.lib.hal_pwm_duty(board.hal, 0, 1, 2, 3)
    assert board.writes[-1] == (0xE6C4, 0x0707)
    assert [address for address, _ in board.writes].count(0xE6C4) == 1


def test_values_that_have_not_been_loaded_are_replaced(board: FakeBoard) -> None:
    """VALx are locked while LDOK is set."""
    board[0xE6C4] = 0x0707
    board.forget()
    board.lib.hal_pwm_duty(board.hal, 0, 1, 2, 3)
    assert board.writes[0] == (0xE6C4, 0x0770)
    assert board[0xE6C4] == 0x0707


@pytest.mark.parametrize("axis", [0, 1])
def test_enable_works_on_one_module_at_once(board: FakeBoard, axis: int) -> None:
    board.lib.hal_pwm_enable(board.hal, axis, True)
    assert (board[PWM[axis] + 0xC0], board[PWM[1 - axis] + 0xC0]) == (0x0770, 0)
    board.lib.hal_pwm_enable(board.hal, axis, False)
    assert board.writes == [(PWM[axis] + 0xC0, 0x0770), (PWM[axis] + 0xC0, 0)]


# ---- over-current ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("axis", [0, 1])
def test_a_fault_input_calls_the_break_handler(board: FakeBoard, axis: int) -> None:
    module = PWM[axis]
    board[module + 0xC7] = 0x0111  # flag, pin
    board.isr(FAULT[axis])
    assert servo_calls(board) == [(BREAK, axis)]
    assert board[module + 0xC6] == 0x3030  # no repeated request
    assert board.lib.hal_over_current_active(board.hal, axis)
    assert not board.lib.hal_over_current_active(board.hal, 1 - axis)

    board.lib.hal_over_current_clear(board.hal, axis)
    assert board[module + 0xC6] == 0x3031
    board[module + 0xC7] = 0x0110
    assert board.lib.hal_over_current_active(board.hal, axis)  # the comparator is still active
    board[module + 0xC7] = 0x0010
    assert not board.lib.hal_over_current_active(board.hal, axis)


def test_clearing_an_over_current_keeps_the_restart_condition(board: FakeBoard) -> None:
    """FFULL stays set: without it the outputs would never be enabled again."""
    board.lib.hal_over_current_clear(board.hal, 0)
    assert board.writes[0] == (0xE6C7, 0x0031)


# ---- others ---------------------------------------------------------------------------------------------------------


def test_unused_vectors_cause_no_access(board: FakeBoard) -> None:
    known = {77, 63, 85, 30, 87, 28, 24, 52}
    assert all(board.isr(vector) == [] for vector in range(111) if vector not in known)


def test_the_watchdog_is_serviced_with_both_words(board: FakeBoard) -> None:
    board.lib.hal_watchdog_service(board.hal)
    assert board.writes == [(0xE322, 0x5555), (0xE322, 0xAAAA)]


def test_the_loops_access_registers_no_more_often_than_necessary(board: FakeBoard) -> None:
    """Register accesses cost time in every period."""
    run_m1(board)
    assert sum(a.kind == READ for a in board.accesses) == 5  # two of them detect an omitted period
    assert sum(a.kind == WRITE for a in board.accesses) == 3
    run_m2(board)
    assert sum(a.kind == READ for a in board.accesses) == 4
    assert sum(a.kind == WRITE for a in board.accesses) == 3
