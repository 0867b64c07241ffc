"""Fault record with known currents: from the virtual board over a pty to ``servo-tool`` and a topic of the bridge."""

from __future__ import annotations

import json
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chain import Chain, User, ros_user
from servo_msgs_py.convert import snapshot_table
from servo_msgs_py.fault_record import COLUMNS, FaultRecord
from servo_msgs_py.runtime.qos import latched_qos
from servo_twin.board import Board
from servo_twin.fault_injection import ShortedPhase, StuckConverter
from servo_twin.simulation import enable
from servo_twin.validation.experiments.named_faults import fault_record
from servo_twin.virtual_board import Pacer, Terminal, serve
from std_msgs.msg import Float64MultiArray

from servo_msgs_py import topics

pytestmark = pytest.mark.realtime

TOPIC = "/servo/" + topics.fault_record_topic("axis1")
SHORT = ShortedPhase(0, "a")
STUCK = StuckConverter(0, "b", 2100)
I_Q = 1.2


class Bench:
    """A board that a thread runs in real time; a test can act on it.

    Parameters
    ----------
    board : Board
        Board after a run in simulated time, which is reproducible.
    port : Path
        Name of its pty.
    """

    def __init__(self, board: Board, port: Path) -> None:
        self._board = board
        self._actions: deque[Callable[[Board], Any]] = deque()
        self._end = threading.Event()
        self._line = Terminal(port)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        pacer = Pacer(time.monotonic_ns(), self._board.time_ns)
        serve(self._board, self._line, pacer, self._stopped)

    def _stopped(self) -> bool:
        while self._actions:
            self._actions.popleft()(self._board)
        return self._end.is_set()

    def do(self, action: Callable[[Board], Any]) -> None:
        """Call a function in the thread of the board, and wait for its end."""
        done = threading.Event()

        def act(board: Board) -> None:
            action(board)
            done.set()

        self._actions.append(act)
        assert done.wait(20.0)

    def close(self) -> None:
        self._end.set()
        self._thread.join(20.0)
        self._line.close()


@pytest.fixture
def chain(tmp_path: Path) -> Iterator[Chain]:
    chain = Chain(tmp_path)
    yield chain
    chain.end()


@pytest.fixture
def board() -> Iterator[Board]:
    """A board after an over-current of axis 1 with a blocked shaft and a current of `I_Q`."""
    with Board(seed=4) as board:
        enable(board)
        board.lock_shaft(0)
        board.write("cmd.mode", [2, 2])
        board.write("cmd.i_q", [I_Q, 0.0])
        board.run(0.05)
        board.inject(SHORT)
        board.run(0.005)
        board.clear_fault(SHORT)
        yield board


@pytest.fixture
def record(board: Board) -> FaultRecord:
    return fault_record(board, 0)


@pytest.fixture
def bench(board: Board, record: FaultRecord, chain: Chain) -> Iterator[Bench]:
    bench = Bench(board, chain.port)
    yield bench
    bench.close()


def table(message: Float64MultiArray) -> list[list[float]]:
    names, rows = snapshot_table(message)
    assert tuple(names) == COLUMNS
    values: list[list[float]] = rows.tolist()
    return values


def listen(user: User) -> list[Any]:
    messages: list[Any] = []
    user.node.create_subscription(Float64MultiArray, TOPIC, messages.append, latched_qos())
    return messages


@pytest.mark.usefixtures("bench")
def test_servo_tool_prints_the_currents_before_the_fault(chain: Chain, board: Board, record: FaultRecord) -> None:
    (seen,) = json.loads(chain.tool("snapshot", "--json"))
    assert (seen["axis"], seen["fault"], seen["state"]) == ("axis1", "OVER_CURRENT", "RUN/SPIN")
    assert seen["samples"] == record.table.tolist()
    before = np.array(seen["samples"])[:-1, :]
    noise = 7.5 * board.plant.axes[0].i_noise
    np.testing.assert_allclose(before[:, COLUMNS.index("i_q")], I_Q, atol=noise)
    np.testing.assert_allclose(before[:, COLUMNS.index("i_d")], 0.0, atol=noise)
    theta = 2.0 * board.truth(0).theta_m
    assert before[:, COLUMNS.index("i_a")].mean() == pytest.approx(-I_Q * math.sin(theta), abs=0.02)


def test_topic_has_the_first_fault_until_it_is_cleared(chain: Chain, bench: Bench, record: FaultRecord) -> None:
    """A second fault does not replace it; later subscribers receive it; the next fault after clearing is published."""
    chain.bridge()
    with ros_user() as first:
        messages = listen(first)
        first.until(first.connected, 30.0, "no bridge")
        first.until(lambda: messages, what="no record")
        assert table(messages[0]) == record.table.tolist()
        assert messages[0].layout.dim[0].label == record.summary()
        bench.do(lambda board: board.inject(STUCK))
        first.until(
            lambda: "CURRENT_SENSE" in first.status("servo/servo_bridge: axis1").message, what="no second fault"
        )
        first.wait_board_time(0.5)  # longer than the second read takes
        assert len(messages) == 1
        with ros_user() as later:
            late = listen(later)
            later.until(lambda: late, what="nothing latched")
            assert late == messages
        bench.do(lambda board: board.clear_fault(STUCK))
        first.until(lambda: first.clear_faults()[0], 30.0, "not cleared")
        first.until(lambda: "STOP" in first.last("/servo/state"), what="not cleared")
        bench.do(lambda board: board.set_supply(36.0))
        first.until(lambda: len(messages) == 2, what="no record of the next fault")
        assert messages[1].layout.dim[0].label.startswith("first fault OVER_VOLTAGE in STOP")
        assert table(messages[1])[-1][COLUMNS.index("u_dc")] > 32.5
