"""Feed-forward against torque ripple on shafts with cogging, with the true harmonic: speed ripple at both levels."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from servo_msgs_py.axis_config_transfer import send_configuration
from servo_msgs_py.board_port import write_axis
from servo_msgs_py.catalogue import Catalogue
from servo_tuning.reading import parse
from servo_tuning.tuned import tuned
from servo_twin.board import Board
from servo_twin.level import Level
from servo_twin.plant import PlantConfig
from servo_twin.servo_config import servo_table
from servo_twin.validation.experiments.rig import COUNT, RPM, at_level, record, set_up, spinning

PHASE = 0.7  # of the cogging at the zero of the plant [rad]
SETTLE = 0.5  # [s]


@contextmanager
def shaft(level: Level, torque: float, periods: int, error: float = 0.0, **values: float) -> Iterator[Board]:
    """Homed axis 1 with cogging [N m], configured with it; its phase is wrong by `error` [rad].

    `values` are further ones of the plant.
    """
    cogging = {"cogging_torque": torque, "cogging_periods": periods, "cogging_phase": PHASE}
    plant = PlantConfig.load().with_axis(0, **cogging, **values)
    with at_level(level), spinning(plant, 1) as board:
        write_axis(board, "cmd.home", 0, board.catalogue.enums["home_method_t"]["HERE"])
        board.run(0.01)
        rest = record(board, [0], 0.05)[0]
        zero = float(np.median(rest["theta"] - rest["position"] * COUNT))
        harmonic = {"order": periods, "amplitude": torque, "phase": (PHASE + periods * zero + error) % (2.0 * math.pi)}
        table = dict(servo_table())
        table["axis1"] = {**table["axis1"], "torque_ripple": {"harmonics": [harmonic]}}
        configuration = parse(table, Catalogue.load())
        send_configuration(board, {0: tuned(configuration.axes[0], configuration).block})
        yield board


def ripple(board: Board, rpm: float, seconds: float, *, on: bool) -> float:
    """RMS deviation of the true speed from its set-point [rpm]."""
    set_up(board, 0, "SPEED", rpm * RPM, TORQUE_RIPPLE=on)
    speed = record(board, [0], SETTLE + seconds)[0].part(SETTLE)["omega"]
    return float(np.sqrt(np.mean((speed / RPM - rpm) ** 2)))


@pytest.mark.parametrize("level", ["ideal", "registers"])
@pytest.mark.parametrize(
    ("torque", "periods", "rpm", "remains"),
    [(0.03, 12, 60.0, 0.15), (0.03, 12, -60.0, 0.15), (0.03, 84, 10.0, 0.25), (0.03, 12, 10.0, 0.4)],
)
def test_cogging_is_compensated(level: Level, torque: float, periods: int, rpm: float, remains: float) -> None:
    """In both directions; the ripple of a shaft without cogging remains (at level registers 3.5 rpm)."""
    with shaft(level, torque, periods) as board:
        before = ripple(board, rpm, 0.5, on=False)
        assert ripple(board, rpm, 0.5, on=True) < remains * before
        assert ripple(board, rpm, 0.5, on=False) == pytest.approx(before, rel=0.2)


@pytest.mark.parametrize("error", [math.pi, 0.5 * math.pi])
def test_a_wrong_phase_makes_it_worse(error: float) -> None:
    with shaft("ideal", 0.03, 12, error) as board:
        assert ripple(board, 60.0, 0.5, on=True) > 1.2 * ripple(board, 60.0, 0.5, on=False)


def test_at_the_current_limit_it_is_no_oscillation() -> None:
    """The sine passes 50 .. 300 Hz during the acceleration at the limit, which leaves nothing of it."""
    with shaft("ideal", 0.03, 12, inertia=1.6e-4) as board:
        set_up(board, 0, "SPEED", 1500.0 * RPM, parameters={"i_q_limit": 1.0}, TORQUE_RIPPLE=True)
        trace = record(board, [0], 1.0)[0]
        assert np.mean(np.abs(trace["i_q_ref"]) > 0.99) > 0.3
        assert not np.any(trace["oscillation"])
