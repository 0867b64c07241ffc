"""The link on a real pty with a fake board: telemetry, jobs, close."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest
from fake_port import FakePort
from fake_servo import CATALOGUE, FakeServo
from fake_target import RO
from link_watcher import TIMEOUT, StartLink, Watcher
from servo_bridge.freemaster.errors import StatusError
from servo_bridge.wire.link import LinkConfig, LinkDownError, LinkState, LinkStatus

pytestmark = pytest.mark.realtime


# ---- telemetry ----------------------------------------------------------------------------------------------------
def test_samples_have_increasing_ticks(connected: Watcher, fake_board: FakeServo) -> None:
    connected.wait_samples(20)
    ticks = [sample.tick for sample in connected.samples]
    assert ticks == sorted(set(ticks))
    assert all(s.request_ns < s.response_ns for s in connected.samples)
    assert connected.link.layout.names[0] == "tick"
    assert [s.state for s in connected.states] == [LinkState.CONNECTING, LinkState.CONNECTED]
    assert connected.link.board is not None
    assert connected.link.board.name == f"servo/{CATALOGUE.board.name}"
    fake_board.put("axis1.position", 1234)
    connected.wait(
        lambda: connected.samples[-1].value("axis1.position") == pytest.approx(1234 * 2 * 3.14159265359 / 4000)
    )


def test_the_scope_is_set_up_once(connected: Watcher, fake_board: FakeServo) -> None:
    connected.wait_samples(50)
    assert [command for command, _ in fake_board.requests].count(0x26) == 1


@pytest.mark.usefixtures("fake_port")
def test_telemetry_of_a_board_with_passwords_is_read(fake_board: FakeServo, start_link: StartLink) -> None:
    fake_board.passwords = {1: "look"}
    fake_board.open_level = 0
    fake_board.reset()
    refused = start_link()
    assert "SERVO_PASSWORD" in refused.wait_state(LinkState.FAILED).remedy
    refused.link.close()
    watcher = start_link(password="look")
    watcher.wait_state(LinkState.CONNECTED)
    watcher.wait_samples(2)
    assert "look" not in repr(LinkConfig("port", password="look"))


def test_statistics_count_samples_and_connections(connected: Watcher) -> None:
    connected.wait_samples(100)
    figures = connected.link.statistics()
    assert figures.samples >= 100
    assert figures.connections == 1
    assert figures.sample_rate > 0.0
    assert figures.bytes_in_rate > figures.bytes_out_rate > 0.0
    assert 0.0 < figures.round_trip_p50 <= figures.round_trip_p99 <= figures.round_trip_max
    assert (figures.crc_errors, figures.damaged) == (0, 0)
    assert figures.timeouts <= 5, "a busy computer may cause delays"


def test_the_rate_can_be_limited(fake_port: FakePort, start_link: StartLink) -> None:
    watcher = start_link(rate=50.0)
    watcher.wait_state(LinkState.CONNECTED)
    watcher.wait_samples(26)
    recent = watcher.samples[-26:]
    assert recent[-1].response_ns - recent[0].response_ns > 0.4e9


def test_a_job_does_not_wait_for_a_slow_telemetry(fake_port: FakePort, start_link: StartLink) -> None:
    watcher = start_link(rate=0.2)
    watcher.wait_state(LinkState.CONNECTED)
    begin = time.monotonic()
    watcher.link.read("u_dc").result(TIMEOUT)
    assert time.monotonic() - begin < 2.5


# ---- jobs ---------------------------------------------------------------------------------------------------------
def test_effect_of_a_write_is_in_the_telemetry(connected: Watcher, fake_board: FakeServo) -> None:
    connected.wait_samples(1)
    count = connected.samples[-1].applied_count
    assert count is not None
    tick = connected.samples[-1].tick
    connected.link.write("cmd.position", [6.283185307179586], first=1).result(TIMEOUT)
    assert fake_board.written == [("cmd.position", 4, (4000).to_bytes(4, "little"))]
    connected.wait(lambda: connected.samples[-1].applied_count == count + 1)
    effect = next(s for s in connected.samples if s.applied_count == count + 1)
    assert effect.applied_tick is not None
    assert tick <= effect.applied_tick <= effect.tick
    assert connected.link.statistics().writes == 1


def test_raw_writes_and_reads_are_executed(connected: Watcher, fake_board: FakeServo) -> None:
    connected.link.write_raw("cmd.i_q", [100, -100]).result(TIMEOUT)
    assert fake_board.get("cmd.i_q") == [100, -100]
    assert connected.link.read("cmd.i_q").result(TIMEOUT) == pytest.approx([100 * 8.25 / 32768, -100 * 8.25 / 32768])


def test_invalid_requests_are_refused_without_sending(connected: Watcher, fake_board: FakeServo) -> None:
    for name, values, first in (
        ("cmd.speed", [1e6], 0),
        ("cmd.speed", [float("nan")], 0),
        ("cmd.speed", [0.0, 0.0, 0.0], 0),
        ("cmd.speed", [0.0], 2),
        ("cmd.speed", [], 0),
        ("axis1.speed", [0.0], 0),
        ("no.such", [0.0], 0),
    ):
        with pytest.raises(ValueError, match=r"\S"):
            connected.link.write(name, values, first=first)
    connected.wait_samples(3)
    assert fake_board.written == []


def test_reading_an_unknown_variable_is_an_error(connected: Watcher) -> None:
    with pytest.raises(ValueError, match="no variable"):
        connected.link.read("no.such")


def test_refusal_of_the_board_keeps_the_link(connected: Watcher, fake_board: FakeServo) -> None:
    row = next(e for e in fake_board.tables[0] if e.name == "cmd.enable")
    row.kind = RO
    with pytest.raises(StatusError, match="access denied"):
        connected.link.write("cmd.enable", [1.0, 1.0]).result(TIMEOUT)
    connected.wait_samples(5)
    assert connected.states[-1].state is LinkState.CONNECTED


def test_without_a_link_jobs_fail_at_once(start_link: StartLink) -> None:
    watcher = start_link()
    with pytest.raises(LinkDownError):
        watcher.link.write("cmd.enable", [1.0, 1.0]).result(TIMEOUT)


# ---- the end ------------------------------------------------------------------------------------------------------
def test_the_final_writes_are_sent_before_the_link_closes(connected: Watcher, fake_board: FakeServo) -> None:
    connected.wait_samples(1)
    begin = time.monotonic()
    assert connected.link.close([("cmd.quick_stop", [1.0, 1.0]), ("cmd.enable", [0.0, 0.0])])
    assert time.monotonic() - begin < 2.0
    assert [name for name, _, _ in fake_board.written] == ["cmd.quick_stop", "cmd.enable"]
    assert connected.states[-1] == LinkStatus(LinkState.DISCONNECTED, "closed")
    with pytest.raises(LinkDownError):
        connected.link.write("cmd.enable", [1.0, 1.0]).result(TIMEOUT)


def test_close_ends_in_time_without_responses_to_final_writes(fake_port: FakePort, connected: Watcher) -> None:
    fake_port.silent = True
    begin = time.monotonic()
    assert not connected.link.close([("cmd.enable", [0.0, 0.0])])
    assert time.monotonic() - begin < 3.0
    assert not [t for t in threading.enumerate() if t.name == "servo link"]


def test_final_writes_are_not_sent_to_another_device(
    fake_port: FakePort, start_link: StartLink, fake_board: FakeServo
) -> None:
    fake_board.put("catalogue_hash", 1)
    watcher = start_link()
    watcher.wait_state(LinkState.FAILED)
    assert not watcher.link.close([("cmd.enable", [0.0, 0.0])])
    assert fake_board.written == []


def test_close_ends_in_time_while_connecting(fake_port: FakePort, start_link: StartLink) -> None:
    fake_port.silent = True
    watcher = start_link()
    begin = time.monotonic()
    assert not watcher.link.close()
    assert time.monotonic() - begin < 3.0


def test_a_link_that_never_started_can_be_closed(tmp_path: Path) -> None:
    assert not Watcher(str(tmp_path / "x")).link.close([("cmd.enable", [0.0, 0.0])])


def test_the_port_is_free_after_closing(fake_port: FakePort, connected: Watcher, start_link: StartLink) -> None:
    connected.link.close()
    start_link().wait_state(LinkState.CONNECTED)


# ---- configuration ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("names", [("no.such",), ("snapshot",)])
def test_invalid_telemetry_is_refused(names: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match=names[0]):
        Watcher("/dev/null", telemetry=names)


@pytest.mark.parametrize(
    "options",
    [{"baud": 0}, {"rate": -1.0}, {"latency": 0.0}, {"lost_after": 0}, {"queue_limit": 0}, {"backoff_min": 0.0}],
)
def test_invalid_configuration_is_refused(options: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="positive"):
        LinkConfig("/dev/null", **options)  # type: ignore[arg-type]
