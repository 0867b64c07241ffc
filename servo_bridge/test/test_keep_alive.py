"""Signs of life of the node: how often, and never two at once. None from one that hangs: test_failures_bridge.py."""

from __future__ import annotations

import time
from concurrent.futures import Future

import pytest
from bridge_rig import Rig
from fake_servo import CATALOGUE
from servo_bridge.keep_alive import KeepAlive

pytestmark = pytest.mark.realtime

CODE = CATALOGUE.bits["command"]["KEEP_ALIVE"]


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
        rig.connect()
        assert 5 <= keep_alives(rig, 1.0) <= 11
        assert rig.set_parameter("board_parameters", ["param.host_timeout=0.08"])[0]
        assert 25 <= keep_alives(rig, 1.0) <= 51
        rig.link.answers_commands = False
        assert keep_alives(rig, 0.3) <= 1


def test_a_short_time_out_that_is_wanted_counts_before_the_board_has_it() -> None:
    with Rig(board_parameters=["param.host_timeout=0.08"]) as rig:
        rig.link.rejected_parameter = "param.host_timeout"
        rig.link.parameters["param.host_timeout"] = [CATALOGUE["param.host_timeout"].to_raw(0.5)]
        rig.connect()
        assert keep_alives(rig, 0.5) >= 13
