"""A file read back from a board gives the same blocks, bit for bit; a block gives its motor and its loops."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from servo_msgs_py.axis_config import AxisConfigTable, Member
from servo_msgs_py.catalogue import AXES
from servo_msgs_py.text_file import parse_toml
from servo_tuning import board_file
from servo_tuning.control_loops import control_loops
from servo_tuning.errors import ConfigError
from servo_tuning.reading import parse
from servo_tuning.tuned import tuned
from tuning_tool import CATALOGUE, axis, configuration, table


def blocks_of(source: dict[str, Any]) -> list[dict[str, int]]:
    whole = parse(source, CATALOGUE)
    return [tuned(one, whole).block for one in whole.axes]


def read_back(blocks: list[dict[str, int]]) -> list[dict[str, int]] | None:
    return board_file.blocks_of(parse_toml(board_file.text_of(blocks, "Read back")))


def motors(count: int) -> list[dict[str, Any]]:
    draw = random.Random(5)
    spread = {"r_s": 3.0, "l_d": 2.0, "psi_m": 1.6, "inertia": 4.0}
    found = []
    for _ in range(count):
        source = table()
        motor = source["axis1"]["motor"]
        for key, factor in spread.items():
            motor[key] *= factor ** draw.uniform(-1.0, 1.0)
        motor["l_q"] = motor["l_d"] * draw.uniform(1.0, 1.4)
        motor["pole_pairs"] = draw.randint(1, 5)
        motor["rotor_inertia"] = 0.5 * motor["inertia"]
        source["axis1"]["features"] = {"speed_observer": draw.random() < 0.5}
        source["axis1"]["stop"] = {"disable": draw.choice(["coast", "short", "ramp"]), "over_speed": "short"}
        source["axis1"]["control"] = {"current_bandwidth": draw.uniform(500.0, 1100.0), "speed_bandwidth": 40.0}
        source["axis1"]["control"]["position_gain"] = draw.uniform(20.0, 40.0)
        found.append(source)
    return found


def test_motor_and_loops_of_a_block_are_those_of_its_file() -> None:
    """Within the rounding to integers."""
    tried = 0
    for source in motors(40):
        try:
            whole = parse(source, CATALOGUE)
            designs = [tuned(one, whole) for one in whole.axes]
        except ConfigError:
            continue  # not every motor can be tuned with these bandwidths
        tried += 1
        blocks = [design.block for design in designs]
        assert read_back(blocks) == blocks
        for design, block in zip(designs, blocks, strict=True):
            loops = control_loops(block)
            assert vars(loops.motor) == pytest.approx(vars(design.motor), rel=1e-3)
            assert (loops.used, loops.observer, loops.observed) == (design.used, design.observer, design.observed)
    assert tried >= 15


@settings(max_examples=25)
@given(st.data())
def test_any_block_survives_its_file(data: st.DataObject) -> None:
    def raw(member: Member) -> st.SearchStrategy[int]:
        return st.integers(*member.raw_range).map(
            lambda number: number & member.raw_range[1] if member.bits else number
        )

    members = AxisConfigTable.load().members
    blocks = [{path: data.draw(raw(member)) for path, member in members.items()} for _ in range(AXES)]
    assert read_back(blocks) == blocks


def test_members_replace_computed_numbers() -> None:
    member = AxisConfigTable.load().members["speed.kp"]
    kp = axis(1).block["speed.kp"]
    changed = {"speed.kp": member.scale(kp + 7)}
    assert axis(1, axis1__members=changed).block["speed.kp"] == kp + 7
    assert axis(2, axis1__members=changed).block["speed.kp"] != kp + 7
    assert axis(1, axis1__members=changed).used.speed.kp > axis(1).used.speed.kp


@pytest.mark.parametrize(
    ("members", "reason"),
    [
        ({"speed.pk": 1}, r"axis1\.members\.speed\.pk is unknown; did you mean speed\.kp"),
        ({"speed.kp": -1}, r"axis1\.members\.speed\.kp = -1: not accepted by a board; write a number from 0 up to"),
        ({"speed.kp": "1"}, r"speed\.kp = '1': not a number"),
        ({"speed.kp": math.nan}, r"speed\.kp = nan: not accepted by a board"),
        ({"features": 1.5}, r"features = 1\.5: not a number"),
        ({"stop.ramp": 1}, r"stop\.ramp = 1: not accepted by a board; write bits of 0x"),
        (5, r"axis1\.members"),
    ],
)
def test_members_that_a_board_refuses_are_refused(members: object, reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        configuration(axis1__members=members)


def test_a_block_without_a_motor_has_a_file() -> None:
    blocks = blocks_of(table())
    for path in ("current_loop.omega_psi", "current_loop.omega_l_d", "speed_observer.acceleration_per_current"):
        empty = [{**block, path: 0} for block in blocks]
        assert read_back(empty) == empty


def test_a_file_of_a_board_has_all_members_of_all_axes() -> None:
    complete = parse_toml(board_file.text_of(blocks_of(table()), "Read back"))
    del complete["axis2"]["members"]["pll.kp"]
    with pytest.raises(ConfigError, match=r"axis2\.members\.pll\.kp is missing"):
        board_file.blocks_of(complete)
    complete["board"]["name"] = "mine"
    with pytest.raises(ConfigError, match=r"board\.name = 'mine': the file is for another board"):
        board_file.blocks_of(complete)
    assert board_file.blocks_of(table()) is None
    assert board_file.blocks_of({}) is None


def test_the_tuning_code_refuses_a_motor_that_the_board_would_refuse() -> None:
    limit = AxisConfigTable.load().members["encoder.pole_pairs"].raw_range[1]
    assert limit == 50
    many = {"axis1__encoder__lines": 2048, "axis1__rotor_search__current": 1.0, "axis1__motor__psi_m": 0.0154 * 2 / 50}
    assert axis(1, axis1__motor__pole_pairs=limit, **many).block["encoder.pole_pairs"] == limit
    with pytest.raises(ConfigError, match="axis1"):
        axis(1, axis1__motor__pole_pairs=limit + 1, axis1__motor__psi_m=0.001)
