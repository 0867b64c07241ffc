"""Some cases of the fault matrix; the full matrix is an experiment of some minutes."""

from __future__ import annotations

import pytest
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import fault_matrix
from servo_twin.validation.experiments.fault_matrix import case, fault_cases, judge
from servo_twin.validation.experiments.operating_states import Bench

PLANT = PlantConfig.load()
CASES = {fault_case.name: fault_case for fault_case in fault_cases(PLANT)}


@pytest.mark.parametrize(
    ("name", "state"),
    [
        ("open phase b", "100 rad/s"),
        ("open phase a", "STOP"),
        ("phase a to minus", "-250 rad/s"),
        ("converter c at 2050", "torque"),
        ("encoder line A", "FREEWHEEL"),
        ("rotor held", "ALIGN"),
        ("supply gone", "torque"),
        ("heat", "hold"),
        ("core stands still 1 ms", "100 rad/s"),
        ("core hangs", "20 rad/s"),
        ("noise x 3", "-250 rad/s"),
    ],
)
def test_fault_is_reported_in_time_without_motion(name: str, state: str) -> None:
    found = case(PLANT, 7, CASES[name], state)
    assert found.agrees, found
    assert judge([found]).agrees


def test_disabled_fault_counts_as_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the check disabled, the motor continues with two phases."""
    genuine = fault_matrix.STATES["100 rad/s"]

    def deaf(bench: Bench) -> None:
        genuine(bench)
        bench.board.write("param.faults_enabled", [0, 0])

    monkeypatch.setattr(fault_matrix, "STATES", {"100 rad/s": deaf})
    found = case(PLANT, 7, CASES["open phase b"], "100 rad/s")
    assert not found.name_correct
    assert not judge([found]).agrees
