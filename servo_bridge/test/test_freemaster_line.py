from __future__ import annotations

import pytest
from fake_target import FakeTarget
from fake_transport import FakeTransport, client_on
from servo_bridge.freemaster import commands
from servo_bridge.freemaster.errors import (
    AnswerTimeoutError,
    DamagedAnswerError,
    DisturbedRequestError,
    StatusError,
    TransportError,
)
from servo_bridge.freemaster.line import Line

MS = 1_000_000
OK = b"+\x00\x00"
READ = commands.read_memory(0x2000_0020, 2)
GOOD = bytes.fromhex("2B 00 34 12 D3")
OTHER = bytes.fromhex("2B 00 2B 2B 2B 2B E8")


def line_on(transport: FakeTransport, **options: object) -> Line:
    return Line(transport, clock=transport.clock, **options)  # type: ignore[arg-type]


def answers(*frames: bytes | list[tuple[int, bytes]]) -> FakeTransport:
    queue = list(frames)
    return FakeTransport(lambda _: queue.pop(0) if queue else b"")


def test_exchange_returns_data_and_times() -> None:
    transport = answers(GOOD)
    exchange = line_on(transport).exchange(READ)
    assert exchange.data == b"\x34\x12"
    assert exchange.response_ns - exchange.request_ns == transport.delay_ns
    assert transport.requests == [READ.frame]


@pytest.mark.parametrize("baud", [9600, 115_200, 1_000_000])
def test_silence_ends_after_the_time_on_the_line_and_the_margin(baud: int) -> None:
    transport = answers()
    start = transport.now
    with pytest.raises(AnswerTimeoutError, match="no response within"):
        line_on(transport, baud=baud, latency=0.1, retries=0).exchange(READ)
    expected = len(READ.frame) * 10e9 / baud + 0.1e9
    assert transport.now - start == pytest.approx(expected, abs=1e5)


def test_timeout_allows_for_a_long_answer_at_a_low_rate() -> None:
    request = commands.read_memory(0, 200)
    target = FakeTarget(safety=False)
    answer = target.feed(request.frame)
    transport = FakeTransport(lambda _: [(k * 10_000_000_000 // 9600, answer[k : k + 1]) for k in range(len(answer))])
    assert line_on(transport, baud=9600, latency=0.05, retries=0).exchange(request).data == bytes(200)


def test_incomplete_answer_times_out() -> None:
    transport = answers(GOOD[:3])
    start = transport.now
    with pytest.raises(DamagedAnswerError, match="no intact response") as caught:
        line_on(transport, retries=0).exchange(READ)
    assert caught.value.received == GOOD[:3]
    assert transport.now - start < 300 * MS


def test_continuous_noise_does_not_block_the_client() -> None:
    transport = FakeTransport(lambda _: [(k * MS, b"hello\r\n") for k in range(2000)])
    start = transport.now
    with pytest.raises(DamagedAnswerError):
        line_on(transport, retries=0).exchange(READ)
    assert transport.now - start < 500 * MS


def test_line_without_silence_does_not_block_the_client() -> None:
    class ContinuousSender(FakeTransport):
        def read(self, deadline: int) -> bytes:
            self.now += MS
            return b"x" * 5000

    transport = ContinuousSender(lambda _: b"")
    line = line_on(transport, retries=0)
    start = transport.now
    for _ in range(3):
        with pytest.raises(DamagedAnswerError):
            line.exchange(READ)
    assert transport.now - start < 3000 * MS


def test_a_request_with_a_lost_answer_is_repeated() -> None:
    transport = answers(b"", b"", GOOD)
    line = line_on(transport)
    assert line.exchange(READ).data == b"\x34\x12"
    assert (line.statistics.retries, line.statistics.timeouts) == (2, 2)
    assert transport.requests == [READ.frame] * 3


def test_after_its_retries_a_request_times_out() -> None:
    transport = answers()
    with pytest.raises(AnswerTimeoutError):
        line_on(transport, retries=2).exchange(READ)
    assert len(transport.requests) == 3


def test_a_request_with_a_damaged_answer_is_repeated() -> None:
    transport = answers(b"+\x00\x34\x13\xd3", GOOD)
    line = line_on(transport)
    assert line.exchange(READ).data == b"\x34\x12"
    assert line.statistics.crc_errors == 1


def test_rest_of_a_damaged_answer_is_discarded() -> None:
    """The second request is sent after the end of the damaged answer."""
    damaged = [(MS, b"+\x00\x34\x13\xd3"), (8 * MS, OTHER)]
    transport = answers(damaged, GOOD)
    line = line_on(transport)
    assert line.exchange(READ).data == b"\x34\x12"
    assert transport.sent_at[1] - transport.sent_at[0] >= 8 * MS + 30 * MS


def test_late_answer_does_not_shift_the_following_ones() -> None:
    """The first answer arrives during the retry, the second one after it; the next request gets its own answer."""
    late = [(215 * MS + 60 * MS, GOOD)]
    second = [(50 * MS, GOOD)]
    transport = answers(late, second, [(10 * MS, OTHER)])
    line = line_on(transport, latency=0.2)
    assert line.exchange(READ).data == b"\x34\x12"
    assert line.exchange(READ).data == b"\x2b\x2b"


def test_unexpected_input_is_discarded() -> None:
    transport = answers(GOOD)
    transport.push(0, OTHER)
    line = line_on(transport)
    assert line.exchange(READ).data == b"\x34\x12"
    assert line.statistics.stray_bytes == len(OTHER)


def test_an_application_command_is_never_repeated() -> None:
    request = commands.send_command(1)
    transport = answers()
    with pytest.raises(AnswerTimeoutError):
        line_on(transport).exchange(request)
    assert len(transport.requests) == 1
    transport = answers(b"+\x00\x01")
    with pytest.raises(DamagedAnswerError):
        line_on(transport).exchange(request)
    assert len(transport.requests) == 1


def test_a_request_received_damaged_is_repeated() -> None:
    transport = answers(b"+\x82\x87", b"+\x83\x80", OK)
    request = commands.send_command(1)
    line_on(transport).exchange(request)
    assert transport.requests == [request.frame] * 3


def test_requests_always_received_damaged_are_an_error() -> None:
    transport = FakeTransport(lambda _: b"+\x82\x87")
    with pytest.raises(DisturbedRequestError):
        line_on(transport).exchange(READ)


def test_a_refusal_is_not_repeated_and_gives_its_reason() -> None:
    transport = answers(b"+\x89\xb6")
    with pytest.raises(StatusError, match="access denied") as caught:
        line_on(transport).exchange(READ)
    assert caught.value.code == 0x89
    assert len(transport.requests) == 1


def test_an_answer_of_the_wrong_form_is_an_error() -> None:
    wrong = bytes.fromhex("2B 40 01 09 AC")
    transport = FakeTransport(lambda _: wrong)
    with pytest.raises(DamagedAnswerError, match="wrong form"):
        line_on(transport, retries=0).exchange(READ)


def test_the_echo_of_single_wire_hardware_is_skipped() -> None:
    target = FakeTarget(safety=False)
    transport = FakeTransport(lambda request: request + target.feed(request))
    assert client_on(transport).read_memory(0x2B2B2B, 16) == bytes(16)


def test_error_of_a_lost_port_is_raised() -> None:
    def gone(_: bytes) -> bytes:
        raise TransportError("gone")

    with pytest.raises(TransportError):
        line_on(FakeTransport(gone)).exchange(READ)


def test_work_is_done_while_waiting_for_the_answer() -> None:
    transport = answers(GOOD, GOOD)
    line = line_on(transport)
    seen: list[tuple[int, int]] = []
    line.meanwhile = lambda: seen.append((len(transport.requests), transport.now))
    begin = transport.now
    line.exchange(READ)
    line.exchange(READ)
    assert seen == [(1, begin)]
    line.meanwhile = lambda: seen.append((0, 0))
    line.work_off()
    line.work_off()
    assert seen[1:] == [(0, 0)]


def test_exception_of_the_owner_stops_a_long_job() -> None:
    class StopError(Exception):
        pass

    def stop() -> None:
        raise StopError

    transport = answers(GOOD)
    with pytest.raises(StopError):
        line_on(transport, before_request=stop).exchange(READ)
    assert transport.requests == []


@pytest.mark.parametrize("options", [{"baud": 0}, {"latency": -1.0}, {"retries": -1}])
def test_invalid_settings_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="not a usable combination"):
        line_on(answers(), **options)
