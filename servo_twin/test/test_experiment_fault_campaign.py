"""Some trials of the fault campaign; the full campaign is an experiment of some minutes."""

from __future__ import annotations

import dataclasses
import random

import pytest
from servo_twin.fault_injection import OpenPhase
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments.campaign_motors import OTHERS, OWN, Motor
from servo_twin.validation.experiments.fault_campaign import Trial, draw, run_trial
from servo_twin.validation.experiments.fault_scenarios import (
    INJECTED_FAULTS,
    NO_FAULT,
    BusRange,
    Context,
    FaultScenario,
    no_fault,
)
from servo_twin.validation.experiments.named_faults import NOTHING
from servo_twin.validation.experiments.operating_states import STATES, Bench, Script
from servo_twin.validation.experiments.rig import at_level

PLANT = PlantConfig.load()


def open_phase(*names: str) -> Trial:
    """A phase of axis 1 opens at 0.1 .. 0.6 of the speed limit."""
    fault = OpenPhase(0, "b")
    fault_case = FaultScenario("open phase", str(fault), lambda board: board.inject(fault), names)
    return Trial(1, 0, Motor.of("axis1", PLANT), STATES["under load"], fault_case, PLANT)


def test_trials_with_the_motors_of_the_plant() -> None:
    results = [run_trial(draw(PLANT, 5, number, OWN)) for number in range(25)]
    assert not [str(result) for result in results if result.failed]
    assert {result.trial.fault.kind for result in results} > {
        NO_FAULT,
        "weak magnet",
        "bad contact",
        "shifted disc",
        "dry bearing",
    }


@pytest.mark.xfail(strict=True, reason="no fault: one in seven of these trials at level ideal")
def test_blocked_rotor_is_detected_without_an_encoder() -> None:
    trial = draw(PLANT, 6, 5, OWN)
    assert (trial.state.name, trial.fault.kind) == ("observer, stop", "rotor held")
    with at_level("ideal"):
        result = run_trial(trial)
    assert not result.failed, str(result)


def test_worn_shaft_has_backlash_and_causes_no_fault() -> None:
    make, _ = INJECTED_FAULTS["worn shaft"]
    trial = Trial(
        1, 0, Motor.of("axis1", PLANT), STATES["reversal"], no_fault(Context(PLANT, 0, STATES["stop"])), PLANT
    )
    worn = make(random.Random(1), Context(PLANT, 0, trial.state))
    with trial.motor.board(PLANT, 1) as board:
        worn.inject(board)
        assert board.plant.axes[0].inertia + board.plant.axes[0].load_inertia == pytest.approx(PLANT.axes[0].inertia)
        assert board.plant.axes[0].resonance == pytest.approx(400.0)
    result = run_trial(dataclasses.replace(trial, fault=worn))
    assert (result.name, result.failed) == (NOTHING, False), str(result)


@pytest.mark.slow
def test_trials_with_another_configuration() -> None:
    """Two motors that differ from the plant, on one board, whose firmware is tuned here."""
    results = [run_trial(draw(PLANT, 4, number, OTHERS[:2])) for number in range(20)]
    assert not [str(result) for result in results if result.failed]
    assert {result.trial.motor.name for result in results} == set(OTHERS[:2])


@pytest.mark.slow
@pytest.mark.parametrize(("motor", "seed", "number"), [("fast", 4, 9)])
def test_stopping_shaft_is_not_detected_as_turning(motor: str, seed: int, number: int) -> None:
    """At zero current, voltage drops and dead time of the switching plant reproduce the applied voltage."""
    group = OTHERS[:2] if motor in OTHERS[:2] else OTHERS[2:]
    trial = draw(PLANT, seed, number, group)
    assert (trial.motor.name, trial.state.name, trial.fault.kind) == (motor, "observer, manoeuvres", NO_FAULT)
    with at_level("registers"):
        result = run_trial(trial)
    assert not result.failed, str(result)


@pytest.mark.slow
def test_voltage_of_a_sensorless_start_is_not_detected_as_lost_phase() -> None:
    """The reference frame of the start-up is not that of the rotor, so its voltage contains the back-EMF."""
    trial = draw(PLANT, 3, 44, OTHERS[2:])
    assert (trial.motor.name, trial.state.name, trial.fault.kind) == ("ipm", "observer, manoeuvres", NO_FAULT)
    with at_level("registers"):
        result = run_trial(trial)
    assert not result.failed, str(result)


@pytest.mark.slow
def test_integrated_noise_is_not_detected_as_back_emf() -> None:
    """A motor whose resistive voltage exceeds its back-EMF, with three times the usual noise."""
    trial = draw(PLANT, 71, 9)
    assert (trial.motor.name, trial.state.name, trial.fault.kind) == ("gimbal", "manoeuvres", NO_FAULT)
    with at_level("registers"):
        result = run_trial(trial)
    assert not result.failed, str(result)


def test_dead_encoder_at_speed_is_not_detected_as_lost_phase() -> None:
    """The current of one phase stays below its set-point because the measured angle no longer changes."""
    make, _ = INJECTED_FAULTS["encoder plug"]
    trial = draw(PLANT, 71, 97)
    assert (trial.motor.name, trial.state.name) == ("axis1", "torque")
    plug = make(random.Random(1), Context(PLANT, trial.motor.axis, trial.state))
    result = run_trial(dataclasses.replace(trial, fault=plug))
    assert result.name == "ENCODER_LOST", str(result)


def slip(state: str, rng: random.Random) -> FaultScenario:
    make, observed = INJECTED_FAULTS["encoder slips"]
    assert not observed
    return make(rng, Context(PLANT, 0, STATES[state]))


def test_permitted_faults_of_a_slip() -> None:
    """The same slips before the rotor has been found, and afterwards."""
    rng, again = random.Random(3), random.Random(3)
    seen = BusRange(24.0, 24.0)
    large = 0
    for _ in range(50):
        early, late = slip("stop", rng), slip("high speed", again)
        assert early.text == late.text
        assert early.expected_faults(seen) == (NOTHING,)
        large += late.move_if_undetected
        assert late.expected_faults(seen) == (
            ("ANGLE_MISMATCH",) if late.move_if_undetected else (NOTHING, "ANGLE_MISMATCH")
        )
    assert 20 < large < 45  # slips of 30 to 180 degrees: those above 90
    for state in ("rotor search", "coasting"):  # the rotor may be searched again
        assert slip(state, rng).expected_faults(seen) == (NOTHING, "ANGLE_MISMATCH", "ROTOR_SEARCH")


@pytest.mark.parametrize("state", ["hold", "high speed", "reversal"])
def test_slip_is_reported_with_its_fault(state: str) -> None:
    rng = random.Random(f"slip {state}")
    fault = slip(state, rng)
    while not fault.move_if_undetected:
        fault = slip(state, rng)
    result = run_trial(Trial(1, 0, Motor.of("axis1", PLANT), STATES[state], fault, PLANT))
    assert not result.failed, str(result)
    assert result.name == "ANGLE_MISMATCH"


def test_drawn_speeds_are_above_the_minimum_of_the_start_up() -> None:
    """0.04 of the speed limit by default, 0.16 for the smallest motor."""
    assert Motor.of("axis1", PLANT).slowest == pytest.approx(1.1 * 0.04)
    assert Motor.of("fast", PLANT).slowest == pytest.approx(1.1 * 0.16)


def test_disabled_fault_fails_the_trial() -> None:
    """With the check disabled, the motor continues with two phases."""
    trial = open_phase("PHASE_LOST")

    def deaf(bench: Bench, rng: random.Random) -> Script:
        script = trial.state.begin(bench, rng)
        bench.board.write("param.faults_enabled", [0, 0])
        return script

    result = run_trial(dataclasses.replace(trial, state=dataclasses.replace(trial.state, begin=deaf)))
    assert result.failed
    assert result.name != "PHASE_LOST"


def test_trial_is_determined_by_its_number() -> None:
    one, again, another = (draw(PLANT, 1, number) for number in (7, 7, 8))
    assert (one.motor, one.plant, one.fault.text) == (again.motor, again.plant, again.fault.text)
    assert one.plant != another.plant
