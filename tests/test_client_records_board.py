"""The client's recording of a virtual board, over its serial line in simulated time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from line_world import World
from servo_bridge.bursts.burst import Burst
from servo_bridge.bursts.recording import Recording
from servo_bridge.bursts.request import Before, BurstRequest
from servo_bridge.freemaster.errors import RecorderError
from servo_bridge.wire.session import Session, connect


@pytest.fixture
def world() -> Iterator[World]:
    world = World("ideal", 1_000_000)
    yield world
    world.close()


def recorded(world: World, session: Session, request: BurstRequest, current: float) -> Burst:
    """Record, and ask for a current when the recorder has run for a while."""
    start = world.now
    recording = Recording(request, world.board.catalogue, clock=lambda: world.now)
    asked = False
    while (burst := recording.step(session)) is None:
        world.host.keep_alive()
        world.run(recording.pause, world.host.keep_alive)
        if not asked and world.now > start + 0.15:
            world.host.write("cmd.i_q", current, -current)
            asked = True
    assert recording.triggered is (request.trigger is not None)
    return burst


def test_a_step_of_the_current_is_recorded_around_its_trigger(world: World) -> None:
    session = connect(world.host.client, world.board.catalogue)
    assert session.mismatch is None
    world.enable()
    modes = world.board.catalogue.enums["control_mode_t"]
    world.host.write("cmd.mode", modes["TORQUE"], modes["TORQUE"])
    names = ("tick", "axis1.i_q_ref", "axis1.i_q", "axis2.i_q")
    request = BurstRequest(names, trigger="axis1.i_q_ref > 0.5", before=Before(part=0.3), points=200, rate=8000.0)
    burst = recorded(world, session, request, 1.0)
    tick, reference, i_q, other = burst.values
    assert [channel.head for channel in burst.channels][1:3] == ["axis1.i_q_ref [A]", "axis1.i_q [A]"]
    assert burst.times == pytest.approx((np.arange(200) - 60) * 125e-6)
    assert set(np.diff(tick.astype(np.int64))) == {2}
    assert reference[59] <= 0.5 < reference[60]
    assert np.mean(i_q[100:]) == pytest.approx(1.0, abs=0.05)
    assert np.mean(other[100:]) == pytest.approx(-1.0, abs=0.05)


def test_what_does_not_fit_is_refused_with_what_does(world: World) -> None:
    session = connect(world.host.client, world.board.catalogue)
    with pytest.raises(RecorderError, match=r"5000 points of 2 variable\(s\) do not fit .* \d+ points fit"):
        recorded(world, session, BurstRequest(("tick", "u_dc"), points=5000), 0.0)
    burst = recorded(world, session, BurstRequest(("tick", "u_dc"), recorder=1, points=50), 0.0)
    assert set(np.diff(burst.values[0].astype(np.int64))) == {8}
    assert burst.times[1] == pytest.approx(500e-6)


def test_the_log_of_the_board_comes_through_its_pipe(world: World) -> None:
    pipe = world.host.client.pipe()
    text = b""
    world.enable()
    for _ in range(50):
        world.run(0.005, world.host.keep_alive)
        text += pipe.exchange()[0]
    lines = text.decode("ascii").splitlines()
    assert lines[0] == "0 reset"
    assert "axis1 RUN/ALIGN" in " ".join(lines)
    ticks = [int(line.split()[0]) for line in lines]
    assert ticks == sorted(ticks)
