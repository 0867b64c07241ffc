"""F15 and F16: the rotor search finds the angle and reports faults; wrong results violate the bounds."""

from __future__ import annotations

import math

import numpy as np
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


def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer start angles; the tested behaviour occurs at each angle."""
    monkeypatch.setattr(rotor_search, "EVERY", 180)
    monkeypatch.setattr(rotor_search, "FAULT_EVERY", 240)
    monkeypatch.setattr(rotor_search, "DISTURBED_AT", (0.1,))


def test_agrees_with_the_reference_design(outcome: Outcome) -> None:
    assert outcome.agrees, [(row.name, row.measured) for row in outcome.rows if not row.agrees]


def test_picture_of_f16_has_every_vector(outcome: Outcome) -> None:
    for axis, curve in enumerate(outcome.panels[1].curves):
        searches = outcome.row(f"axis{axis + 1} from 30 degrees, searches").measured
        assert searches is not None
        shown = curve.y[~np.isnan(curve.y)]
        assert abs(shown[0]) < 25.0  # the first vector is at 0 ..
        assert abs(shown[-1] - 30.0) < 3.0  # .. and the last one close to the rotor
    assert np.ptp(outcome.panels[0].curves[0].y) > 3.0


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


def test_a_wrong_angle_does_not_agree(monkeypatch: pytest.MonkeyPatch, plant: PlantConfig) -> None:
    few(monkeypatch)
    genuine = rotor_search.wrapped
    monkeypatch.setattr(rotor_search, "wrapped", lambda degrees: genuine(degrees + 5.0))
    wrong = [row.name for row in rotor_search.run(plant, seed=2).rows if not row.agrees]
    assert len([name for name in wrong if name.endswith("error")]) == 14


def test_moving_shaft_is_not_a_blocked_shaft(monkeypatch: pytest.MonkeyPatch, plant: PlantConfig) -> None:
    few(monkeypatch)
    monkeypatch.setattr(Board, "lock_shaft", lambda self, axis, locked=True: None)
    rows = {row.name: row.agrees for row in rotor_search.run(plant, seed=2).rows}
    assert not rows["axis1 shaft blocked: ROTOR_SEARCH"]
    assert not rows["axis1 shaft blocked during the search: ROTOR_SEARCH"]
    assert rows["axis1 encoder unplugged: ENCODER_LOST"]


def test_wrong_fault_does_not_agree(monkeypatch: pytest.MonkeyPatch, plant: PlantConfig) -> None:
    few(monkeypatch)
    monkeypatch.setattr(Board, "connect_encoder", lambda self, axis, connected=True: self.lock_shaft(axis))
    rows = {row.name: row.agrees for row in rotor_search.run(plant, seed=2).rows}
    assert not rows["axis1 encoder unplugged: ENCODER_LOST"]
    assert rows["axis1 encoder line A dead: ENCODER_LOST"]


def test_large_motion_does_not_agree(monkeypatch: pytest.MonkeyPatch, plant: PlantConfig) -> None:
    few(monkeypatch)
    monkeypatch.setattr(rotor_search, "TWITCH_COUNTS", 1)
    long = [row.name for row in rotor_search.run(plant, seed=2).rows if not row.agrees]
    assert long
    assert all(name.endswith("movement") for name in long)


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
            assert board.read_raw("axis1.faults") == board.read_raw("axis2.faults") == [expected]
