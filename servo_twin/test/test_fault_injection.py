"""Fault injection: physics against closed forms on both plants, and the whole board at both levels."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from native_library import Native, c_axis, ideal_plant
from servo_msgs_py.board_port import active
from servo_twin.board import Board
from servo_twin.fault_injection import (
    BusNoise,
    CurrentNoise,
    EncoderGlitches,
    HotPowerStage,
    InjectedFault,
    OpenPhase,
    ShortedPhase,
    StuckConverter,
    StuckLine,
    SupplyDip,
)
from servo_twin.level import Level
from servo_twin.simulation import enable
from switching_rig import Switching

STEP = 31.25e-6
CLOCK = 1e-8
FLYWHEEL = 1.0
"""Inertia so large that the speed stays constant [kg m^2]."""

SPEED = 200.0
OPEN_PHASE, SHORTED = 0, 1
MINUS = -1


class Averaged:
    """Motor of axis 1 with its inverter, averaged, at a constant bus voltage."""

    def __init__(self, native: Native, bus: float = 24.0, **axis: Any) -> None:
        self.native, self.bus = native, bus
        self.plant = ideal_plant(inertia=FLYWHEEL, **axis).axes[0]
        config = c_axis(native, self.plant)
        self.motor = native.ffi.new("plant_motor_t *")
        self.inverter = native.ffi.new("averaged_inverter_t *")
        self.charge = native.ffi.new("double *")
        native.lib.plant_motor_init(self.motor, config)
        native.lib.averaged_inverter_init(self.inverter, config, 16000.0, STEP)

    def spin(self, omega: float) -> None:
        self.motor.omega = omega

    def drive(self, *duty: float) -> None:
        self.inverter.on = True
        self.native.lib.averaged_inverter_load(self.inverter, duty, self.bus)

    def open(self, phase: int) -> None:
        self.native.lib.averaged_inverter_open(self.inverter, self.motor, phase, True)

    def short(self, phase: int, to: int) -> None:
        self.native.lib.averaged_inverter_short(self.inverter, phase, to)

    def run(self, seconds: float) -> Any:
        """Run and return the phase currents, one row per step."""
        rows = []
        for _ in range(round(seconds / STEP)):
            remaining = STEP
            while remaining > 1e-15:
                remaining -= self.native.lib.averaged_inverter_step(
                    self.inverter, self.motor, self.bus, remaining, self.charge
                )
            rows.append(list(self.motor.phase))
        return np.array(rows)


class Switched:
    """The same at switching level."""

    def __init__(self, native: Native, bus: float = 24.0, **axis: Any) -> None:
        plant = ideal_plant(inertia=FLYWHEEL, dead_time_min=0.0, **axis).with_bus(
            u_source=bus, r_source=1e-3, capacitance=1.0
        )
        self.plant = plant.axes[0]
        self.rig = Switching(native, plant)

    def spin(self, omega: float) -> None:
        self.rig.spin(0, omega)

    def gates(self, *gates: int) -> None:
        for phase, gate in enumerate(gates):
            self.rig.edge(0, phase, gate)

    def fault(self, kind: int, phase: int, value: float = 0.0) -> None:
        fault = self.rig.ffi.new("board_fault_t *", (kind, 0, phase, value, 0.0))
        self.rig.lib.switching_set_fault(self.rig.c, fault, False)

    def open(self, phase: int) -> None:
        self.fault(OPEN_PHASE, phase)

    def short(self, phase: int, to: int) -> None:
        self.fault(SHORTED, phase, to)

    def run(self, seconds: float) -> Any:
        rows = []
        for _ in range(round(seconds / STEP)):
            self.rig.advance(self.rig.clock + round(STEP / CLOCK))
            rows.append(list(self.rig.truth(0).phase))
        return np.array(rows)


@pytest.fixture(params=["averaged", "switching"])
def make(request: pytest.FixtureRequest) -> Any:
    if request.param == "averaged":
        native = request.getfixturevalue("plant_c")
        return lambda **options: Averaged(native, **options)
    native = request.getfixturevalue("switching_c")
    return lambda **options: Switched(native, **options)


# ---- physics --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("phase", [0, 1, 2])
def test_an_open_phase_leaves_two_in_series(make: Any, phase: int) -> None:
    """2 V across two windings at standstill: the current rises to u / (2 R) with the time constant L/R."""
    it = make(bus=2.0, l_d=0.5e-3, l_q=0.5e-3)
    it.open(phase)
    one, other = (phase + 1) % 3, (phase + 2) % 3
    if isinstance(it, Averaged):
        duty = [0.5] * 3
        duty[one], duty[other] = 1.0, 0.0
        it.drive(*duty)
        it.native.lib.plant_motor_lock(it.motor, True)
    else:
        gates = [1, 1, 1]
        gates[other] = 2
        it.gates(*gates)
    i = it.run(2e-3)
    t = (1 + np.arange(len(i))) * STEP
    end = 2.0 / (2 * it.plant.r_s)
    assert np.all(i[:, phase] == 0.0)
    assert np.allclose(i[:, one], end * (1 - np.exp(-t * it.plant.r_s / 0.5e-3)), atol=0.002 * end)
    assert np.allclose(i[:, one], -i[:, other], atol=1e-12)


@pytest.mark.parametrize("phase", [0, 1, 2])
def test_current_of_an_opened_phase_continues_in_the_other_two(make: Any, phase: int) -> None:
    it = make()
    it.spin(SPEED)
    it.short((phase + 1) % 3, (phase + 2) % 3)  # initial current
    it.run(1e-3)
    it.open((phase + 1) % 3)
    i = it.run(1e-3)
    assert np.all(i[:, (phase + 1) % 3] == 0.0)
    assert np.all(np.abs(i.sum(axis=1)) < 1e-9)


@pytest.mark.parametrize("alone", [0, 1, 2])
def test_shorted_phases_brake_by_their_loop_current(make: Any, alone: int) -> None:
    """sqrt(3) w psi across 2 R and 2 L, with all switches open."""
    it = make(l_d=0.45e-3, l_q=0.45e-3)
    it.spin(SPEED)
    it.short((alone + 1) % 3, (alone + 2) % 3)
    i = it.run(60e-3)[-1000:]
    w = it.plant.pole_pairs * SPEED
    peak = math.sqrt(3) * w * it.plant.psi_m / (2 * math.hypot(it.plant.r_s, w * 0.45e-3))
    assert np.max(np.abs(i[:, (alone + 1) % 3])) == pytest.approx(peak, rel=0.01)
    assert np.all(i[:, alone] == 0.0)


def test_three_phases_on_bus_minus_are_a_winding_short(make: Any) -> None:
    """All low sides on: K_e w / sqrt(R^2 + w^2 L^2)."""
    it = make(l_d=0.45e-3, l_q=0.45e-3)
    it.spin(SPEED)
    if isinstance(it, Averaged):
        it.drive(0.0, 0.0, 0.0)
    else:
        it.gates(2, 2, 2)
    i = it.run(60e-3)[-1000:]
    w = it.plant.pole_pairs * SPEED
    assert np.max(i) == pytest.approx(w * it.plant.psi_m / math.hypot(it.plant.r_s, w * 0.45e-3), rel=0.01)


def test_a_phase_on_bus_minus_conducts_through_the_lower_diodes(plant_c: Native, switching_c: Native) -> None:
    """The currents of the other two phases have one sign only. Both plants agree."""
    currents = []
    for it in (Averaged(plant_c, v_drop=0.7), Switched(switching_c, v_drop=0.7)):
        it.spin(SPEED)
        it.short(0, MINUS)
        currents.append(it.run(50e-3)[-1000:])
    for i in currents:
        assert np.max(i[:, 0]) < 1e-9
        assert np.min(i[:, 1:]) > -1e-9
    peaks = [np.min(i[:, 0]) for i in currents]
    assert peaks[0] < -2.0
    assert peaks[0] == pytest.approx(peaks[1], rel=0.01)


def test_a_short_is_fed_by_an_upper_switch_alone(switching_c: Native) -> None:
    it = Switched(switching_c)
    it.short(0, MINUS)
    for gates, tripped in [((2, 2, 2), False), ((2, 1, 2), False), ((1, 1, 1), True), ((0, 1, 1), False)]:
        it.gates(*gates)
        assert it.rig.truth(0).over_current == tripped
    it.short(0, 1)
    for gates, tripped in [((1, 1, 2), False), ((1, 2, 2), True), ((1, 0, 2), False), ((2, 1, 2), True)]:
        it.gates(0, 0, 0)
        it.gates(*gates)
        assert it.rig.truth(0).over_current == tripped


# ---- boards ---------------------------------------------------------------------------------------------------------


@pytest.fixture(params=["ideal", "registers"])
def board(request: pytest.FixtureRequest) -> Iterator[Board]:
    level: Level = request.param
    with Board(seed=11, level=level) as board:
        yield board


def turn(board: Board, speed: float) -> None:
    enable(board)
    board.write("cmd.mode", [1, 1])
    board.write("cmd.speed", [speed, speed])
    board.run(0.2)


@pytest.mark.parametrize("fault", [ShortedPhase(0, "b"), ShortedPhase(0, "a", "c")])
def test_a_short_opens_the_switches_without_software(board: Board, fault: InjectedFault) -> None:
    turn(board, 150.0)
    board.inject(fault)
    board.run(100e-6)
    assert board.stats().breaks == 1
    board.run(0.002)
    assert active(board, 0) == {"OVER_CURRENT"}
    board.run(0.3)
    assert abs(board.truth(0).omega_m) < 10.0, "braked by the shorted windings"
    assert active(board, 1) == set()
    assert board.truth(1).omega_m == pytest.approx(150.0, rel=0.05)
    board.clear_fault()
    board.write("cmd.clear_faults", [1, 0])
    board.run(0.05)
    assert active(board, 0) == set()


def test_open_phase_has_no_current(board: Board) -> None:
    turn(board, 100.0)
    board.inject(OpenPhase(0, "a"))
    board.run(0.0005)
    board.lock_shaft(0)
    board.run(0.01)
    truth = board.truth(0)
    theta = 2 * truth.theta_m
    assert truth.i_d * math.cos(theta) - truth.i_q * math.sin(theta) == pytest.approx(0.0, abs=1e-9)
    board.clear_fault(OpenPhase(0, "a"))


def counts_seen(board: Board) -> set[int]:
    seen = set()
    for _ in range(100):
        board.run(0.0005)
        seen.add(board.read_words("axis1.position")[0])
    return seen


@pytest.mark.parametrize("high", [False, True])
@pytest.mark.parametrize("line", ["A", "B"])
def test_with_a_stuck_line_the_position_alternates_by_one_count(board: Board, line: Any, high: bool) -> None:
    board.run(0.01)
    board.inject(StuckLine(0, line, high))
    board.run(0.001)
    board.set_load(0, -0.01)  # negative load: it accelerates the shaft, the outputs are off
    seen = counts_seen(board)
    assert board.truth(0).omega_m > 5.0
    assert len(seen) == 2
    assert max(seen) - min(seen) == 1
    board.clear_fault()
    assert max(counts_seen(board)) - max(seen) > 10


@pytest.mark.parametrize("line", ["A", "B"])
def test_glitches_do_not_change_the_count(board: Board, line: Any) -> None:
    """Each glitch is an edge and its opposite."""
    board.run(0.01)
    before = board.read_words("axis1.position")[0]
    board.inject(EncoderGlitches(0, line, 2000.0))
    seen = counts_seen(board)
    assert all(abs(position - before) <= 1 for position in seen)
    board.clear_fault()
    board.run(0.001)
    assert board.read_words("axis1.position")[0] == before


def test_a_dip_of_the_supply_ends_by_itself(board: Board) -> None:
    turn(board, 50.0)
    board.inject(SupplyDip(20.0, 0.4))
    board.run(0.39)
    assert 20.0 < board.truth(0).u_dc < 23.0, "the motors are supplied by the bus capacitor"
    board.run(0.02)
    assert board.truth(0).u_dc == pytest.approx(24.0, abs=0.2)
    board.set_load(0, 0.04)
    board.inject(SupplyDip())
    while not active(board, 0):
        board.run(0.0005)
    board.set_load(0, 0.0)
    assert board.truth(0).u_dc < 16.5
    assert active(board, 0) == {"UNDER_VOLTAGE"}
    board.clear_fault()
    board.run(0.05)
    assert board.truth(0).u_dc == pytest.approx(24.0, abs=0.1)


def test_noise_is_in_the_measured_current(board: Board) -> None:
    turn(board, 50.0)
    quiet = board.si(board.record(board.time_ns + 100_000_000))
    board.inject(CurrentNoise(0, 0.06))
    board.inject(BusNoise(0.5))
    loud = board.si(board.record(board.time_ns + 100_000_000))
    assert np.std(loud["axis1.i_d"]) > 2.0 * np.std(quiet["axis1.i_d"])
    assert np.std(loud["u_dc"]) > 3.0 * np.std(quiet["u_dc"])
    board.clear_fault()
    again = board.si(board.record(board.time_ns + 100_000_000))
    assert np.std(again["axis1.i_d"]) < 1.5 * np.std(quiet["axis1.i_d"])


def test_a_hot_power_stage_cools_after_the_fault(board: Board) -> None:
    board.inject(HotPowerStage(1, 95.0))
    board.run(0.01)
    assert board.truth(1).t_sink == 95.0
    assert board.truth(0).t_sink == pytest.approx(25.0, abs=0.1)
    board.clear_fault()
    board.run(0.1)
    assert 90.0 < board.truth(1).t_sink < 95.0


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (OpenPhase(2, "a"), "axes 0 .. 1"),
        (OpenPhase(0, "d"), "none of a, b, c"),  # type: ignore[arg-type]
        (ShortedPhase(0, "a", "a"), "shorted to itself"),
        (StuckConverter(0, "a", 4096), "4095"),
        (SupplyDip(-1.0), "at least 0"),
        (SupplyDip(10.0, 0.0), "must be above 0"),
        (CurrentNoise(0, math.inf), "finite"),
    ],
)
def test_invalid_faults_are_refused(fault: InjectedFault, message: str) -> None:
    with Board(level="ideal") as board, pytest.raises((ValueError, IndexError), match=message):
        board.inject(fault)
