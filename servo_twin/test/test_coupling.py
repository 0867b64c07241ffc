"""A board coupled with another simulator: by a torque on its shaft, or by a shaft that the other one moves."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import pytest
from servo_msgs_py.units import PERIOD_NS
from servo_twin.board import Board, BoardError
from servo_twin.plant import PlantConfig
from servo_twin.simulation import enable

PERIOD: Final = PERIOD_NS * 1e-9
AXIS: Final = 0

pytestmark = pytest.mark.usefixtures("level")


def plant(**changes: float) -> PlantConfig:
    return PlantConfig.load().with_axis(AXIS, **changes)


def turning(board: Board, speed: float = 60.0) -> None:
    """Axis 1 turns under control without friction, at an instant that begins a PWM period.

    The rotor search is before: without friction the shaft swings too long for it, in one of five searches.
    """
    enable(board)
    board.set_plant("axis1.friction", 0.0)
    board.write("cmd.mode", [1, 1])
    board.write("cmd.speed", [speed, 0.0])
    board.run(0.3)
    board.advance(-(-board.time_ns // PERIOD_NS) * PERIOD_NS)


def test_energy_of_an_external_torque_is_balanced() -> None:
    """Work of load and air gap against kinetic energy and viscous loss, within 0.1 % of what was exchanged."""
    with Board(seed=4) as board:
        turning(board)
        shaft = board.plant.axes[AXIS]
        start = before = board.truth(AXIS)
        work = loss = exchanged = 0.0
        for step in range(2000):
            load = 0.05 * math.sin(2.0 * math.pi * 25.0 * step * PERIOD)
            board.set_load(AXIS, load)
            board.advance(board.time_ns + PERIOD_NS)
            now = board.truth(AXIS)
            rotation = now.theta_m - before.theta_m
            from_outside = -load * rotation
            work += from_outside + (now.impulse_e - before.impulse_e) / PERIOD * rotation
            loss += shaft.viscous * 0.5 * (now.omega_m + before.omega_m) * rotation
            exchanged += abs(from_outside)
            before = now
        kinetic = 0.5 * shaft.inertia * (before.omega_m**2 - start.omega_m**2)
        assert work == pytest.approx(kinetic + loss, abs=1e-3 * exchanged)


def test_driven_shaft_follows_the_motion_and_the_encoder_sees_it() -> None:
    with Board(seed=4) as board:
        board.run(0.01)
        start = board.truth(AXIS).theta_m
        step_ns = 16 * PERIOD_NS
        before = board.read_words("axis1.position")[0]
        for k in range(1, 201):
            t = k * step_ns * 1e-9
            theta, omega = start + 3.0 * (1.0 - math.cos(20.0 * t)), 60.0 * math.sin(20.0 * t)
            board.drive_shaft(AXIS, theta, omega, step_ns * 1e-9)
            board.advance(board.time_ns + step_ns)
            truth = board.truth(AXIS)
            assert truth.theta_m == pytest.approx(theta, abs=2e-6)  # linear within a period at level `registers`
            assert truth.omega_m == pytest.approx(omega, abs=0.1)  # the mean of the last step of the plant
        board.run(0.01)
        moved = board.truth(AXIS).theta_m - start
        lsb = float(board.catalogue["axis1.position"].lsb)
        assert (board.read_words("axis1.position")[0] - before) * lsb == pytest.approx(moved, abs=0.005)


@pytest.mark.parametrize("periods", [1, 8])
def test_host_that_owns_the_inertia_gets_the_same_motion(periods: int) -> None:
    """A host with rotor and friction of the plant, in steps of up to 0.5 ms, against the board's own rotor."""
    with Board(seed=4) as board:
        turning(board)
        shaft = board.plant.axes[AXIS]
        driven = board.copy()
        first = driven.truth(AXIS)
        theta, omega, impulse = first.theta_m, first.omega_m, first.impulse_e
        step = periods * PERIOD
        torque = shaft.viscous * omega
        free, coupled = [], []
        for one in (board, driven):
            one.write("cmd.speed", [-40.0, 0.0])
        for _ in range(3200 // periods):
            omega_1 = omega + step * (torque - shaft.viscous * omega) / shaft.inertia
            theta, omega = theta + 0.5 * step * (omega + omega_1), omega_1
            driven.drive_shaft(AXIS, theta, omega, step)
            for one in (board, driven):
                one.advance(one.time_ns + periods * PERIOD_NS)
            after = driven.truth(AXIS).impulse_e
            torque, impulse = (after - impulse) / step, after
            free.append(board.truth(AXIS).theta_m)
            coupled.append(driven.truth(AXIS).theta_m)
        difference = np.abs(np.array(free) - np.array(coupled))
        assert difference.max() < 0.02 * periods  # of 12 rad; the torque is late by one step
        last = 320 // periods  # 20 ms: the speed ripples by more than 1 rad/s
        speeds = [(angles[-1] - angles[-1 - last]) / (last * step) for angles in (free, coupled)]
        assert speeds[1] == pytest.approx(speeds[0], abs=0.5)


def test_nothing_mechanical_of_the_plant_acts_on_a_driven_shaft() -> None:
    """Load, friction and end stops change nothing but the lengths of integration steps."""
    rough = plant(friction=0.01, viscous=1e-3, load_torque=0.1, stop_stiffness=0.1, stop_max=0.2)
    truths = []
    for one in (plant(), rough):
        with Board(seed=4) as board:
            board.drive_shaft(AXIS, board.truth(AXIS).theta_m + 16.0, 800.0, 0.04)
            board.take_plant(one)
            board.run(0.06)
            truths.append(board.truth(AXIS))
    assert truths[0].impulse_e < -1e-5  # the motor charges the bus through the diodes
    assert truths[0].theta_m == pytest.approx(truths[1].theta_m, abs=1e-9)
    assert truths[0].impulse_e == pytest.approx(truths[1].impulse_e, rel=1e-6)


def test_released_shaft_keeps_its_motion() -> None:
    with Board(plant(friction=0.0, viscous=0.0), seed=4) as board:
        board.connect_motor(AXIS, False)
        board.run(0.01)
        board.drive_shaft(AXIS, board.truth(AXIS).theta_m + 0.5, 50.0, 0.02)
        board.run(0.02)
        board.release_shaft(AXIS)
        board.set_load(AXIS, 0.001)
        board.run(0.01)
        slower = 0.001 * 0.01 / board.plant.axes[AXIS].inertia
        assert board.truth(AXIS).omega_m == pytest.approx(50.0 - slower, rel=1e-6)


def test_driven_shaft_belongs_to_the_state() -> None:
    with Board(seed=4) as board:
        board.run(0.01)
        board.drive_shaft(AXIS, 1.0, 20.0, 0.05)
        board.run(0.013)
        copy = board.copy()
        for one in (board, copy):
            one.advance(50_000_000)
        assert copy.state() == board.state()


@pytest.mark.parametrize("ratio", [0.5, 1.0, 10.0])  # of the true inertia to the given one
def test_brake_holds_a_driven_shaft_and_slips_at_its_torque(ratio: float) -> None:
    """The host is a semi-implicit Euler integrator of one inertia."""
    given, step_ns, limit = 1e-4, 16 * PERIOD_NS, 0.1
    step = step_ns * 1e-9
    with Board(PlantConfig.load().with_value("axis1.pins.brake_torque", limit), seed=4) as board:
        board.run(0.01)
        board.connect_motor(AXIS, False)
        theta, omega, torque = board.truth(AXIS).theta_m, 0.0, 0.0
        held, ends = theta + 0.5 * limit / (ratio * given) * step**2, []  # the first step is without the brake
        for load in (0.5 * limit, 1.2 * limit, 0.0):
            for _ in range(600):
                omega += (torque + load) / (ratio * given) * step
                theta += omega * step
                board.drive_shaft(AXIS, theta, omega, step)
                board.advance(board.time_ns + step_ns)
                torque = board.brake_torque(AXIS, given, step)
                assert abs(torque) <= limit
            ends.append((theta, omega))
        assert ends[0][0] == pytest.approx(held + 0.5 * limit / (0.086 * given / step**2), abs=1e-7)
        assert ends[1][1] == pytest.approx(0.2 * limit / (ratio * given) * 600 * step, rel=0.03)
        assert (ends[0][1], ends[2][1]) == pytest.approx((0.0, 0.0), abs=1e-5)
        board.release_shaft(AXIS)
        board.drive_shaft(AXIS, theta - 1.0, 0.0, step)
        board.advance(board.time_ns + step_ns)
        assert board.brake_torque(AXIS, given, step) == 0.0  # it holds where it was closed anew


@pytest.mark.parametrize(("inertia", "seconds"), [(math.nan, 1e-3), (0.0, 1e-3), (math.inf, 1e-3), (1e-4, math.nan)])
def test_brake_of_no_inertia_or_time_is_refused(inertia: float, seconds: float) -> None:
    with Board(seed=4) as board, pytest.raises(BoardError, match=r"axis1: .* both are above 0 and finite"):
        board.brake_torque(AXIS, inertia, seconds)


def test_end_stop_at_no_distance_is_refused() -> None:
    with Board(seed=4) as board, pytest.raises(BoardError, match="axis1: end stops 1 and nan rad"):
        board.obstruct_shaft(AXIS, 1.0, math.nan)


@pytest.mark.parametrize(
    ("motion", "changes", "message"),
    [
        ((math.nan, 0.0, 0.001), {}, "axis1: the motion is not a number"),
        ((0.0, math.inf, 0.001), {}, "axis1: the motion is not a number"),
        ((100.0, 0.0, 0.001), {}, "faster than 2000 rad/s"),
        ((0.0, 0.0, 0.0), {}, "time of the motion is not above 0"),
        ((0.0, 0.0, 0.01), {"load_inertia": 1e-5, "shaft_stiffness": 1.0}, "has a second mass"),
    ],
)
def test_motion_that_cannot_be_is_refused(
    motion: tuple[float, float, float], changes: dict[str, float], message: str
) -> None:
    with Board(plant(**changes), seed=4) as board, pytest.raises(BoardError, match=message):
        board.drive_shaft(AXIS, *motion)


@pytest.mark.parametrize("torque", [100.0, -1e5, 1e9, -1e300])
def test_torque_beyond_any_motor_ends_the_run_until_a_state_is_restored(torque: float) -> None:
    with Board(seed=4) as board:
        board.run(0.05)
        state = board.state()
        board.set_load(AXIS, torque)
        with pytest.raises(BoardError, match="faster than 20000 rad/s"):
            board.run(0.1)
        with pytest.raises(BoardError, match="faster than 20000 rad/s"):
            board.run(0.1)
        board.restore(state)
        board.run(0.1)
        assert board.truth(AXIS).omega_m == 0.0
