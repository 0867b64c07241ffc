"""Scenarios of the timing measurement: modes, features, feedback, start-up, stops and faults."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.board_port import choose
from servo_msgs_py.catalogue import AXES
from servo_msgs_py.timed_points import POINTS_PER_WRITE, TimedPoint, encode_points
from servo_msgs_py.units import PERIOD_NS

from servo_twin.board import Board
from servo_twin.simulation import enable, keep_set_points
from servo_twin.validation.experiments.rig import features

_TURN: Final = 6.283185307179586
_AHEAD: Final = 16
"""Capacity of the point queue of an axis."""


@dataclass(frozen=True)
class Scenario:
    """A state of the board."""

    name: str
    prepare: Callable[[Board], None]  # brings a new board into the state
    seconds: float = 0.05  # observed time [s]
    during: Callable[[Board], None] = lambda board: None  # actions during the observation
    baud: float = 115200.0  # speed of the serial line [bit/s]


def _features(board: Board, every: bool) -> None:
    if every:
        for axis in range(AXES):
            features(board, axis, **{flag.name: True for flag in board.catalogue.flags["features"]})
        board.write_raw(
            "cmd.home", [board.catalogue.enums["home_method_t"]["HERE"]] * AXES
        )  # soft limits require a valid position


def _mode(board: Board, name: str) -> None:
    for axis in range(AXES):
        choose(board, "cmd.mode", axis, name)


def _moving(every: bool, mode: str, value: float, settle: float = 0.3) -> Callable[[Board], None]:
    def prepare(board: Board) -> None:
        _features(board, every)
        enable(board)
        board.write("param.speed_limit", [419.0] * AXES)
        board.write("param.over_speed", [500.0] * AXES)
        _mode(board, mode)
        signs = [value, -value]
        if mode == "POSITION":
            lsb = board.catalogue["cmd.position"].lsb
            at = [lsb * board.read_words(f"axis{axis + 1}.position")[0] for axis in range(AXES)]
            board.write("cmd.position", [now + sign for now, sign in zip(at, signs, strict=True)])
            settle_for = 0.02
        else:
            board.write("cmd.speed" if mode == "SPEED" else "cmd.i_q", signs)
            settle_for = settle
        board.run(settle_for)

    return prepare


def _following(every: bool) -> Callable[[Board], None]:
    """Both axes on a circle with 2 Hz: accelerations, and a new segment every 10 ms."""

    def prepare(board: Board) -> None:
        _features(board, every)
        enable(board)
        _mode(board, "TRAJECTORY")
        board.run(0.002)
        start, omega = board.read_words("tick")[0] + 800, 2.0 * _TURN
        lsb = board.catalogue["cmd.position"].lsb
        at = [lsb * board.read_words(f"axis{axis + 1}.position")[0] for axis in range(AXES)]
        for first in range(0, _AHEAD, POINTS_PER_WRITE // AXES):
            points = []
            for k in range(first, first + POINTS_PER_WRITE // AXES):
                angle = omega * k * 160 * PERIOD_NS * 1e-9
                for axis in range(AXES):
                    points.append(
                        TimedPoint(
                            axis, start + 160 * k, at[axis] + 1.0 - math.cos(angle), omega * math.sin(angle), 0.02
                        )
                    )
            words = encode_points(board.catalogue, points)
            board.write_memory(board.address("cmd.points"), np.array(words, dtype="<i4").tobytes())
            board.run(0.001)
        board.run(0.06)

    return prepare


def _observed(every: bool, settle: float) -> Callable[[Board], None]:
    def prepare(board: Board) -> None:
        _features(board, every)
        board.write("param.feedback", [board.catalogue.enums["feedback_kind_t"]["OBSERVER"]] * AXES)
        keep_set_points(board)
        board.run(0.03)
        _mode(board, "SPEED")
        board.write("cmd.speed", [150.0, -150.0])
        board.write("cmd.enable", [1] * AXES)
        board.run(settle)

    return prepare


def _search(board: Board) -> None:
    _features(board, True)
    keep_set_points(board)
    board.run(0.03)
    board.write("cmd.enable", [1] * AXES)


def _quick_stop(board: Board) -> None:
    board.write("cmd.quick_stop", [1] * AXES)


def _encoders_lost(board: Board) -> None:
    for axis in range(AXES):
        board.cut_encoder_line(axis, "A")


def _requests(board: Board) -> None:
    """Send read requests of the whole snapshot without pauses."""
    assert board.serial_in(bytes.fromhex("2B 01 04 00 70 8B") * 600)


def _frame(code: int, payload: bytes) -> bytes:
    """Bytes of a FreeMASTER request."""
    body = bytes([code, len(payload)]) + payload
    crc = 0
    for byte in body:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1) ^ (0x107 if crc & 0x80 else 0)
    return b"+" + (body + bytes([crc])).replace(b"+", b"++")


def _recording(prepare: Callable[[Board], None]) -> Callable[[Board], None]:
    """Set-up with an additional recorder of 4 variables of 2 bytes in every period."""

    def then_record(board: Board) -> None:
        prepare(board)
        names = [f"axis{axis + 1}.{name}" for axis in range(AXES) for name in ("i_q", "duty_a")]
        operations = bytes([1, 4, len(names), 0, 0, 0])
        for slot, name in enumerate(names):
            address = board.address(name)
            groups = [address >> shift & 0x7F for shift in range(0, address.bit_length(), 7)]
            data = bytes([slot, *(group | 0x80 for group in groups[:-1]), groups[-1], 2, 0, 0])
            operations += bytes([2, len(data)]) + data
        assert board.serial_in(_frame(0x24, b"\0" + operations + b"\3\0"))
        board.run(0.02)
        assert board.serial_out().endswith(bytes.fromhex("2B 00 00")), "the recorder runs"

    return then_record


def _excited(prepare: Callable[[Board], None], point: str) -> Callable[[Board], None]:
    """Set-up with an additional test signal on both axes."""

    def then_excite(board: Board) -> None:
        prepare(board)
        board.write("cmd.test_amplitude", [0.002] * AXES)
        board.write("cmd.test_step", [0.01] * AXES)
        board.write("cmd.test_calls", [960000] * AXES)
        board.write("cmd.test_point", [board.catalogue.enums["test_point_t"][point]] * AXES)
        board.run(0.005)

    return then_excite


def _both(name: str, prepare: Callable[[bool], Callable[[Board], None]], seconds: float = 0.05) -> list[Scenario]:
    return [Scenario(name, prepare(False), seconds), Scenario(f"{name}, every feature", prepare(True), seconds)]


STANDARD: Final = Scenario("speed", _moving(False, "SPEED", 100.0))
"""Scenario without ``--all``."""

SCENARIOS: Final = (
    Scenario("off", lambda board: board.run(0.03)),
    *_both("hold", lambda every: _moving(every, "SPEED", 0.0)),
    *_both("position", lambda every: _moving(every, "POSITION", 20 * _TURN), 0.3),
    *_both("trajectory", _following, 0.1),
    *_both("speed", lambda every: _moving(every, "SPEED", 100.0)),
    *_both("crawl", lambda every: _moving(every, "SPEED", 0.5)),
    *_both("torque", lambda every: _moving(every, "TORQUE", 0.3)),
    *_both("voltage limit", lambda every: _moving(every, "SPEED", 419.0, 1.0)),
    *_both("observer", lambda every: _observed(every, 3.0)),
    *_both("speed, recording", lambda every: _recording(_moving(every, "SPEED", 100.0))),
    *_both(
        "speed, recording, current excited", lambda every: _recording(_excited(_moving(every, "SPEED", 100.0), "I_Q"))
    ),
    Scenario("position, speed excited", _excited(_moving(False, "POSITION", 20 * _TURN), "SPEED"), 0.3),
    Scenario("observer, every feature, recording", _recording(_observed(True, 3.0))),
    Scenario("rotor search, every feature", _search, 1.5),
    *_both("observer start-up", lambda every: _observed(every, 0.0), 2.0),
    Scenario("quick stop, every feature", _moving(True, "SPEED", 300.0, 0.5), 0.3, _quick_stop),
    Scenario("encoders lost, every feature", _moving(True, "SPEED", 100.0), 0.3, _encoders_lost),
    Scenario("requests at 2 Mbaud", _moving(False, "SPEED", 100.0), 0.05, _requests, 2e6),
)
