"""Configuration blocks as integers, bytes and words."""

from __future__ import annotations

import re
import zlib

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from servo_msgs_py.axis_config import AxisConfigError, AxisConfigTable, Member
from servo_msgs_py.catalogue import Catalogue

TABLE = AxisConfigTable.load()
MEMBERS = list(TABLE.members.values())


def raw(member: Member) -> st.SearchStrategy[int]:
    numbers = st.integers(*member.raw_range)
    return numbers.map(lambda x: x & member.raw_range[1]) if member.bits else numbers


BLOCKS = st.fixed_dictionaries({member.name: raw(member) for member in MEMBERS})


@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])  # a block has many members
@given(BLOCKS, st.integers(0, 1))
def test_block_is_restored_from_bytes_and_words(block: dict[str, int], axis: int) -> None:
    data = TABLE.encode(block)
    assert len(data) == sum(member.format.size for member in MEMBERS)
    assert TABLE.decode(data) == block
    assert TABLE.block(TABLE.words(block)) == block
    head = b"".join(number.to_bytes(4, "little") for number in (TABLE.layout, len(TABLE), axis))
    assert TABLE.checksum(axis, block) == zlib.crc32(head + data)
    assert TABLE.checksum(axis, block) != TABLE.checksum(1 - axis, block)


@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(BLOCKS, st.sampled_from(MEMBERS), st.sampled_from([-1, 1]))
def test_values_that_the_board_refuses_are_reported(block: dict[str, int], member: Member, sign: int) -> None:
    wrong = member.raw_range[1] + 1 if sign > 0 else member.raw_range[0] - 1
    with pytest.raises(AxisConfigError, match=re.escape(member.name)):
        TABLE.check({**block, member.name: wrong})
    missing = dict(block)
    del missing[member.name]
    with pytest.raises(AxisConfigError, match="missing"):
        TABLE.encode(missing)
    with pytest.raises(AxisConfigError, match="not a member"):
        TABLE.check({**block, "nothing": 1})


def test_wrong_lengths_are_refused() -> None:
    with pytest.raises(AxisConfigError, match=f"{len(TABLE)} expected"):
        TABLE.block([0])
    with pytest.raises(AxisConfigError, match="bytes"):
        TABLE.decode(b"\x00")


def test_values_have_units() -> None:
    members = TABLE.members
    assert members["i_q_limit"].shown(15888) == "4.00012 A"
    assert members["winding.resistance"].shown(3145728) == "0.55 V/A"
    assert members["speed.kp"].unit == "A/(rad/s)"
    assert members["search_ticks_max"].shown(10000) == "5 s"
    assert members["stop.ramp"].shown(0x40) == "0x40"
    assert members["encoder.pole_pairs"].shown(2) == "2"


def test_a_parameter_accepts_every_default() -> None:
    linked = 0
    for parameter in Catalogue.load().variables.values():
        sign, _, path = parameter.default.partition("axis.")
        if path:
            linked += 1
            low, high = parameter.raw_range
            for raw in TABLE.members[path].raw_range:
                assert low <= (-raw if sign else raw) <= high, parameter.name
    assert linked >= 11


def test_layout_hash_depends_on_ranges_and_names() -> None:
    table = {"formats": {"f": {"type": "int16", "maximum": 5}}, "members": {"a": {"format": "f"}, "b": {"format": "f"}}}
    catalogue = Catalogue.load()
    layouts = {
        AxisConfigTable.parse({**table, "members": members}, catalogue).layout
        for members in (
            {"a": {"format": "f"}, "b": {"format": "f"}},
            {"b": {"format": "f"}, "a": {"format": "f"}},
            {"a": {"format": "f"}, "b": {"format": "f", "live": True}},
            {"a": {"format": "f"}, "b": {"format": "f", "maximum": 4}},
            {"a": {"format": "f"}, "b": {"format": "f", "bits": 1}},
            {"a": {"format": "f"}, "c": {"format": "f"}},
        )
    }
    assert len(layouts) == 6


@pytest.mark.parametrize(
    ("entry", "reason"),
    [
        ({}, "no type"),
        ({"format": "f", "maximum": 40000}, "does not fit"),
        ({"format": "f", "minimum": 6}, "does not fit"),
        ({"format": "f", "scale": "nothing"}, "unknown scale"),
        ({"format": "f", "colour": 1}, "unknown key colour"),
        ({"format": "parameter"}, "no parameter with this default"),
    ],
)
def test_a_table_that_is_not_well_formed_is_refused(entry: dict[str, object], reason: str) -> None:
    table = {"formats": {"f": {"type": "int16", "maximum": 5}}, "members": {"a": entry}}
    with pytest.raises(AxisConfigError, match=f"^a: .*{reason}"):
        AxisConfigTable.parse(table, Catalogue.load())
