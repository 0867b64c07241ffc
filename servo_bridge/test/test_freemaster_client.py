from __future__ import annotations

import contextlib
import hashlib

import pytest
from fake_target import RO, RW, FakeEntry, FakeTarget
from fake_transport import FakeTransport, client_on
from hypothesis import given
from hypothesis import strategies as st
from servo_bridge.freemaster.client import Client
from servo_bridge.freemaster.commands import Command, ScopeSlot, send_command
from servo_bridge.freemaster.dialect_v4 import password_key
from servo_bridge.freemaster.errors import (
    AnswerTimeoutError,
    CodecError,
    CommandUnfinishedError,
    DisturbedRequestError,
    FreemasterError,
    StatusError,
    WrongProtocolError,
)
from servo_bridge.freemaster.frames import Framing


def connected(target: FakeTarget) -> Client:
    client = client_on(FakeTransport(target.feed))
    client.identify()
    target.requests.clear()
    return client


def test_identify_reads_the_configuration_values() -> None:
    target = FakeTarget(
        mtu=100, config={"BA": bytes.fromhex("80 80 80 80 02"), "RC": b"\x01", "NM": "Säge".encode() + b"\0"}
    )
    client = client_on(FakeTransport(target.feed))
    info = client.identify()
    assert (info.protocol, info.mtu, info.base_address) == (4, 100, 0x20000000)
    assert (info.name, info.version, info.description, info.build) == ("Säge", "fake 1.0", "test target", "today")
    assert (info.scopes, info.recorders, info.pipes) == (1, 1, 0)
    assert not info.big_endian
    assert info.password_level == 0
    assert client.mtu == 100


def test_identify_accepts_a_target_with_minimal_configuration() -> None:
    target = FakeTarget()
    target.config = {"MTU": b"\x20"}
    info = client_on(FakeTransport(target.feed)).identify()
    assert (info.mtu, info.name, info.base_address, info.scopes) == (32, "", None, 0)


def test_byte_order_and_password_level_are_read() -> None:
    info = client_on(FakeTransport(FakeTarget(big_endian=True, passwords={1: "x"}).feed)).identify()
    assert info.big_endian
    assert info.password_level == 1


def test_another_device_is_recognised() -> None:
    with pytest.raises(WrongProtocolError, match=r"the response is not FreeMASTER \(first bytes b'Hello"):
        client_on(FakeTransport(lambda _: b"Hello world\r\n")).identify()


def test_a_short_circuit_of_the_lines_is_recognised() -> None:
    with pytest.raises(WrongProtocolError, match="only the echo"):
        client_on(FakeTransport(lambda request: request)).identify()


def test_missing_answer_is_not_reported_as_another_protocol() -> None:
    with pytest.raises(AnswerTimeoutError):
        client_on(FakeTransport(lambda _: b"")).identify()


def test_bad_line_is_not_reported_as_another_protocol() -> None:
    with pytest.raises(DisturbedRequestError):
        client_on(FakeTransport(lambda _: b"+\x82\x87")).identify()


@given(st.binary(max_size=80))
def test_garbage_gives_a_specific_error(garbage: bytes) -> None:
    client = client_on(FakeTransport(lambda _: garbage), retries=1)
    with contextlib.suppress(FreemasterError):
        client.identify()
    with contextlib.suppress(FreemasterError):
        client.read_memory(0, 4)
    assert client.line.statistics.requests <= 30


@pytest.mark.parametrize(("mtu", "sizes"), [(32, [32] * 15 + [20]), (240, [240, 240, 20]), (254, [248, 248, 4])])
def test_reads_are_split_by_the_buffer(mtu: int, sizes: list[int]) -> None:
    target = FakeTarget(mtu=mtu, safety=False)
    content = bytes(k * 7 % 256 for k in range(500))
    target.poke(0x1000, content)
    client = connected(target)
    assert client.read_memory(0x1000, 500) == content
    assert [payload[-1] if size < 128 else payload[-2] & 0x7F | payload[-1] << 7
            for (_, payload), size in zip(target.requests, sizes, strict=True)] == sizes  # fmt: skip


def test_empty_reads_send_no_request() -> None:
    target = FakeTarget()
    client = connected(target)
    assert client.read_memory(0x1000, 0) == b""
    assert target.requests == []


def test_a_write_changes_the_memory() -> None:
    target = FakeTarget(tables=[[FakeEntry("x", b"\xe1", 0x1000, 2, RW)]])
    client = connected(target)
    client.write_memory(0x1000, b"\x2b\x2b")
    assert target.peek(0x1000, 2) == b"\x2b\x2b"


def test_access_to_a_read_only_variable_is_refused() -> None:
    client = connected(FakeTarget(tables=[[FakeEntry("x", b"\xe1", 0x1000, 2, RO)]]))
    with pytest.raises(StatusError, match="access denied"):
        client.write_memory(0x1000, b"ab")
    with pytest.raises(StatusError, match="access denied"):
        client.read_memory(0x1000, 3)


@pytest.mark.parametrize("mtu", [32, 100, 240, 254])
def test_the_largest_write_fits_and_no_larger_one_is_tried(mtu: int) -> None:
    target = FakeTarget(mtu=mtu, safety=False)
    client = connected(target)
    limit = client.write_limit(0x2000_0000)
    client.write_memory(0x2000_0000, b"\x55" * limit)
    assert target.peek(0x2000_0000, limit) == b"\x55" * limit
    target.requests.clear()
    with pytest.raises(CodecError, match="do not fit one write"):
        client.write_memory(0x2000_0000, bytes(limit + 1))
    assert target.requests == []


def test_a_write_is_encoded_once(monkeypatch: pytest.MonkeyPatch) -> None:
    client = connected(FakeTarget(safety=False))
    encoded: list[int] = []
    encode = Framing.encode

    def counted(self: Framing, command: int, payload: bytes = b"") -> bytes:
        encoded.append(command)
        return encode(self, command, payload)

    monkeypatch.setattr(Framing, "encode", counted)
    client.write_memory(0x2000_0000, b"ab", lengthy=True)
    assert encoded == [0x23]


def test_28_scope_slots_take_one_frame() -> None:
    target = FakeTarget(mtu=254, scope_limit=28, safety=False)
    client = connected(target)
    for k in range(28):
        target.set_int(0x1000 + 4 * k, k, 4)
    request = client.set_scope([ScopeSlot(0x1000 + 4 * k, 4) for k in range(28)])
    assert [command for command, _ in target.requests] == [0x26]
    assert client.exchange(request).data == b"".join(k.to_bytes(4, "little") for k in range(28))


def test_scope_is_set_up_in_pieces_for_a_small_buffer() -> None:
    target = FakeTarget(mtu=32, safety=False)
    client = connected(target)
    request = client.set_scope([ScopeSlot(0x2000_0000 + k, 1) for k in range(8)])
    assert len(target.requests) > 1
    assert max(len(payload) for _, payload in target.requests) <= 30
    assert len(client.exchange(request).data) == 8


def test_a_scope_that_does_not_fit_is_refused() -> None:
    client = connected(FakeTarget(mtu=32, safety=False))
    with pytest.raises(CodecError, match="do not fit one response"):
        client.set_scope([ScopeSlot(0x1000, 8)] * 5)
    client = connected(FakeTarget(safety=False))
    with pytest.raises(StatusError, match="bad size"):
        client.set_scope([ScopeSlot(0x1000, 2)] * 9)


def test_application_command_returns_its_result() -> None:
    target = FakeTarget(commands={0x11: lambda arguments: 0x42 if arguments == b"\x01\x02\xd4" else 0})
    client = connected(target)
    assert client.run_command(0x11, b"\x01\x02\xd4") == 0x42


def test_command_without_completion_times_out() -> None:
    client = connected(FakeTarget(commands={1: lambda _: 0xFE}))
    with pytest.raises(CommandUnfinishedError, match=r"still runs after 0\.5 s"):
        client.run_command(1, timeout=0.5)


class CommandRecorder:
    """Target that records executed commands; like the firmware it executes a command when its result is requested."""

    def __init__(self) -> None:
        self.ran: list[int] = []
        self.target = FakeTarget(commands={1: lambda _: self._run(1), 2: lambda _: self._run(2)})

    def _run(self, code: int) -> int:
        self.ran.append(code)
        return code

    def lose_answer(self, request: bytes) -> bytes:
        self.target.feed(request)
        return b""


def test_command_with_a_lost_answer_is_completed_at_once() -> None:
    noting = CommandRecorder()
    with pytest.raises(AnswerTimeoutError, match="SENDAPPCMD"):
        client_on(FakeTransport(noting.lose_answer)).run_command(1)
    assert noting.ran == [1]
    assert [command for command, _ in noting.target.requests] == [Command.SENDAPPCMD, Command.GETAPPCMDSTS]


def test_a_pending_command_of_another_client_is_completed_first() -> None:
    noting = CommandRecorder()
    client = connected(noting.target)
    client.exchange(send_command(1))
    assert client.run_command(2) == 2
    assert noting.ran == [1, 2]


def locked(passwords: dict[int, str]) -> tuple[FakeTarget, Client]:
    target = FakeTarget(tables=[[FakeEntry("x", b"\xe1", 0x1000, 2, RW)]], passwords=passwords)
    return target, connected(target)


@pytest.mark.parametrize(
    ("passwords", "given", "level"),
    [({1: "a", 2: "b", 3: "c"}, "a", 1), ({1: "a", 2: "b", 3: "c"}, "c", 3), ({2: "b"}, "b", 3), ({1: "a"}, "a", 3)],
)
def test_password_gives_the_highest_possible_level(passwords: dict[int, str], given: str, level: int) -> None:
    target, client = locked(passwords)
    assert client.info.password_level == min(passwords)
    assert client.log_in(given) == level
    assert target.level == level
    assert client.log_in(given, 1) == 1


def test_key_of_a_password_is_the_salted_hash() -> None:
    inner = hashlib.sha1(b"secret").digest()
    salt = bytes(range(16))
    assert password_key("secret", salt) == hashlib.sha1(salt + inner + salt).digest()


def test_a_wrong_password_is_refused() -> None:
    _, client = locked({1: "a"})
    with pytest.raises(StatusError, match="wrong password"):
        client.log_in("b")
    with pytest.raises(StatusError, match="password needed"):
        client.read_memory(0x1000, 2)
    with pytest.raises(StatusError, match="unknown command"):
        connected(FakeTarget()).log_in("b")


def test_password_is_requested_if_the_target_requires_it() -> None:
    target, client = locked({1: "a", 2: "b"})
    answers = ["b", "a"]
    client.ask_password = answers.pop
    assert client.read_memory(0x1000, 2) == b"\0\0"
    client.write_memory(0x1000, b"ab")
    assert target.peek(0x1000, 2) == b"ab"
    assert answers == []
    target.reset()
    client.ask_password = lambda: None
    with pytest.raises(StatusError, match="password needed"):
        client.read_memory(0x1000, 2)


def test_a_lost_answer_does_not_end_the_login() -> None:
    target, _ = locked({1: "a"})
    lost = [True, False, True]

    def respond(request: bytes) -> bytes:
        answer = target.feed(request)
        return b"" if request[1] in (0x2C, 0x2D) and lost and lost.pop() else answer

    client = client_on(FakeTransport(respond))
    client.identify()
    assert client.log_in("a") == 3
