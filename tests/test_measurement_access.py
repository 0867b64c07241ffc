"""Access of measurements to a board over its serial line, compared with direct access to the board."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import pytest
from line_simulation import SimulatedLine
from servo_bridge.freemaster.client import Client
from servo_bridge.freemaster.line import Line
from servo_bridge.measurement_access import SessionAccess, measurement_access
from servo_bridge.wire.session import connect
from servo_measurement.access import Capture, MeasurementError, faults_refused
from servo_msgs_py.axis_config_transfer import read_block, send_configuration
from servo_msgs_py.catalogue import Catalogue
from servo_twin.board import Board
from servo_twin.board_access import VirtualBoardAccess

BAUD: Final = 115_200


@pytest.fixture
def board() -> Iterator[Board]:
    with Board(level="ideal", baud=BAUD, seed=2) as board:
        board.run(0.1)
        yield board


@pytest.fixture
def access(board: Board) -> Iterator[SessionAccess]:
    line = SimulatedLine(board)
    session = connect(Client(Line(line, baud=BAUD, clock=line.clock)), Catalogue.load())
    with measurement_access(session) as access:
        yield access


def test_values_and_blocks_agree_with_the_board(board: Board, access: SessionAccess) -> None:
    inside = VirtualBoardAccess(board)
    access.write("param.i_q_limit", [1.0, 2.0])
    access.write("param.i_q_limit", [1.5], 1)
    assert access.read("param.i_q_limit") == inside.read("param.i_q_limit") == pytest.approx([1.0, 1.5], abs=3e-4)
    with pytest.raises(ValueError, match="can only be read"):
        access.write("axis1.i_q", [1.0])
    block = read_block(access, 1)
    changed = {**block, "position_gain": block["position_gain"] // 2}
    send_configuration(access, {1: changed})
    assert read_block(inside, 1) == changed
    assert access.capacity(["tick", "axis1.i_q"]) == inside.capacity(["tick", "axis1.i_q"]) == 1280


def test_enabled_axis_has_no_host_time_out(board: Board, access: SessionAccess) -> None:
    access.write("cmd.enable", [1.0, 1.0])
    access.wait(3.0)
    names = ("tick", "axis1.i_q")
    with faults_refused(access, 0):
        recording = access.record(Capture(names, access.capacity(names), 2, slow=True))
    assert np.all(np.diff(recording["tick"]) == 16.0)
    assert recording.step == pytest.approx(1e-3)
    assert board.read("axis1.state") == board.catalogue.enums["state_t"]["RUN"]
    assert board.read("axis1.faults") == 0


def test_recording_starts_at_its_trigger(access: SessionAccess) -> None:
    def start() -> None:
        access.write("cmd.enable", [1.0], 0)

    names = ("tick", "axis1.event_state", "axis1.i_d")
    recording = access.record(Capture(names, 400, 1, slow=False, start=start, trigger="axis1.event_state"))
    assert recording["axis1.event_state"][0] == 64.0
    assert np.diff(recording["tick"]).tolist() == [1.0] * 399
    with pytest.raises(MeasurementError, match="has not started"):
        access.record(Capture(names, 400, 1, slow=False, trigger="axis2.event_mode"))
    assert access.record(Capture(["tick"], 10, 1, slow=True))["tick"].size == 10
    with pytest.raises(MeasurementError, match="axis3"):
        access.record(Capture(["axis3.i_q"], 10, 1, slow=False))


def test_recorder_starts_before_the_recorded_action(board: Board, access: SessionAccess) -> None:
    """The memory of the recorder is filled meanwhile, so that no sample after the trigger is lost."""
    begun = []

    def start() -> None:
        begun.append(board.time_ns * 1e-9)
        access.wait(0.5)
        access.write("cmd.enable", [float(len(begun) == 1)], 0)

    names, waited = ("tick", "axis1.event_state"), []
    for lead in (0.0, 0.5):
        asked = board.time_ns * 1e-9
        recording = access.record(
            Capture(names, 1280, 1, slow=True, start=start, trigger="axis1.event_state", lead=lead)
        )
        assert recording["axis1.event_state"][0] > 0.0
        assert np.diff(recording["tick"]).tolist() == [8.0] * 1279
        waited.append(begun[-1] - asked)
    assert waited[0] - waited[1] == pytest.approx(0.5, abs=0.05)
