"""Encoder timers and serial line of the MC56F84789 port."""

from __future__ import annotations

import pytest
from firmware_compiler import CompileC
from port_board import EDGE, TMR, FakeBoard
from recorded_accesses import SERVO

ISR_EDGE, ISR_RECEIVE = (28, 24), 52
IEF, IEFIE, TOF = 0x0800, 0x0400, 0x2000
CAPT, CNTR, SCTRL = 2, 5, 7


def edge(board: FakeBoard, axis: int, count: int, time: int) -> None:
    """A B edge: timers with a clear flag capture their counters."""
    for channel, value in ((0, count), (1, time), (3, 0)):
        base = TMR[axis] + 0x10 * channel
        if not board[base + SCTRL] & IEF:
            board[base + CAPT] = value
            board[base + SCTRL] |= IEF
            if channel == 3:
                board[base + CNTR] = 0


def take(board: FakeBoard, axis: int) -> tuple[int, int] | None:
    capture = board.ffi.new("edge_capture_t *")
    return (capture.count, capture.time) if board.lib.hal_capture_take(board.hal, axis, capture) else None


@pytest.mark.parametrize("axis", [0, 1])
def test_count_and_index_count_are_read_from_their_timers(board: FakeBoard, axis: int) -> None:
    board[TMR[axis] + CNTR] = 0xF061
    board[TMR[axis] + 0x20 + CNTR] = 7
    assert board.lib.hal_encoder_count(board.hal, axis) == 0xF061
    assert board.lib.hal_index_count(board.hal, axis) == 7
    board.lib.hal_encoder_preset(board.hal, axis, 1000)
    assert board[TMR[axis] + CNTR] == 1000


@pytest.mark.parametrize(
    ("period", "up", "down"), [(4000, 0x0F9F, 0xF061), (400, 0x018F, 0xFE71), (32768, 0x7FFF, 0x8001)]
)
def test_the_counter_reloads_after_its_period(board: FakeBoard, period: int, up: int, down: int) -> None:
    board[TMR[1] + CNTR] = 7
    board.lib.hal_encoder_start(board.hal, 1, period)
    assert (board[TMR[1]], board[TMR[1] + 1], board[TMR[1] + CNTR]) == (up, down, 0)


@pytest.mark.parametrize("axis", [0, 1])
def test_arm_opens_the_captures_and_the_interrupt(board: FakeBoard, axis: int) -> None:
    for channel in range(4):
        board[TMR[axis] + 0x10 * channel + SCTRL] |= IEF
    board.lib.hal_capture_arm(board.hal, axis)
    assert [board[TMR[axis] + 0x10 * n + SCTRL] & (IEF | IEFIE) for n in (0, 1, 3)] == [IEFIE, 0, 0]


def test_each_arming_allows_one_capture(board: FakeBoard) -> None:
    board.lib.hal_capture_arm(board.hal, 0)
    assert take(board, 0) is None
    edge(board, 0, 123, 456)
    assert take(board, 0) == (123, 456)
    assert not board[TMR[0] + SCTRL] & IEFIE
    edge(board, 0, 124, 457)  # ignored: not armed
    assert take(board, 0) is None
    board.lib.hal_capture_arm(board.hal, 0)
    edge(board, 0, 125, 458)
    assert take(board, 0) == (125, 458)
    assert take(board, 1) is None


def test_arming_is_repeated_if_an_edge_occurs_during_it(board: FakeBoard) -> None:
    """An edge captured by only one of the timers would give a wrong speed."""
    for writes in range(1, 7):
        for channel in (0, 1, 3):
            board[TMR[0] + 0x10 * channel + SCTRL] |= IEF
        board.chip.slip = writes
        board.lib.hal_capture_arm(board.hal, 0)
        count, time = (bool(board[TMR[0] + 0x10 * n + SCTRL] & IEF) for n in (0, 1))
        assert count == time, writes


@pytest.mark.parametrize("axis", [0, 1])
def test_an_edge_interrupt_calls_the_edge_handler(board: FakeBoard, axis: int) -> None:
    board.chip.takes_edge = True
    board.lib.hal_capture_arm(board.hal, axis)
    edge(board, axis, 321, 654)
    accesses = board.isr(ISR_EDGE[axis])
    assert (SERVO, EDGE, axis) in accesses
    assert (board.chip.taken.count, board.chip.taken.time) == (321, 654)
    assert not board[TMR[axis] + SCTRL] & IEFIE


def test_an_edge_that_is_not_read_interrupts_once(board: FakeBoard) -> None:
    board.lib.hal_capture_arm(board.hal, 0)
    edge(board, 0, 1, 2)
    board.isr(ISR_EDGE[0])
    assert board[TMR[0] + SCTRL] & (IEF | IEFIE) == IEF
    assert take(board, 0) == (1, 2)  # still pending for the slow loop


# ---- age of the last edge -------------------------------------------------------------------------------------------


def test_the_age_of_an_edge_saturates_at_the_overflow(board: FakeBoard) -> None:
    board[TMR[0] + 0x30 + CNTR] = 4711
    assert board.lib.hal_edge_age(board.hal, 0) == 4711
    board[TMR[0] + 0x30 + SCTRL] |= TOF
    assert board.lib.hal_edge_age(board.hal, 0) == 0x10000


def test_counter_is_read_before_its_flag(board: FakeBoard) -> None:
    board.lib.hal_edge_age(board.hal, 0)
    assert [a.address for a in board.accesses] == [TMR[0] + 0x35, TMR[0] + 0x37]


def test_overflow_survives_arming_and_ends_with_an_edge(board: FakeBoard) -> None:
    board.lib.hal_capture_arm(board.hal, 0)
    board[TMR[0] + 0x37] |= TOF
    board.lib.hal_capture_arm(board.hal, 0)
    assert board.lib.hal_edge_age(board.hal, 0) == 0x10000
    edge(board, 0, 1, 2)
    assert take(board, 0) == (1, 2)
    assert board.lib.hal_edge_age(board.hal, 0) == 0


def test_overflow_ends_with_an_unread_edge(board: FakeBoard) -> None:
    board.lib.hal_capture_arm(board.hal, 0)
    board[TMR[0] + 0x37] |= TOF
    edge(board, 0, 1, 2)
    board.lib.hal_capture_arm(board.hal, 0)
    assert board.lib.hal_edge_age(board.hal, 0) == 0


# ---- serial line ----------------------------------------------------------------------------------------------------

STAT, DATA, CTRL2 = 0xE083, 0xE084, 0xE082


def received(board: FakeBoard) -> bytes:
    byte = board.ffi.new("uint8_t *")
    data = b""
    while board.lib.hal_serial_get(board.hal, byte):
        data += bytes([byte[0]])
    return data


def test_all_bytes_of_the_fifo_are_received(board: FakeBoard) -> None:
    assert received(board) == b""
    for byte in b"wxyz":
        board.lib.fake_receive(board.chip, byte)
    accesses = board.isr(ISR_RECEIVE)
    assert accesses[0].address == STAT  # reading it and then the data clears the flag
    assert received(board) == b"wxyz"


def test_ring_buffer_keeps_its_order_across_its_end(board: FakeBoard) -> None:
    for start in range(0, 400, 4):
        block = bytes((start + k) % 256 for k in range(4))
        for byte in block:
            board.lib.fake_receive(board.chip, byte)
        board.isr(ISR_RECEIVE)
        assert received(board) == block


def test_full_ring_buffer_discards_the_newest_byte(board: FakeBoard) -> None:
    for byte in range(80):
        board.lib.fake_receive(board.chip, byte)
        board.isr(ISR_RECEIVE)
    assert received(board) == bytes(range(64))


def test_overrun_is_cleared(board: FakeBoard) -> None:
    """Reception stays blocked while the flag is set; writing STAT clears it."""
    board[STAT] = 0x2800
    board.lib.fake_receive(board.chip, 1)
    board.isr(ISR_RECEIVE)
    assert (STAT, 0) in board.writes


@pytest.mark.parametrize("waiting", [0, 3, 4])
def test_bytes_are_sent_while_the_fifo_has_space(board: FakeBoard, waiting: int) -> None:
    board[CTRL2] = 0x20 | waiting << 13
    sent = board.lib.hal_serial_put(board.hal, 0x5A)
    assert sent == (waiting < 4)
    assert board.writes == ([(DATA, 0x5A)] if sent else [])


@pytest.mark.parametrize(
    ("baud", "rate"),
    [(0, 434), (115200, 434), (921600, 54), (1_000_000, 50), (1200, 41667), (300, 0xFFFF), (9_000_000, 8)],
)
def test_baud_rate_is_set_to_the_nearest_possible_one(compile_c: CompileC, baud: int, rate: int) -> None:
    """The nearest possible baud rate if the requested one is out of range."""
    board = FakeBoard(compile_c, initialised=False)
    board.lib.fake_baud(board.chip, baud)
    assert board.init()
    assert board[0xE080] == rate
