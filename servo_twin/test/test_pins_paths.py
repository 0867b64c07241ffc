"""Limit switches and trajectories: no path leads into a switch that is active."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from servo_msgs_py.board_port import choose, word
from servo_msgs_py.timed_points import TimedPoint, encode_points
from servo_twin.board import Board, BoardError
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments.pins import FIRST_DROP, fit, load_of, wired
from servo_twin.validation.experiments.rig import COUNT, prepared, spinning

FAR = 3.0  # [rad]


def sent(board: Board, *points: tuple[float, float, float]) -> None:
    """Queue points of axis 1: time from now [s], distance from the present position [rad], speed [rad/s]."""
    tick, here = board.read_words("tick")[0], word(board, 0, "position") * COUNT
    encoded = [TimedPoint(0, tick + round(16000 * at), here + distance, speed) for at, distance, speed in points]
    words = encode_points(board.catalogue, encoded)
    board.write_memory(board.address("cmd.points"), board.catalogue["cmd.points"].pack(words))


@pytest.fixture(params=[0.0, 1.0], ids=["on the switch", "before it"])
def board(request: pytest.FixtureRequest) -> Iterator[Board]:
    """Axis 1 holds at the distance `param` [rad] from its upper limit switch (0: on it), which raises no fault."""
    plant = PlantConfig.load().drawn(1)
    start = plant.axes[0].theta_start
    assert not isinstance(start, str)
    plant = wired(plant, limit_max=start + (request.param or -1.0))
    with prepared(lambda board: fit(board, "limit_max")), spinning(plant, 1) as found:
        found.write("param.faults_enabled", [0.0, 0.0])
        choose(found, "cmd.mode", 0, "TRAJECTORY")
        found.run(0.2)
        yield found


def test_no_path_continues_into_an_active_switch(board: Board) -> None:
    begin = board.truth(0).theta_m
    ahead = board.plant.axes[0].pins.limit_max - begin
    if ahead < 0.0:
        with pytest.raises(BoardError):
            sent(board, (0.05, 0.0, 0.0), (1.0, FAR, 0.0))
        board.run(1.2)
        assert abs(board.truth(0).theta_m - begin) < 4 * COUNT
        sent(board, (0.05, 0.0, 0.0), (1.0, -FAR, 0.0))  # away from the switch
        board.run(1.2)
        assert board.truth(0).theta_m - begin == pytest.approx(-FAR, abs=0.02)
    else:
        sent(board, (0.05, 0.0, 0.0), (1.0, FAR, 0.0))
        board.run(1.2)
        assert ahead <= board.truth(0).theta_m - begin < ahead + 0.1
    assert board.read_words("axis1.faults")[0] == 0


def test_load_is_held_until_the_brake_closes_after_disable_in_the_first_search() -> None:
    plant = wired(PlantConfig.load().drawn(1), brake_torque=0.2, brake_open_time=0.03, brake_close_time=0.02)
    with Board(plant, seed=1, level="ideal") as board:
        fit(board, "brake")
        board.set_load(0, -load_of(plant, 0))
        begin = board.truth(0).theta_m
        board.write("cmd.enable", [1.0, 0.0])
        while board.truth(0).brake_holds:
            assert board.time_ns < 3_000_000_000
            board.run(0.001)
        board.run(0.02)
        board.write("cmd.enable", [0.0, 0.0])
        board.run(0.5)
        assert board.truth(0).brake_holds
        assert abs(board.truth(0).theta_m - begin) < FIRST_DROP
