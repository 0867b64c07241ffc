"""Position moves: no overshoot, no limit cycle; a limit cycle violates the bounds."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import TICK
from servo_twin.plant import PlantConfig
from servo_twin.simulation import SimulationError
from servo_twin.validation.experiments import position
from servo_twin.validation.experiments.rig import record, spinning

TARGET = 100
PLANT = PlantConfig.load()


@pytest.fixture(scope="module")
def still() -> Trace:
    """Two seconds of a shaft at rest."""
    with spinning(PlantConfig.load(), 1) as board:
        return record(board, [0], 2.0)[0]


def moved(still: Trace, shape: NDArray[np.float64]) -> Trace:
    return still.changed(position=shape.astype(np.float64))


def test_short_moves_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(position, "DISTANCES", (0.01, 1.0))
    outcome = position.run(PlantConfig.load(), seed=4)
    assert len(outcome.rows) == 2 * 2 * 2 * 4
    assert outcome.agrees, [(row.name, row.measured) for row in outcome.rows if not row.agrees]


def test_figures_of_a_known_shape(still: Trace) -> None:
    shape = np.full(still.time.size, TARGET)
    shape[:1000] = np.linspace(0, TARGET - 10, 1000)
    shape[1200] = TARGET + 7
    shape[-10] = TARGET - 1
    move = position.measure(moved(still, shape), TARGET, 0.5, PLANT, 0)
    assert (move.overshoot, move.cycle) == (7.0, 1.0)
    assert move.error == pytest.approx(1.0 / 1000.0)
    assert move.settling == pytest.approx(1201 * TICK - 0.5)
    back = position.measure(moved(still, -shape), -TARGET, 0.5, PLANT, 0)
    assert (back.overshoot, back.cycle) == (7.0, 1.0)


def test_limit_cycle_is_detected(still: Trace) -> None:
    shape = TARGET + 2 * np.sign(np.sin(2.0 * np.pi * 10.0 * still.time))
    shape[0] = 0
    move = position.measure(moved(still, shape), TARGET, 0.0, PLANT, 0)
    assert move.cycle > position.COUNTS_MAX


def test_a_shaft_that_does_not_arrive_never_settles(still: Trace) -> None:
    move = position.measure(moved(still, np.zeros(still.time.size)), TARGET, 0.0, PLANT, 0)
    assert move.settling is None
    assert move.error == TARGET


def test_blocked_shaft_does_not_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(position, "DISTANCES", (1.0,))
    with spinning(PlantConfig.load(), 1) as board:
        board.lock_shaft(0)
        with pytest.raises(SimulationError, match="STALLED"):
            position.travel(board, 0, 1.0, ramp=False)
