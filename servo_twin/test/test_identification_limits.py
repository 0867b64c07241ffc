"""Identification with other currents, voltages and motors, and the remedies of its refusals."""

from __future__ import annotations

import dataclasses
import itertools
import math
import os
import random
from collections.abc import Mapping, Sequence
from typing import Final

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from servo_measurement import estimation, motor_rig, motor_test
from servo_measurement.access import FAULT, MeasurementError
from servo_measurement.motor_config import corrected, fitted
from servo_measurement.motor_test import MotorTest
from servo_measurement.motor_values import VOLTAGE_USE, Limits
from servo_msgs_py.rounding import rounded_down, rounded_up
from servo_tuning.errors import ConfigError, Remedy
from servo_tuning.remedies import with_value
from servo_tuning.tuned import tuned_axis
from servo_twin.board import Board
from servo_twin.board_access import VirtualBoardAccess
from servo_twin.identification.session import identified, measure_virtual
from servo_twin.identification.trials import random_case
from servo_twin.plant import PlantConfig
from servo_twin.servo_config import servo_table

PLANT: Final = PlantConfig.load()
OPTIONS: Final = {
    "--current": "current",
    "--voltage": "voltage",
    "--speed-max": "speed",
    "--turns-max": "turns",
    "--energy-max": "energy",
}
SEED: Final = 1
LIMITS: Final = Limits(24.0, 4.0, r_on=0.03)
REFUSALS_MAX: Final = 6
EVERY_CASE: Final = "SERVO_EVERY_CASE"
LONG_CASES: Final = (
    (5, 6, "flux", True),
    (5, 10, "friction", True),
    (5, 19, "dead time", True),  # its flux is seen with a fast vector only
    (5, 23, "r_s", True),
    (5, 24, "tuning", True),  # a heavy rotor, which slips and swings after a short ramp; its search takes too long
)
PLAIN_ERRORS: Final[Mapping[str, float]] = {"r_s": 0.1, "l_d": 0.03, "l_q": 0.03, "psi_m": 0.015, "inertia": 0.04}
"""Relative errors of the closed-form estimates, which a refinement would reduce."""


def assert_identified(plant: PlantConfig, limits: Limits, seed: int = 1) -> None:
    log, problem = measure_virtual(plant, 0, limits, servo_table(), level="ideal", seed=seed)
    result = identified(log, plant, problem, refined=False, level="ideal")
    assert not result.problems
    for name, error in PLAIN_ERRORS.items():
        assert result.estimates[name] == pytest.approx(getattr(plant.axes[0], name), rel=error), name


@pytest.mark.parametrize(
    ("voltage", "current"), [(24.0, 3.9), (24.0, 1.0), (24.0, 0.5), (12.0, 1.0), (10.0, 1.0), (33.0, 2.0)]
)
def test_any_current_and_voltage(voltage: float, current: float) -> None:
    assert_identified(PLANT.with_bus(u_source=voltage), Limits(voltage, current, r_on=0.03))


@pytest.mark.parametrize("number", [2, 8, 17, 22])
def test_other_motors(number: int) -> None:
    """Number 8 has a bus that takes no braking energy, 22 a shaft that swings about a rotating vector."""
    assert_identified(*random_case(PLANT, 0, LIMITS, SEED, number))


def test_the_supply_fault_of_a_lower_voltage_is_cleared_and_returns() -> None:
    with Board(PLANT.with_bus(u_source=12.0), seed=1, level="ideal") as board:
        board.run(0.05)
        states = board.catalogue.enums["state_t"]
        assert board.read("axis1.state") == states["FAULT"], "the committed threshold is 16 V"
        before = board.read_words("config.checksum")
        log = MotorTest(VirtualBoardAccess(board), 0, Limits(12.0, 1.0), servo_table()).run()
        assert log.labelled("hold")
        board.run(0.1)
        assert board.read_words("config.checksum") == before
        assert board.read("axis1.state") == states["FAULT"]


@pytest.mark.parametrize(
    ("changes", "current"),
    [
        ({"current": 5.0}, 4.0),
        ({"current": 0.1}, 0.63),  # not the 4 A of the board: it measures with 0.5 A
        ({"voltage": 36.0}, 4.0),
        ({"current": 5.0, "voltage": 12.0, "speed": 1.0, "turns": 1.0}, 4.0),
    ],
)
def test_remedies_of_options_are_accepted(changes: dict[str, float], current: float) -> None:
    limits = dataclasses.replace(Limits(24.0, 4.0, r_on=0.03), **changes)
    assert assert_remedies_lead_to_a_result(PLANT, limits).current == pytest.approx(current, rel=0.1)


@pytest.mark.parametrize(
    ("seed", "number", "first", "accepted"),
    [
        (1, 15, "dead time", False),  # the lightest shaft: it ran away with half of the current
        (1, 18, "l_d", True),  # needs a higher voltage, too
        (1, 21, "l_d", True),  # the voltage is not enough for a fast vector
        (1, 30, "dead time", False),  # all phase currents are within the range: no current can be told
        (1, 0, "dead time", True),  # a light shaft: it oscillates with slow integral parts of the current controllers
        (5, 3, "flux", False),  # off the vector, although the inductances hardly differ
        (5, 4, "speed limit", True),
        (5, 7, "psi_m", True),  # reverses at rest without a compensation of the dead time: its encoder counts
        (5, 22, "dead time", False),  # a higher gain of the current controllers trips the over-current protection
        (5, 32, "dead time", False),  # the current for the winding is too large for the reluctance
        (5, 34, "dead time", True),
        (5, 36, "dead time", False),  # the test signal turns the rotor
        (5, 39, "r_s", True),  # a heavy rotor below a low speed limit
        *(LONG_CASES if EVERY_CASE in os.environ else ()),
    ],
)
def test_every_value_that_a_refusal_names_is_accepted(seed: int, number: int, first: str, accepted: bool) -> None:
    """Random motors; those of seed 5 with random limits. No value leads to a fault.

    Those that turn for minutes of board time are left out unless the environment has SERVO_EVERY_CASE.
    """
    plant, limits = random_case(PLANT, 0, LIMITS, seed, number)
    limits = limits if seed == SEED else with_random_limits(limits, seed, number)
    refused, _ = refusals(plant, limits)
    assert refused[0].about == first
    assert bool(refused[-1].remedies) == accepted, str(refused[-1])


def with_random_limits(limits: Limits, seed: int, number: int) -> Limits:
    rng = random.Random(f"limits {seed} {number}")

    def spread(low: float, high: float) -> float:
        return math.exp(rng.uniform(math.log(low), math.log(high)))

    current = max(limits.current * spread(0.2, 1.0), 0.1)
    return dataclasses.replace(
        limits, current=current, speed=spread(5.0, 200.0), turns=spread(3.0, 20.0), energy=spread(0.02, 2.0)
    )


def refusals(plant: PlantConfig, limits: Limits) -> tuple[list[MeasurementError], Limits]:
    """Refusals in order, each after the values of the previous one, and the last limits.

    A value is accepted: the next refusal is neither about the same thing, nor a fault.
    """
    refused: list[MeasurementError] = []
    while (error := refusal(plant, limits)) is not None:
        assert not refused or error.about not in (FAULT, *(one.about for one in refused)), [*map(str, refused), error]
        assert len(refused) < REFUSALS_MAX
        refused.append(error)
        if not error.remedies:
            break
        assert error.about
        plant, limits = with_remedy(plant, limits, error)
    return refused, limits


def assert_remedies_lead_to_a_result(plant: PlantConfig, limits: Limits) -> Limits:
    """Return the accepted limits."""
    refused, limits = refusals(plant, limits)
    assert refused
    assert refused[-1].remedies, str(refused[-1])
    return limits


def with_remedy(plant: PlantConfig, limits: Limits, error: MeasurementError) -> tuple[PlantConfig, Limits]:
    """The options of the first remedy, and the supply for them."""
    remedy: Remedy | None
    (remedy, *_) = error.remedies or [None]
    while remedy is not None:
        assert remedy.value is not None
        assert f"{remedy.entry} {remedy.value:g}" in str(error)
        limits = dataclasses.replace(limits, **{OPTIONS[remedy.entry]: remedy.value})
        if remedy.entry == "--voltage":
            plant = plant.with_bus(u_source=remedy.value)
        remedy = remedy.also
    return plant, limits


class _Accepted(Exception):
    """All checks before the first write have passed."""


class _WithoutWrites(VirtualBoardAccess):
    def write_words(self, name: str, words: Sequence[int], first: int = 0) -> bool:
        raise _Accepted


@settings(max_examples=60, derandomize=True, deadline=None, phases=[Phase.generate])
@given(
    st.floats(10.0, 34.0),
    st.builds(Limits, st.floats(5.0, 60.0), st.floats(0.01, 20.0), st.floats(0.1, 500.0), st.floats(0.1, 40.0)),
)
def test_remedies_of_the_checks_before_any_motion_are_accepted(supply: float, limits: Limits) -> None:
    plant = PLANT.with_bus(u_source=supply)
    with Board(plant, seed=1, level="ideal") as board:
        board.run(0.05)
        refused: list[str] = []
        while (error := refusal_of(_WithoutWrites(board), limits)) is not None:
            _, limits = with_remedy(plant, limits, error)
            assert error.remedies[0].entry not in refused, (refused, str(error))
            refused.append(error.remedies[0].entry)


def refusal(plant: PlantConfig, limits: Limits) -> MeasurementError | None:
    """Error that ends the test of a motor, or the first problem of its estimates."""
    with Board(plant, seed=1, level="ideal") as board:
        board.run(0.05)
        test = MotorTest(VirtualBoardAccess(board), 0, limits, servo_table())
        try:
            test.run()
        except MeasurementError as error:
            return error
    for one in identified(test.log, plant, refined=False, level="ideal").problems:
        return MeasurementError(one.fact, *one.remedies, about=one.entry)
    return None


def refusal_of(access: VirtualBoardAccess, limits: Limits) -> MeasurementError | None:
    try:
        MotorTest(access, 0, limits, servo_table()).run()
    except MeasurementError as error:
        return error
    except _Accepted:
        pass
    return None


# ---- a test that is finished, and its remedies


@pytest.mark.parametrize(
    ("plant", "limits", "reason"),
    [
        (PLANT.with_axis(0, r_s=9.0, l_d=4e-3, l_q=4e-3), Limits(24.0, 3.9), "resistance of the winding is too high"),
        (PLANT.with_axis(0, friction=0.016), Limits(24.0, 1.0, r_on=0.03), "friction holds the rotor"),
    ],
)
def test_remedies_of_refusals_at_the_vector_are_accepted(plant: PlantConfig, limits: Limits, reason: str) -> None:
    error, *others = refusals(plant, limits)[0]
    assert reason in str(error)
    assert not others


@pytest.mark.parametrize("r_s", [6.7, 7.2, 7.8])
def test_the_voltage_is_enough_for_a_current_that_is_named_instead(r_s: float) -> None:
    error = refusal(PLANT.with_axis(0, r_s=r_s), Limits(24.0, 3.9))
    assert error is not None
    (remedy,) = error.remedies
    assert remedy.value is not None
    largest = VOLTAGE_USE * 24.0 / math.sqrt(3.0) / r_s
    assert 0.75 * largest < remedy.value <= largest


def test_no_current_is_told_if_there_is_no_response(monkeypatch: pytest.MonkeyPatch) -> None:
    def without_response(*_: object, **__: object) -> None:
        raise ValueError

    monkeypatch.setattr(motor_test, "impedance", without_response)
    monkeypatch.setattr(motor_test, "ROUNDS", 1)
    monkeypatch.setattr(MotorTest, "_refuse_small_current", lambda *_, **__: None)
    error = refusal(PLANT, LIMITS)
    assert error is not None
    assert str(error).endswith("test signal of 1.1 A: check the connection of all three motor wires")


def test_one_speed_is_named_that_shows_a_small_flux_and_narrows_its_interval() -> None:
    refused, _ = refusals(PLANT.with_axis(0, psi_m=0.004), dataclasses.replace(LIMITS, speed=8.0))
    assert [one.about for one in refused] == ["flux"]
    assert refused[0].remedies


def test_no_speed_is_named_for_a_shaft_that_follows_no_vector(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (motor_test, estimation):
        monkeypatch.setattr(module, "shaft_follows", lambda recording, name, pairs: False)
    error = refusal(PLANT, dataclasses.replace(LIMITS, speed=20.0))
    assert error is not None
    assert "it is blocked" in str(error)
    assert not error.remedies


def test_pulses_of_growing_current_alternate_their_direction(monkeypatch: pytest.MonkeyPatch) -> None:
    speeds: list[float] = []
    brake = MotorTest._brake

    def noting(test: MotorTest, gain: float, maximum: float) -> None:
        speeds.append(test._rig.value("speed"))
        brake(test, gain, maximum)

    monkeypatch.setattr(MotorTest, "_brake", noting)
    assert refusal(PLANT.with_axis(0, inertia=1e-4), LIMITS) is None
    before = speeds[:-2]  # the last two pulses are recorded
    assert len(before) >= 3
    assert all(one * other < 0.0 for one, other in itertools.pairwise(before))


def test_a_shaft_without_room_for_the_next_recording_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(motor_rig, "_ROOM_RUNS", 0)
    error = refusal(PLANT, dataclasses.replace(LIMITS, turns=3.0))
    assert error is not None
    assert error.about == "turns"


def test_a_current_that_does_not_settle_is_not_called_a_high_resistance(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(motor_test, "FIRST_KI", motor_test.FIRST_KI / 30.0)
    error = refusal(PLANT, LIMITS)
    assert error is not None
    assert not error.remedies
    assert "does not settle, although the bus voltage is enough" in str(error)


def test_a_rotor_off_its_vector_is_not_called_a_load() -> None:
    """Number 5: above 0.85 A its reluctance turns it off the vector, and with less its friction does."""
    plant, limits = random_case(PLANT, 0, LIMITS, SEED, 5)
    refused, accepted = refusals(plant, limits)
    assert [one.about for one in refused] == ["reluctance", "friction"]
    assert accepted.current < 0.85
    assert not refused[-1].remedies
    assert refusal(plant.with_axis(0, friction=2e-4), accepted) is None


def test_a_configuration_follows_the_motor() -> None:
    """Entries that depend on motor and limits are corrected by the remedies of the tuning rules."""
    for number in (2, 4, 8, 17):
        plant, limits = random_case(PLANT, 0, LIMITS, SEED, number)
        it = plant.axes[0]
        names = ("r_s", "l_d", "l_q", "psi_m", "pole_pairs", "inertia", "friction", "viscous")
        motor = {name: float(getattr(it, name)) for name in names}
        for slow_loops in (False, True):
            table = fitted(servo_table(), 0, limits, motor, slow_loops=slow_loops)
            assert tuned_axis(table, 0).block
            assert table["axis1"]["limits"]["current"] == limits.current
            assert table["axis1"]["motor"]["inertia"] == motor["inertia"]
            assert table["board"]["nominal_voltage"] == limits.voltage


def test_a_raised_over_voltage_threshold_is_said() -> None:
    said: list[str] = []
    with Board(PLANT.with_bus(u_source=33.0), seed=1, level="ideal") as board:
        board.run(0.05)
        with pytest.raises(MeasurementError, match="too few"):
            MotorTest(VirtualBoardAccess(board), 0, Limits(33.0, 1.0, turns=1.0), servo_table(), said.append).run()
    assert "the over-voltage threshold is raised from" in said[0]


def test_values_that_may_not_be_changed_are_not_searched() -> None:
    """The board ends the session of a host that computes for longer than param.host_timeout."""
    checked: list[None] = []
    with pytest.raises(ConfigError):
        corrected(with_value(servo_table(), "axis1.control.current_bandwidth", 9000.0), 0, lambda: checked.append(None))
    assert len(checked) == 1


@given(st.floats(1e-3, 1e3))
def test_two_digits_are_rounded_in_their_direction(value: float) -> None:
    low, high = rounded_down(value), rounded_up(value)
    assert low * (1.0 - 1e-9) <= value <= high * (1.0 + 1e-9)
    assert high - low < 0.1 * value * (1.0 + 1e-6)
    assert [low, high] == [float(f"{one:.2g}") for one in (low, high)]
