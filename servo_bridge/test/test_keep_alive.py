"""Keep-alives of the link: their period, their loss, a hanging owner. A blocked node: test_failures_bridge.py."""

from __future__ import annotations

import time

import pytest
from bridge_rig import Rig
from fake_servo import CATALOGUE, FakeServo
from link_watcher import Watcher
from servo_bridge.freemaster.commands import Command
from servo_bridge.wire.keep_alive import KEEP_ALIVE_PERIOD, keep_alive_period, kept_alive
from test_stop_at_connection import Wire

PERIOD_NS = round(KEEP_ALIVE_PERIOD * 1e9)


def signals(board: FakeServo) -> list[int]:
    """Times of the keep-alives that the board has received [ns]."""
    return [time_ns for time_ns, name in board.host_signals if name == "KEEP_ALIVE"]


def read_for(wire: Wire, duration_ns: int) -> None:
    """Read continuously for a time."""
    until = wire.transport.clock() + duration_ns
    while wire.transport.clock() < until:
        wire.client.read_memory(wire.board.addresses["tick"], 4)


@pytest.mark.parametrize(
    ("timeouts", "period"), [([], 0.1), ([0.5], 0.1), ([30.0], 0.1), ([0.2], 0.05), ([0.2, 0.1], 0.025)]
)
def test_period_allows_four_keep_alives_per_host_timeout(timeouts: list[float], period: float) -> None:
    known = [{"param.host_timeout": [CATALOGUE["param.host_timeout"].to_raw(timeout)]} for timeout in timeouts]
    assert keep_alive_period(CATALOGUE, {}, *known) == pytest.approx(period)


def test_keep_alives_fill_the_pauses_between_commands_only() -> None:
    wire = Wire()
    fed: list[int] = []
    with kept_alive(wire.client, CATALOGUE, fed=fed.append) as keep_alive:
        read_for(wire, 10 * PERIOD_NS)
        assert 8 <= len(signals(wire.board)) <= 10
        known = len(signals(wire.board))
        for _ in range(20):
            read_for(wire, PERIOD_NS // 2)
            keep_alive.commanded()  # the write of a command
        assert len(signals(wire.board)) <= known + 1
        keep_alive.period = KEEP_ALIVE_PERIOD / 5
        known = len(signals(wire.board))
        read_for(wire, 2 * PERIOD_NS)
        assert 8 <= len(signals(wire.board)) - known <= 10
    assert len(fed) == len(signals(wire.board)) + 20


def test_lost_answer_of_a_keep_alive_does_not_stop_the_traffic() -> None:
    wire = Wire()
    wire.client.identify()
    with kept_alive(wire.client, CATALOGUE):
        read_for(wire, 3 * PERIOD_NS)  # measures the delay of the line
        lost: list[int] = []

        def lose(command: int) -> bool:
            if command != Command.SENDAPPCMD or lost:
                return False
            lost.append(wire.transport.clock())
            return True

        wire.lose = lose
        read_for(wire, 3 * PERIOD_NS)
        assert lost
        assert min(time_ns for time_ns in signals(wire.board) if time_ns > lost[0]) - lost[0] < 20_000_000


@pytest.mark.realtime
def test_link_feeds_the_board_only_while_its_owner_is_alive(connected: Watcher, fake_board: FakeServo) -> None:
    connected.wait(lambda: connected.link.statistics().silence.duration > 0.0)  # a second one is acknowledged
    connected.hang = "timer Supervisor._slow has been running for 1.1 s in the thread of the executor"
    connected.wait_samples(1)
    known = len(signals(fake_board))
    end = time.monotonic() + 5 * KEEP_ALIVE_PERIOD
    connected.wait(lambda: time.monotonic() > end)
    assert len(signals(fake_board)) <= known + 1
    connected.hang = ""
    connected.wait(lambda: len(signals(fake_board)) > known + 1)
    connected.wait(lambda: connected.link.statistics().silence.duration > 4 * KEEP_ALIVE_PERIOD)  # acknowledged
    assert "the bridge was late: timer Supervisor._slow" in connected.link.statistics().silence.cause


@pytest.mark.realtime
def test_keep_alive_period_follows_the_host_timeout_of_the_board() -> None:
    with Rig(board_parameters=["param.host_timeout=0.2"]) as rig:
        assert rig.link.keep_alive_period == pytest.approx(0.05)  # before it is written
        rig.link.parameters["param.host_timeout"] = [CATALOGUE["param.host_timeout"].to_raw(0.5)]
        rig.connect()
        assert rig.set_parameter("board_parameters", ["param.host_timeout=0.08"])[0]
        rig.until(lambda: rig.link.keep_alive_period == pytest.approx(0.02))
