"""The motor against an independent integration and energy conservation; friction against closed forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from native_library import Native, c_axis, ideal_plant
from numpy.typing import NDArray
from servo_twin.plant import AxisPlant, PlantConfig

STEP = 15.625e-6  # a quarter of a PWM period [s]


def make(plant_c: Native, axis: AxisPlant) -> Any:
    motor = plant_c.ffi.new("plant_motor_t *")
    plant_c.lib.plant_motor_init(motor, c_axis(plant_c, axis))
    return motor


def step(plant_c: Native, motor: Any, alpha: float, beta: float, duration: float = STEP) -> None:
    """Advance by `duration`; a step ends early where the shaft stops."""
    remaining = duration
    while remaining > 1e-12:
        remaining -= plant_c.lib.plant_motor_step(motor, (alpha, beta), remaining)


def field_energy(inductance: float, i_s: float, current: float) -> float:
    """Integral of the current over the flux, for one axis."""
    if i_s == 0.0:
        return 0.5 * inductance * current**2
    x = 2.0 * math.sinh(math.asinh(1.5 * current / i_s) / 3.0)
    return inductance * i_s**2 * (x**2 / 2.0 + x**4 / 12.0)


def stator_frame_reference(
    axis: AxisPlant, voltage: NDArray[np.float64], step_s: float, load: float, substeps: int = 16
) -> NDArray[np.float64]:
    """State (i_d, i_q, omega_m, theta_m) after each voltage, by the flux equations of the stator frame (DRM E11-E15).

    d(psi)/dt = u - R i with psi = L(theta) i + psi_m (cos, sin); torque 3/2 p (psi_alpha i_beta - psi_beta i_alpha).
    With saturation the flux x in an axis of the rotor needs the current x / L (1 + (x / (L i_s))^2 / 3).
    """
    p = axis.pole_pairs

    def currents(psi: NDArray[np.float64], theta: float) -> NDArray[np.float64]:
        c, s = math.cos(p * theta), math.sin(p * theta)
        mean, half = (axis.l_d + axis.l_q) / 2, (axis.l_d - axis.l_q) / 2
        c2, s2 = math.cos(2 * p * theta), math.sin(2 * p * theta)
        if axis.i_saturation_d > 0.0:
            turn = np.array([[c, s], [-s, c]])
            scale = np.array([axis.l_d * axis.i_saturation_d, axis.l_q * axis.i_saturation_q])
            flux = turn @ psi - [axis.psi_m, 0.0]
            saturated: NDArray[np.float64] = turn.T @ (
                flux / [axis.l_d, axis.l_q] * (1.0 + np.square(flux / scale) / 3.0)
            )
            return saturated
        inductance = np.array([[mean + half * c2, half * s2], [half * s2, mean - half * c2]])
        solution: NDArray[np.float64] = np.linalg.solve(inductance, psi - axis.psi_m * np.array([c, s]))
        return solution

    def rate(x: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
        psi, omega, theta = x[:2], x[2], x[3]
        i = currents(psi, theta)
        torque = 1.5 * p * (psi[0] * i[1] - psi[1] * i[0])
        return np.array([*(u - axis.r_s * i), (torque - load - axis.viscous * omega) / axis.inertia, omega])

    start = float(axis.theta_start)
    x = np.array([axis.psi_m * math.cos(p * start), axis.psi_m * math.sin(p * start), 0.0, start])
    h = step_s / substeps
    rows = []
    for u in voltage:
        for _ in range(substeps):
            k1 = rate(x, u)
            k2 = rate(x + h / 2 * k1, u)
            k3 = rate(x + h / 2 * k2, u)
            k4 = rate(x + h * k3, u)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        i = currents(x[:2], x[3])
        c, s = math.cos(p * x[3]), math.sin(p * x[3])
        rows.append([i[0] * c + i[1] * s, i[1] * c - i[0] * s, x[2], x[3]])
    return np.array(rows)


@pytest.mark.parametrize("iron", [{}, {"i_saturation_d": 3.0, "i_saturation_q": 2.0}], ids=["linear", "saturated"])
def test_agrees_with_the_flux_equations_of_the_stator_frame(plant_c: Native, iron: dict[str, Any]) -> None:
    plant = ideal_plant(viscous=2e-5, theta_start=0.4, **iron)
    axis = plant.axes[0]
    # a voltage vector that accelerates the shaft beyond synchronism: all states are excited
    times = np.arange(640) * STEP
    angle = 0.7 + 2 * math.pi * (20 * times + 1500 * times**2)
    voltage = 5.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    expected = stator_frame_reference(axis, voltage, STEP, load=0.01, substeps=8)
    motor = make(plant_c, axis)
    motor.load = 0.01
    rows = []
    for alpha, beta in voltage:
        step(plant_c, motor, alpha, beta)
        rows.append([motor.i_d, motor.i_q, motor.omega, motor.theta])
    assert np.abs(expected[:, 1]).max() > 3.0  # the compared currents and speeds are large enough
    assert np.abs(expected[:, 2]).max() > 30.0
    error = np.abs(np.array(rows) - expected).max(axis=0)
    assert (error < np.array([5e-8, 5e-8, 5e-8, 1e-10]) * (40.0 if iron else 1.0)).all()  # A, A, rad/s, rad


@pytest.mark.parametrize("iron", [0.0, 1.5], ids=["linear", "saturated"])
def test_energy_is_conserved(plant_c: Native, iron: float) -> None:
    """Electrical energy in = heat + friction + kinetic + magnetic energy."""
    axis = ideal_plant(friction=2e-3, viscous=1e-5, i_saturation_d=iron, i_saturation_q=iron).axes[0]
    motor = make(plant_c, axis)
    supplied = heat = rubbed = 0.0
    for k in range(4000):
        angle = 2 * math.pi * min(k * STEP * 400, 40) * k * STEP
        u = np.array([4 * math.cos(angle), 4 * math.sin(angle)])
        before = (motor.i_d, motor.i_q, motor.omega, motor.phase[0], motor.phase[1])
        step(plant_c, motor, *u)
        i_0 = np.array([before[3], (before[3] + 2 * before[4]) / math.sqrt(3)])
        i_1 = np.array([motor.phase[0], (motor.phase[0] + 2 * motor.phase[1]) / math.sqrt(3)])
        supplied += 1.5 * float(u @ (i_0 + i_1)) / 2 * STEP
        square = before[0] ** 2 + before[1] ** 2, motor.i_d**2 + motor.i_q**2
        heat += 1.5 * axis.r_s * sum(square) / 2 * STEP
        speed = (before[2] + motor.omega) / 2
        rubbed += (axis.friction * abs(speed) + axis.viscous * speed**2) * STEP
    kinetic = 0.5 * axis.inertia * motor.omega**2
    magnetic = 1.5 * (field_energy(axis.l_d, iron, motor.i_d) + field_energy(axis.l_q, iron, motor.i_q))
    assert supplied > 0.1
    assert heat + rubbed + kinetic + magnetic == pytest.approx(supplied, rel=1e-3)


def test_phase_currents_agree_with_the_rotor_frame(plant_c: Native) -> None:
    """Amplitude-invariant transforms (k = 2/3): a current vector of 3 A along phase a is 3 A in phase a."""
    motor = make(plant_c, ideal_plant(theta_start=0.6).axes[0])
    plant_c.lib.plant_motor_set_phases(motor, 3.0, -1.5)
    assert math.hypot(motor.i_d, motor.i_q) == pytest.approx(3.0, rel=1e-12)
    assert math.atan2(motor.i_q, motor.i_d) == pytest.approx(-1.2, rel=1e-12)


def test_trigonometry_is_as_accurate_as_the_library(plant_c: Native) -> None:
    for theta in [0.0, 1e-9, 0.4, math.pi / 4, -math.pi / 2, 3.0, -7.5, 1234.5678, -98765.4321]:
        motor = make(plant_c, ideal_plant(theta_start=theta).axes[0])
        assert motor.sine == pytest.approx(math.sin(2 * theta), abs=3e-15 + 1e-16 * abs(theta))
        assert motor.cosine == pytest.approx(math.cos(2 * theta), abs=3e-15 + 1e-16 * abs(theta))


class TestFriction:
    def test_holds_up_to_its_limit(self, plant_c: Native) -> None:
        motor = make(plant_c, ideal_plant(friction=2e-3).axes[0])
        for load, moves in [(1.99e-3, False), (-1.99e-3, False), (2.01e-3, True), (-2.01e-3, True)]:
            motor.load, motor.omega, motor.theta = load, 0.0, 0.0
            for _ in range(200):
                assert plant_c.lib.plant_motor_coast(motor, STEP) == STEP
            assert (motor.theta != 0.0) == moves
            assert math.copysign(1.0, -load) * motor.theta >= 0.0  # the load opposes positive motion

    def test_stops_a_coasting_shaft_exactly_and_for_good(self, plant_c: Native) -> None:
        axis = ideal_plant(friction=2e-3).axes[0]
        motor = make(plant_c, axis)
        motor.omega = -50.0
        distance = 50.0**2 * axis.inertia / (2 * axis.friction)
        time = 50.0 * axis.inertia / axis.friction
        for _ in range(math.ceil(time / STEP) + 100):
            remaining = STEP
            while remaining > 1e-15:
                remaining -= plant_c.lib.plant_motor_coast(motor, remaining)
        assert motor.omega == 0.0
        assert motor.theta == pytest.approx(-distance, rel=1e-9)

    def test_friction_of_a_powered_motor_at_reversal(self, plant_c: Native) -> None:
        """Current drives against the motion: at zero speed only the friction torque changes its sign."""
        axis = ideal_plant(friction=4e-3).axes[0]
        torque = 0.01
        motor = make(plant_c, axis)
        motor.load, motor.omega = torque, 20.0
        before = 20.0 * axis.inertia / (torque + axis.friction)
        after = 20e-3 - before
        remaining = 20e-3
        while remaining > 1e-12:
            remaining -= plant_c.lib.plant_motor_coast(motor, min(remaining, STEP))
        assert motor.omega == pytest.approx(-after * (torque - axis.friction) / axis.inertia, rel=1e-6)

    def test_too_small_current_does_not_move_the_shaft(self, plant_c: Native) -> None:
        axis = PlantConfig.load().with_axis(0, theta_start=0.35).axes[0]
        motor = make(plant_c, axis)
        current = 0.99 * axis.friction / axis.torque_constant
        angle = 2 * float(axis.theta_start) + math.pi / 2
        for _ in range(2000):
            u = motor.r * current
            step(plant_c, motor, u * math.cos(angle), u * math.sin(angle))
        assert motor.i_q == pytest.approx(current, rel=1e-3)
        assert motor.theta == float(axis.theta_start)

    def test_a_locked_shaft_does_not_move(self, plant_c: Native) -> None:
        motor = make(plant_c, ideal_plant().axes[0])
        motor.omega = 100.0
        plant_c.lib.plant_motor_lock(motor, True)
        for _ in range(100):
            step(plant_c, motor, 0.0, 6.0)
        assert (motor.omega, motor.theta) == (0.0, 0.0)
        assert motor.i_q > 5.0
