"""A sensorless axis on the virtual board: start-up, flying start, load, stall; angle check with an encoder."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from servo_msgs_py.board_port import active, choose, place, reached, write_axis
from servo_msgs_py.catalogue import numbers
from servo_msgs_py.units import TICK_NS
from servo_twin.board import Board
from servo_twin.fault_injection import SlippedEncoder
from servo_twin.level import Level
from servo_twin.plant import PlantConfig
from servo_twin.simulation import enable, keep_set_points
from servo_twin.validation.experiments.rig import RPM, features

STOP, RUN = 2, 3
PAIRS = 2
LIMIT_SENSORLESS = 128
UNKNOWN = 0.35 / math.sqrt(2.0)
"""Voltage error of dead time and switches, root mean square [V] (emf_check.floor)."""


def sensorless(
    speeds: tuple[float, float], plant: PlantConfig | None = None, seed: int = 1, level: Level | None = None
) -> Board:
    """A board without encoders, just enabled with speed set-points [rad/s]; an axis with 0 waits."""
    board = Board(plant, seed=seed, level=level)
    keep_set_points(board)
    board.run(0.05)
    board.write("param.feedback", [1, 1])
    board.run(0.01)
    for axis, speed in enumerate(speeds):
        choose(board, "cmd.mode", axis, "SPEED")
        write_axis(board, "cmd.enable", axis, 1)
        write_axis(board, "cmd.speed", axis, speed)
    return board


def until(board: Board, where: str, seconds: float, axis: int = 0) -> float:
    """Time until an axis is in a sub-state of RUN [s]."""
    start = board.clock()
    assert reached(board, lambda: place(board, axis) == where, seconds), active(board, axis)
    return board.clock() - start


def until_fault(board: Board, seconds: float, axis: int = 0) -> tuple[float, set[str]]:
    """Time until a fault, and its name; infinite without one."""
    start = board.clock()
    if not reached(board, lambda: bool(active(board, axis)), seconds):
        return math.inf, set()
    return board.clock() - start, active(board, axis)


@pytest.fixture
def running() -> Iterator[Board]:
    """Axis 1 without its encoder at 100 rad/s, axis 2 waiting."""
    with sensorless((100.0, 0.0)) as board:
        until(board, "SPIN", 0.5)
        board.run(0.3)
        yield board


def test_hand_over_has_no_jump() -> None:
    """Change from the forced vector to the rotor frame within a PWM period: no current peak, no dip of the speed."""
    with sensorless((100.0, 0.0)) as board:
        until(board, "SPIN", 0.5)
        before = board.truth(0).omega_m
        peak = 0.0
        for _ in range(160):
            board.run(62.5e-6)
            truth = board.truth(0)
            peak = max(peak, math.hypot(truth.i_d, truth.i_q))
            assert truth.omega_m > before - 3.0
        assert peak < 2.5


@pytest.mark.parametrize("speed", [60.0, 250.0, -200.0])
def test_flying_start_of_a_turning_shaft(speed: float) -> None:
    """Outputs off at speed, then enabled: no ramp and no jerk; ready within 100 ms."""
    with sensorless((speed, 0.0)) as board:
        until(board, "SPIN", 0.5)
        board.run(0.4)
        features(board, 0, OVER_SPEED=True)
        board.write("param.over_speed", [5.0, 5.0])
        assert until_fault(board, 0.1)[1] == {"OVER_SPEED"}
        features(board, 0, OVER_SPEED=False)
        board.run(0.01)
        board.write("cmd.clear_faults", [1, 1])
        board.run(0.02)
        write_axis(board, "cmd.enable", 0, 1)
        write_axis(board, "cmd.speed", 0, speed)
        until(board, "STARTUP", 0.1)
        before, peak = board.truth(0).omega_m, 0.0
        while place(board, 0) == "STARTUP":
            board.run(62.5e-6)
            truth = board.truth(0)
            peak = max(peak, math.hypot(truth.i_d, truth.i_q))
            assert truth.omega_m * speed > 0.0
        assert peak < 2.5
        assert abs(board.truth(0).omega_m) > abs(before) - 40.0
        board.run(0.3)
        assert board.truth(0).omega_m == pytest.approx(speed, abs=4.0)


def test_no_ripple_without_load() -> None:
    """With currents near zero the dead time dominates the voltage; the d current prevents that."""
    with sensorless((100.0, 0.0)) as board:
        until(board, "SPIN", 0.5)
        board.run(0.5)
        speeds = []
        for _ in range(400):
            board.advance(board.time_ns + TICK_NS)
            speeds.append(board.truth(0).omega_m)
        assert np.std(speeds) < 1.5


def test_position_counts_what_the_shaft_turns(running: Board) -> None:
    start, counts = running.truth(0).theta_m, running.read_words("axis1.position")[0]
    running.run(1.0)
    rotation = (running.truth(0).theta_m - start) / (2.0 * math.pi) * 4000
    assert running.read_words("axis1.position")[0] - counts == pytest.approx(rotation, abs=30)


def test_reversal_goes_through_a_new_start(running: Board) -> None:
    write_axis(running, "cmd.speed", 0, -100.0)
    until(running, "STARTUP", 0.1)
    until(running, "SPIN", 0.5)
    running.run(0.3)
    assert running.truth(0).omega_m == pytest.approx(-100.0, abs=3.0)


def test_torque_mode_starts_only_with_a_turning_shaft(running: Board) -> None:
    """The start-up rotates the shaft with its own current, independent of the torque set-point."""
    choose(running, "cmd.mode", 0, "TORQUE")
    write_axis(running, "cmd.i_q", 0, 0.3)
    running.run(0.05)
    log = running.si(running.record(running.time_ns + 10_000_000))
    assert log["axis1.i_q"].mean() == pytest.approx(0.3, abs=0.02)
    assert running.truth(0).omega_m > 140.0
    assert running.read_words("axis1.limits")[0] & LIMIT_SENSORLESS == 0
    write_axis(running, "cmd.i_q", 0, -0.3)
    until(running, "READY", 0.5)
    write_axis(running, "cmd.i_q", 0, 0.5)
    running.run(0.3)
    assert place(running, 0) == "READY"
    assert running.read_words("axis1.limits")[0] & LIMIT_SENSORLESS
    assert running.truth(0).omega_m == pytest.approx(0.0, abs=0.5)


def test_disable_ramps_down_and_switches_off(running: Board) -> None:
    write_axis(running, "cmd.enable", 0, 0)
    running.run(0.2)
    assert running.read_words("axis1.state")[0] == STOP
    assert running.truth(0).omega_m == pytest.approx(0.0, abs=1.0)


def test_unplugged_motor_does_not_start() -> None:
    with sensorless((100.0, 0.0)) as board:
        board.connect_motor(0, False)
        assert until_fault(board, 3.0)[1] == {"PHASE_LOST"}


# ---- the observer beside an encoder ----------------------------------------------------------------------------------


def with_encoders(plant: PlantConfig | None = None) -> Board:
    """Both axes spinning with their encoders and the angle check."""
    board = Board(plant, seed=1)
    board.run(0.05)
    enable(board)
    board.run(0.1)
    return board


def slip(board: Board, degrees: float) -> None:
    """Rotate the encoder of axis 1 on its shaft by an electrical angle."""
    choose(board, "cmd.mode", 0, "TORQUE")
    write_axis(board, "cmd.i_q", 0, 0.0)
    board.run(0.001)
    board.inject(SlippedEncoder(0, round(degrees / 360.0 * 4000 / PAIRS)))
    board.run(0.1)
    assert not active(board, 0)


def fault_of_offset(board: Board, degrees: float, seconds: float) -> tuple[float, set[str]]:
    """Time until a fault, and its name, after a command of 100 rad/s with an encoder offset [electrical degrees]."""
    slip(board, degrees)
    features(board, 0, ANGLE_CHECK=True)
    choose(board, "cmd.mode", 0, "SPEED")
    write_axis(board, "cmd.speed", 0, 100.0)
    return until_fault(board, seconds)


@pytest.mark.parametrize(("degrees", "maximum"), [(45.0, 90.0), (135.0, 90.0), (180.0, 100.0)])
def test_wrong_offset_is_detected_before_a_runaway(degrees: float, maximum: float) -> None:
    with with_encoders() as board:
        time, names = fault_of_offset(board, degrees, 0.3)
        assert names == {"ANGLE_MISMATCH"}
        assert time < 0.05
        assert abs(board.truth(0).omega_m) < maximum


def test_offset_of_90_degrees_is_detected_by_a_rotating_vector() -> None:
    """At 90 degrees no current produces torque, so there is no back-EMF; at 80 and 100 degrees there is."""
    with with_encoders() as board:
        time, names = fault_of_offset(board, 90.0, 1.0)
        assert names == {"ANGLE_MISMATCH"}
        assert time < 0.7


@pytest.mark.parametrize("factor", [1.0, 1.5])
def test_no_false_alarm(factor: float) -> None:
    """Speeds, reversals, load steps up to the current limit; nominal resistance and 150 % of it."""
    plant = PlantConfig.load().with_bus(capacitance=0.05)  # both may brake at once
    for axis in range(2):
        plant = plant.with_axis(axis, r_s=plant.axes[axis].r_s * factor)
    rng = np.random.default_rng(3)
    with with_encoders(plant) as board:
        for axis in range(2):
            features(board, axis, ANGLE_CHECK=True)
            choose(board, "cmd.mode", axis, "SPEED")
        for _ in range(12):
            for axis in range(2):
                write_axis(board, "cmd.speed", axis, float(rng.uniform(-2900.0, 2900.0)) * RPM)
                board.set_load(axis, float(rng.uniform(-0.08, 0.08)))
            board.run(0.15)
            assert not active(board, 0) | active(board, 1)


def test_observer_agrees_with_the_encoder() -> None:
    with with_encoders() as board:
        features(board, 0, ANGLE_CHECK=True)
        choose(board, "cmd.mode", 0, "SPEED")
        for speed in (50.0, -150.0, 300.0):
            write_axis(board, "cmd.speed", 0, speed)
            board.run(0.4)
            angles: list[float] = []
            speeds: list[float] = []
            for _ in range(100):
                board.advance(board.time_ns + TICK_NS)
                speeds += numbers(board.read("axis1.estimate_speed"))
                seen, encoder = board.read("axis1.estimate_theta_e"), board.read("axis1.theta_e")
                assert isinstance(seen, float)
                assert isinstance(encoder, float)
                angles.append(math.degrees(math.remainder(seen - encoder, 2.0 * math.pi)))
            # error of the rotor search by friction: one or two degrees
            assert abs(np.mean(angles)) < 6.0
            # without load the currents are too small to determine the voltage drop of the switches
            unknown = 0.0 if board.level == "ideal" else UNKNOWN / (PAIRS * abs(speed) * board.plant.axes[0].psi_m)
            assert np.std(angles) < 1.5 + math.degrees(unknown)
            assert np.mean(speeds) == pytest.approx(speed, abs=4.0)
