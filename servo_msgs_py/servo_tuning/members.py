"""Members of configuration blocks in SI units, as the groups ``[axisN.members]`` of a file.

Members replace the numbers that the tuning code computes from the other groups.
"""

from __future__ import annotations

from typing import Final

from servo_msgs_py.axis_config import AxisConfigTable, Member
from servo_msgs_py.units import to_raw

from servo_tuning.errors import refused
from servo_tuning.schema import check_table, unknown_name

MEMBERS: Final = "members"
"""Name of the group of an axis."""


def read_members(where: str, value: object) -> dict[str, int]:
    """Raw numbers of the members in a group, by C path.

    Parameters
    ----------
    where : str
        Full name of the group, for messages.
    value : object
        Parsed group: values in the units of the members.

    Raises
    ------
    ConfigError
        About the first member that is unknown or that a board would refuse.
    """
    members = AxisConfigTable.load().members
    found = {}
    for path, entry in check_table(where, value).items():
        if path not in members:
            raise unknown_name(f"{where}.{path}", path, members)
        found[path] = _raw(f"{where}.{path}", members[path], entry)
    return found


def _raw(where: str, member: Member, value: object) -> int:
    expected = f"write {member.expected}" if not member.bits else f"write bits of {member.raw_range[1]:#x}"
    if isinstance(value, bool) or not isinstance(value, (int, float)) or (member.lsb == 1.0 and value % 1):
        raise refused(where, repr(value), "not a number of this member", expected)
    try:
        raw = to_raw(value, member.lsb, *member.raw_range)
    except ValueError:
        raw = -1 if member.bits else member.raw_range[0] - 1
    if not member.accepts(raw):
        raise refused(where, repr(value), "not accepted by a board", expected)
    return raw
