"""Start of the MC56F84789 port: registers after port_init, and the order of the accesses."""

from __future__ import annotations

import pytest
from firmware_compiler import CompileC
from port_board import GPIO, INIT, PWM, TMR, FakeBoard
from recorded_accesses import INTERRUPTS, SERVO, WRITE


@pytest.fixture
def board(compile_c: CompileC) -> FakeBoard:
    return FakeBoard(compile_c)


def first(board: FakeBoard, address: int, value: int | None = None) -> int:
    """Index of the first write to a register (of a value)."""
    for place, access in enumerate(board.accesses):
        if access.kind == WRITE and access.address == address and value in (None, access.value):
            return place
    raise AssertionError(f"{address:04X} is never written with {value}")


def last(board: FakeBoard, address: int) -> int:
    return max(place for place, access in enumerate(board.accesses) if access[:2] == (WRITE, address))


# ---- registers after the start --------------------------------------------------------------------------------------

PWM_SM = {
    0x01: (0xF3CB, 0xF3CB, 0xF3CB),
    0x03: (0x0800, 0x0800, 0x0800),
    0x05: (0, 0, 0),
    0x07: (0x0C34, 0x0C34, 0x0C34),
    0x0D: (0xF402, 0xF402, 0xF402),
    0x10: (0, 0, 0),
    0x11: (0, 0, 0),
    0x16: (0xFF11, 0xFF11, 0xFF11),
    0x17: (0xFF00, 0xFF00, 0xFF00),
    0x18: (0x64, 0x64, 0x64),
    0x19: (0x64, 0x64, 0x64),
}


@pytest.mark.parametrize(("axis", "ctrl2"), [(0, (0x0000, 0x0204, 0x0204)), (1, (0x0300, 0x0304, 0x0304))])
def test_start_up_sets_the_pwm_submodules(board: FakeBoard, axis: int, ctrl2: tuple[int, int, int]) -> None:
    for sm in range(3):
        base = PWM[axis] + 0x30 * sm
        found = {offset: board[base + offset] for offset in PWM_SM}
        assert found == {offset: values[sm] for offset, values in PWM_SM.items()}
        assert board[base + 0x02] & ~0x40 == ctrl2[sm]
        assert board[base + 0x0F] == {(0, 0): 1651, (0, 1): 0xF47D}.get((axis, sm), 0)
        low, high = board[base + 0x09], board[base + 0x0B]
        assert (low + high) & 0xFFFF == 0  # symmetrical about zero
        assert high == 3125 // 2


def test_only_the_start_interrupt_is_enabled(board: FakeBoard) -> None:
    """Sampling and M1 are off until the one-shot start interrupt (DRM 4.3.3)."""
    inten = {(axis, sm): board[PWM[axis] + 0x30 * sm + 0x13] for axis in (0, 1) for sm in range(3)}
    tctrl = {(axis, sm): board[PWM[axis] + 0x30 * sm + 0x15] for axis in (0, 1) for sm in range(3)}
    assert {place: value for place, value in inten.items() if value} == {(0, 0): 0x20}
    assert {place: value for place, value in tctrl.items() if value} == {(0, 0): 0x01}  # sync of PWMB


@pytest.mark.parametrize("axis", [0, 1])
def test_start_up_sets_the_pwm_module(board: FakeBoard, axis: int) -> None:
    module = PWM[axis]
    assert board[module + 0xC0] == 0  # the application switches the outputs on
    assert board[module + 0xC4] & 0x0F00 == 0x0700
    assert board[module + 0xC6] == 0x3031
    assert board[module + 0xC7] & 0x00F0 == 0x0030
    assert board[module + 0xC8] == 0x0202
    assert board[module + 0xC1] == board[module + 0xC3] == 0


def test_start_up_sets_the_converter(board: FakeBoard) -> None:
    assert board[0xE500] == 0x1805
    assert board[0xE501] == 0x0044
    assert [board[0xE504 + n] for n in range(4)] == [0x4640, 0x0060, 0xCEC8, 0x00F8]
    assert board[0xE508] == 0xC0C0
    assert board[0xE552] == 0x0008
    assert board[0xE553] == 0x040F
    assert board[0xE54E] == 0x1DA4  # power bits only
    assert [board[0xE53E + n] for n in range(16)] == [0] * 16
    others = (0xE502, 0xE503, 0xE54F, 0xE550, 0xE551, 0xE554, 0xE555)
    assert [board[address] for address in others] == [0] * len(others)
    assert board.writes_of(0xE500) == [0x5005, 0x1805]  # stopped while it is set up
    assert board.writes_of(0xE501) == [0x4044, 0x0044]
    assert (0xE509, 0x1800) in board.writes


@pytest.mark.parametrize("axis", [0, 1])
def test_start_up_sets_the_timers(board: FakeBoard, axis: int) -> None:
    module = TMR[axis]
    assert [board[module + 0x10 * n + 6] for n in range(4)] == [0x80A5, 0x3E80, 0x2800, 0x3E80]
    assert [board[module + 0x10 * n + 7] & 0x00C0 for n in range(4)] == [0xC0, 0xC0, 0, 0xC0]
    assert [board[module + 0x10 * n + 0xA] for n in range(4)] == [0, 0, 0, 0x0800]
    assert [board[module + 0x10 * n + 0xB] for n in range(2)] == [0x0105, 0x0105]
    assert board[module + 3] == 0
    assert board[module + 0xF] == 0xF


def test_start_up_sets_the_crossbars(board: FakeBoard) -> None:
    assert (board[0xE35A], board[0xE35B]) == (0x1400, 0x1414)
    assert (board[0xE360], board[0xE380], board[0xE381], board[0xE346]) == (0x1609, 0x7FDF, 0, 0x2E2E)


def test_start_up_sets_the_interrupt_levels(board: FakeBoard) -> None:
    """Field of the peripheral with vector v: number v - 9, two bits each; codes are one above the level."""
    codes = {
        v: board[0xE300 + (v - 9) // 8] >> 2 * ((v - 9) % 8) & 3
        for v in range(18, 110)
        if board[0xE300 + (v - 9) // 8] >> 2 * ((v - 9) % 8) & 3
    }
    assert codes == {77: 3, 63: 3, 85: 2, 30: 2, 87: 2, 28: 1, 24: 1, 52: 3}
    assert board[0xE302] >> 10 & 3 == 2  # ADC_CC0 in the manual
    assert board[0xE309] >> 8 & 3 == 2  # PWMA_CMP1


def test_start_up_sets_clock_serial_line_and_watchdog(board: FakeBoard) -> None:
    assert (board[0xE2B0], board[0xE2B1]) == (0x0085, 0x2031)
    assert board[0xE2B4] & 0x97FF == 0x0155  # trimmed, internal oscillator on, crystal
    assert board[0xE2B5] & 0x7C00 == 0x2800
    assert [board[0xE080 + n] for n in range(3)] == [0x01B2, 0x002C, 0x00A0]
    assert (board[0xE321], board[0xE320]) == (0x0186, 0x0303)


def test_start_up_sets_the_pins(board: FakeBoard) -> None:
    per = {port: board[base + 3] for port, base in GPIO.items()}
    assert per == {"A": 0x73, "B": 0xF3, "C": 0x019F, "D": 0x5A5A, "E": 0x03FF, "F": 0x6100, "G": 0x003F}
    assert board[GPIO["F"] + 2] == 0x00C0  # scope pins are outputs
    selects = [board[address] for address in range(0xE417, 0xE422) if address not in (0xE418, 0xE41B, 0xE421)]
    assert selects == [0, 0x4010, 0x0001, 0xA000, 0x0005, 0, 0x1401, 0]


# ---- order ----------------------------------------------------------------------------------------------------------

# Registers of a block, its gate register and the bits that must be set before.
GATED = [
    (range(0xE600, 0xE6D0), 0xE40F, 0x00E0),
    (range(0xE700, 0xE7D0), 0xE40F, 0x000E),
    (range(0xE500, 0xE556), 0xE40E, 0x0080),
    (range(0xE140, 0xE180), 0xE40C, 0xF000),
    (range(0xE180, 0xE1C0), 0xE40C, 0x0F00),
    (range(0xE080, 0xE086), 0xE40D, 0x1000),
    (range(0xE200, 0xE270), 0xE40C, 0x007F),
]


def test_no_access_before_its_clock_gate_is_open(board: FakeBoard) -> None:
    gates = dict.fromkeys((0xE40C, 0xE40D, 0xE40E, 0xE40F), 0)
    for access in board.accesses:
        if access.kind == WRITE and access.address in gates:
            gates[access.address] = access.value
        for block, gate, bits in GATED:
            if access.address in block:
                assert gates[gate] & bits == bits, f"{access.address:04X}"


def test_watchdog_stops_first_and_starts_locked_at_the_end(board: FakeBoard) -> None:
    assert board.writes[0] == (0xE320, 0)
    assert board.writes[-1] == (0xE320, 0x0303)
    assert last(board, 0xE321) < last(board, 0xE320)


def test_interrupts_are_enabled_last(board: FakeBoard) -> None:
    assert board.accesses[-1].kind == INTERRUPTS


def test_the_clock_is_switched_to_a_locked_pll_only(board: FakeBoard) -> None:
    """Crystal, reference, divider, lock detector, power, and the switch only on a locked PLL."""
    ctrl = [value for address, value in board.writes if address == 0xE2B0]
    assert ctrl == [0x0010, 0x0014, 0x0094, 0x0084, 0x0085]
    assert first(board, 0xE2B5) < first(board, 0xE2B0, 0x0014) < first(board, 0xE2B1) < first(board, 0xE2B0, 0x0084)


@pytest.mark.parametrize("axis", [0, 1])
def test_the_pwm_runs_after_everything_else_is_set(board: FakeBoard, axis: int) -> None:
    """Outputs off, values, LDOK, FORCE, faults, RUN; pins are assigned to the PWM when its outputs are off."""
    module = PWM[axis]
    force = first(board, module + 0x02, board[module + 0x02])
    values = max(last(board, module + 0x30 * sm + offset) for sm in range(3) for offset in (1, 5, 7, 9, 0xB, 0xD))
    mctrl = [first(board, module + 0xC4, value) for value in (0, 0x0007, 0x0707)]
    faults = [first(board, module + 0xC6, 0x3030), first(board, module + 0xC7), first(board, module + 0xC6, 0x3031)]
    assert mctrl[0] < values
    assert first(board, module + 0xC0) < values < mctrl[1] < force < faults[0] < faults[1] < faults[2] < mctrl[2]
    assert board[module + 0x02] & 0x40 == 0x40
    assert first(board, module + 0xC0) < first(board, GPIO["EG"[axis]] + 3)


def test_follower_runs_before_its_master(board: FakeBoard) -> None:
    assert first(board, PWM[1] + 0xC4, 0x0707) < first(board, PWM[0] + 0xC4, 0x0707)


def test_application_starts_on_a_finished_board_before_the_carriers(board: FakeBoard) -> None:
    place = [(a.kind, a.address) for a in board.accesses].index((SERVO, INIT))
    assert max(last(board, 0xE552), last(board, 0xE35A), last(board, TMR[1] + 0xF)) < place
    assert place < first(board, PWM[1] + 0xC4, 0x0707)


def test_adc_is_powered_before_it_is_released(board: FakeBoard) -> None:
    assert first(board, 0xE54E) < first(board, 0xE500, 0x1805)


# ---- failed start ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("stuck", "value"), [(0xE2B2, 0x0003)])
def test_without_clock_nothing_is_switched_on(compile_c: CompileC, stuck: int, value: int) -> None:
    board = FakeBoard(compile_c, initialised=False)
    board[stuck] = value  # the switch never ends
    assert not board.init()
    touched = {address for address, _ in board.writes}
    assert touched <= {0xE320, 0xE321, 0xE2B0, 0xE2B4, 0xE2B5}
    assert board[0xE320] == 0x0303  # the watchdog restarts the chip
