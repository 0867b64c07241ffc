"""Configuration block of an axis, computed from its constants and back."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Final

from servo_msgs_py.axis_config import AxisConfigTable, MemberRangeError
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.stop_categories import CATEGORIES

from servo_tuning.conversion import AxisConstants, Category, FaultSet, Field, PiRaw, Switches
from servo_tuning.errors import ConfigError, Problem, either
from servo_tuning.schema import AXIS_GROUPS


@lru_cache(maxsize=1)
def _masks() -> tuple[Mapping[str, int], Mapping[str, int]]:
    flags = Catalogue.load().flags
    features, faults = ({flag.name.lower(): flag.mask for flag in flags[name]} for name in ("features", "faults"))
    return features, faults


def _raw(value: Field) -> int:
    features, faults = _masks()
    if isinstance(value, Switches):
        return sum(features[name] for name in value)
    if isinstance(value, FaultSet):
        return sum(faults[name] for name in value)
    if isinstance(value, Category):
        return CATEGORIES.index(value)
    assert isinstance(value, int)
    return value


_ENTRIES: Final[Mapping[str, str]] = {
    "current_loop.d": "control.current_bandwidth",
    "current_loop.q": "control.current_bandwidth",
    "speed": "control.speed_bandwidth",
    "observed_speed": "observer.speed_part",
    "pll": "observer.pll_i",
    "observer": "observer.bandwidth",
    "offset_tolerance": "sensing.offset_tolerance",
    "encoder.pole_pairs": "motor.pole_pairs",
}
"""Entry that corrects a member out of range, by its path or the path of its group."""


def _entry_of(path: str) -> str:
    """Entry that corrects a member; empty: there is none."""
    group, _, key = path.rpartition(".")
    if key in AXIS_GROUPS.get(group, {}):
        return path
    return _ENTRIES.get(path) or _ENTRIES.get(group, "")


def block_of(constants: AxisConstants, name: str) -> dict[str, int]:
    """Return the configuration block of an axis, by member.

    Parameters
    ----------
    constants : mapping
        All fields of ``axis_config_t``.
    name : str
        Name of the axis, for the refusal.

    Raises
    ------
    ConfigError
        If a board would refuse a member.
    """
    table, found = AxisConfigTable.load(), members_of(constants, name)
    block = {path: found[path] for path in table.members if path in found}
    table.check(block)
    return block


def members_of(constants: AxisConstants, name: str) -> dict[str, int]:
    """Return the members of a block that some fields give; arguments and refusals as in `block_of`."""
    found: dict[str, int] = {}
    for path, value in constants.items():
        if isinstance(value, PiRaw):
            found |= {f"{path}.{gain}": raw for gain, raw in value._asdict().items()}
        else:
            found[path] = _raw(value)
    try:
        AxisConfigTable.load().check_part(found)
    except MemberRangeError as error:
        entry = _entry_of(error.path)
        changes = (either(f"{name}.{entry}"),) if entry else ()
        problem = Problem(f"{name}: {error}", f"{name}: {error.path}", changes, "correct the motor data")
        raise ConfigError(problem) from None
    return found


def constants_of(block: Mapping[str, int], like: AxisConstants) -> AxisConstants:
    """Convert a block to constants, the inverse of `block_of`.

    Parameters
    ----------
    block : mapping
        Raw numbers by member.
    like : mapping
        Fields of ``axis_config_t`` with the types of the result.
    """
    features, faults = _masks()

    def field(path: str, old: Field) -> Field:
        if isinstance(old, PiRaw):
            return PiRaw(*(block[f"{path}.{gain}"] for gain in PiRaw._fields))
        raw = block[path]
        if isinstance(old, Switches):
            return Switches(name for name, mask in features.items() if raw & mask)
        if isinstance(old, FaultSet):
            return FaultSet(sorted(name for name, mask in faults.items() if raw & mask))
        if isinstance(old, Category):
            return Category(CATEGORIES[raw])
        return raw

    return {path: field(path, old) for path, old in like.items()}
