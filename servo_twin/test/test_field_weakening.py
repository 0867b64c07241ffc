"""Field weakening on the virtual board: moves, torque, both directions at the rated speed, and its end."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from servo_msgs_py.board_port import choose, word, write_axis, write_word
from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import field_weakening, rig
from servo_twin.validation.experiments.field_weakening import RATED, at_rated
from servo_twin.validation.experiments.rig import RPM, features, record, spinning

AXIS = field_weakening.AXIS


@pytest.fixture
def rated() -> Iterator[Board]:
    """Axis 1 at its rated speed with field weakening."""
    with at_rated(PlantConfig.load(), 5, [AXIS], weak=True) as board:
        board.run(0.25)
        assert board.truth(AXIS).i_d < -0.3
        yield board


def test_a_position_move_at_the_rated_speed_arrives() -> None:
    """No following error, and no more overshoot than at lower speeds."""
    with spinning(PlantConfig.load(), 5) as board:
        features(board, AXIS, FIELD_WEAKENING=True, FOLLOWING_ERROR=True, OVER_SPEED=True)
        write_axis(board, "param.speed_limit", AXIS, RATED)
        write_axis(board, "param.over_speed", AXIS, 480.0)
        target = word(board, AXIS, "position") + 30 * 4000
        write_word(board, "cmd.position", AXIS, target)
        move = record(board, [AXIS], 1.2)[AXIS]
    assert float(move["omega"].max()) > 0.98 * RATED
    assert float(move["i_d"].min()) < -0.3
    assert float(move["position"].max()) <= target + 2
    assert abs(float(move["position"][-1]) - target) <= 2
    assert float(np.abs(move["i_d"][-100:]).max()) < 0.1


def test_negative_rated_speed_is_reached(rated: Board) -> None:
    write_axis(rated, "cmd.speed", AXIS, -RATED)
    rated.run(0.5)
    assert rated.truth(AXIS).omega_m == pytest.approx(-RATED, rel=0.005)
    assert rated.truth(AXIS).i_d < -0.3


def test_torque_mode_reaches_the_speed_limit(rated: Board) -> None:
    choose(rated, "cmd.mode", AXIS, "TORQUE")
    write_axis(rated, "cmd.i_q", AXIS, 0.5)
    run = record(rated, [AXIS], 0.3)[AXIS]
    assert float(run["omega"][-100:].mean()) == pytest.approx(RATED, rel=0.01)
    assert float(run["omega"].std()) < 60.0 * RPM


def test_the_angle_check_raises_no_alarm(rated: Board) -> None:
    """Observer and encoder agree on the rotor angle, also at the voltage limit."""
    features(rated, AXIS, ANGLE_CHECK=True)
    for load, supply in ((field_weakening.STEP, 24.0), (0.02, 19.0), (0.0, 24.0)):
        rated.set_load(AXIS, load)
        rated.set_supply(supply)
        run = record(rated, [AXIS], 0.3)[AXIS]  # fails on a fault
        assert float(run["i_d"][-100:].mean()) < -0.3


def test_field_weakening_works_without_an_encoder() -> None:
    """The observer follows the rotor at the rated speed, with a load step and a dip of the supply."""
    with spinning(PlantConfig.load(), 5) as board:
        board.write("cmd.enable", [0, 0])
        board.run(0.3)
        write_axis(board, "param.feedback", AXIS, 1.0)
        features(board, AXIS, FIELD_WEAKENING=True)
        write_axis(board, "param.speed_limit", AXIS, RATED)
        choose(board, "cmd.mode", AXIS, "SPEED")
        write_axis(board, "cmd.speed", AXIS, RATED)
        board.write("cmd.enable", [1, 0])
        board.run(2.0)
        for load, supply in ((0.0, 24.0), (field_weakening.STEP, 24.0), (0.02, 20.0), (0.02, 24.0)):
            board.set_load(AXIS, load)
            board.set_supply(supply)
            run = record(board, [AXIS], 0.4)[AXIS].part(0.2)
            target = field_weakening.theoretical_speed(board.plant.axes[AXIS], supply, load, weak=True)
            assert float(run["omega"].mean()) == pytest.approx(target, rel=field_weakening.SPEED_TOLERANCE)
            assert float(run["omega"].std()) < field_weakening.SPEED_DEVIATION_MAX
            assert float(run["i_d"].mean()) < -0.4
            used, true = board.read("axis1.theta_e"), board.plant.axes[AXIS].pole_pairs * board.truth(AXIS).theta_m
            assert isinstance(used, float)
            assert abs(math.remainder(used - true, 2.0 * math.pi)) < math.radians(25.0)


@pytest.mark.parametrize("supply", [24.0, 20.0])
def test_outputs_off_at_the_rated_speed_keep_the_bus_voltage(rated: Board, supply: float) -> None:
    """The rectified back-EMF, 22.3 V between two phases, charges the bus to no more than that."""
    rated.set_supply(supply)
    rated.write_raw("param.on_disable", [0, 0])  # COAST
    rated.write("cmd.enable", [0, 0])
    run = record(rated, [AXIS], 0.1)[AXIS]
    assert float(run["u_dc"].max()) < max(24.0, 22.4) + 0.2
    assert not run["faults"].any()
    assert float(np.abs(run["i_d"][2:]).max()) < 0.1


def test_experiment_agrees_and_detects_a_disabled_feature(monkeypatch: pytest.MonkeyPatch) -> None:
    def wrong() -> list[str]:
        return [row.name for row in field_weakening.run(PlantConfig.load(), 3).rows if not row.agrees]

    assert wrong() == []
    monkeypatch.setattr(rig, "features", lambda board, axis, **switches: None)
    assert any("speed gained" in name for name in wrong())
