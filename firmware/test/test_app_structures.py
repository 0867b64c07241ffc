"""The structures described in the table agree with the compiler, so a client can decode the blocks."""

from __future__ import annotations

from typing import Any, NamedTuple

import pytest
from core_library import Core
from servo_bench import Bench
from servo_msgs_py.catalogue import Catalogue

CATALOGUE = Catalogue.load()
STRUCT = b"\xed:STRUCT"


class Member(NamedTuple):
    """Entry of the table below a structure."""

    type: bytes
    offset: int
    size: int


def rows(core: Core) -> list[tuple[bytes, bytes, Any]]:
    """Name, type and numbers of every entry."""
    table = Bench(core).servo.freemaster.app.tsa
    strings = core.ffi.cast("char *", table.strings)
    entries = [table.entry[i] for i in range(table.entries)]
    return [(core.ffi.string(strings + it.name), core.ffi.string(strings + it.type), it) for it in entries]


def structures(core: Core) -> dict[str, tuple[int, dict[str, Member]]]:
    """Size and members by the name of the type, as a client collects them."""
    found: dict[str, tuple[int, dict[str, Member]]] = {}
    members: dict[str, Member] | None = None
    for name, type_, entry in rows(core):
        if type_ == STRUCT:
            members = {}
            found[name.decode()] = (entry.size, members)
        elif entry.kind != 0 or type_.startswith(b"\xed"):
            members = None
        elif members is not None:
            members[name.decode()] = Member(type_, entry.address, entry.size)
    return found


@pytest.fixture(scope="module")
def found(core: Core) -> Any:
    return structures(core)


def test_members_have_the_offsets_of_the_compiler(core: Core, found: dict[str, tuple[int, dict[str, Member]]]) -> None:
    assert set(found) == {"snapshot_t", "axis_snapshot_t", "fault_record_t"}
    for name, (size, members) in found.items():
        fields = {key: field for key, field in core.ffi.typeof(name).fields if key != "unused"}
        assert size == core.ffi.sizeof(name)
        assert members.keys() == fields.keys()
        for key, member in members.items():
            assert (member.offset, member.size) == (fields[key].offset, core.ffi.sizeof(fields[key].type)), key
            inner = found.get(member.type.decode("latin-1"))
            assert inner is None or member.size % inner[0] == 0


def test_blocks_have_the_documented_types(core: Core, found: dict[str, tuple[int, dict[str, Member]]]) -> None:
    types = {name.decode(): (type_.decode("latin-1"), it.size) for name, type_, it in rows(core) if it.kind != 0}
    for variable in CATALOGUE.variables.values():
        if variable.type == "block":
            type_, size = types[variable.name]
            assert size == found[type_][0]
