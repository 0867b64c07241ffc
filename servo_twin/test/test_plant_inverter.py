"""The inverter: dead time and voltage drops against closed forms, freewheeling through the diodes, shunts."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from native_library import Native, c_axis, ideal_plant
from servo_twin.plant import AxisPlant, PlantConfig

PWM = 16000.0
STEP = 15.625e-6
BUS = 24.0


class InverterRig:
    """Inverter and motor of one axis at a constant bus voltage."""

    def __init__(self, plant_c: Native, axis: AxisPlant, *, on: bool = True, bus: float = BUS) -> None:
        self.native = plant_c
        self.bus = bus
        config = c_axis(plant_c, axis)
        self.motor = plant_c.ffi.new("plant_motor_t *")
        self.inverter = plant_c.ffi.new("averaged_inverter_t *")
        self._charge = plant_c.ffi.new("double *")
        plant_c.lib.plant_motor_init(self.motor, config)
        plant_c.lib.averaged_inverter_init(self.inverter, config, PWM, STEP)
        self.inverter.on = on

    def duty(self, *duty: float) -> None:
        self.native.lib.averaged_inverter_load(self.inverter, duty, self.bus)

    def run(self, steps: int) -> None:
        for _ in range(steps):
            remaining = STEP
            while remaining > 1e-15:
                remaining -= self.native.lib.averaged_inverter_step(
                    self.inverter, self.motor, self.bus, remaining, self._charge
                )

    @property
    def charge(self) -> float:
        return float(self._charge[0])

    @property
    def phase(self) -> list[float]:
        return list(self.motor.phase)


def locked(plant_c: Native, axis: AxisPlant, **options: Any) -> InverterRig:
    rig = InverterRig(plant_c, axis, **options)
    plant_c.lib.plant_motor_lock(rig.motor, True)
    return rig


def test_ideal_inverter_applies_its_mean_voltage(plant_c: Native) -> None:
    axis = ideal_plant().axes[0]
    rig = locked(plant_c, axis)
    rig.duty(0.55, 0.475, 0.475)
    rig.run(3000)
    assert rig.motor.i_d == pytest.approx(0.075 * BUS * 2 / 3 / axis.r_s, rel=1e-6)


@pytest.mark.parametrize(("dead_time", "v_drop", "r_on"), [(1e-6, 0.0, 0.0), (0.0, 0.7, 0.0), (1e-6, 0.7, 0.03)])
@pytest.mark.parametrize("sign", [1, -1])
def test_error_voltage_against_the_current(
    plant_c: Native, dead_time: float, v_drop: float, r_on: float, sign: int
) -> None:
    """Positive current in one phase, negative in two: the voltage vector is reduced by 4/3 (t_d f u + V_drop)."""
    axis = ideal_plant(dead_time=dead_time, v_drop=v_drop, r_on=r_on).axes[0]
    rig = locked(plant_c, axis)
    swing = sign * 0.1
    rig.duty(0.5 + swing, 0.5 - swing / 2, 0.5 - swing / 2)
    rig.run(4000)
    error = 4 / 3 * (dead_time * PWM * BUS + v_drop)
    current = (swing * BUS - sign * error) / (axis.r_s + r_on)
    assert rig.motor.i_d == pytest.approx(current, rel=1e-6)
    assert min(abs(i) for i in rig.phase) > 0.5  # far from the transition


def test_the_dead_time_error_is_0_384_volts(plant_c: Native) -> None:
    """1 us at 16 kHz and 24 V."""
    axis = ideal_plant(dead_time=1e-6).axes[0]
    rig = locked(plant_c, axis)
    rig.native.lib.plant_motor_set_phases(rig.motor, 2.0, -1.0)
    rig.duty(0.6, 0.45, 0.45)
    rig.run(1)
    assert rig.inverter.leg[0] == pytest.approx(0.6 * BUS - 0.384, abs=1e-9)
    assert rig.inverter.leg[1] == pytest.approx(0.45 * BUS + 0.384, abs=1e-9)


@pytest.mark.parametrize("current", [2.0, -2.0])
@pytest.mark.parametrize(
    ("duty", "forward", "backward"),
    [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.01, 0.0, 0.026), (0.99, 0.974, 1.0), (0.5, 0.484, 0.516)],
)
def test_pulses_shorter_than_the_dead_time_are_lost(
    plant_c: Native, current: float, duty: float, forward: float, backward: float
) -> None:
    rig = locked(plant_c, ideal_plant(dead_time=1e-6).axes[0])
    rig.native.lib.plant_motor_set_phases(rig.motor, current, -current / 2)
    rig.duty(duty, 0.5, 0.5)
    rig.run(1)
    assert rig.inverter.share[0] == pytest.approx(forward if current > 0 else backward, abs=1e-12)


def test_the_transition_is_smooth_odd_and_inside_the_ripple(plant_c: Native) -> None:
    axis = ideal_plant(dead_time=1e-6, v_drop=0.7).axes[0]
    currents = np.linspace(-0.5, 0.5, 401)
    volts = []
    for current in currents:
        rig = locked(plant_c, axis)
        rig.native.lib.plant_motor_set_phases(rig.motor, current, 0.0)
        rig.duty(0.5, 0.5, 0.5)
        rig.run(1)
        volts.append(rig.inverter.leg[0] - 0.5 * BUS)
    volts_a = np.array(volts)
    full = 1e-6 * PWM * BUS + 0.7
    assert volts_a == pytest.approx(-volts_a[::-1], abs=1e-12)
    assert np.all(np.diff(volts_a) <= 1e-12)
    assert volts_a[0] == pytest.approx(full)
    band = (
        1e-6 * BUS / min(axis.l_d, axis.l_q)
    )  # without modulation the ripple is only the current that rises in one dead time
    assert band < 0.07
    assert np.abs(volts_a[np.abs(currents) > band]) == pytest.approx(full)
    assert np.abs(volts_a[np.abs(currents) < 0.9 * band]).max() < full
    assert np.abs(np.diff(volts_a)).max() < 1.6 * full / band * np.diff(currents).max()


def test_currents_decay_without_oscillation_at_rest(plant_c: Native) -> None:
    rig = locked(plant_c, PlantConfig.load().axes[0])
    rig.native.lib.plant_motor_set_phases(rig.motor, 0.3, -0.1)
    rig.duty(0.5, 0.5, 0.5)
    largest = []
    for _ in range(60):
        rig.run(1)
        largest.append(max(map(abs, rig.phase)))
    assert all(later <= earlier for earlier, later in itertools.pairwise(largest))
    assert largest[-1] < 1e-3


@pytest.mark.parametrize("swing", [0.01, 0.03, 0.1])
def test_inverter_loss_is_bus_power_minus_winding_loss(plant_c: Native, swing: float) -> None:
    """A locked motor, also at currents so small that the voltage drop of the legs decreases with them."""
    axis = ideal_plant(dead_time=1e-6, v_drop=0.7, r_on=0.03).axes[0]
    rig = locked(plant_c, axis)
    rig.duty(0.5 + swing, 0.5 - swing / 2, 0.5 - swing / 2)
    rig.run(2000)
    rig.inverter.heat, before = 0.0, rig.charge
    rig.run(1000)
    copper = axis.r_s * sum(i**2 for i in rig.phase) * 1000 * STEP
    assert rig.inverter.heat > 0.0
    assert rig.inverter.heat == pytest.approx((rig.charge - before) * BUS - copper, rel=1e-6)


class TestAllSwitchesOpen:
    def test_current_decays_into_the_bus(self, plant_c: Native) -> None:
        """Phase a is clamped to bus minus, b and c to bus plus: -2/3 (u + 2 V_drop) along a."""
        axis = ideal_plant(v_drop=0.7).axes[0]
        rig = locked(plant_c, axis, on=False)
        rig.native.lib.plant_motor_set_phases(rig.motor, 3.0, -1.5)
        volts = 2 / 3 * (BUS + 1.4)
        time = axis.l_d / axis.r_s * math.log1p(3.0 * axis.r_s / volts)
        steps = math.ceil(time / STEP)
        rig.run(2)
        assert rig.motor.i_d == pytest.approx(
            -volts / axis.r_s + (3.0 + volts / axis.r_s) * math.exp(-2 * STEP * axis.r_s / axis.l_d), rel=1e-6
        )
        rig.run(steps)
        assert rig.phase == [0.0, 0.0, 0.0]
        stored = 0.75 * axis.l_d * 3.0**2
        assert -rig.charge * BUS < stored
        assert -rig.charge == pytest.approx(3.0 * time / 2, rel=0.15)  # a triangle; its end falls inside one step

    def test_one_phase_may_end_before_the_others(self, plant_c: Native) -> None:
        rig = locked(plant_c, ideal_plant(v_drop=0.7).axes[0], on=False)
        rig.native.lib.plant_motor_set_phases(rig.motor, 3.0, -2.7)
        seen = set()
        for _ in range(20):
            before = [math.copysign(1.0, i) if i else 0.0 for i in rig.phase]
            rig.run(1)
            after = [math.copysign(1.0, i) if i else 0.0 for i in rig.phase]
            assert all(b == 0.0 or b == a for a, b in zip(before, after, strict=True))  # none reverses
            seen.add(tuple(after))
        assert (1.0, -1.0, 0.0) in seen
        assert rig.phase == [0.0, 0.0, 0.0]

    def test_a_slow_rotor_carries_no_current(self, plant_c: Native) -> None:
        axis = ideal_plant(friction=2e-3).axes[0]
        rig = InverterRig(plant_c, axis, on=False)
        rig.motor.omega = 300.0
        rig.run(100)
        assert rig.phase == [0.0, 0.0, 0.0]
        assert rig.charge == 0.0
        assert rig.motor.omega == pytest.approx(300.0 - 100 * STEP * 2e-3 / axis.inertia, rel=1e-9)

    def test_a_floating_terminal_shows_the_back_emf(self, plant_c: Native) -> None:
        axis = ideal_plant().axes[0]
        rig = InverterRig(plant_c, axis, on=False)
        rig.motor.omega = 300.0
        rig.run(1)
        expected = 0.0  # phase a at its zero crossing
        assert rig.inverter.leg[0] - 0.5 * BUS == pytest.approx(expected, abs=0.1)
        assert rig.inverter.leg[1] - rig.inverter.leg[2] == pytest.approx(2 * 300 * axis.psi_m * math.sqrt(3), rel=1e-3)

    def test_a_fast_rotor_charges_the_bus_through_the_diodes(self, plant_c: Native) -> None:
        """A three-phase rectifier into a stiff bus: the peak of the line voltage has to exceed u + 2 V_drop."""
        axis = ideal_plant(v_drop=0.7).axes[0]
        threshold = (BUS + 1.4) / (math.sqrt(3) * axis.psi_m * axis.pole_pairs)
        for omega, conducts in [(0.99 * threshold, False), (1.5 * threshold, True)]:
            rig = InverterRig(plant_c, axis, on=False)
            rig.motor.omega = omega
            rig.run(600)
            assert (rig.charge < 0.0) == conducts
            assert (rig.motor.omega < omega) == conducts
        kinetic = 0.5 * axis.inertia * (omega**2 - rig.motor.omega**2)
        delivered = -rig.charge * BUS
        assert 0.3 * kinetic < delivered < kinetic
        # the diodes clamp the terminals to the bus
        assert all(-0.7 - 1e-9 <= v <= BUS + 0.7 + 1e-9 for v in rig.inverter.leg)

    @settings(max_examples=60, deadline=None, derandomize=True)
    @given(
        i_a=st.floats(-8, 8),
        i_b=st.floats(-8, 8),
        omega=st.floats(-900, 900),
        theta=st.floats(-4, 4),
        bus=st.floats(1, 40),
    )
    def test_energy_is_not_created(
        self, plant_c: Native, i_a: float, i_b: float, omega: float, theta: float, bus: float
    ) -> None:
        axis = ideal_plant(v_drop=0.7, theta_start=theta).axes[0]
        rig = InverterRig(plant_c, axis, on=False, bus=bus)
        rig.native.lib.plant_motor_set_phases(rig.motor, i_a, i_b)
        rig.motor.omega = omega

        def energy() -> float:
            m = rig.motor
            magnetic = 0.75 * (axis.l_d * m.i_d**2 + axis.l_q * m.i_q**2)
            return float(0.5 * axis.inertia * m.omega**2 + magnetic)

        before = energy()
        for _ in range(40):
            rig.run(1)
            assert abs(sum(rig.phase)) < 1e-9
        # voltages and currents of a step are means, hence a small tolerance
        assert energy() - rig.charge * bus <= before * 1.02 + 1e-5


class TestShunts:
    @pytest.mark.parametrize(
        ("duty", "current", "low", "high"),
        [
            (0.5, 2.0, 2.0, 0.0),
            (0.5, -2.0, -2.0, 0.0),
            (0.0, 2.0, 2.0, 2.0),  # the low side never opens: the offset sample is invalid
            (1.0, 2.0, 0.0, 0.0),  # the low side never conducts: there is nothing to sample
            (0.995, -2.0, 0.0, 0.0),  # the low side's pulse is shorter than the dead time
            (0.995, 2.0, 2.0, 0.0),  # its diode still conducts
            (0.01, 2.0, 2.0, 2.0),  # no high-side pulse remains
        ],
    )
    def test_shunts_carry_the_current_of_the_low_side(
        self, plant_c: Native, duty: float, current: float, low: float, high: float
    ) -> None:
        rig = locked(plant_c, ideal_plant(dead_time=1e-6).axes[0])
        rig.duty(duty, 0.5, 0.5)
        rig.native.lib.plant_motor_set_phases(rig.motor, current, -current / 2)
        rig.run(1)
        now = rig.phase[0]
        shunt = rig.native.lib.averaged_inverter_shunt
        assert shunt(rig.inverter, rig.motor, 0, True) == (now if low else 0.0)
        assert shunt(rig.inverter, rig.motor, 0, False) == (now if high else 0.0)

    def test_only_currents_of_lower_diodes_pass_the_shunts(self, plant_c: Native) -> None:
        rig = locked(plant_c, ideal_plant().axes[0], on=False)
        rig.native.lib.plant_motor_set_phases(rig.motor, 3.0, -1.0)
        shunt = rig.native.lib.averaged_inverter_shunt
        assert [shunt(rig.inverter, rig.motor, k, True) for k in range(3)] == pytest.approx([3.0, 0.0, 0.0])
