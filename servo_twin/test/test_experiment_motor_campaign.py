"""Some motors of the motor campaign; the full campaign is an experiment of some minutes."""

from __future__ import annotations

import dataclasses
import math

import pytest
from servo_tuning.remedies import refusal_of
from servo_twin.plant import PlantConfig
from servo_twin.random_motor import (
    ACCELERATION_TIME,
    FLUX,
    INDUCTANCE,
    INERTIA,
    POLE_PAIRS,
    R_S,
    TIME_CONSTANT,
    VOLTAGE,
    random_motor,
)
from servo_twin.validation.experiments.motor_campaign import Result, corrected, data_sheet, judge, run_trial
from servo_twin.validation.experiments.rig import at_level

SEED = 1
DRIVEN = (
    *((SEED, number) for number in (1, 7, 24, 36)),  # as they are, or after other bandwidths; with 2 .. 21 pole pairs
    (3, 98),  # 0.0048 kg m^2; a speed loop slow enough to find an oscillation passed the target and stayed there
    (3, 60),  # L / R = 4.8 ms: a slow integral part of the current controller let dead time hold the current
)
"""Seeds and numbers of accepted motors."""
REFUSED = (
    (34, "correct motor.psi_m, motor.pole_pairs"),  # torque constant beyond the full scale of the contract
    (44, "0.8 of the range of the current sensors"),  # 15 uH: OVER_CURRENT at level registers
    (59, "hides the direction of its current"),  # oscillates by 560 counts at level registers
)


def test_motors_are_within_the_ranges_and_depend_on_the_seed_only() -> None:
    motors = [random_motor(SEED, number) for number in range(200)]
    assert motors == [random_motor(SEED, number) for number in range(200)]
    for motor in motors:
        torque = 1.5 * motor.pole_pairs * motor.psi_m * motor.current
        values = (
            (motor.r_s, R_S),
            (motor.l_d, INDUCTANCE),
            (motor.pole_pairs, POLE_PAIRS),
            (motor.inertia, INERTIA),
            (motor.voltage, VOLTAGE),
            (motor.l_d / motor.r_s, TIME_CONSTANT),
            (motor.inertia * motor.no_load_speed / torque, ACCELERATION_TIME),
            (motor.psi_m, FLUX),
        )
        assert all(low <= value <= high for value, (low, high) in values)
        assert motor.psi_m * motor.pole_pairs * motor.no_load_speed == pytest.approx(motor.voltage / math.sqrt(3.0))
    assert max(motor.pole_pairs for motor in motors) > 20
    assert max(motor.inertia for motor in motors) > 100 * min(motor.inertia for motor in motors)


def test_accepted_motors_enable_and_move() -> None:
    with at_level("ideal"):
        results = [run_trial(seed, number, PlantConfig.load()) for seed, number in DRIVEN]
    assert [str(one) for one in results if one.refused or one.problem] == []
    assert judge(results).agrees


@pytest.mark.parametrize(("number", "reason"), REFUSED)
def test_a_refusal_that_no_entry_corrects_names_the_reason(number: int, reason: str) -> None:
    found = corrected(data_sheet(random_motor(SEED, number)))
    assert found.problem is not None
    assert found.problem == refusal_of(found.table)
    assert reason in str(found.problem)


def test_a_drive_that_does_not_work_is_a_failure() -> None:
    good = Result(0, random_motor(SEED, 0), (), "", contradicts=False, search=1.0, overshoot=2.0, duration=0.9)
    for bad in (
        dataclasses.replace(good, problem="no arrival"),
        dataclasses.replace(good, refused="axis1.limits.current", contradicts=False),
    ):
        assert good != bad
        assert bad.failed
        assert not judge([good, bad]).agrees
    assert judge([good, dataclasses.replace(good, refused="torque constant", contradicts=True)]).agrees
