"""Continuous sampling of a virtual board, at both levels."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.units import PERIOD_NS, SLOW_PERIODS
from servo_twin.board import Board, BoardError
from servo_twin.level import Level

VARIABLES = Catalogue.load().variables
SNAPSHOT = [(VARIABLES[name], 0) for name in ("tick", "u_dc", "axis2.position", "axis1.i_q")]


@pytest.mark.parametrize("level", get_args(Level))
def test_last_samples_are_kept_in_order(level: Level) -> None:
    with Board(level=level, seed=3) as board:
        board.run(0.01)
        board.sample(1, SNAPSHOT, 50)
        rows = board.record(board.time_ns + 20 * SLOW_PERIODS * PERIOD_NS)
        assert len(board.sampled()) == len(rows)
        rows = board.record(board.time_ns + 130 * SLOW_PERIODS * PERIOD_NS)
        points = board.sampled()
        assert len(points) == 50
        for field, (variable, _) in zip(points.dtype.names or (), SNAPSHOT, strict=True):
            assert points[field].tolist() == rows[variable.name][-50:].tolist(), variable.name


def test_every_period_is_sampled_including_loop_variables() -> None:
    with Board(seed=3) as board:
        board.sample(0, [(VARIABLES[name], 0) for name in ("tick", "u_dc_now", "axis1.duty_a")], 4000)
        board.run(0.2)
        points = board.sampled()
        ticks, volts, _ = (points[field].astype(int) for field in points.dtype.names or ())
        assert np.diff(ticks).tolist() == [1] * (len(ticks) - 1)
        assert len(ticks) == pytest.approx(3200, abs=2)
        assert len(set(volts.tolist())) > 10


def test_invalid_recordings_are_refused_and_release_the_recorder() -> None:
    with Board() as board:
        with pytest.raises(BoardError, match="no sampling is active"):
            board.sampled()
        with pytest.raises(BoardError, match="wrong number of bytes"):
            board.sample(0, [(variable, 0) for variable in list(VARIABLES.values())[1:10]], 10)
        with pytest.raises(BoardError, match="access denied"):
            board.sample(0, [(VARIABLES["cmd.points"], 10_000)], 10)
        board.run(0.01)
        board.sample(0, SNAPSHOT, 10)
        board.end_sampling()
        board.run(0.01)
        board.sample(1, SNAPSHOT[:1], 10)
        board.run(0.002)
        assert len(board.sampled()) == pytest.approx(4, abs=1)
