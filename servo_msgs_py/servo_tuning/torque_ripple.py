"""Harmonics of the torque ripple: the group ``[axisN.torque_ripple]`` of a configuration.

    torque = sum of amplitude sin(order angle + phase)    N m, angle from the home position

The board adds the opposite current.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from servo_msgs_py.axis_config import AxisConfigTable

from servo_tuning.errors import ConfigError, refused
from servo_tuning.schema import check_table, checked_number, number, unknown_name

TORQUE_RIPPLE: Final = "torque_ripple"
"""Name of the group of an axis."""

HARMONICS: Final = "harmonics"
"""Its only entry."""

HARMONICS_MAX: Final = sum(path.startswith("torque_ripple.order[") for path in AxisConfigTable.load().members)
"""Harmonics that a configuration block holds."""

_ORDER_MAX: Final = round(AxisConfigTable.load().members[f"{TORQUE_RIPPLE}.order[0]"].maximum)
_PHASE_STEPS: Final = 2**16  # of a turn
_ENTRIES: Final = {
    "order": number("", "periods per mechanical turn", minimum=1.0, maximum=_ORDER_MAX, whole=True),
    "amplitude": number("N m", "amplitude of the torque", minimum=0.0),
    "phase": number("rad", "phase of the torque at the home position", minimum=-100.0, maximum=100.0),
}


@dataclass(frozen=True)
class Harmonic:
    """One harmonic of the torque ripple."""

    order: int  # periods per mechanical turn
    amplitude: float  # [N m]
    phase: float  # [rad]

    def toml(self) -> str:
        """The harmonic as an inline table."""
        return f"{{ order = {self.order}, amplitude = {self.amplitude:.6g}, phase = {self.phase:.5g} }}"


def fragment(axis: str, harmonics: Sequence[Harmonic]) -> str:
    """The group of an axis as TOML text; `read_harmonics` reads it."""
    lines = "".join(f"  {one.toml()},\n" for one in harmonics)
    return f"[{axis}.{TORQUE_RIPPLE}]\n{HARMONICS} = [" + (f"\n{lines}" if lines else "") + "]\n"


def read_harmonics(where: str, table: object) -> tuple[Harmonic, ...]:
    """Check the group.

    Parameters
    ----------
    where : str
        Full name of the group, for messages.
    table : object
        Parsed group; it may be empty.

    Raises
    ------
    ConfigError
        If an entry is missing, unknown or out of range, or there are too many harmonics.
    """
    entries = check_table(where, table)
    for key in entries:
        if key != HARMONICS:
            raise unknown_name(f"{where}.{key}", key, (HARMONICS,))
    found = entries.get(HARMONICS, [])
    where = f"{where}.{HARMONICS}"
    if not isinstance(found, Sequence) or isinstance(found, str) or len(found) > HARMONICS_MAX:
        shown = f"{len(found)} harmonics" if isinstance(found, Sequence) else repr(found)
        raise refused(where, shown, "not a list that a board holds", f"write at most {HARMONICS_MAX} harmonics")
    harmonics = tuple(_harmonic(f"{where}[{k}]", entry) for k, entry in enumerate(found))
    orders = [one.order for one in harmonics]
    for order in orders:
        if orders.count(order) > 1:
            raise refused(where, f"order {order}", "given twice", "write one harmonic for each order")
    return harmonics


def _harmonic(where: str, value: object) -> Harmonic:
    table: Mapping[str, object] = check_table(where, value)
    for key in table:
        if key not in _ENTRIES:
            raise unknown_name(f"{where}.{key}", key, tuple(_ENTRIES))
    numbers = {}
    for key, entry in _ENTRIES.items():
        if key not in table:
            raise ConfigError(f"{where}.{key} is missing; write {entry.expected}: {entry.text}")
        numbers[key] = checked_number(entry, f"{where}.{key}", table[key])
    return Harmonic(int(numbers["order"]), numbers["amplitude"], numbers["phase"])


def ripple_members(harmonics: Sequence[Harmonic], torque_per_current: float) -> dict[str, float]:
    """Members of a configuration block for the opposite current, by C path: periods, fraction of full scale, turns.

    Parameters
    ----------
    harmonics : sequence of Harmonic
        The torque ripple.
    torque_per_current : float
        Torque of the full-scale current [N m].
    """
    found: dict[str, float] = {}
    for k in range(HARMONICS_MAX):
        one = harmonics[k] if k < len(harmonics) else Harmonic(0, 0.0, math.pi)
        turns = round((one.phase / (2.0 * math.pi) + 0.5) * _PHASE_STEPS) % _PHASE_STEPS / _PHASE_STEPS
        values = {"order": one.order, "amplitude": one.amplitude / torque_per_current, "phase": turns}
        found |= {f"{TORQUE_RIPPLE}.{name}[{k}]": value for name, value in values.items()}
    return found
