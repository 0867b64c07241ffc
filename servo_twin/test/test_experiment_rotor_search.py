"""F15 and F16: the rotor search finds the angle and reports faults; wrong results violate the bounds."""

from __future__ import annotations

import math

import pytest
from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import rotor_search
from servo_twin.validation.experiments.outcome import Outcome
from servo_twin.validation.experiments.rotor_search import Search, SearchFault


@pytest.fixture(scope="module")
def plant() -> PlantConfig:
    return PlantConfig.load()


@pytest.fixture(scope="module")
def outcome(plant: PlantConfig) -> Outcome:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rotor_search, "EVERY", 30)
        patch.setattr(rotor_search, "FAULT_EVERY", 120)
        return rotor_search.run(plant, seed=11)


def test_agrees_with_the_reference_design(outcome: Outcome) -> None:
    assert outcome.agrees, [(row.name, row.measured) for row in outcome.rows if not row.agrees]


def test_a_rotor_at_180_degrees_needs_the_second_vector(plant: PlantConfig) -> None:
    for search in rotor_search.find(rotor_search.start_at(plant, 180.0), 1):
        assert search.error is not None
        assert abs(search.error) < 1.7
        assert search.current > 3.9  # the first vector reached its current limit without a movement


def test_the_bound_of_the_error_depends_on_the_current(plant: PlantConfig) -> None:
    axis = plant.axes[0]
    assert rotor_search.error_bound(axis, 4.0) == pytest.approx(
        0.7 + math.degrees(math.asin(2e-3 / (3 * 0.0154 * 4.0))) + 0.36
    )
    assert rotor_search.error_bound(axis, 0.0) > 90.0


@pytest.mark.parametrize("search_fault", rotor_search.SEARCH_FAULTS, ids=lambda search_fault: search_fault.name)
def test_one_axis_may_fail_alone(plant: PlantConfig, search_fault: SearchFault) -> None:
    first, second = rotor_search.find(plant, 3, search_fault=search_fault, axes=[1])
    assert isinstance(first, Search)
    assert first.error is not None
    assert first.faults == frozenset()
    assert second.error is None
    assert second.faults == {search_fault.fault}


def test_faults_are_distinguished_without_dead_time_compensation(plant: PlantConfig) -> None:
    """The search compares voltages, so it compensates the dead time even if the host has disabled the compensation."""
    for k, search_fault in enumerate((rotor_search.LOCKED, rotor_search.UNPLUGGED)):
        with Board(rotor_search.start_at(plant, 75.0), seed=k) as board:
            board.write_raw("param.features", [0, 0])
            board.run(0.03)
            for axis in range(2):
                search_fault.inject(board, axis)
            board.write("cmd.enable", [1, 1])
            board.run(1.2)
            expected = board.catalogue.flag("faults", search_fault.fault).mask
            assert board.read_words("axis1.faults") == board.read_words("axis2.faults") == [expected]
