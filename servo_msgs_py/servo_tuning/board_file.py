"""Files of the members of all axes and the name of their board, and nothing else: the content of a board."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

from servo_msgs_py.axis_config import AxisConfigTable, Member
from servo_msgs_py.board_description import DEFAULT_BOARD
from servo_msgs_py.catalogue import AXIS_NAMES, Catalogue, axis_name

from servo_tuning.configuration import check_board_name
from servo_tuning.control_loops import control_loops
from servo_tuning.errors import ConfigError
from servo_tuning.members import MEMBERS, read_members
from servo_tuning.schema import check_table

_DIGITS: Final = 17  # of a number of double precision


def blocks_of(table: Mapping[str, Any]) -> list[dict[str, int]] | None:
    """Blocks of a parsed file that contains the members of all axes and nothing else; None if it is another file.

    Raises
    ------
    ConfigError
        If a member is missing, unknown or would be refused by a board, or the file is for another board.
    """
    board, axes = table.get("board", {}), {name: axis for name, axis in table.items() if name != "board"}
    if not axes or any(not isinstance(axis, Mapping) or set(axis) != {MEMBERS} for axis in axes.values()):
        return None
    if set(board) - {"name"}:
        return None
    check_board_name(board.get("name", DEFAULT_BOARD), Catalogue.load().board)
    blocks = []
    for name in AXIS_NAMES:
        where = f"{name}.{MEMBERS}"
        block = read_members(where, check_table(name, table.get(name, {})).get(MEMBERS, {}))
        for path in AxisConfigTable.load().members:
            if path not in block:
                raise ConfigError(f"{where}.{path} is missing; add it, or add the groups of the other entries")
        blocks.append({path: block[path] for path in AxisConfigTable.load().members})
    return blocks


def text_of(blocks: Sequence[Mapping[str, int]], heading: str) -> str:
    """TOML text of blocks, with the nominal motor and the loops of each as comments; `blocks_of` reads it."""
    lines = [f"# {line}" for line in heading.splitlines()]
    lines += ["", "[board]", f'name = "{Catalogue.load().board.name}"']
    for axis, block in enumerate(blocks):
        lines += ["", *(f"# {line}" for line in _summary(block)), f"[{axis_name(axis)}.{MEMBERS}]"]
        for path, member in AxisConfigTable.load().members.items():
            unit = f"  # {member.unit}" if member.unit else ""
            lines.append(f'"{path}" = {_shortest(member, block[path])}{unit}')
    return "\n".join(lines) + "\n"


def _shortest(member: Member, raw: int) -> str:
    """Decimal number with the fewest digits that is converted to this raw number."""
    if member.bits:
        return f"{raw:#x}"
    if member.lsb == 1.0:
        return str(raw)
    texts = (f"{raw * member.lsb:.{digits}g}" for digits in range(1, _DIGITS + 1))
    text = next(text for text in texts if round(float(text) / member.lsb) == raw)
    return repr(float(text))


def _summary(block: Mapping[str, int]) -> list[str]:
    try:
        loops = control_loops(block)
        it, gains = loops.motor, loops.used
        current = gains.current_d.kp / it.l_d / (2.0 * math.pi)
        speed = gains.speed.kp * it.torque_constant / it.inertia / (2.0 * math.pi)
    except ZeroDivisionError:  # a board accepts such members
        return ["motor: without flux linkage, inductance or acceleration"]
    motor = (
        f"motor: r_s {it.r_s:.4g} ohm, l_d {it.l_d:.4g} H, l_q {it.l_q:.4g} H, psi_m {it.psi_m:.4g} V s, "
        f"{it.pole_pairs:g} pole pairs, inertia {it.inertia:.4g} kg m^2"
    )
    loops_text = f"current {current:.4g} Hz, speed {speed:.4g} Hz; position gain {gains.position:.4g} 1/s"
    return [motor, f"bandwidths: {loops_text}"]
