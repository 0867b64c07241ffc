"""Dispatcher: order of writes, one at a time, exact tick of the effect, and failures."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_bridge.dispatcher import Dispatcher
from servo_bridge.set_point_queue import CommandWrite, SetPointQueue
from servo_msgs_py.convert import AppliedCommand


def position(raw: int) -> CommandWrite:
    return CommandWrite("cmd.position", 0, (raw, raw))


ENABLE = CommandWrite("cmd.enable", 0, (1, 1))


class Queue(SetPointQueue):
    """Writes in order of arrival."""

    def __init__(self, *writes: CommandWrite) -> None:
        super().__init__()
        self.waiting = list(writes)
        self.taken: list[CommandWrite] = []
        self.void: list[CommandWrite] = []

    def next_write(self) -> CommandWrite | None:
        return self.waiting.pop(0) if self.waiting else None

    def accepted(self, write: CommandWrite) -> None:
        self.taken.append(write)

    def failed(self, write: CommandWrite) -> bool:
        self.void.append(write)
        return True


class Rig:
    """Dispatcher with a queue, sent writes and errors."""

    def __init__(self, *writes: CommandWrite) -> None:
        self.queue = Queue(*writes)
        self.sent: list[CommandWrite] = []
        self.trouble: list[str] = []
        self.dispatcher = Dispatcher(self.sent.append, self.queue, self.trouble.append)

    def connected(self) -> Rig:
        self.dispatcher.open()
        self.dispatcher.confirm(0, 0, 0)
        return self


def test_write_before_the_first_sample_is_reported_with_the_tick_of_the_sample() -> None:
    rig = Rig()
    stop = CommandWrite("cmd.quick_stop", 0, (1, 1))
    rig.dispatcher.open(stop)
    assert rig.dispatcher.confirm(1000, 904, 1) == AppliedCommand("cmd.quick_stop", 904, (1, 1), 3)
    assert rig.dispatcher.confirm(1008, 904, 1) is None


def test_nothing_is_sent_before_the_link_is_up_and_a_sample_was_seen() -> None:
    rig = Rig(position(1))
    rig.dispatcher.pump()
    rig.dispatcher.open()
    rig.dispatcher.pump()
    assert rig.sent == []
    rig.dispatcher.confirm(8, 0, 7)
    assert rig.sent == [position(1)]


def test_next_write_is_sent_after_the_sample_that_confirms_the_previous_one() -> None:
    rig = Rig(position(1), position(2)).connected()
    first = rig.sent[0]
    assert rig.dispatcher.confirm(8, 0, 0) is None
    rig.dispatcher.acknowledged(first, None)
    assert rig.queue.taken == [first]
    assert rig.dispatcher.confirm(16, 0, 0) is None
    assert len(rig.sent) == 1
    assert rig.dispatcher.confirm(32, 24, 1) == AppliedCommand("cmd.position", 24, (1, 1), 3)
    assert rig.sent[1:] == [position(2)]


def test_confirmation_works_across_the_wrap_of_ticks_and_counts() -> None:
    rig = Rig(CommandWrite("cmd.i_q", 1, (-5,)))
    rig.dispatcher.open()
    start = (1 << 32) - 8
    rig.dispatcher.confirm(start, 5, 0xFFFF)
    rig.dispatcher.acknowledged(rig.sent[0], None)
    assert rig.dispatcher.confirm(start + 16, 0, 0) == AppliedCommand("cmd.i_q", 1 << 32, (0, -5), 2)


def test_urgent_writes_precede_set_points_and_report_their_tick() -> None:
    rig = Rig(position(1), position(2)).connected()
    done = rig.dispatcher.urgent(ENABLE)
    rig.dispatcher.acknowledged(rig.sent[0], None)
    rig.dispatcher.confirm(16, 8, 1)
    assert rig.sent == [position(1), ENABLE]
    assert not done.done()
    rig.dispatcher.acknowledged(ENABLE, None)
    rig.dispatcher.confirm(32, 24, 2)
    assert done.result(0) == 24
    assert rig.sent[2] == position(2)
    assert ENABLE not in rig.queue.taken


def test_parameters_wait_for_urgent_writes_but_not_for_set_points() -> None:
    rig = Rig(position(1), position(2)).connected()
    done = rig.dispatcher.parameter("param.host_timeout", [5])
    stop = CommandWrite("cmd.quick_stop", 0, (1, 1))
    rig.dispatcher.urgent(stop)
    parameter = CommandWrite("param.host_timeout", 0, (5,))
    for number in range(1, 4):
        rig.dispatcher.acknowledged(rig.sent[-1], None)
        rig.dispatcher.confirm(16 * number, 16 * number - 8, number)
    assert rig.sent == [position(1), stop, parameter, position(2)]
    assert done.result(0) == 40
    waiting = rig.dispatcher.parameter("param.brake", [1])
    rig.dispatcher.lost("unplugged")
    with pytest.raises(ConnectionError, match="unplugged"):
        waiting.result(0)


def test_urgent_writes_keep_their_order() -> None:
    rig = Rig().connected()
    release = CommandWrite("cmd.quick_stop", 0, (0, 0))
    rig.dispatcher.urgent(release)
    rig.dispatcher.urgent(ENABLE)
    rig.dispatcher.acknowledged(release, None)
    rig.dispatcher.confirm(16, 8, 1)
    assert rig.sent == [release, ENABLE]


def test_refused_write_is_reported_and_the_next_one_is_sent() -> None:
    rig = Rig(position(1), position(2)).connected()
    rig.dispatcher.acknowledged(rig.sent[0], "the board answers 89, access denied")
    assert rig.queue.void == [position(1)]
    assert rig.sent[1:] == [position(2)]
    assert "cmd.position" in rig.trouble[0]
    assert "access denied" in rig.trouble[0]


def test_a_refused_urgent_write_fails_its_future() -> None:
    rig = Rig().connected()
    done = rig.dispatcher.urgent(ENABLE)
    rig.dispatcher.acknowledged(ENABLE, "no answer")
    with pytest.raises(ConnectionError, match="no answer"):
        done.result(0)


def test_write_without_effect_times_out() -> None:
    rig = Rig(position(1), position(2)).connected()
    rig.dispatcher.acknowledged(rig.sent[0], None)
    for tick in range(8, 8 + 42 * 8, 8):
        assert rig.dispatcher.confirm(tick, 0, 0) is None
    assert rig.queue.void == [position(1)]
    assert rig.sent[1:] == [position(2)]
    assert "not applied within 20 ms" in rig.trouble[0]


def test_close_discards_pending_writes_and_ignores_late_answers() -> None:
    rig = Rig(position(1), position(2)).connected()
    done = rig.dispatcher.urgent(ENABLE)
    late = rig.sent[0]
    rig.dispatcher.lost("port gone")
    with pytest.raises(ConnectionError, match="port gone"):
        done.result(0)
    rig.dispatcher.acknowledged(late, None)
    rig.dispatcher.confirm(16, 8, 1)
    assert len(rig.sent) == 1
    assert rig.queue.taken == []
    with pytest.raises(ConnectionError, match="not connected"):
        rig.dispatcher.urgent(ENABLE).result(0)


def test_late_answer_is_not_assigned_to_the_next_write() -> None:
    rig = Rig(position(1), position(2)).connected()
    late = rig.sent[0]
    rig.dispatcher.lost("port gone")
    rig.connected()
    assert rig.sent == [position(1), position(2)]
    rig.dispatcher.acknowledged(late, None)
    assert rig.dispatcher.confirm(16, 8, 1) is None
    assert rig.queue.taken == []


def test_writes_of_another_master_are_not_confirmed_as_own() -> None:
    rig = Rig(position(1)).connected()
    assert rig.dispatcher.confirm(8, 8, 1) is None
    rig.dispatcher.acknowledged(rig.sent[0], None)
    assert rig.dispatcher.confirm(16, 8, 1) is None
    applied = rig.dispatcher.confirm(24, 24, 2)
    assert applied is not None
    assert applied.tick == 24


class Board:
    """Model of the firmware: writes are latched at the next slow tick and confirmed in the snapshot."""

    def __init__(self) -> None:
        self.tick = 0
        self.count = 0
        self.applied_tick = 0
        self.pending: list[CommandWrite] = []
        self.truth: list[tuple[CommandWrite, int]] = []

    def advance(self, slow_ticks: int) -> None:
        for _ in range(slow_ticks):
            self.tick += 8
            if self.pending:
                self.count = (self.count + 1) & 0xFFFF
                self.applied_tick = self.tick
                self.truth += [(write, self.tick) for write in self.pending]
                self.pending.clear()


@given(st.integers(0, 2**32), st.sampled_from([0.1, 1.0, 4.0, 16.0]))
def test_reported_ticks_are_exact_at_any_line_speed(seed: int, pace: float) -> None:
    chance = random.Random(seed)
    board = Board()
    rig = Rig(*(position(k) for k in range(20)))
    found: list[tuple[CommandWrite, int]] = []
    rig.dispatcher.open()
    answered = 0
    for _ in range(400):
        board.advance(int(chance.expovariate(1.0 / pace)))
        applied = rig.dispatcher.confirm(board.tick, board.applied_tick & 0xFFFF_FFFF, board.count)
        if applied is not None:
            found.append((position(applied.raw[0]), applied.tick))
        board.advance(int(chance.expovariate(1.0 / pace)))
        if len(rig.sent) > answered:
            board.pending.append(rig.sent[answered])
            rig.dispatcher.acknowledged(rig.sent[answered], None)
            answered += 1
    assert found == board.truth[: len(found)]
    assert len(found) >= min(20, board.tick // 8 // 4) - 1
