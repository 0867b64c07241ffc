"""Speed by four methods: the floor, the stagnation and the worked example of F19."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
from servo_msgs_py.trace import Trace
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import mt_speed
from servo_twin.validation.experiments.rig import COUNT, RPM


@pytest.fixture(scope="module")
def plant() -> PlantConfig:
    return PlantConfig.load()


@pytest.mark.usefixtures("level")
def test_agrees_with_the_reference_design(plant: PlantConfig) -> None:
    outcome = mt_speed.run(plant, seed=2)
    assert outcome.agrees, [(row.name, row.measured) for row in outcome.rows if not row.agrees]


def test_worked_example_gives_exact_fractions() -> None:
    assert mt_speed.worked_example() == (Fraction(1), Fraction(4, 5), Fraction(1, 2), Fraction(4, 11), Fraction(1, 3))
    assert mt_speed.enhanced_factor(7, 7) == 1


@pytest.mark.usefixtures("level")
def test_shaft_follows_the_given_speed(plant: PlantConfig) -> None:
    motion = mt_speed.drive(plant, 1, lambda k: 10.0, 0.02, enhanced=True)
    # the switching plant holds the viscous friction constant within its steps of about 30 us
    assert motion["omega"] == pytest.approx(10.0, rel=1e-4)


def test_edges_of_a_steady_shaft(plant: PlantConfig) -> None:
    speed = 100.0 * RPM
    motion = mt_speed.drive(plant, 1, lambda k: speed, 0.1, enhanced=True)
    edges = mt_speed.edges_of(motion, mt_speed.start_angle(plant, 1))
    assert np.diff(edges.time[5:]) == pytest.approx(COUNT / speed, rel=1e-4)
    assert abs(edges.number.size - motion["position"][-1]) <= 1
    assert (edges.of_b().number % 2 == 0).all()


def test_plain_method_violates_the_bounds(monkeypatch: pytest.MonkeyPatch, plant: PlantConfig) -> None:
    """With the enhanced M/T method disabled the speed stagnates."""
    genuine = mt_speed.drive

    def drive(plant: PlantConfig, seed: int, speed_at: Callable[[int], float], seconds: float, enhanced: bool) -> Trace:
        return genuine(plant, seed, speed_at, seconds, enhanced=False)

    monkeypatch.setattr(mt_speed, "drive", drive)
    monkeypatch.setattr(mt_speed, "SPEEDS", (100.0, 1000.0))
    wrong = {row.name for row in mt_speed.run(plant, seed=2).rows if not row.agrees}
    assert {"enhanced M/T, stagnation", "firmware against E33 and F19 while braking"} <= wrong


def test_stagnation_of_a_known_signal() -> None:
    speed = np.array([3.0, 3.0, 3.0, 3.0, 2.0, 2.0, 0.0, 0.0, 0.0])
    overdue = np.array([False, False, True, True, True, True, True, True, True])
    assert mt_speed.stagnation(speed, overdue) == pytest.approx(2 * 0.5e-3)
