"""From evidence to the name of a fault: every rule of the priority table, its suspicions, and the latch."""

from __future__ import annotations

import itertools
from typing import Final, NamedTuple

import pytest
from diagnosis_rig import ANGLE, CURRENT, ENCODER, PHASE, SENSOR, Diagnosis
from servo_msgs_py.catalogue import Catalogue

BITS: Final = {fault.name: fault.mask for fault in Catalogue.load().flags["faults"]}
ALL: Final = sum(BITS.values())
CAUSES: Final = {
    SENSOR: "CURRENT_SENSE",
    PHASE: "PHASE_LOST",
    CURRENT: "PHASE_LOST",
    ENCODER: "ENCODER_LOST",
    ANGLE: "ANGLE_MISMATCH",
}


class Rule(NamedTuple):
    """Fault of a finding, the suspicions that explain it, and the substitute fault if that fault is disabled."""

    fault: str
    instead: int = 0
    otherwise: str = ""


RULES: Final = {
    "OVER_VOLTAGE": Rule("OVER_VOLTAGE"),
    "UNDER_VOLTAGE": Rule("UNDER_VOLTAGE"),
    "OVER_CURRENT_TRIP": Rule("OVER_CURRENT", PHASE | ENCODER),
    "OFFSET_OUT_OF_RANGE": Rule("CURRENT_OFFSET"),
    "SEARCH_NO_MOVEMENT": Rule("ROTOR_SEARCH"),
    "COUNT_CONTRADICTS_INDEX": Rule("ENCODER"),
    "HOST_SILENT": Rule("HOST_SILENT"),
    "SHAFT_BLOCKED": Rule("STALLED"),
    "RUNAWAY": Rule("RUNAWAY", SENSOR | PHASE | CURRENT | ANGLE),
    "SINGLE_CHANNEL_TOGGLE": Rule("ENCODER_LOST"),
    "SHORT_CURRENT_WITHOUT_COUNT": Rule("ENCODER_LOST"),
    "EMF_WITHOUT_COUNT": Rule("ENCODER_LOST", SENSOR | PHASE | CURRENT),
    "EMF_CONFIRMED": Rule("ENCODER_LOST", SENSOR),
    "SEARCH_WITHOUT_COUNT": Rule("ENCODER_LOST", otherwise="ROTOR_SEARCH"),
    "STALL_WITHOUT_COUNT": Rule("ENCODER_LOST", otherwise="STALLED"),
    "FOLLOWING_ERROR": Rule("FOLLOWING_ERROR"),
    "OVER_SPEED": Rule("OVER_SPEED"),
    "SEARCH_REVERSED": Rule("ENCODER_REVERSED", SENSOR | PHASE | CURRENT),
    "HEAT_SINK_HOT": Rule("OVER_TEMPERATURE"),
    "WINDING_HOT": Rule("MOTOR_TEMPERATURE"),
    "START_UP_SLOW": Rule("START_UP"),
    "OBSERVER_LOST": Rule("SPEED_FEEDBACK", SENSOR | PHASE | CURRENT),
    "EMF_ANGLE_MISMATCH": Rule("ANGLE_MISMATCH", SENSOR),
    "OBSERVER_ANGLE_MISMATCH": Rule("ANGLE_MISMATCH"),
    "STALL_ANGLE_MISMATCH": Rule("ANGLE_MISMATCH", otherwise="STALLED"),
    "PHASE_NO_CURRENT": Rule("PHASE_LOST", SENSOR),
    "CURRENT_NOT_FOLLOWING": Rule("PHASE_LOST", SENSOR),
    "SEARCH_LOW_CURRENT": Rule("PHASE_LOST", SENSOR, "ROTOR_SEARCH"),
    "SEARCH_END_NO_CURRENT": Rule("PHASE_LOST", otherwise="ROTOR_SEARCH"),
    "START_UP_NO_CURRENT": Rule("PHASE_LOST", otherwise="START_UP"),
    "CURRENT_SENSE_FAILED": Rule("CURRENT_SENSE"),
    "LOOPS_LATE": Rule("LATE_LOOP"),
    "WATCHDOG_RESET": Rule("WATCHDOG"),
    "HOMING_FAILED": Rule("HOMING"),
    "ENABLE_OPEN": Rule("ENABLE_INPUT"),
    "LIMIT_SWITCH": Rule("LIMIT_SWITCH"),
    "OSCILLATION": Rule("OSCILLATION"),
}
"""In the order of their priority."""


def verdict(rig: Diagnosis, findings: int, suspected: int = 0, enabled: int = ALL, **more: int) -> tuple[int, int]:
    """The first fault, and all of them."""
    evidence = rig.ffi.new("evidence_t *", {"confirmed": findings, "suspected": suspected & ~PHASE, **more})
    if suspected & PHASE:
        evidence.phases_without_current = 2
    result = rig.lib.fault_isolate(evidence, enabled)
    return result.first, result.faults


def test_every_finding_has_a_rule(rig: Diagnosis) -> None:
    names = {name.removeprefix("FINDING_") for name in dir(rig.lib) if name.startswith("FINDING_")}
    assert names == set(RULES)
    assert [rig.finding(name) for name in RULES] == [1 << k for k in range(rig.lib.FINDINGS)]


@pytest.mark.parametrize("name", RULES)
def test_a_finding_without_suspicions_has_its_own_name(rig: Diagnosis, name: str) -> None:
    mine = BITS[RULES[name].fault]
    assert verdict(rig, rig.finding(name)) == (mine, mine)
    assert rig.lib.fault_names(rig.finding(name)) == mine
    assert rig.lib.fault_enabled(rig.finding(name), mine) == rig.finding(name)
    assert rig.lib.fault_enabled(rig.finding(name), ALL & ~mine) == 0


@pytest.mark.parametrize("suspicion", CAUSES)
@pytest.mark.parametrize("name", RULES)
def test_a_suspicion_replaces_only_the_findings_that_it_explains(rig: Diagnosis, name: str, suspicion: int) -> None:
    rule = RULES[name]
    cause = CAUSES[suspicion] if rule.instead & suspicion else rule.fault
    first, faults = verdict(rig, rig.finding(name), suspicion)
    assert first == BITS[cause]
    kept = BITS["OVER_CURRENT"] if name == "OVER_CURRENT_TRIP" else 0  # the switches are open, independent of the cause
    assert faults == BITS[cause] | kept


@pytest.mark.parametrize("suspicion", CAUSES)
@pytest.mark.parametrize("name", RULES)
def test_a_cause_that_is_not_enabled_explains_nothing(rig: Diagnosis, name: str, suspicion: int) -> None:
    rule = RULES[name]
    enabled = ALL & ~BITS[CAUSES[suspicion]] | BITS[rule.fault]
    if CAUSES[suspicion] != rule.fault:
        assert verdict(rig, rig.finding(name), suspicion, enabled)[0] == BITS[rule.fault]


@pytest.mark.parametrize("name", RULES)
def test_a_finding_whose_fault_is_disabled_stops_only_with_a_substitute_fault(rig: Diagnosis, name: str) -> None:
    rule = RULES[name]
    other = BITS[rule.otherwise] if rule.otherwise else 0
    assert verdict(rig, rig.finding(name), enabled=ALL & ~BITS[rule.fault]) == (other, other)


@pytest.mark.parametrize("name", RULES)
def test_a_finding_is_relevant_if_one_of_its_faults_is_enabled(rig: Diagnosis, name: str) -> None:
    rule = RULES[name]
    causes = (cause for suspicion, cause in CAUSES.items() if rule.instead & suspicion)
    names = {rule.fault, *causes, *filter(None, [rule.otherwise])}
    for fault, bit in BITS.items():
        assert rig.lib.fault_relevant(rig.finding(name), bit) == (fault in names)
    assert not rig.lib.fault_relevant(0, ALL)


def test_the_strongest_suspicion_comes_first(rig: Diagnosis) -> None:
    everything = SENSOR | PHASE | CURRENT | ENCODER | ANGLE
    away = rig.finding("RUNAWAY")
    assert verdict(rig, away, everything)[0] == BITS["CURRENT_SENSE"]
    assert verdict(rig, away, everything & ~SENSOR)[0] == BITS["PHASE_LOST"]
    assert verdict(rig, away, CURRENT | ANGLE)[0] == BITS["PHASE_LOST"]
    assert verdict(rig, away, ENCODER | ANGLE)[0] == BITS["ANGLE_MISMATCH"]
    assert verdict(rig, rig.finding("OVER_CURRENT_TRIP"), PHASE | ENCODER)[0] == BITS["PHASE_LOST"]


def test_of_simultaneous_findings_the_first_row_names_the_fault(rig: Diagnosis) -> None:
    for first, second in itertools.combinations(RULES, 2):
        expected = BITS[RULES[first].fault]
        result = verdict(rig, rig.finding(first) | rig.finding(second))
        assert result == (expected, expected | BITS[RULES[second].fault])


def test_a_phase_without_current_and_with_a_constant_code_is_not_suspected(rig: Diagnosis) -> None:
    trip = rig.finding("OVER_CURRENT_TRIP")
    assert verdict(rig, trip, phases_without_current=0b010, repeating=0b101)[0] == BITS["PHASE_LOST"]
    assert verdict(rig, trip, phases_without_current=0b010, repeating=0b010)[0] == BITS["OVER_CURRENT"]
    assert verdict(rig, trip, phases_without_current=0b110, repeating=0b010)[0] == BITS["PHASE_LOST"]
    assert verdict(rig, trip, SENSOR, phases_without_current=0b010)[0] == BITS["OVER_CURRENT"]


# ---- causes that are found after their consequence
DERIVED = [
    "CURRENT_OFFSET",
    "ROTOR_SEARCH",
    "ENCODER_LOST",
    "ENCODER_REVERSED",
    "ANGLE_MISMATCH",
    "PHASE_LOST",
    "SPEED_FEEDBACK",
    "START_UP",
]


@pytest.mark.parametrize("captured", BITS)
def test_a_failed_current_sense_found_later_voids_faults_derived_from_currents(rig: Diagnosis, captured: str) -> None:
    derived = sum(BITS[name] for name in DERIVED)
    revision = rig.lib.fault_revise(BITS["CURRENT_SENSE"], BITS[captured], 2047)
    if captured in (*DERIVED, "OVER_CURRENT"):
        assert (revision.first, revision.voids) == (BITS["CURRENT_SENSE"], derived)
    else:
        assert (revision.first, revision.voids) == (0, 0)
    assert rig.lib.fault_revise(BITS["CURRENT_SENSE"], BITS[captured], 2048).first == 0


@pytest.mark.parametrize("captured", BITS)
def test_a_late_loop_counted_after_the_over_current_is_its_cause(rig: Diagnosis, captured: str) -> None:
    revision = rig.lib.fault_revise(BITS["LATE_LOOP"], BITS[captured], 15)
    assert (revision.first, revision.voids) == (BITS["LATE_LOOP"] if captured == "OVER_CURRENT" else 0, 0)
    assert rig.lib.fault_revise(BITS["LATE_LOOP"], BITS[captured], 16).first == 0


def test_of_two_simultaneous_causes_the_failed_current_sense_is_first(rig: Diagnosis) -> None:
    revision = rig.lib.fault_revise(BITS["LATE_LOOP"] | BITS["CURRENT_SENSE"], BITS["OVER_CURRENT"], 15)
    assert revision.first == BITS["CURRENT_SENSE"]


def test_other_faults_found_later_are_consequences(rig: Diagnosis) -> None:
    for fresh in set(BITS) - {"CURRENT_SENSE", "LATE_LOOP"}:
        assert rig.lib.fault_revise(BITS[fresh], ALL, 0).first == 0


# ---- the latch
class Latch:
    def __init__(self, rig: Diagnosis) -> None:
        self.rig = rig
        self.record = rig.ffi.new("fault_record_t *")
        self.clock = rig.ffi.new("uint32_t *", 1000)
        self.latch = rig.ffi.new("fault_latch_t *")
        rig.lib.fault_latch_init(self.latch, self.record, self.clock)

    def capture(self, name: str) -> int:
        evidence = self.rig.ffi.new("evidence_t *", {"confirmed": self.rig.finding(name)})
        return int(self.rig.lib.fault_latch_capture(self.latch, evidence, self.rig.seen))

    @property
    def first(self) -> int:
        return int(1 << self.latch.first >> 1)


def test_the_first_fault_is_recorded_and_later_ones_only_captured(rig: Diagnosis) -> None:
    latch = Latch(rig)
    rig.seen.state, rig.seen.substate, rig.seen.u_dc = 3, 4, 77
    assert latch.capture("OVER_SPEED") == BITS["OVER_SPEED"]
    latch.clock[0], rig.seen.state, rig.seen.u_dc = 1010, 0, 78
    assert latch.capture("HEAT_SINK_HOT") == BITS["OVER_TEMPERATURE"]
    rig.lib.fault_latch_sample(latch.latch, rig.seen)
    assert latch.latch.captured == BITS["OVER_SPEED"] | BITS["OVER_TEMPERATURE"]
    assert latch.first == BITS["OVER_SPEED"]
    record = latch.record
    assert (record.tick, record.state, record.substate, record.size, record.u_dc[0]) == (1000, 3, 4, 1, 77)


def test_a_revision_replaces_the_first_fault_and_removes_void_faults(rig: Diagnosis) -> None:
    latch = Latch(rig)
    latch.capture("PHASE_NO_CURRENT")
    latch.clock[0] += 2047
    latch.capture("CURRENT_SENSE_FAILED")
    assert (latch.first, latch.latch.captured) == (BITS["CURRENT_SENSE"], BITS["CURRENT_SENSE"])
    assert latch.record.code == latch.latch.first


def test_disabled_faults_are_not_captured(rig: Diagnosis) -> None:
    latch = Latch(rig)
    latch.latch.enabled = ALL & ~BITS["OVER_SPEED"]
    assert latch.capture("OVER_SPEED") == 0
    assert (latch.latch.captured, latch.first, latch.latch.findings, latch.record.size) == (0, 0, 0, 0)


def test_a_fault_after_a_partial_clear_keeps_the_name_of_what_remained(rig: Diagnosis) -> None:
    latch = Latch(rig)
    latch.capture("OVER_SPEED")
    latch.capture("HEAT_SINK_HOT")
    rig.lib.fault_latch_clear(latch.latch, BITS["OVER_TEMPERATURE"])
    latch.capture("PHASE_NO_CURRENT")
    assert latch.first == BITS["OVER_TEMPERATURE"]
    assert latch.latch.captured == BITS["OVER_TEMPERATURE"] | BITS["PHASE_LOST"]


def test_clearing_keeps_remaining_faults_and_restarts_the_record(rig: Diagnosis) -> None:
    latch = Latch(rig)
    latch.capture("OVER_SPEED")
    latch.capture("HEAT_SINK_HOT")
    rig.lib.fault_latch_clear(latch.latch, BITS["OVER_TEMPERATURE"])
    assert (latch.latch.captured, latch.first) == (BITS["OVER_TEMPERATURE"],) * 2
    rig.lib.fault_latch_clear(latch.latch, 0)
    assert (latch.latch.captured, latch.first, latch.latch.findings) == (0, 0, 0)
    for _ in range(70):
        rig.lib.fault_latch_sample(latch.latch, rig.seen)
    assert latch.record.size == 64
