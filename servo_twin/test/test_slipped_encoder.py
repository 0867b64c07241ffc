"""An encoder that has slipped on its shaft, or has died while nothing is asked of the motor; and what must not be taken
for it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest
from servo_msgs_py.board_port import active, choose, place, write_axis
from servo_msgs_py.units import TICK
from servo_twin.board import Board
from servo_twin.fault_injection import SlippedEncoder
from servo_twin.plant import PlantConfig
from servo_twin.simulation import enable
from servo_twin.validation.experiments.rig import features

pytestmark = pytest.mark.usefixtures("level")

PLANT = PlantConfig.load()
STALL = 0.5
"""Time at full current without movement before the stall test [s] (timing.stall_max)."""

PROOF = 0.4
"""Duration of the rotation of the vector to both sides and back [s] (rotor_search.turn_time)."""

ON_THE_WAY = 0.2  # ramp to full current, and detection of standstill by the M/T method [s]


def started(plant: PlantConfig = PLANT) -> Board:
    board = Board(plant, seed=5)
    board.write("param.host_timeout", 30.0)
    board.run(0.05)
    enable(board)
    board.run(0.1)
    return board


@pytest.fixture
def board() -> Iterator[Board]:
    with started() as board:
        yield board


def rough(axis: int, factor: float) -> PlantConfig:
    return PLANT.with_axis(axis, friction=PLANT.axes[axis].friction * factor)


def slip(board: Board, axis: int, degrees: float) -> None:
    """Slip the encoder by an electrical angle [degrees]."""
    motor = board.plant.axes[axis]
    board.inject(SlippedEncoder(axis, round(degrees / 360.0 * 4 * motor.encoder_lines / motor.pole_pairs)))
    board.run(0.002)


def speed(board: Board, axis: int, rad_per_s: float) -> None:
    choose(board, "cmd.mode", axis, "SPEED")
    write_axis(board, "cmd.speed", axis, rad_per_s)


def until_fault(board: Board, axis: int, seconds: float) -> tuple[float, set[str], float]:
    """Time until the first fault, its name, and the largest speed before it."""
    fastest = 0.0
    for k in range(round(seconds / TICK)):
        if names := active(board, axis):
            return k * TICK, names, fastest
        board.run(TICK)
        fastest = max(fastest, abs(board.truth(axis).omega_m))
    return math.inf, set(), fastest


# ---- the fault itself ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("counts", [300, -1500, 9000])
def test_slipping_disc_changes_the_count_without_motion(counts: int) -> None:
    """Also across the compare values of the counter."""
    with Board(seed=1) as board:
        board.run(0.05)
        before, angle = board.read_words("axis2.position")[0], board.truth(1).theta_m
        for part in (
            counts // 3,
            counts // 3,
            counts - 2 * (counts // 3),
        ):  # the counter resolves at most half a revolution at a time
            for piece in (part // 2, part - part // 2):
                board.inject(SlippedEncoder(1, piece))
                board.run(0.002)
        assert board.read_words("axis2.position")[0] - before == counts
        assert board.truth(1).theta_m == angle
        assert active(board, 1) == set()


# ---- in motion -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("degrees", [60.0, 120.0, -150.0, 180.0, 270.0])
def test_a_slip_in_motion_is_reported_before_the_shaft_gains_speed(board: Board, axis: int, degrees: float) -> None:
    speed(board, axis, 100.0)
    board.run(0.3)
    slip(board, axis, degrees)
    time, names, fastest = until_fault(board, axis, 0.1)
    assert names == {"ANGLE_MISMATCH"}
    assert time < 0.02
    assert fastest < 140.0  # RUNAWAY's margin
    assert active(board, 1 - axis) == set()


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("degrees", "friction"), [(120.0, 1.0), (180.0, 2.0), (240.0, 20.0)])
def test_a_slip_at_rest_is_reported_when_a_motion_is_commanded(axis: int, degrees: float, friction: float) -> None:
    """The torque has the wrong sign, so the shaft accelerates in the wrong direction at full current."""
    with started(rough(axis, friction)) as board:
        slip(board, axis, degrees)
        speed(board, axis, 100.0)
        time, names, fastest = until_fault(board, axis, 0.2)
        assert names == {"ANGLE_MISMATCH"}
        assert time < 0.05
        assert fastest < 125.0  # a back-EMF of 3.8 V; half of the resistance accounts for 1.1 V of it


def test_slip_without_voltage_compensation_is_detected_as_runaway(board: Board) -> None:
    features(board, 0, BUS_COMPENSATION=False)
    speed(board, 0, 100.0)
    board.run(0.3)
    slip(board, 0, 120.0)
    assert until_fault(board, 0, 0.1)[1] == {"RUNAWAY"}


# ---- without torque --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(
    ("degrees", "friction"), [(90.0, 1.0), (-90.0, 1.0), (-90.0, 2.0), (82.0, 20.0), (-98.0, 20.0)]
)
def test_angle_without_torque_is_distinguished_from_a_blocked_shaft(axis: int, degrees: float, friction: float) -> None:
    with started(rough(axis, friction)) as board:
        slip(board, axis, degrees)
        speed(board, axis, 100.0)
        time, names, fastest = until_fault(board, axis, 1.5)
        assert names == {"ANGLE_MISMATCH"}
        assert STALL < time < STALL + PROOF + ON_THE_WAY
        assert fastest < 20.0
        board.run(0.05)
        assert abs(board.truth(axis).omega_m) < 20.0


@pytest.fixture
def rough_board() -> Iterator[Board]:
    with started(rough(0, 4.0)) as board:
        yield board


def test_an_angle_without_torque_in_motion_is_an_angle_mismatch(rough_board: Board) -> None:
    """Without the measured bus voltage the slip is detected after the shaft has slowed down."""
    board = rough_board
    features(board, 0, BUS_COMPENSATION=False)
    speed(board, 0, 60.0)
    board.run(0.3)
    slip(board, 0, 90.0)
    time, names, fastest = until_fault(board, 0, 2.0)
    assert names == {"ANGLE_MISMATCH"}
    assert time > STALL
    assert fastest < 65.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_blocked_shaft_is_reported_as_stalled(board: Board, sign: float) -> None:
    board.lock_shaft(0)
    speed(board, 0, 60.0 * sign)
    time, names, _ = until_fault(board, 0, 2.0)
    assert names == {"STALLED"}
    assert STALL + PROOF < time < STALL + PROOF + ON_THE_WAY


@pytest.mark.parametrize("room", [0.0, 0.005])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_shaft_at_an_end_stop_is_reported_as_stalled(board: Board, sign: float, room: float) -> None:
    """The rotating vector pulls the shaft back: freely (`room` 0) or by some backlash only."""
    back = math.inf if room == 0.0 else room
    board.obstruct_shaft(0, back if sign > 0.0 else 0.01, 0.01 if sign > 0.0 else back)
    speed(board, 0, 60.0 * sign)
    time, names, fastest = until_fault(board, 0, 2.0)
    assert names == {"STALLED"}
    assert time > STALL
    assert fastest < 65.0


@pytest.mark.parametrize("part", [0.05, 0.2, 0.35, 0.6, 0.95])
def test_shaft_released_during_the_stall_test_is_reported_as_stalled(board: Board, part: float) -> None:
    board.lock_shaft(0)
    speed(board, 0, 60.0)
    while place(board, 0) != "ALIGN":
        board.run(TICK)
        assert active(board, 0) == set()
    board.run(part * PROOF)
    board.lock_shaft(0, False)
    _, names, fastest = until_fault(board, 0, 1.0)
    assert names == {"STALLED"}
    assert fastest < 100.0  # it was released under full current


@pytest.mark.parametrize("axis", [0, 1])
def test_a_load_as_large_as_the_current_limit_is_a_stall(board: Board, axis: int) -> None:
    speed(board, axis, 0.0)
    torque = 4.0 * PLANT.axes[axis].torque_constant
    for k in range(100):  # gradually, because the controller cannot follow a step
        board.set_load(axis, torque * (k + 1) / 100)
        board.run(0.002)
    speed(board, axis, 60.0)
    _, names, _ = until_fault(board, axis, 2.0)
    assert names == {"STALLED"}


# ---- an encoder that dies while no current flows ---------------------------------------------------------------------


def coast(board: Board, axis: int, rad_per_s: float) -> None:
    """In torque mode, with a current of 0."""
    speed(board, axis, rad_per_s)
    board.run(0.05 + abs(rad_per_s) / 1000.0)
    choose(board, "cmd.mode", axis, "TORQUE")
    write_axis(board, "cmd.i_q", axis, 0.0)
    board.run(0.01)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("rad_per_s", [35.0, -60.0, 90.0, -200.0])
def test_dead_encoder_without_current_is_detected(board: Board, axis: int, rad_per_s: float) -> None:
    coast(board, axis, rad_per_s)
    board.connect_encoder(axis, False)
    time, names, fastest = until_fault(board, axis, 0.5)
    assert names == {"ENCODER_LOST"}
    assert time < 0.05
    assert fastest <= abs(rad_per_s)


@pytest.mark.parametrize("rad_per_s", [35.0, -200.0])
def test_a_coasting_shaft_that_is_stopped_at_once_is_no_fault(board: Board, rad_per_s: float) -> None:
    coast(board, 0, rad_per_s)
    board.lock_shaft(0)
    assert until_fault(board, 0, 0.5)[1] == set()
    board.lock_shaft(0, False)
    speed(board, 0, rad_per_s)
    board.run(0.3)
    assert active(board, 0) == set()
    assert board.truth(0).omega_m == pytest.approx(rad_per_s, abs=8.0)


def test_a_shaft_at_rest_without_current_is_no_fault(board: Board) -> None:
    choose(board, "cmd.mode", 0, "TORQUE")
    write_axis(board, "cmd.i_q", 0, 0.0)
    board.run(0.2)
    board.connect_encoder(0, False)
    assert until_fault(board, 0, 0.3)[1] == set()
