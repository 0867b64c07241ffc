"""The link on a real pty with failures of boards, ports and lines."""

from __future__ import annotations

import logging
import threading
import time
from pathlib import Path

import pytest
from fake_port import Device, FakePort, NoiseDevice
from fake_servo import CATALOGUE, FakeServo
from fake_target_v3 import FakeTargetV3
from link_watcher import TIMEOUT, StartLink, Watcher
from servo_bridge.wire.link import Link, LinkConfig, LinkDownError, LinkState, LinkStatus, Sample

pytestmark = pytest.mark.realtime


# ---- failures -----------------------------------------------------------------------------------------------------
def test_link_waits_for_the_port(tmp_path: Path, fake_board: FakeServo, start_link: StartLink) -> None:
    watcher = start_link()
    status = watcher.wait_state(LinkState.DISCONNECTED)
    assert "does not exist" in status.reason
    assert status.remedy
    with FakePort(tmp_path / "ttyFAKE", fake_board):
        watcher.wait_state(LinkState.CONNECTED)
        watcher.link.close()


def test_link_reconnects_when_the_port_returns(fake_port: FakePort, connected: Watcher, fake_board: FakeServo) -> None:
    connected.link.write("cmd.enable", [1.0, 1.0]).result(TIMEOUT)
    fake_port.unplug()
    gone = time.monotonic()
    status = connected.wait_state(LinkState.DISCONNECTED)
    assert connected.times[-1] - gone < 1.0
    assert "lost" in status.reason or "does not exist" in status.reason
    with pytest.raises(LinkDownError):
        connected.link.write("cmd.position", [1.0, 1.0]).result(TIMEOUT)
    fake_port.plug()
    connected.wait_state(LinkState.CONNECTED)
    connected.wait_samples(5)
    assert [name for name, _, _ in fake_board.written] == ["cmd.enable"], "a command was sent again"
    assert connected.link.statistics().connections == 2
    assert connected.samples[-1].epoch == 0, "the board has continued to run"


def test_no_command_is_repeated_after_a_reconnection(
    fake_port: FakePort, connected: Watcher, fake_board: FakeServo
) -> None:
    connected.wait_samples(1)
    fake_port.silent = True
    begin = time.monotonic()
    pending = [connected.link.write("cmd.position", [0.1 * k, 0.0]) for k in range(5)]
    status = connected.wait_state(LinkState.DISCONNECTED)
    assert connected.times[-1] - begin < 2.0
    assert "stopped responding" in status.reason
    for write in pending:
        with pytest.raises(Exception, match=r"stopped responding|no response"):
            write.result(TIMEOUT)
    seen = len(fake_board.written)
    fake_port.silent = False
    connected.wait_state(LinkState.CONNECTED)
    connected.wait_samples(3)
    assert len(fake_board.written) == seen, "a command was sent again"


def test_a_board_that_never_answers_is_reported(fake_port: FakePort, start_link: StartLink) -> None:
    fake_port.silent = True
    status = start_link().wait_state(LinkState.DISCONNECTED)
    assert "no response at 115200 baud" in status.reason
    assert "baud rate" in status.remedy


@pytest.mark.parametrize(
    ("device", "text"), [(FakeTargetV3(), "no table of variables"), (NoiseDevice(), "not FreeMASTER")]
)
def test_a_device_of_another_protocol_is_reported(
    tmp_path: Path, start_link: StartLink, device: Device, text: str
) -> None:
    with FakePort(tmp_path / "ttyFAKE", device):
        watcher = start_link()
        status = watcher.wait_state(LinkState.FAILED)
        assert text in status.reason
        watcher.link.close()


def test_a_board_of_another_version_gets_no_command(
    fake_port: FakePort, start_link: StartLink, fake_board: FakeServo
) -> None:
    fake_board.put("catalogue_hash", 1)
    watcher = start_link()
    status = watcher.wait_state(LinkState.FAILED)
    assert "another table of variables" in status.reason
    assert "flash the firmware" in status.remedy
    with pytest.raises(LinkDownError, match="another table of variables"):
        watcher.link.write("cmd.enable", [1.0, 1.0]).result(TIMEOUT)
    # The correct firmware is flashed while the program runs.
    fake_board.put("catalogue_hash", CATALOGUE.hash)
    watcher.wait_state(LinkState.CONNECTED)
    assert fake_board.written == []
    assert [s.state for s in watcher.states].count(LinkState.FAILED) == 1


def test_a_too_small_scope_is_reported(fake_port: FakePort, start_link: StartLink, fake_board: FakeServo) -> None:
    fake_board.scope_limit = 3
    status = start_link().wait_state(LinkState.FAILED)
    assert "SETSCOPE" in status.reason


def test_reset_of_the_board_starts_a_new_epoch(connected: Watcher, fake_board: FakeServo) -> None:
    connected.wait_samples(5)
    fake_board.restart()
    connected.wait(lambda: any("reset" in s.reason for s in connected.states))
    connected.wait(lambda: connected.states[-1].state is LinkState.CONNECTED and connected.samples[-1].epoch == 1)
    assert connected.samples[-1].tick < 16_000 * TIMEOUT
    assert connected.link.statistics().resets == 1


def test_a_board_is_stopped_at_every_connection_before_anything_else(connected: Watcher, fake_board: FakeServo) -> None:
    connected.wait_samples(5)
    first = fake_board.requests[:]
    fake_board.requests.clear()
    fake_board.restart()
    connected.wait(lambda: connected.states[-1].state is LinkState.CONNECTED and connected.samples[-1].epoch == 1)
    again = fake_board.requests[[command for command, _ in fake_board.requests].index(0x20) :]
    for requests in (first, again):
        assert [command for command, _ in requests[:3]] == [0x20, 0x20, 0x30]
        assert requests[2][1] == bytes([CATALOGUE.bits["command"]["QUICK_STOP"]])


def test_reset_is_detected_by_the_lost_scope_set_up(connected: Watcher, fake_board: FakeServo) -> None:
    connected.wait_samples(5)
    fake_board.scope = []
    connected.wait(lambda: connected.states[-1].state is LinkState.CONNECTED and connected.samples[-1].epoch == 1)
    assert any("reset" in s.reason for s in connected.states)


def test_a_reset_while_disconnected_starts_a_new_epoch(
    fake_port: FakePort, connected: Watcher, fake_board: FakeServo
) -> None:
    fake_board.first_tick += 3600 * 16_000  # an hour of operation
    connected.wait(
        lambda: connected.states[-1].state is LinkState.CONNECTED and connected.samples[-1].tick > 3600 * 16_000
    )
    epoch = connected.samples[-1].epoch
    fake_port.unplug()
    connected.wait_state(LinkState.DISCONNECTED)
    fake_board.restart()
    fake_port.plug()
    connected.wait_state(LinkState.CONNECTED)
    connected.wait_samples(1)
    assert connected.samples[-1].epoch == epoch + 1
    assert connected.link.statistics().resets == 1


def test_clock_that_disagrees_is_reported_as_such_and_keeps_the_link(connected: Watcher, fake_board: FakeServo) -> None:
    connected.wait_samples(5)
    tick = connected.samples[-1].tick
    fake_board.first_tick += 5 * 16_000
    connected.wait(lambda: connected.samples[-1].tick > tick + 5 * 16_000)
    figures = connected.link.statistics()
    assert (figures.resets, figures.clock_disagreements, connected.samples[-1].epoch) == (0, 1, 0)
    assert 3.0 < figures.clock_disagreement_max < 4.1
    assert [s.state for s in connected.states] == [LinkState.CONNECTING, LinkState.CONNECTED]


def test_token_of_another_host_is_used(fake_port: FakePort, start_link: StartLink, fake_board: FakeServo) -> None:
    """A clock that disagrees after a reconnection begins no epoch while the token is the same."""
    fake_board.put("boot_token", 77)
    watcher = start_link()
    watcher.wait_state(LinkState.CONNECTED)
    watcher.wait_samples(1)
    fake_port.unplug()
    watcher.wait_state(LinkState.DISCONNECTED)
    fake_board.first_tick += 3600 * 16_000
    fake_port.plug()
    watcher.wait_state(LinkState.CONNECTED)
    watcher.wait(lambda: watcher.samples[-1].tick > 3600 * 16_000)
    assert (watcher.samples[-1].epoch, watcher.link.statistics().resets) == (0, 0)
    assert fake_board.get("boot_token") == [77]


@pytest.mark.usefixtures("fake_port")
def test_board_with_the_configuration_of_a_measurement_is_not_used(
    fake_board: FakeServo, start_link: StartLink
) -> None:
    fake_board.put("measurement.state", CATALOGUE.enums["measurement_state_t"]["RESTORING"])
    watcher = start_link()
    watcher.wait(lambda: any("configuration of a measurement" in s.reason for s in watcher.states))
    assert all(s.state is not LinkState.CONNECTED for s in watcher.states)
    fake_board.put("measurement.state", 0)
    watcher.wait_state(LinkState.CONNECTED)


def test_stopped_control_loop_is_reported(connected: Watcher, fake_board: FakeServo) -> None:
    frozen = fake_board.ticks()
    fake_board.ticks = lambda: frozen
    status = connected.wait_state(LinkState.FAILED)
    assert "stands still" in status.reason
    fake_board.ticks = lambda: frozen + (time.monotonic_ns() - fake_board.start_ns) // 62_500
    connected.wait_state(LinkState.CONNECTED)


def test_noisy_line_keeps_the_link(fake_port: FakePort, connected: Watcher) -> None:
    count = 0

    def damage(answer: bytes) -> bytes:
        nonlocal count
        count += 1
        if count % 5 == 0:
            return answer[:3] + bytes([answer[3] ^ 0x10]) + answer[4:] if len(answer) > 4 else answer
        return answer

    fake_port.mangle = damage
    connected.wait_samples(40)
    figures = connected.link.statistics()
    assert figures.crc_errors + figures.damaged > 0
    assert [s.state for s in connected.states] == [LinkState.CONNECTING, LinkState.CONNECTED]


def test_lost_answer_keeps_the_link(fake_port: FakePort, connected: Watcher) -> None:
    lost: list[bytes] = []

    def lose_one(answer: bytes) -> bytes:
        if lost:
            return answer
        lost.append(answer)
        return b""

    fake_port.mangle = lose_one
    connected.wait(lambda: connected.link.statistics().timeouts >= 1)
    connected.wait_samples(5)
    assert [s.state for s in connected.states] == [LinkState.CONNECTING, LinkState.CONNECTED]


def test_keep_alive_without_answer_keeps_the_link(
    fake_port: FakePort, connected: Watcher, fake_board: FakeServo
) -> None:
    fake_port.mangle = lambda answer: b"" if fake_board.requests[-1][0] == 0x30 else answer
    known = len(fake_board.requests)
    connected.wait(lambda: [request[0] for request in fake_board.requests[known:]].count(0x30) >= 6)
    connected.wait_samples(5)
    assert [s.state for s in connected.states] == [LinkState.CONNECTING, LinkState.CONNECTED]


def test_lost_bytes_keep_the_link(fake_port: FakePort, connected: Watcher, fake_board: FakeServo) -> None:
    count = 0

    def lose(answer: bytes) -> bytes:
        nonlocal count
        count += 1
        return answer[:-1] if count % 4 == 0 else answer

    fake_port.mangle = lose
    writes = [connected.link.write("cmd.position", [0.1 * k, 0.0]) for k in range(4)]
    for write in writes:
        write.result(TIMEOUT)
    connected.wait_samples(5)
    assert connected.states[-1].state is LinkState.CONNECTED


def test_errors_in_callbacks_do_not_end_the_thread(
    fake_port: FakePort, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    seen: list[Sample] = []
    done = threading.Event()

    def fail(sample: Sample) -> None:
        seen.append(sample)
        if len(seen) >= 3:
            done.set()
        raise RuntimeError("bug of the owner")

    def ignore(status: LinkStatus) -> None:
        raise RuntimeError("another one")

    link = Link(LinkConfig(fake_port.path), CATALOGUE, on_sample=fail, on_state=ignore)
    with caplog.at_level(logging.CRITICAL):
        link.start()
        assert done.wait(TIMEOUT)
        link.close()
