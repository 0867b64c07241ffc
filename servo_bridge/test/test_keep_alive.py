"""Keep-alives of the node: their period, one at a time. A blocked node: test_failures_bridge.py."""

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
    """Records sent keep-alives; the test answers them."""

    def __init__(self) -> None:
        self.futures: list[Future[int]] = []
        self.subject = KeepAlive(CATALOGUE, self._run)

    def _run(self, code: int, *, urgent: bool) -> Future[int]:
        assert (code, urgent) == (CODE, True)
        self.futures.append(Future())
        return self.futures[-1]


@pytest.mark.parametrize("error", [None, TimeoutError("no answer")])
def test_at_most_one_keep_alive_is_pending(error: Exception | None) -> None:
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
def test_period_allows_four_keep_alives_per_host_timeout(timeouts: list[float], period: float) -> None:
    known = [{"param.host_timeout": [CATALOGUE["param.host_timeout"].to_raw(timeout)]} for timeout in timeouts]
    assert Sent().subject.period({}, *known) == pytest.approx(period)


def keep_alives(rig: Rig, duration: float) -> int:
    """Number of keep-alives of the node during a time [s]."""
    before, end = len(rig.link.commands), time.monotonic() + duration
    rig.until(lambda: time.monotonic() > end)
    assert {code for _, code in rig.link.commands} == {CODE}
    return len(rig.link.commands) - before


def test_keep_alive_period_follows_the_host_timeout_of_the_board() -> None:
    with Rig() as rig:
        rig.link.parameters["param.host_timeout"] = [CATALOGUE["param.host_timeout"].to_raw(0.5)]
        rig.connect()
        assert 5 <= keep_alives(rig, 1.0) <= 11
        assert rig.set_parameter("board_parameters", ["param.host_timeout=0.08"])[0]
        assert 25 <= keep_alives(rig, 1.0) <= 51
        rig.link.answers_commands = False
        assert keep_alives(rig, 0.3) <= 1


def test_requested_shorter_host_timeout_applies_before_it_is_written() -> None:
    with Rig(board_parameters=["param.host_timeout=0.08"]) as rig:
        rig.link.rejected_parameter = "param.host_timeout"
        rig.link.parameters["param.host_timeout"] = [CATALOGUE["param.host_timeout"].to_raw(0.5)]
        rig.connect()
        assert keep_alives(rig, 0.5) >= 13
