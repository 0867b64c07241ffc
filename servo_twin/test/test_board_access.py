"""Measurements' access to a virtual board in simulated time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from servo_measurement.access import (
    RECORDER_BYTES,
    Capture,
    MeasurementError,
    faults_refused,
    refuse_faults,
)
from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.axis_config_transfer import BlockRefusedError, read_block, send_configuration
from servo_msgs_py.units import PERIOD_NS, SLOW_PERIODS
from servo_twin.board import Board
from servo_twin.board_access import VirtualBoardAccess
from servo_twin.simulation import enable
from servo_twin.validation.experiments.named_faults import fault_record


@pytest.fixture(params=["ideal", "registers"])
def access(request: pytest.FixtureRequest) -> Iterator[VirtualBoardAccess]:
    with Board(level=request.param, seed=2) as board:
        board.run(0.1)
        yield VirtualBoardAccess(board)


def test_values_are_si_and_elements_are_written_separately(access: VirtualBoardAccess) -> None:
    access.write("param.i_q_limit", [1.0, 2.0])
    access.write("param.i_q_limit", [1.5], 1)
    assert access.read("param.i_q_limit") == pytest.approx([1.0, 1.5], abs=3e-4)
    with pytest.raises(ValueError, match=r"param.i_q_limit: 99 is outside"):
        access.write("param.i_q_limit", [99.0])
    with pytest.raises(ValueError, match=r"has 2 element"):
        access.write("param.i_q_limit", [1.0, 1.0], 1)
    with pytest.raises(ValueError, match="can only be read"):
        access.write("axis1.i_q", [1.0])


def test_samples_have_the_requested_period(access: VirtualBoardAccess) -> None:
    recording = access.record(Capture(["tick"], 50, 4, slow=False))
    assert recording.step == pytest.approx(4 * PERIOD_NS * 1e-9)
    assert np.diff(recording["tick"]).tolist() == [4.0] * 49
    assert recording.time[-1] == pytest.approx(49 * recording.step)
    recording = access.record(Capture(["tick", "u_dc"], 20, 3, slow=True))
    assert np.diff(recording["tick"]).tolist() == [3.0 * SLOW_PERIODS] * 19
    assert recording["u_dc"].mean() == pytest.approx(24.0, abs=1.0)


def test_recording_starts_at_its_trigger(access: VirtualBoardAccess) -> None:
    def start() -> None:
        access.wait(0.0)
        access.write("cmd.enable", [1.0], 0)

    recording = access.record(
        Capture(["tick", "axis1.event_state"], 10, 1, slow=True, start=start, trigger="axis1.event_state")
    )
    event = recording["axis1.event_state"]
    assert event[0] > 0.0
    assert access.capacity(["tick", "axis1.event_state"]) == RECORDER_BYTES // 6
    with pytest.raises(MeasurementError, match="no trigger within"):
        access.record(Capture(["tick"], 10, 1, slow=True, trigger="axis2.event_mode"))
    with pytest.raises(MeasurementError, match="write one element"):
        access.record(Capture(["cmd.i_q"], 10, 1, slow=True))
    with pytest.raises(MeasurementError, match="is not a variable"):
        access.record(Capture(["axis3.i_q"], 10, 1, slow=True))


def test_event_of_a_command_is_at_the_tick_of_its_effect(access: VirtualBoardAccess) -> None:
    enable(access.board)
    speed = access.catalogue.enums["control_mode_t"]["SPEED"]
    names = ["tick", "axis2.event_mode", "axis2.mode"]
    recording = access.record(
        Capture(
            names, 10, 1, slow=False, start=lambda: access.write("cmd.mode", [speed], 1), trigger="axis2.event_mode"
        )
    )
    assert recording["tick"][0] == access.board.read_words("applied_tick")[0]
    assert recording["axis2.mode"].tolist() == [speed] * 10


def test_first_fault_is_at_the_tick_of_its_record(access: VirtualBoardAccess) -> None:
    recording = access.record(
        Capture(
            ["tick", "axis1.first_fault"],
            10,
            1,
            slow=False,
            start=lambda: access.board.set_supply(36.0),
            trigger="axis1.first_fault",
        )
    )
    assert set(recording["axis1.first_fault"]) == {access.catalogue.flag("faults", "OVER_VOLTAGE").mask.bit_length()}
    record = fault_record(access.board, 0)
    assert 0 <= recording["tick"][0] - record.tick <= 1


def test_fault_is_reported_with_its_remedy(access: VirtualBoardAccess) -> None:
    refuse_faults(access, 0)
    access.board.connect_encoder(0, False)
    access.write("cmd.enable", [1.0], 0)
    with pytest.raises(MeasurementError, match=r"axis1 has a fault\. \w+: .+\. .+"), faults_refused(access, 0):
        access.record(Capture(["tick"], 1000, 8, slow=True))
    refuse_faults(access, 1)


def test_configuration_blocks_are_taken_together(access: VirtualBoardAccess) -> None:
    blocks = {axis: read_block(access, axis) for axis in (0, 1)}
    changed = {axis: {**block, "position_gain": block["position_gain"] // 2} for axis, block in blocks.items()}
    taken = send_configuration(access, changed)
    table = AxisConfigTable.load()
    assert taken.checksums == tuple(table.checksum(axis, block) for axis, block in changed.items())
    assert read_block(access, 1) == changed[1]
    access.board.write("cmd.enable", [1, 1])
    access.wait(0.2)
    with pytest.raises(BlockRefusedError, match="at standstill"):
        send_configuration(access, {0: {**blocks[0], "torque_constant": blocks[0]["torque_constant"] // 2}})
