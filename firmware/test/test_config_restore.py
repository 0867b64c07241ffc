"""A file read back from a board gives the same blocks, bit for bit."""

from __future__ import annotations

import random
from typing import Any

import pytest
from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.text_file import parse_toml
from servo_tuning.errors import ConfigError
from servo_tuning.reading import parse
from servo_tuning.restore import restore_table, toml_text
from servo_tuning.tuned import tuned
from tuning_tool import CATALOGUE, axis, configuration, table

TIMEOUTS = (0.5, 0.25)


def blocks_of(source: dict[str, Any]) -> list[dict[str, int]]:
    whole = parse(source, CATALOGUE)
    return [tuned(one, whole).block for one in whole.axes]


def read_back(blocks: list[dict[str, int]]) -> tuple[dict[str, Any], list[dict[str, int]]]:
    """The file as TOML, and the blocks computed from it."""
    text = toml_text(restore_table(blocks, TIMEOUTS, CATALOGUE), "Read back")
    again: dict[str, Any] = parse_toml(text)
    return again, blocks_of(again)


def test_the_committed_file_is_restored_with_its_numbers() -> None:
    blocks = blocks_of(table())
    again, same = read_back(blocks)
    assert same == blocks
    for number in (1, 2):
        found, motor = again[f"axis{number}"], table()[f"axis{number}"]["motor"]
        assert "exact" not in found
        entries = ("r_s", "l_d", "l_q", "psi_m", "pole_pairs", "inertia")
        assert {key: found["motor"][key] for key in entries} == {key: motor[key] for key in entries}
        assert found["control"]["current_bandwidth"] == 1000.0
        assert found["stop"]["host_silent"] == "ramp"
    assert (again["board"]["host_timeout"], again["board"]["command_timeout"]) == TIMEOUTS


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


def test_any_motor_is_restored_bit_for_bit() -> None:
    tried = 0
    for source in motors(40):
        try:
            blocks = blocks_of(source)
        except ConfigError:
            continue  # not every motor can be tuned with these bandwidths
        tried += 1
        assert read_back(blocks)[1] == blocks
    assert tried >= 15


def test_numbers_without_a_file_entry_are_kept_exactly() -> None:
    blocks = blocks_of(table())
    blocks[0]["current_loop.q.kp"] += 12345
    blocks[0]["emf_check.ticks_check"] = 9
    again, same = read_back(blocks)
    assert same == blocks
    assert "current_loop.q.kp" in again["axis1"]["exact"]
    assert again["axis1"]["emf_check"]["check_time"] == pytest.approx(0.0045)


def test_exact_numbers_replace_computed_ones() -> None:
    kp = axis(1).block["speed.kp"]
    assert axis(1, axis1__exact={"speed.kp": kp + 7}).block["speed.kp"] == kp + 7
    assert axis(2, axis1__exact={"speed.kp": kp + 7}).block["speed.kp"] != kp + 7
    assert axis(1, axis1__exact={"speed.kp": kp + 7}).used.speed.kp > axis(1).used.speed.kp


@pytest.mark.parametrize(
    ("exact", "reason"),
    [
        ({"speed.pk": 1}, r"axis1\.exact\.speed\.pk is unknown; did you mean speed\.kp"),
        ({"speed.kp": -1}, r"axis1\.exact\.speed\.kp = -1: not accepted by a board; write an integer in 0 \.\. 213"),
        ({"speed.kp": 1.5}, r"speed\.kp = 1\.5: not accepted by a board"),
        ({"stop.ramp": 1}, r"stop\.ramp = 1: not accepted by a board"),
        (5, r"axis1\.exact"),
    ],
)
def test_exact_numbers_out_of_the_range_of_the_board_are_refused(exact: object, reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        configuration(axis1__exact=exact)


def test_the_tuning_code_refuses_a_motor_that_the_board_would_refuse() -> None:
    """25 pole pairs fit every format, but exceed a sum on the board."""
    limit = AxisConfigTable.load().members["encoder.pole_pairs"].raw_range[1]
    with pytest.raises(ConfigError, match="axis1"):
        axis(1, axis1__motor__pole_pairs=limit + 1, axis1__motor__psi_m=0.001)
