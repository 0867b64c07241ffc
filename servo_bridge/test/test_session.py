from __future__ import annotations

from dataclasses import replace

import pytest
from fake_servo import CATALOGUE, FakeServo
from fake_target import RO, RW, FakeEntry, FakeTarget
from fake_transport import FakeTransport, client_on
from servo_bridge.wire.refusal import refusal_text
from servo_bridge.wire.session import BoardMismatchError, Session, connect
from servo_msgs_py.catalogue import Variable
from servo_msgs_py.timed_points import POINT_WORDS, TimedPoint, encode_points


def session_on(target: FakeTarget) -> Session:
    return connect(client_on(FakeTransport(target.feed)), CATALOGUE)


def entry(board: FakeServo, name: str) -> FakeEntry:
    return next(e for e in board.tables[0] if e.name == name)


def test_board_with_the_same_catalogue_is_read_in_si() -> None:
    board = FakeServo()
    board.put("axis1.position", 4000)
    session = session_on(board)
    assert session.mismatch is None
    assert set(session.variables) == set(CATALOGUE.variables)
    assert session.read(session.variables["axis1.position"]) == pytest.approx(6.283185307)
    assert session.read(session.variables["param.speed_limit"]) == pytest.approx([100.0, 100.0], abs=1e-6)
    assert isinstance(session.read(session.variables["snapshot"]), bytes)
    assert session.variables["u_dc"].unit == "V"


def test_writes_are_scaled_and_reach_single_elements() -> None:
    board = FakeServo()
    session = session_on(board)
    session.write(session.variables["cmd.position"], [6.283185307179586], first=1)
    assert board.get("cmd.position") == [0, 4000]
    assert board.written == [("cmd.position", 4, (4000).to_bytes(4, "little"))]


@pytest.mark.parametrize(
    ("name", "values", "first", "text"),
    [
        ("cmd.speed", [1000.0, 0.0], 0, "outside"),
        ("cmd.speed", [float("nan"), 0.0], 0, "not a finite"),
        ("cmd.speed", [0.0, 0.0], 1, "has 2 element"),
        ("cmd.speed", [], 0, "has 2 element"),
        ("cmd.speed", [0.0], -1, "has 2 element"),
        ("axis1.speed", [0.0], 0, "can only be read"),
        ("snapshot", [0.0], 0, "can only be read"),
    ],
)
def test_writes_that_are_refused_send_nothing(name: str, values: list[float], first: int, text: str) -> None:
    board = FakeServo()
    session = session_on(board)
    with pytest.raises(ValueError, match=text):
        session.write(session.variables[name], values, first)
    assert board.written == []


def test_board_of_another_version_is_refused() -> None:
    board = FakeServo()
    board.put("catalogue_hash", CATALOGUE.hash ^ 1)
    mismatch = session_on(board).mismatch
    assert mismatch is not None
    assert f"{CATALOGUE.hash ^ 1:08X}" in mismatch.reason
    assert "flash the firmware" in mismatch.remedy
    assert not mismatch.foreign


def test_another_board_is_refused_with_its_name_and_the_known_ones() -> None:
    board = FakeServo()
    board.config["NM"] = b"servo/mine\0"
    mismatch = session_on(board).mismatch
    assert mismatch is not None
    assert "'mine' is not the board" in mismatch.reason
    assert f"known are {CATALOGUE.board.name}" in mismatch.reason
    assert not mismatch.foreign


def test_firmware_that_does_not_name_its_board_is_for_the_default_board() -> None:
    board = FakeServo()
    board.config["NM"] = b"servo\0"
    assert session_on(board).mismatch is None


def test_board_with_another_catalogue_is_read_by_its_own_types() -> None:
    target = FakeTarget(
        tables=[[FakeEntry("gain", b"\xf4:3.12", 0x1000, 2, RW), FakeEntry("n", b"\xe1", 0x1002, 2, RO)]]
    )
    target.build()
    session = session_on(target)
    assert session.mismatch is not None
    assert session.mismatch.foreign
    session.write(session.variables["gain"], [1.5])
    assert session.read(session.variables["gain"]) == 1.5
    with pytest.raises(ValueError, match="can only be read"):
        session.variables["gain"].encode_raw([1])


@pytest.mark.parametrize(
    ("name", "change", "text"),
    [
        ("axis1.speed", {"type": b"\xf2"}, "axis1.speed is of type i32 instead of frac32"),
        ("axis2.u_q", {"type": b"\xe1"}, "axis2.u_q is of type u16 instead of frac16"),
        ("cmd.position", {"size": 4}, "cmd.position has 4 bytes instead of 8"),
        ("cmd.enable", {"kind": RO}, "cmd.enable is read-only"),
        ("axis1.state", {"type": b"substate_t"}, "axis1.state is of type substate_t instead of enum"),
        ("tick", {"name": "tock"}, "tick is missing"),
    ],
)
def test_a_table_that_contradicts_its_hash_is_refused(name: str, change: dict[str, object], text: str) -> None:
    board = FakeServo()
    row = entry(board, name)
    board.tables[0][board.tables[0].index(row)] = replace(row, **change)  # type: ignore[arg-type]
    board.build(0x3000)
    mismatch = session_on(board).mismatch
    assert isinstance(mismatch, BoardMismatchError)
    assert text in mismatch.reason


@pytest.mark.parametrize("variable", [each for each in CATALOGUE.variables.values() if each.writable])
def test_refused_numbers_are_reported_in_si_with_their_quantity(variable: Variable) -> None:
    raw = variable.raw_range[1] - 1 if variable.lsb != 1.0 else 1
    count = POINT_WORDS if variable.name == "cmd.points" else 1
    text = refusal_text(CATALOGUE, variable, variable.pack([raw] * count), 0)
    assert text.startswith(variable.name)
    assert variable.unit in text
    assert variable.lsb == 1.0 or str(raw) not in text


def test_refused_points_are_reported_as_points() -> None:
    points = [TimedPoint(1, 879_569, 1.5, 0.0), TimedPoint(1, 881_169, 2.0, 0.0)]
    variable = CATALOGUE["cmd.points"]
    assert refusal_text(CATALOGUE, variable, variable.pack(encode_points(CATALOGUE, points)), 0) == (
        "cmd.points: the board refuses 2 timed points, from 1.5 rad of axis2 at 54.9731 s to 2 rad of axis2 at "
        "55.0731 s of its time"
    )
