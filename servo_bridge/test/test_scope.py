from __future__ import annotations

import struct

import pytest
from fake_servo import CATALOGUE, FakeServo
from fake_transport import FakeTransport, client_on
from servo_bridge.freemaster.errors import StatusError
from servo_bridge.wire.board_clock import TickExtender
from servo_bridge.wire.scope import Sample, ScopeLayout
from servo_bridge.wire.scope_reader import BoardResetError, BoardStoppedError, ScopeReader
from servo_bridge.wire.session import connect

TOKEN = 1234
NAMES = ("tick", "applied_tick", "applied_count", "axis1.position", "axis1.i_q", "cmd.position")


def layout(*names: str) -> ScopeLayout:
    return ScopeLayout([CATALOGUE[name] for name in names])


def test_a_sample_is_decoded() -> None:
    scope = layout(*NAMES)
    data = struct.pack("<IIHihii", 1000, 992, 7, -4000, 16384, 4000, -8000)
    assert scope.size == len(data)
    sample = Sample(1000, 0, 0, 1, data, scope.raw(data), scope)
    assert sample.value("axis1.position") == pytest.approx(-6.283185307)
    assert sample.value("axis1.i_q") == pytest.approx(4.125)
    assert sample.values()["cmd.position"] == pytest.approx([6.283185307, -12.566370614])
    assert (sample.applied_tick, sample.applied_count) == (992, 7)
    with pytest.raises(KeyError):
        sample.value("u_dc")


def test_applied_tick_is_extended_like_the_tick() -> None:
    scope = layout("tick", "applied_tick")
    tick = 2**32 + 5
    for raw, expected in ((tick - 2**32, tick), (2**32 - 3, 2**32 - 3)):
        data = struct.pack("<II", 5, raw)
        assert Sample(tick, 0, 0, 0, data, scope.raw(data), scope).applied_tick == expected


def test_sample_without_applied_tick_and_count_is_decoded() -> None:
    scope = layout("tick")
    sample = Sample(1, 0, 0, 0, b"\1\0\0\0", (1,), scope)
    assert sample.applied_tick is None
    assert sample.applied_count is None


def test_blocks_do_not_fit_a_slot() -> None:
    with pytest.raises(ValueError, match="snapshot has 0 bytes"):
        layout("tick", "snapshot")


class Bench:
    """A scope reader on a fake board in simulated time."""

    def __init__(self) -> None:
        self.tick = 800
        self.step = 16
        self.board = FakeServo(ticks=self._ticks)
        self.transport = FakeTransport(self.board.feed)
        session = connect(client_on(self.transport), CATALOGUE)
        self.disagreements: list[int] = []
        self.board.put("boot_token", TOKEN)
        self.reader = ScopeReader(session, layout(*NAMES), TickExtender(), TOKEN, self.disagreements.append)

    def _ticks(self) -> int:
        self.tick += self.step
        return self.tick


def test_reader_delivers_new_samples_only() -> None:
    bench = Bench()
    assert bench.reader.first().tick == 832
    bench.step = 0
    assert bench.reader.next() is None
    bench.step = 16
    following = bench.reader.next()
    assert following is not None
    assert following.tick == 848


def test_reader_detects_a_reset_by_the_token() -> None:
    """Another client has set up an equal scope after the reset."""
    bench = Bench()
    bench.tick = 100_000_000
    bench.reader.first()
    bench.tick = 0
    bench.board.put("boot_token", 0)
    with pytest.raises(BoardResetError, match="token"):
        bench.reader.next()


def test_clock_that_disagrees_is_counted_and_is_no_reset() -> None:
    bench = Bench()
    first = bench.reader.first()
    bench.tick += 5 * 16_000  # 5 s
    sample = bench.reader.next()
    assert sample is not None
    assert (sample.epoch, sample.tick) == (first.epoch, first.tick + 5 * 16_000 + 32)
    assert bench.disagreements == [pytest.approx(4_000_000_000, abs=100_000_000)]
    bench.reader.next()
    assert len(bench.disagreements) == 1


def test_sample_that_was_damaged_on_the_line_is_repeated() -> None:
    bench = Bench()
    first = bench.reader.first()
    bench.tick += 1 << 24  # one bit
    ticks = bench.board.ticks

    def damaged_once() -> int:
        tick = ticks()
        if tick >= 1 << 24:
            bench.tick -= 1 << 24
        return tick

    bench.board.ticks = damaged_once
    sample = bench.reader.next()
    assert sample is not None
    assert (sample.epoch, sample.tick) == (first.epoch, first.tick + 32)
    assert bench.disagreements == []


def test_reader_detects_a_lost_set_up() -> None:
    bench = Bench()
    epoch = bench.reader.first().epoch
    bench.board.restart()
    with pytest.raises(BoardResetError, match="no longer set up"):
        bench.reader.next()
    assert epoch == 0


@pytest.mark.parametrize("from_start", [True, False])
def test_reader_detects_a_stopped_clock(from_start: bool) -> None:
    bench = Bench()
    if not from_start:
        bench.reader.first()
    bench.step = 0
    before = bench.transport.now
    with pytest.raises(BoardStoppedError, match="stands still"):
        bench.reader.first()
    assert bench.transport.now - before < 1_100_000_000


def test_reader_forwards_refusals() -> None:
    bench = Bench()
    bench.reader.first()
    bench.board.scopes = 0
    with pytest.raises(StatusError):
        bench.reader.next()
