"""The first contact with a board, in simulated time: quick stop first, then keep-alives during the discovery."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from fake_servo import CATALOGUE, FakeServo
from fake_target import FakeTarget
from fake_transport import FakeTransport, client_on
from servo_bridge.freemaster.client import Client
from servo_bridge.freemaster.commands import Command, send_command
from servo_bridge.freemaster.errors import AnswerTimeoutError
from servo_bridge.wire.keep_alive import KEEP_ALIVE_PERIOD
from servo_bridge.wire.session import connect
from servo_bridge.wire.stop_at_connection import stopped_at_connection

HOST_TIMEOUT_NS = 500_000_000
BYTES_MAX = 300  # of the longest exchange, request and answer with escape bytes


class Wire:
    """A servo board on a line with a finite speed."""

    def __init__(self, baud: int = 115_200) -> None:
        self.byte_ns = 10_000_000_000 // baud
        self.lose: Callable[[int], bool] = lambda _: False  # True for commands whose answers are lost
        self.transport = FakeTransport(self._answer)
        self.board = FakeServo(clock=self.transport.clock)
        self.client = client_on(self.transport, baud=baud)

    def _answer(self, request: bytes) -> list[tuple[int, bytes]]:
        answer = self.board.feed(request)
        if self.lose(request[1]):
            return []
        return [((len(request) + len(answer)) * self.byte_ns, answer)]

    def commands(self) -> list[int]:
        return [command for command, _ in self.board.requests]


def application_commands(board: FakeServo) -> list[str]:
    return [name for _, name in board.host_signals]


def test_stop_is_sent_before_the_variable_table_is_read() -> None:
    wire = Wire()
    with stopped_at_connection(wire.client, CATALOGUE):
        pass
    assert [(c, p) for c, p in wire.board.requests if c != Command.GETAPPCMDSTS] == [
        (Command.GETCONFIG, b"\0PV\0"),
        (Command.GETCONFIG, b"\0NM\0"),
        (Command.SENDAPPCMD, bytes([CATALOGUE.bits["command"]["QUICK_STOP"]])),
    ]
    assert application_commands(wire.board) == ["QUICK_STOP"]


def test_another_device_gets_no_command() -> None:
    target = FakeTarget()
    client = client_on(FakeTransport(target.feed))
    with stopped_at_connection(client, CATALOGUE):
        assert client.before_exchange is None
        client.identify()
    assert Command.SENDAPPCMD not in [command for command, _ in target.requests]


def test_a_client_that_only_reads_stops_nothing() -> None:
    wire = Wire()
    assert connect(wire.client, CATALOGUE).mismatch is None
    assert wire.board.host_signals == []


@pytest.mark.parametrize("baud", [19_200, 115_200])
def test_no_host_timeout_during_discovery(baud: int) -> None:
    wire = Wire(baud)
    opened = wire.transport.clock()
    with stopped_at_connection(wire.client, CATALOGUE):
        begin = wire.transport.clock()
        assert begin - opened < 0.3e9, "already stopped"
        assert connect(wire.client, CATALOGUE).mismatch is None
        assert wire.transport.clock() - begin > HOST_TIMEOUT_NS
    assert application_commands(wire.board)[0] == "QUICK_STOP"
    assert set(application_commands(wire.board)[1:]) == {"KEEP_ALIVE"}
    assert wire.board.host_silence_ns < KEEP_ALIVE_PERIOD * 1e9 + 2 * BYTES_MAX * wire.byte_ns < HOST_TIMEOUT_NS


def test_keep_alives_end_with_the_block() -> None:
    wire = Wire()
    with stopped_at_connection(wire.client, CATALOGUE):
        connect(wire.client, CATALOGUE)
    known = len(wire.board.host_signals)
    connect(wire.client, CATALOGUE)
    assert len(wire.board.host_signals) == known


def test_keep_alives_without_an_answer_are_no_error() -> None:
    wire = Wire()
    with stopped_at_connection(wire.client, CATALOGUE):
        wire.lose = lambda command: command == Command.SENDAPPCMD
        assert connect(wire.client, CATALOGUE).mismatch is None
    assert application_commands(wire.board).count("KEEP_ALIVE") > 1
    assert wire.board.host_silence_ns < HOST_TIMEOUT_NS


def test_a_stop_without_an_answer_ends_the_attempt() -> None:
    wire = Wire()
    wire.lose = lambda command: command == Command.SENDAPPCMD
    with pytest.raises(AnswerTimeoutError), stopped_at_connection(wire.client, CATALOGUE):
        pytest.fail("a board that has not been stopped must not be used")
    assert wire.client.before_exchange is None


def test_pending_command_of_another_host_does_not_prevent_the_stop() -> None:
    """The board runs a command when its result is requested; a host that ends before leaves it pending."""
    wire = Wire()
    Client(wire.client.line).exchange(send_command(CATALOGUE.bits["command"]["KEEP_ALIVE"]))
    with stopped_at_connection(wire.client, CATALOGUE):
        pass
    assert application_commands(wire.board) == ["KEEP_ALIVE", "QUICK_STOP"]


def test_firmware_without_application_commands_is_left_to_the_comparison() -> None:
    wire = Wire()
    wire.board.commands.clear()
    wire.board.put("catalogue_hash", 1)
    with stopped_at_connection(wire.client, CATALOGUE):
        assert connect(wire.client, CATALOGUE).mismatch is not None
