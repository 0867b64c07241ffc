"""Recordings of a virtual board by the client, over the serial line in simulated time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from line_simulation import LineSimulation
from servo_bridge.bursts.recording import BurstRecording
from servo_bridge.bursts.request import Before, BurstRequest
from servo_bridge.freemaster.errors import RecorderError
from servo_bridge.wire.session import Session, connect
from servo_msgs_py.trace import Trace


@pytest.fixture
def sim() -> Iterator[LineSimulation]:
    sim = LineSimulation("ideal", 1_000_000)
    yield sim
    sim.close()


def recorded(sim: LineSimulation, session: Session, request: BurstRequest, current: float) -> Trace:
    """Record, with a current set-point after the recorder has run for some time."""
    start = sim.now
    recording = BurstRecording(request, sim.board.catalogue, clock=lambda: sim.now)
    asked = False
    while (burst := recording.step(session)) is None:
        sim.host.keep_alive()
        sim.run(recording.pause, sim.host.keep_alive)
        if not asked and sim.now > start + 0.15:
            sim.host.write("cmd.i_q", current, -current)
            asked = True
    assert recording.triggered is (request.trigger is not None)
    return burst


def test_a_step_of_the_current_is_recorded_around_its_trigger(sim: LineSimulation) -> None:
    session = connect(sim.host.client, sim.board.catalogue)
    assert session.mismatch is None
    sim.enable()
    modes = sim.board.catalogue.enums["control_mode_t"]
    sim.host.write("cmd.mode", modes["TORQUE"], modes["TORQUE"])
    names = ("tick", "axis1.i_q_ref", "axis1.i_q", "axis2.i_q")
    request = BurstRequest(names, trigger="axis1.i_q_ref > 0.5", before=Before(part=0.3), points=200, rate=8000.0)
    burst = recorded(sim, session, request, 1.0)
    tick, reference, i_q, other = burst.columns.values()
    assert [burst.head(name) for name in burst.columns][1:3] == ["axis1.i_q_ref [A]", "axis1.i_q [A]"]
    assert burst.time == pytest.approx((np.arange(200) - 60) * 125e-6)
    assert set(np.diff(tick.astype(np.int64))) == {2}
    assert reference[59] <= 0.5 < reference[60]
    assert np.mean(i_q[100:]) == pytest.approx(1.0, abs=0.05)
    assert np.mean(other[100:]) == pytest.approx(-1.0, abs=0.05)


def test_too_many_samples_are_refused_with_the_maximum(sim: LineSimulation) -> None:
    session = connect(sim.host.client, sim.board.catalogue)
    with pytest.raises(RecorderError, match=r"5000 points of 2 variable\(s\) do not fit .* \d+ points fit"):
        recorded(sim, session, BurstRequest(("tick", "u_dc"), points=5000), 0.0)
    burst = recorded(sim, session, BurstRequest(("tick", "u_dc"), recorder=1, points=50), 0.0)
    assert set(np.diff(burst["tick"].astype(np.int64))) == {8}
    assert burst.time[1] == pytest.approx(500e-6)
