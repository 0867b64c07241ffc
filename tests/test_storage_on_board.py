"""Storage in the data flash of a board, by the command line and over ROS, and the twin of such a board."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pytest
from chain import FAST_BAUD, Chain, User, ros_user, wait_for
from diagnostic_msgs.msg import DiagnosticStatus
from line_simulation import SimulatedLine
from sensor_msgs.msg import JointState
from servo_bridge.freemaster.client import Client
from servo_bridge.freemaster.commands import write_memory
from servo_bridge.freemaster.line import Line
from servo_bridge.tuning.plan import computed
from servo_bridge.wire.session import connect
from servo_bridge.wire.session_port import SessionPort
from servo_msgs_py.blocks_message import blocks_message
from servo_msgs_py.board_storage import StorageRefusedError, begin_request, execute_request
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.runtime.qos import latched_qos
from servo_twin.board import Board
from servo_twin.level import Level
from std_msgs.msg import Int64MultiArray
from std_srvs.srv import Trigger
from test_tune_on_board import BAUD, ToolBench, edited

from servo_msgs_py import topics

COPY_B: Final = 4 * (28 + 2) * 256
"""Offset of copy B in an image of the flash [bytes]."""


# ---- the tool, in simulated time -----------------------------------------------------------------------------------


@pytest.fixture
def bench() -> Iterator[ToolBench]:
    with Board(level="ideal", baud=BAUD, seed=4) as board:
        board.run(0.1)
        yield ToolBench(board)


def test_values_are_stored_listed_and_erased(bench: ToolBench, capsys: pytest.CaptureFixture[str]) -> None:
    assert bench.tool("info") == 0
    assert "built-in values since the reset; nothing stored" in capsys.readouterr().out
    for number in (1, 2):
        assert bench.tool("save", "--to-board") == 0
        assert f"stored as set {number}; restored at each reset" in capsys.readouterr().out
    assert bench.tool("info") == 0
    assert "newest set 2" in capsys.readouterr().out
    assert bench.tool("factory") == 0
    assert "the built-in values are used from the next reset on" in capsys.readouterr().out
    assert bench.raw("storage.sequence") == [0]


class LossyAnswerLine(SimulatedLine):
    """Line that loses the next `lose` answers."""

    lose = 0

    def read(self, deadline: int) -> bytes:
        data = super().read(deadline)
        if data and self.lose:
            self.lose -= 1
            self.advance(deadline)
            self.board.serial_out()
            return b""
        return data


def test_request_with_a_lost_answer_is_executed_once() -> None:
    """The client repeats it; the board recognises its token."""
    with Board(level="ideal", baud=BAUD, seed=4) as board:
        board.run(0.1)
        line = LossyAnswerLine(board)
        session = connect(Client(Line(line, baud=BAUD, clock=line.clock, retries=3)), Catalogue.load())
        memory = SessionPort(session)
        written: list[str] = []
        write = memory.write_words

        def write_words(name: str, words: Sequence[int], first: int = 0) -> bool:
            line.lose = 2
            written.append(name)
            return write(name, words, first)

        memory.write_words = write_words  # type: ignore[method-assign]
        requests = board.read("storage.saves")
        for number in (1, 2):
            assert execute_request(memory, "SAVE").sequence == number
        assert line.lose == 0
        assert written == ["storage.request"] * 2
        assert board.read("storage.saves") == 2
        assert requests == 0
        board.write("cmd.enable", [1, 0])
        board.run(0.01)
        with pytest.raises(StorageRefusedError, match="moving or enabled"):
            execute_request(memory, "SAVE")


@pytest.mark.parametrize("level", ["ideal", "registers"])
def test_no_byte_is_lost_during_an_erase(level: Level) -> None:
    """A write that takes 14 ms on the line is processed after the erase."""
    with Board(level=level) as board:
        board.run(0.1)
        begin_request(board, "SAVE")
        board.run(0.0005)
        board.serial_in(write_memory(board.address("cmd.points"), bytes(128)).frame)
        board.run(0.0134)
        assert board.serial_out() == b""
        assert board.read("point_refusal") == 0
        board.run(0.01)
        assert board.serial_out()[:1] == b"+"
        assert board.read("point_refusal") != 0, "points with zeros only are refused, but have been received"
        assert board.read("receiver_overruns") == 0


def test_invalid_command_lines_are_refused(bench: ToolBench, tmp_path: Path) -> None:
    from servo_bridge.tool_values import UsageError

    for arguments in (("save",), ("save", "--to-board", str(tmp_path / "a.toml"))):
        with pytest.raises(UsageError, match="write a FILE"):
            bench.tool(*arguments)


# ---- over ROS ------------------------------------------------------------------------------------------------------


class StorageClient:
    """ROS client of the storage services."""

    def __init__(self, user: User) -> None:
        self.user = user
        self._clients = {
            name: user.node.create_client(Trigger, f"/servo/{name}")
            for name in (topics.SAVE_TO_BOARD, topics.RESTORE_FACTORY)
        }

    def call(self, name: str) -> tuple[bool, str]:
        client = self._clients[name]
        self.user.until(client.service_is_ready, 20.0)
        return self.user.call(client, Trigger.Request())

    def status(self) -> DiagnosticStatus:
        return self.user.status("servo/servo_bridge: storage")

    def until_status(self, text: str) -> DiagnosticStatus:
        self.user.until(lambda: text in self.status().message, 20.0, text)
        return self.status()


@pytest.mark.slow
@pytest.mark.realtime
def test_services_diagnostics_and_the_twin_of_a_board_with_stored_values(tmp_path: Path) -> None:
    chain, flash = Chain(tmp_path, FAST_BAUD, level="ideal"), tmp_path / "flash.bin"
    with ros_user() as user:
        storage = StorageClient(user)
        user.listen("/servo/tuning", Int64MultiArray, latched_qos())
        try:
            board = chain.board(flash=flash)
            gains = edited(tmp_path, "gains.toml", control={"position_gain": 50.0, "speed_bandwidth": 60.0})
            chain.tool("tune", str(gains))
            chain.tool("set", "param.speed_limit", "60,80")
            chain.bridge(telemetry_rate=130.0)
            user.until(user.connected, 30.0, "the bridge is not connected")
            storage.until_status("built-in values since the reset; nothing stored")

            success, message = storage.call(topics.SAVE_TO_BOARD)
            assert success, message
            assert message.startswith("stored as set 1")
            board.kill()
            user.until(lambda: not user.connected(), 20.0, "the board is still there")
            chain.board(flash=flash)
            chain.twin()
            user.until(user.connected, 30.0, "the bridge is not connected again")
            assert storage.until_status("values of copy A since the reset; newest set 1").level == DiagnosticStatus.OK
            stored = blocks_message(computed(gains, Catalogue.load()).blocks).data
            user.until(lambda: user.last("/servo/tuning") == stored, 30.0, "the gains are not known")
            user.until(lambda: user.last("/twin/healthy") is True, 30.0, "the twin is not healthy")

            user.enable_axes()
            assert storage.call(topics.SAVE_TO_BOARD) == (False, _AT_REST)
            user.until(lambda: user.last("/twin/healthy") is True, 30.0, "the twin is not healthy while both hold")
            start = len(user.messages["/twin/residual"])
            user.joint_commands.publish(JointState(name=["axis1", "axis2"], position=[30.0, -30.0]))
            user.until(lambda: abs(user.position_of(0) - 30.0) < 0.01, 20.0, "not there")
            residuals = [message.position for message in user.messages["/twin/residual"][start:]]
            assert len(residuals) > 20
            assert float(np.abs(residuals).max()) < 0.05, "another gain would differ by more than half a radian"
            rows = [row["axis1.speed"] for row in user.rows() if "axis1.speed" in row]
            assert 55.0 < max(rows) < 65.0

            user.enable(False)
            user.until(lambda: user.last("/servo/state") == "axis1=STOP axis2=STOP", 20.0)
            success, message = storage.call(topics.SAVE_TO_BOARD)
            assert (success, message.startswith("stored as set 2")) == (True, True), message
        finally:
            chain.end()
        image = bytearray(flash.read_bytes())
        image[COPY_B + 200] ^= 0x01
        flash.write_bytes(image)
        chain = Chain(tmp_path, FAST_BAUD, level="ideal")
        try:
            chain.board(flash=flash)
            chain.bridge(telemetry_rate=130.0)
            status = storage.until_status("copy B is damaged")
            assert status.level == DiagnosticStatus.WARN
            assert {value.key: value.value for value in status.values} == {
                "newest set": "1",
                "values since the reset": "COPY A",
                "copy A": "INTACT",
                "copy B": "DAMAGED",
            }
            success, message = storage.call(topics.RESTORE_FACTORY)
            assert success, message
            assert storage.until_status("nothing stored").level == DiagnosticStatus.OK
            wait_for(lambda: set(flash.read_bytes()[4 * 28 * 256 : 4 * 32 * 256]) == {0xFF}, 5.0)
        finally:
            chain.end()
            print(chain.logs())


_AT_REST: Final = (
    "an axis is moving or enabled. Disable both axes, wait for standstill and try again. The stored values "
    "are unchanged"
)
