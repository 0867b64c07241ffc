"""Each monitor alone: conditions under which it raises a finding, and conditions under which it does not."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from diagnosis_rig import (
    ANGLE,
    BUS_COMPENSATION,
    CURRENT,
    DEAD_TIME,
    EMF_FLOOR,
    ENCODER,
    FOLLOWING_ERROR,
    OVER_SPEED,
    RESISTANCE,
    SENSOR,
    SILENT,
    Diagnosis,
)

NOTHING: set[str] = set()


def first_tick(step: Callable[[int], set[str]], finding: str, ticks: int) -> int:
    """First tick (from 1) with the finding, which is the only one until then; 0: never."""
    for tick in range(1, ticks + 1):
        found = step(tick)
        if found:
            assert found == {finding}
            return tick
    return 0


# ---- current converters
def noise(rig: Diagnosis, phase: int, samples: int, codes: int = 4) -> None:
    for k in range(samples):
        assert rig.sensor(phase, 2040 + k % (codes + 1)) == NOTHING


@pytest.mark.parametrize(("off", "tick"), [(33, 4), (-33, 4), (32, 0), (-32, 0)])
def test_a_code_off_its_offset_is_a_failed_current_sense_after_four_samples(
    rig: Diagnosis, off: int, tick: int
) -> None:
    rig.seen.switching = True
    assert first_tick(lambda _: rig.sensor(1, 2048 + off), "CURRENT_SENSE_FAILED", 60) == tick


def test_a_code_off_its_offset_is_suspected_after_two_samples_until_a_correct_one(rig: Diagnosis) -> None:
    rig.seen.switching = True
    rig.sensor(0, 2100)
    assert not rig.suspect().suspected & SENSOR
    rig.sensor(0, 2100)
    assert rig.suspect().suspected & SENSOR
    rig.sensor(0, 2048)
    assert not rig.suspect().suspected & SENSOR


def test_no_code_is_off_while_the_switches_are_open(rig: Diagnosis) -> None:
    assert first_tick(lambda _: rig.sensor(0, 2100), "CURRENT_SENSE_FAILED", 50) == 0


def test_a_code_repeated_64_times_while_others_are_noisy_is_stuck(rig: Diagnosis) -> None:
    noise(rig, 1, 64)
    assert first_tick(lambda _: rig.sensor(0, 2048), "CURRENT_SENSE_FAILED", 100) == 65


@pytest.mark.parametrize(("samples", "codes"), [(63, 4), (64, 3)])
def test_without_a_window_of_noise_elsewhere_no_code_is_stuck(rig: Diagnosis, samples: int, codes: int) -> None:
    noise(rig, 1, samples, codes)
    assert first_tick(lambda _: rig.sensor(0, 2048), "CURRENT_SENSE_FAILED", 100) == 0


@pytest.mark.parametrize(("again", "suspected"), [(15, True), (16, False)])
def test_another_constant_code_is_no_noise(rig: Diagnosis, again: int, suspected: bool) -> None:
    noise(rig, 1, 64)
    for _ in range(again + 1):
        rig.sensor(1, 2000)
    for _ in range(8):
        rig.sensor(0, 2048)
    assert bool(rig.suspect().suspected & SENSOR) == suspected


def test_equal_codes_are_repeating_after_two_and_suspected_after_six(rig: Diagnosis) -> None:
    noise(rig, 1, 64)
    reported = []
    for _ in range(8):
        rig.sensor(2, 2048)
        evidence = rig.suspect()
        reported.append((evidence.repeating == 0b100, bool(evidence.suspected & SENSOR)))
    assert [repeating for repeating, _ in reported] == [False] * 2 + [True] * 6
    assert [suspected for _, suspected in reported] == [False] * 6 + [True] * 2


# ---- phases: at frame 0 the current in d is that of phase a, the current in q goes from b to c
@pytest.fixture
def driven(rig: Diagnosis) -> Diagnosis:
    rig.seen.controlled = True
    rig.seen.spins = True
    return rig


@pytest.mark.parametrize(
    ("current", "set_point", "tick"),
    [
        ((0, 2000), (2 * SILENT + 2, 2000), 8),  # below the certain threshold
        ((0, 2000), (2 * SILENT - 2, 2600), 0),  # more current is not required
        ((0, 1200), (SILENT + 10, 1000), 8),  # much less than the other phases
        ((140, 1200), (SILENT + 10, 1000), 0),  # an eighth
        ((0, 1200), (SILENT - 10, 1000), 0),
    ],
)
def test_a_phase_without_current_at_a_set_point_for_eight_ticks_is_lost(
    driven: Diagnosis, current: tuple[int, int], set_point: tuple[int, int], tick: int
) -> None:
    driven.current(*current)
    driven.seen.current_ref = set_point
    assert first_tick(lambda _: driven.phase(), "PHASE_NO_CURRENT", 20) == tick


def test_a_phase_is_suspected_after_two_ticks_without_current_with_decay(driven: Diagnosis) -> None:
    driven.current(0, 2000)
    driven.seen.current_ref = (2000, 2000)
    driven.phase()
    assert driven.suspect().phases_without_current == 0
    driven.phase()
    assert driven.suspect().phases_without_current == 0b001
    driven.seen.current_ref = (0, 2000)
    for _ in range(125):
        driven.phase()
        driven.monitors.phase.octants[0] = 0  # not relevant for this test
    assert driven.suspect().phases_without_current == 0b001
    driven.phase()  # the 128th
    driven.monitors.phase.octants[0] = 0
    assert driven.suspect().phases_without_current == 0


def test_a_phase_is_not_compared_during_an_unconfirmed_stop_or_a_reversal_of_the_set_point(driven: Diagnosis) -> None:
    driven.current(0, 2000)
    driven.seen.current_ref = (2000, 2000)
    driven.seen.stop_unconfirmed = True
    assert first_tick(lambda _: driven.phase(), "PHASE_NO_CURRENT", 20) == 0
    driven.seen.stop_unconfirmed = False
    for tick in range(20):
        driven.seen.current_ref = (2000, 2000 if tick % 2 else -2000)
        assert driven.phase() == NOTHING


@pytest.mark.parametrize(("sectors", "tick"), [(5, 0), (6, 33)])
def test_no_current_in_six_of_eight_octants_and_33_samples_is_a_lost_phase(
    driven: Diagnosis, sectors: int, tick: int
) -> None:
    """The current flows from b to c at every rotor angle."""

    def step(k: int) -> set[str]:
        angle = (k % sectors + 0.5) * math.pi / 4.0
        driven.seen.d_axis_angle = (round(angle / math.pi * 32768) + 32768) % 65536 - 32768
        driven.current(round(491 * math.sin(angle)), round(491 * math.cos(angle)))
        return driven.phase()

    assert first_tick(step, "PHASE_NO_CURRENT", 300) == tick


@pytest.mark.parametrize(("sectors", "suspected"), [(0b011, False), (0b111, True), (0b10101, True)])
def test_low_current_in_three_directions_makes_a_phase_loss_possible(
    driven: Diagnosis, sectors: int, suspected: bool
) -> None:
    driven.monitors.phase.octants[1] = 0x100 | sectors
    assert bool(driven.suspect().phases_without_current) == suspected


@pytest.mark.parametrize(("faint", "kept"), [(14, True), (15, False)])
def test_octants_are_cleared_if_15_of_16_ticks_have_too_little_current(
    driven: Diagnosis, faint: int, kept: bool
) -> None:
    for tick in range(16):
        driven.current(0, 400 if tick < 16 - faint else 360)  # 346 and 311 in b and c
        assert driven.phase() == NOTHING
    assert bool(driven.monitors.phase.octants[0]) == kept


@pytest.mark.parametrize(
    ("change", "tick"),
    [
        ({}, 40),
        ({"spins": False}, 0),
        ({"ticks_without_movement": 4}, 0),
        ({"ticks_without_movement": 4, "sensorless": True}, 40),
        ({"voltage": (0, 2 * EMF_FLOOR)}, 0),
        ({"voltage": (0, 2 * EMF_FLOOR + 1)}, 40),
        ({"voltage": (0, 6000), "emf": 6000}, 0),
        ({"current_ref": (0, 3 * SILENT // 4)}, 0),
    ],
)
def test_voltage_without_current_for_forty_ticks(driven: Diagnosis, change: dict[str, object], tick: int) -> None:
    state: dict[str, object] = {"ticks_without_movement": 3, "voltage": (0, 4000), "current_ref": (0, 2000), **change}
    for name, value in state.items():
        setattr(driven.seen, name, value)
    assert first_tick(lambda _: driven.phase(), "CURRENT_NOT_FOLLOWING", 60) == tick


def test_missing_current_of_a_start_up_is_not_counted_in_spin(driven: Diagnosis) -> None:
    """The reference frame of the start-up is not that of the rotor, so its voltage contains the back-EMF."""
    driven.seen.voltage, driven.seen.current_ref, driven.seen.spins = (0, 4000), (0, 2000), False
    for _ in range(100):
        assert driven.phase() == NOTHING
    driven.seen.spins = True
    assert first_tick(lambda _: driven.phase(), "CURRENT_NOT_FOLLOWING", 60) == 40


@pytest.mark.parametrize(("change", "tick"), [(1000, 0), (0, 40)])
def test_inductive_voltage_is_no_missing_current(driven: Diagnosis, change: int, tick: int) -> None:
    """The set-point of the speed loop alternates: the current follows each set-point until the next reversal."""

    def step(number: int) -> set[str]:
        sign = (-1) ** number
        driven.seen.voltage, driven.seen.current_ref = (0, 3000 * sign), (0, 2000 * sign)
        driven.current(0, change * sign // 2)
        return driven.phase()

    assert first_tick(step, "CURRENT_NOT_FOLLOWING", 100) == tick


def test_a_current_that_does_not_follow_is_suspected_after_eight_ticks_and_decays_at_a_quarter_of_the_rate(
    driven: Diagnosis,
) -> None:
    driven.seen.voltage, driven.seen.current_ref = (0, 4000), (0, 2000)
    reported = []
    for tick in range(1, 13):
        if tick == 9:
            driven.seen.voltage = (0, 0)
        driven.phase()
        reported.append(bool(driven.suspect().suspected & CURRENT))
    assert reported == [False] * 7 + [True] * 4 + [False]


def test_phase_monitor_is_reset_without_current_control(driven: Diagnosis) -> None:
    driven.current(0, 2000)
    driven.seen.current_ref = (2000, 2000)
    for _ in range(7):
        driven.phase()
    assert driven.seen.conducting_phases == 0b110
    driven.seen.controlled = False
    assert driven.phase() == NOTHING
    assert (driven.seen.conducting_phases, driven.suspect().phases_without_current) == (0, 0)
    driven.seen.controlled = True
    assert first_tick(lambda _: driven.phase(), "PHASE_NO_CURRENT", 20) == 8


# ---- count of the encoder
@pytest.mark.parametrize(("changes", "tick"), [(12, 64), (11, 0)])
def test_a_count_that_alternates_in_two_windows_of_32_ticks(rig: Diagnosis, changes: int, tick: int) -> None:
    position = 0

    def step(k: int) -> set[str]:
        nonlocal position
        position ^= (k - 1) % 32 < changes
        return rig.encoder(position)

    assert first_tick(step, "SINGLE_CHANNEL_TOGGLE", 200) == tick


def test_one_window_of_toggles_is_not_enough_and_a_constant_window_resets(rig: Diagnosis) -> None:
    for k in range(640):
        assert rig.encoder(k % 2 if k // 32 % 2 else 0) == NOTHING


def test_a_hunting_shaft_is_no_alternating_count(rig: Diagnosis) -> None:
    for k in range(640):
        assert rig.encoder((0, 1, 2, 1)[k % 4]) == NOTHING


@pytest.mark.parametrize(("dither", "rests"), [(2, True), (-2, True), (3, False), (-3, False)])
def test_a_shaft_that_rests_may_dither_by_two_counts(rig: Diagnosis, dither: int, rests: bool) -> None:
    for k in range(11):
        rig.encoder(dither * (k % 2))
    assert (rig.seen.ticks_without_movement == 11) == rests


@pytest.mark.parametrize(("size", "tick"), [(2 * SILENT + 1, 11), (2 * SILENT, 0)])
def test_current_in_shorted_windings_of_a_shaft_that_rests_for_eight_ticks(
    rig: Diagnosis, size: int, tick: int
) -> None:
    """The first three ticks without movement do not count."""
    rig.seen.shorted = True
    rig.current(size, 0)
    assert first_tick(lambda _: rig.encoder(), "SHORT_CURRENT_WITHOUT_COUNT", 40) == tick


def test_current_in_shorted_windings_of_a_shaft_that_turns_is_expected(rig: Diagnosis) -> None:
    rig.seen.shorted = True
    rig.current(3000, 0)
    for k in range(100):
        assert rig.encoder(k) == NOTHING


@pytest.mark.parametrize(("counts", "suspected"), [(8, True), (7, False)])
def test_windings_shorted_after_an_abrupt_stop_make_the_encoder_suspect(
    rig: Diagnosis, counts: int, suspected: bool
) -> None:
    for k in range(5):
        rig.encoder(k * counts)
    rig.encoder(4 * counts)
    assert not rig.suspect().suspected & ENCODER
    rig.seen.shorted = True
    assert bool(rig.suspect().suspected & ENCODER) == suspected


# ---- encoder and voltage
@pytest.fixture
def spinning(rig: Diagnosis) -> Diagnosis:
    rig.seen.spins = True
    rig.seen.features = DEAD_TIME
    rig.seen.current_limit = 16000
    return rig


def turn(rig: Diagnosis, tick: int, degrees: float = 20.0, size: float = 6000.0) -> None:
    """Set the voltage of a rotating rotor while the encoder does not count."""
    angle = math.radians(degrees * tick)
    rig.seen.voltage = (round(size * math.cos(angle)), round(size * math.sin(angle)))


def probe_current(rig: Diagnosis) -> tuple[int, int]:
    return rig.evidence.test_current.d, rig.evidence.test_current.q


@pytest.mark.parametrize("degrees", [20.0, -20.0, 0.0])
def test_rotating_voltage_for_eight_ticks_with_current_is_a_lost_encoder(spinning: Diagnosis, degrees: float) -> None:
    spinning.current(2 * SILENT, 0)

    def step(tick: int) -> set[str]:
        turn(spinning, tick, degrees)
        return spinning.encoder()

    assert first_tick(step, "EMF_WITHOUT_COUNT", 40) == (11 if degrees else 0)


@pytest.mark.parametrize(
    ("features", "beyond", "found"),
    [(DEAD_TIME, 0, False), (DEAD_TIME, 1, True), (0, 2 * EMF_FLOOR, False), (0, 2 * EMF_FLOOR + 1, True)],
)
def test_voltage_explained_by_dead_time_and_half_of_the_resistance_is_no_back_emf(
    spinning: Diagnosis, features: int, beyond: int, found: bool
) -> None:
    """Steps of 90 degrees along the axes, where the length is exact. Without compensation the floor is tripled."""
    spinning.current(2 * SILENT, 0)
    spinning.seen.features = features
    length = EMF_FLOOR + spinning.seen.drop // 2 + beyond

    def step(tick: int) -> set[str]:
        spinning.monitors.encoder.unexplained_voltage = (0, 0)
        d, q = ((1, 0), (0, 1), (-1, 0), (0, -1))[tick % 4]
        spinning.seen.voltage = (2 * length * d + spinning.seen.drop, 2 * length * q)
        return spinning.encoder()

    assert bool(first_tick(step, "EMF_WITHOUT_COUNT", 40)) == found


@pytest.mark.parametrize("limit", [16000, 2000])
@pytest.mark.parametrize(
    ("part", "finding"), [(0.4, "CURRENT_NOT_FOLLOWING"), (0.6, "EMF_WITHOUT_COUNT"), (0.8, "EMF_CONFIRMED")]
)
def test_without_current_a_test_current_decides_after_four_ticks(
    spinning: Diagnosis, part: float, finding: str, limit: int
) -> None:
    spinning.seen.current_limit = limit
    size = min(4 * SILENT, limit)
    probed_in: list[int] = []

    def step(tick: int) -> set[str]:
        turn(spinning, tick)
        found = spinning.encoder()
        if probe_current(spinning) != (0, 0):
            probed_in.append(tick)
            d, q = probe_current(spinning)
            assert (abs(d), abs(q)) in {(size, 0), (0, size)}
            spinning.current(round(part * d), round(part * q))
        return found

    assert first_tick(step, finding, 40) == 15
    assert probed_in == [11, 12, 13, 14]


@pytest.mark.parametrize(("i_q", "sign"), [(1000, -1), (0, 1), (-1000, 1)])
def test_a_test_current_on_q_is_directed_away_from_the_limit(spinning: Diagnosis, i_q: int, sign: int) -> None:
    spinning.seen.current_ref.q = i_q
    for tick in range(1, 16):
        turn(spinning, tick)
        spinning.seen.voltage = (0, 6000) if tick >= 10 else spinning.seen.voltage
        spinning.encoder(kp=0)
        if probe_current(spinning) != (0, 0):
            break
    assert probe_current(spinning) == (0, sign * 4 * SILENT)
    spinning.current(0, round(0.8 * sign * 4 * SILENT))
    spinning.seen.voltage = (0, 6000 + round(RESISTANCE * spinning.seen.current.q))
    assert first_tick(lambda _: spinning.encoder(kp=0), "EMF_CONFIRMED", 10) == 4


def test_a_voltage_that_disappears_with_the_test_current_was_wind_up(spinning: Diagnosis) -> None:
    for tick in range(1, 40):
        turn(spinning, tick, size=6000.0 if tick < 11 else 0.0)
        assert spinning.encoder() == NOTHING
        d, q = probe_current(spinning)
        spinning.current(d, q)


@pytest.mark.parametrize(("swept", "immediate"), [(16384, True), (16385, False)])
def test_constant_voltage_for_a_quarter_turn_of_a_back_emf_needs_a_test(
    spinning: Diagnosis, swept: int, immediate: bool
) -> None:
    spinning.current(2 * SILENT, 0)
    for _ in range(12):
        turn(spinning, 0)
        assert spinning.encoder() == NOTHING
    spinning.monitors.encoder.expected_rotation = swept
    turn(spinning, 1, 120.0)
    assert spinning.encoder() == ({"EMF_WITHOUT_COUNT"} if immediate else NOTHING)
    for tick in range(2, 20):
        turn(spinning, tick, 120.0 if immediate else 20.0)
        if spinning.encoder() or probe_current(spinning) != (0, 0):
            break
    assert (probe_current(spinning) == (0, 0)) == immediate


def test_growing_voltage_in_a_constant_direction_for_sixty_ticks_drives_no_current(spinning: Diagnosis) -> None:
    """From the sixth tick on: the first three are ignored, and the filter takes two."""
    spinning.seen.voltage = (6000, 0)
    assert first_tick(lambda _: spinning.encoder(), "CURRENT_NOT_FOLLOWING", 100) == 65


def test_less_than_four_times_the_unexplained_voltage_is_no_wind_up(spinning: Diagnosis) -> None:
    spinning.seen.voltage = (4 * EMF_FLOOR, 0)
    assert first_tick(lambda _: spinning.encoder(), "CURRENT_NOT_FOLLOWING", 200) == 0


def test_a_step_of_the_set_point_explains_the_voltage_of_its_tick(spinning: Diagnosis) -> None:
    spinning.seen.voltage = (6000, 0)

    def step(tick: int) -> set[str]:
        spinning.seen.current_ref.q = (EMF_FLOOR + 1) * (tick % 2)
        return spinning.encoder()

    assert first_tick(step, "CURRENT_NOT_FOLLOWING", 200) == 0


def stopped_at_once(rig: Diagnosis, counts: int = 8) -> None:
    for k in range(5):
        rig.encoder(k * counts)
    rig.monitors.encoder.reference_count = rig.monitors.encoder.last_count = 0


@pytest.mark.parametrize(("counts", "tick"), [(8, 20), (7, 0)])
def test_an_abrupt_stop_is_probed_with_a_current_after_twenty_ticks(
    spinning: Diagnosis, counts: int, tick: int
) -> None:
    stopped_at_once(spinning, counts)
    ticks = [k for k in range(1, 121) if spinning.encoder() == NOTHING and probe_current(spinning) != (0, 0)]
    assert ticks == (list(range(tick, tick + 80)) if tick else [])


@pytest.mark.parametrize(("settled", "swings", "tick"), [(8, 4, 31), (8, 3, 0), (7, 4, 34)])
def test_a_probe_with_four_consecutive_voltage_changes_detects_a_rotating_rotor(
    spinning: Diagnosis, settled: int, swings: int, tick: int
) -> None:
    """The current settles for eight ticks; later voltages are compared with that of the eighth tick."""
    stopped_at_once(spinning)
    started = 20

    def step(k: int) -> set[str]:
        d, _ = probe_current(spinning)
        spinning.current(round(0.75 * d) + 1, 0)
        beyond = started + settled <= k < started + settled + swings
        spinning.seen.integrator_d = (EMF_FLOOR // 2 + 2) << 40 if beyond else 0
        return spinning.encoder()

    assert first_tick(step, "EMF_WITHOUT_COUNT", 99) == tick


def test_a_probe_without_current_or_with_a_changed_set_point_detects_nothing(spinning: Diagnosis) -> None:
    for flows in (False, True):
        spinning.encoder(100)
        stopped_at_once(spinning)
        for k in range(1, 60):
            d, _ = probe_current(spinning)
            spinning.current(d if flows else 0, 0)
            spinning.seen.current_ref.q = (SILENT // 2 + 1) if flows and k >= 31 else 0
            spinning.seen.integrator_d = 5000 << 40 if k >= 28 else 0
            assert spinning.encoder() == NOTHING


# ---- angle of the encoder
@pytest.fixture
def turning(rig: Diagnosis) -> Diagnosis:
    rig.seen.spins = True
    rig.seen.features = DEAD_TIME | BUS_COMPENSATION
    rig.seen.emf = 3000
    rig.seen.conducting_phases = 7
    rig.current(0, 1300)
    return rig


def test_a_residual_voltage_for_five_ticks_is_an_angle_mismatch(turning: Diagnosis) -> None:
    """The filter delays the finding by one tick."""
    turning.seen.voltage = (5000, 3000)
    assert first_tick(lambda _: turning.angle(), "EMF_ANGLE_MISMATCH", 50) == 6


@pytest.mark.parametrize(
    "change",
    [
        {"ticks_without_movement": 1},
        {"features": DEAD_TIME},
        {"features": BUS_COMPENSATION},
        {"conducting_phases": 5},
        {"voltage": (15000, 3000)},  # too large for a back-EMF
        {"emf": EMF_FLOOR // 4},
        {"current_magnitude": SILENT - 1},
    ],
)
def test_conditions_without_an_angle_mismatch(turning: Diagnosis, change: dict[str, object]) -> None:
    turning.seen.voltage = (5000, 3000)
    for name, value in change.items():
        setattr(turning.seen, name, value)
    assert first_tick(lambda _: turning.angle(), "EMF_ANGLE_MISMATCH", 50) == 0


@pytest.mark.parametrize(("less", "found"), [(1, True), (0, False)])
def test_a_residual_above_three_times_the_back_emf_is_no_angle_mismatch(
    turning: Diagnosis, less: int, found: bool
) -> None:
    """Bound of the residual: 2 times the back-EMF (rotated by 180 degrees), plus the uncertainties of the model."""
    unknown = EMF_FLOOR // 4 + turning.seen.emf // 2 + turning.seen.drop // 2
    beyond = unknown + 3 * turning.seen.emf - less
    turning.seen.voltage = (beyond, turning.seen.emf + int(RESISTANCE * turning.seen.current.q))

    def step(_: int) -> set[str]:
        turning.monitors.angle.unexplained_voltage = (beyond, 0)
        return turning.angle()

    turning.seen.current_change = 0
    assert bool(first_tick(step, "EMF_ANGLE_MISMATCH", 50)) == found


@pytest.mark.parametrize("omega", [10000, -10000])
@pytest.mark.parametrize("current", [(16000, 0), (-16000, 0), (0, 16000), (0, -16000)])
def test_the_voltage_of_an_intact_motor_is_no_angle_mismatch(
    turning: Diagnosis, current: tuple[int, int], omega: int
) -> None:
    """A wrong sign would leave twice the voltage drop of the resistance or of the inductance."""
    d, q = current
    for inductive in (0.1, 1.0):
        turning.loop.omega_l_d = turning.loop.omega_l_q = round(inductive * 2**24)
        turning.current(d, q)
        omega_l = inductive * omega / 32768.0
        turning.seen.omega_e = omega
        turning.seen.voltage = (
            round(RESISTANCE * d - omega_l * q),
            round(RESISTANCE * q + omega_l * d + turning.seen.emf),
        )
        assert first_tick(lambda _: turning.angle(), "EMF_ANGLE_MISMATCH", 50) == 0
        assert abs(turning.monitors.angle.unexplained_voltage.d) < 10
        assert abs(turning.monitors.angle.unexplained_voltage.q) < 10


def test_all_phases_must_have_carried_current_since_the_residual_began(turning: Diagnosis) -> None:
    turning.seen.voltage = (5000, 3000)
    for tick in range(1, 12):
        turning.seen.conducting_phases = 1 << tick % 3 if tick < 9 else 0
        assert ("EMF_ANGLE_MISMATCH" in turning.angle()) == (tick >= 6)
    turning.seen.voltage = (0, 3244)
    while turning.monitors.angle.ticks:
        turning.seen.conducting_phases = 7
        turning.angle()
    turning.seen.voltage, turning.seen.conducting_phases = (5000, 3000), 6
    assert first_tick(lambda _: turning.angle(), "EMF_ANGLE_MISMATCH", 20) == 0


def test_phases_that_carried_current_before_a_standstill_do_not_count(turning: Diagnosis) -> None:
    turning.seen.voltage = (5000, 3000)
    turning.angle()
    turning.seen.ticks_without_movement, turning.seen.conducting_phases = 1, 0
    turning.angle()
    turning.seen.ticks_without_movement, turning.seen.conducting_phases = 0, 3
    assert first_tick(lambda _: turning.angle(), "EMF_ANGLE_MISMATCH", 20) == 0


@pytest.mark.parametrize(("beyond", "suspected"), [(3000 + EMF_FLOOR // 4, False), (3001 + EMF_FLOOR // 4, True)])
def test_a_residual_above_the_back_emf_makes_the_angle_suspect(
    turning: Diagnosis, beyond: int, suspected: bool
) -> None:
    for emf in (3000, -3000):
        turning.seen.emf = emf
        turning.monitors.angle.unexplained_voltage = (0, -beyond)
        assert bool(turning.suspect().suspected & ANGLE) == suspected
    turning.seen.sensorless = True
    assert not turning.suspect().suspected & ANGLE


# ---- the stall test
@pytest.mark.parametrize("i_q", [15888, -15888])
def test_a_shaft_without_movement_in_the_stall_test_is_blocked(rig: Diagnosis, i_q: int) -> None:
    rig.stall_start(i_q)
    assert first_tick(lambda _: rig.stall(), "SHAFT_BLOCKED", 1000) == 800


@pytest.mark.parametrize(
    ("flux", "finding", "tick"), [(209631, "STALL_WITHOUT_COUNT", 400), (209630, "SHAFT_BLOCKED", 800)]
)
def test_a_flux_that_follows_the_vector_is_a_free_rotor_with_a_dead_encoder(
    rig: Diagnosis, flux: int, finding: str, tick: int
) -> None:
    rig.stall_start(15888)
    rig.monitors.stall.follow.high = flux
    assert first_tick(lambda _: rig.stall(), finding, 1000) == tick


def mirrored(rig: Diagnosis, movement: int) -> None:
    """The shaft moves while the vector rotates to the first side."""
    rig.seen.count = 0
    rig.stall_start(15888)
    for _ in range(50):
        assert rig.stall() == NOTHING
    assert rig.stall(movement) == NOTHING
    assert rig.monitors.stall.mirrored == (abs(movement) >= 3)


def test_movement_by_two_counts_is_ignored(rig: Diagnosis) -> None:
    mirrored(rig, 2)
    mirrored(rig, -2)


@pytest.mark.parametrize(("movement", "tick"), [(24, 1), (23, 16)])
def test_a_shaft_that_continues_to_move_was_blocked(rig: Diagnosis, movement: int, tick: int) -> None:
    mirrored(rig, 3)
    assert first_tick(lambda k: rig.stall(3 + movement + (k > 8) * 3), "SHAFT_BLOCKED", 40) == tick


@pytest.mark.parametrize(("back", "tick"), [(6, 2), (5, 16)])
def test_a_shaft_that_reverses_or_stops_contradicts_the_angle(rig: Diagnosis, back: int, tick: int) -> None:
    mirrored(rig, 3)
    assert first_tick(lambda k: rig.stall(10 if k == 1 else 10 - back), "STALL_ANGLE_MISMATCH", 40) == tick


@pytest.mark.parametrize(("late", "finding"), [(3, "SHAFT_BLOCKED"), (2, "STALL_ANGLE_MISMATCH")])
def test_movement_in_the_second_half_of_sixteen_ticks_decides(rig: Diagnosis, late: int, finding: str) -> None:
    mirrored(rig, 3)
    assert first_tick(lambda k: rig.stall(8 if k <= 8 else 8 + late), finding, 40) == 16


def test_against_the_torque_the_vector_is_rotated_to_its_largest_angle(rig: Diagnosis) -> None:
    mirrored(rig, -3)
    assert rig.monitors.stall.phi == -50 * 109
    assert first_tick(lambda _: rig.stall(-3), "SHAFT_BLOCKED", 300) == 150


# ---- the shaft in motion
def test_stall_is_found_after_its_number_of_ticks(rig: Diagnosis) -> None:
    rig.shaft_seen.no_movement_at_limit = True
    assert first_tick(lambda _: rig.shaft(), "SHAFT_BLOCKED", 20) == 6
    rig.shaft_seen.no_movement_at_limit = False
    assert rig.shaft() == NOTHING


@pytest.mark.parametrize(
    ("change", "tick"),
    [
        ({}, 5),
        ({"speed": -6002}, 5),
        ({"speed": 6001}, 0),
        ({"decelerated_at_limit": False}, 0),
        ({"decelerated_at_limit": False, "speed_limit": 5001}, 5),
        ({"decelerated_at_limit": False, "speed_limit": 5002}, 0),
    ],
)
def test_speed_gained_against_the_full_current_or_beyond_the_limit(
    rig: Diagnosis, change: dict[str, object], tick: int
) -> None:
    """Speed gain above the margin of 1000 for more than four ticks."""
    state: dict[str, object] = {"decelerated_at_limit": True, "speed_limit": 100000, "speed": 6002, **change}
    for name, value in state.items():
        setattr(rig.shaft_seen, name, value)
    rig.monitors.shaft.braked_speed = 5001
    assert first_tick(lambda _: rig.shaft(), "RUNAWAY", 20) == tick


@pytest.mark.parametrize("sign", [1, -1])
def test_following_error_and_over_speed_need_their_features(rig: Diagnosis, sign: int) -> None:
    rig.shaft_seen.following_error_max, rig.shaft_seen.over_speed_max, rig.shaft_seen.speed_limit = 100, 200, 1000
    rig.shaft_seen.following_error, rig.shaft_seen.speed = 101 * sign, 201 * sign
    assert first_tick(lambda _: rig.shaft(), "FOLLOWING_ERROR", 20) == 0
    rig.shaft_seen.features = FOLLOWING_ERROR
    assert first_tick(lambda _: rig.shaft(), "FOLLOWING_ERROR", 20) == 7
    rig.shaft_seen.features = OVER_SPEED
    assert first_tick(lambda _: rig.shaft(), "OVER_SPEED", 20) == 8
    rig.shaft_seen.features = FOLLOWING_ERROR | OVER_SPEED
    rig.shaft_seen.following_error, rig.shaft_seen.speed = 100 * sign, 200 * sign
    assert first_tick(lambda _: rig.shaft(), "FOLLOWING_ERROR", 20) == 0


# ---- heat and bus
@pytest.mark.parametrize(("hot", "cool", "step"), [(2321, 1911, 1), (1911, 2321, -1)])
def test_over_temperature_is_found_after_sixteen_ticks_and_ends_below_its_hysteresis(
    rig: Diagnosis, hot: int, cool: int, step: int
) -> None:
    assert first_tick(lambda _: rig.heat(hot, cool, hot - step), "HEAT_SINK_HOT", 40) == 0
    assert first_tick(lambda _: rig.heat(hot, cool, hot), "HEAT_SINK_HOT", 40) == 16
    assert rig.heat(hot, cool, cool) == {"HEAT_SINK_HOT"}
    assert rig.heat(hot, cool, cool - step) == NOTHING
    for _ in range(5):
        assert first_tick(lambda _: rig.heat(hot, cool, hot), "HEAT_SINK_HOT", 15) == 0
        rig.heat(hot, cool, hot - step)


@pytest.mark.parametrize(
    ("u_dc", "settled", "broken", "findings"),
    [
        (200, True, False, set()),
        (201, True, False, {"OVER_VOLTAGE"}),
        (100, True, False, set()),
        (99, True, False, {"UNDER_VOLTAGE"}),
        (99, False, False, set()),
        (201, False, True, {"OVER_VOLTAGE", "OVER_CURRENT_TRIP"}),
    ],
)
def test_bus_voltage_and_over_current_latch(
    rig: Diagnosis, u_dc: int, settled: bool, broken: bool, findings: set[str]
) -> None:
    limits = rig.ffi.new("bus_monitor_t *", {"u_dc_max": 200, "u_dc_min": 100})
    rig.evidence.confirmed = rig.lib.bus_monitor_findings(limits, u_dc, settled, broken)
    assert rig.names() == findings


# ---- oscillation
def wave(frequency: float, amplitude: float, ticks: int, noise: float = 0.0) -> list[int]:
    """Samples of a current once per slow tick of 0.5 ms."""
    random = np.random.default_rng(1)
    time = 0.0005 * np.arange(ticks)
    samples = amplitude * np.sin(2.0 * math.pi * frequency * time) + noise * random.standard_normal(ticks)
    return [int(x) for x in np.clip(np.round(samples), -32768, 32767)]


@pytest.mark.parametrize("frequency", [60.0, 80.0, 330.0, 700.0])
@pytest.mark.parametrize(("amplitude", "noise"), [(1000.0, 0.0), (16000.0, 900.0), (60000.0, 0.0)])
def test_a_sustained_oscillation_is_found_in_time_with_its_frequency(
    rig: Diagnosis, frequency: float, amplitude: float, noise: float
) -> None:
    """Also if it is limited, or with noise. The first swings have no previous one and may be counted anew."""
    found = [k for k, x in enumerate(wave(frequency, amplitude, 1000, noise)) if rig.oscillation(x)]
    assert 399 <= found[0] <= 399 + 4 * 20
    assert rig.monitors.oscillation.frequency == pytest.approx(frequency, rel=0.03, abs=1.0)


@pytest.mark.parametrize(
    "current",
    [
        pytest.param(wave(48.0, 30000.0, 4000), id="slower than the longest period"),
        pytest.param(wave(200.0, 480.0, 4000), id="smaller than the smallest swing"),
        pytest.param(wave(0.0, 0.0, 4000, 150.0), id="noise"),
        pytest.param([int(30000 * math.exp(-k / 80) * math.cos(0.6 * k)) for k in range(4000)], id="decays"),
        pytest.param([20000 if k // 60 % 2 else -20000 for k in range(4000)], id="steps of a set-point"),
        pytest.param(([*wave(200.0, 9000.0, 350), *[0] * 40] * 9), id="pauses"),
    ],
)
def test_other_currents_are_no_oscillation(rig: Diagnosis, current: list[int]) -> None:
    assert not any(rig.oscillation(x) for x in current)
    assert rig.monitors.oscillation.frequency == 0


def test_an_oscillation_that_continues_is_found_again(rig: Diagnosis) -> None:
    found = [k for k, x in enumerate(wave(250.0, 4000.0, 1700)) if rig.oscillation(x)]
    assert len(found) == 4
    assert all(400 <= b - a <= 410 for a, b in itertools.pairwise(found))


@pytest.mark.parametrize("seed", range(20))
def test_any_current_is_counted_without_overflow(rig: Diagnosis, seed: int) -> None:
    random = np.random.default_rng(seed)
    swing = int(random.integers(0, 32768))
    extremes = random.choice([-32768, -1, 0, 1, 32767], 1000)
    monitor, swings = rig.monitors.oscillation, []
    for x in np.where(random.random(1000) < 0.5, extremes, random.integers(-32768, 32768, 1000)):
        falling, between = monitor.falling, abs(monitor.extreme - monitor.opposite)
        rig.oscillation(int(x), swing)
        assert monitor.pause <= 21
        assert monitor.turns <= monitor.ticks <= 400
        if monitor.falling != falling:
            assert monitor.swing == between
            swings.append(between)
    assert max(swings) > 32767
