"""Configuration block of an axis, computed from its constants and back."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.stop_categories import CATEGORIES

from servo_tuning.conversion import AxisConstants, Category, FaultSet, Field, PiRaw, Switches


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


def block_of(constants: AxisConstants) -> dict[str, int]:
    """Return the configuration block of an axis, by member, from all fields of ``axis_config_t``.

    Raises
    ------
    AxisConfigError
        If a board would refuse a member.
    """
    found: dict[str, int] = {}
    for path, value in constants.items():
        if isinstance(value, PiRaw):
            found |= {f"{path}.{gain}": raw for gain, raw in value._asdict().items()}
        else:
            found[path] = _raw(value)
    table = AxisConfigTable.load()
    block = {path: found[path] for path in table.members if path in found}
    table.check(block)
    return block


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
