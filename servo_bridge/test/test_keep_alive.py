"""The node's signs of life: how often, never two at once, and none from a node whose executor hangs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future

import pytest
import rclpy
from bridge_rig import DOMAIN, Rig
from fake_port import FakePort
from fake_servo import CATALOGUE, FakeServo
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.parameter import Parameter
from servo_bridge.keep_alive import KeepAlive
from servo_bridge.node import ServoBridge

pytestmark = pytest.mark.realtime

CODE = CATALOGUE.bits["command"]["KEEP_ALIVE"]
READ_SCOPE = 0x27

Turn = Callable[[float], None]


class Sent:
    """Notes what is sent; nothing is answered before the test says so."""

    def __init__(self) -> None:
        self.futures: list[Future[int]] = []
        self.subject = KeepAlive(CATALOGUE, self._run)

    def _run(self, code: int, *, urgent: bool) -> Future[int]:
        assert (code, urgent) == (CODE, True)
        self.futures.append(Future())
        return self.futures[-1]


@pytest.mark.parametrize("error", [None, TimeoutError("no answer")])
def test_never_more_than_one_waits(error: Exception | None) -> None:
    sent = Sent()
    sent.subject.send()
    sent.subject.send()
    assert len(sent.futures) == 1
    if error is None:
        sent.futures[0].set_result(0)
    else:
        sent.futures[0].set_exception(error)
    sent.subject.send()
    assert len(sent.futures) == 2


@pytest.mark.parametrize(
    ("timeouts", "period"), [([], 0.1), ([0.5], 0.1), ([30.0], 0.1), ([0.2], 0.05), ([0.2, 0.1], 0.025)]
)
def test_four_fit_into_the_time_that_the_board_waits(timeouts: list[float], period: float) -> None:
    known = [{"param.host_timeout": [CATALOGUE["param.host_timeout"].to_raw(timeout)]} for timeout in timeouts]
    assert Sent().subject.period({}, *known) == pytest.approx(period)


def keep_alives(rig: Rig, duration: float) -> int:
    """How many the node sends meanwhile [s]."""
    before, end = len(rig.link.commands), time.monotonic() + duration
    rig.until(lambda: time.monotonic() > end)
    assert {code for _, code in rig.link.commands} == {CODE}
    return len(rig.link.commands) - before


def test_the_node_follows_the_time_out_of_the_board() -> None:
    with Rig() as rig:
        rig.link.parameters["param.host_timeout"] = [CATALOGUE["param.host_timeout"].to_raw(0.5)]
        rig.up()
        assert 5 <= keep_alives(rig, 1.0) <= 11
        assert rig.set_parameter("board_parameters", ["param.host_timeout=0.08"])[0]
        assert 25 <= keep_alives(rig, 1.0) <= 51
        rig.link.mute = True
        assert keep_alives(rig, 0.3) <= 1


def test_a_short_time_out_that_is_wanted_counts_before_the_board_has_it() -> None:
    with Rig(board_parameters=["param.host_timeout=0.08"]) as rig:
        rig.link.stubborn = "param.host_timeout"
        rig.link.parameters["param.host_timeout"] = [CATALOGUE["param.host_timeout"].to_raw(0.5)]
        rig.up()
        assert keep_alives(rig, 0.5) >= 13


@pytest.fixture
def bridge(fake_port: FakePort) -> Iterator[Turn]:
    """A bridge on a real link; yields what turns its executor for so long [s]."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    executor = EventsExecutor(context=context)
    node = ServoBridge(
        executor.create_task, context=context, parameter_overrides=[Parameter("port", value=fake_port.path)]
    )
    executor.add_node(node)

    def turn(duration: float) -> None:
        end = time.monotonic() + duration
        while time.monotonic() < end:
            executor.spin_once(timeout_sec=0.01)

    yield turn
    executor.remove_node(node)
    node.shutdown()
    executor.shutdown()
    rclpy.shutdown(context=context)


def test_a_node_whose_executor_hangs_is_not_taken_for_alive(bridge: Turn, fake_board: FakeServo) -> None:
    def counts() -> tuple[int, int]:
        return len(fake_board.signs), [command for command, _ in fake_board.requests].count(READ_SCOPE)

    bridge(1.0)
    signs, samples = counts()
    bridge(0.5)
    assert counts()[0] >= signs + 3
    signs, samples = counts()
    time.sleep(0.7)  # the executor hangs
    assert counts()[1] > samples + 20, "the link's thread goes on"
    assert counts()[0] <= signs + 1
    assert fake_board.silence_ns > 500_000_000
    deadline = time.monotonic() + 10.0  # what has come meanwhile is dealt with first
    while counts()[0] <= signs + 1 and time.monotonic() < deadline:
        bridge(0.1)
    assert counts()[0] > signs + 1
