"""The configuration block of an axis (``axis_config.toml``): its members, and the block as integers and bytes.

A block is a mapping from the C path of a member, such as ``current_loop.d.kp``, to its raw number. Board and host
number the members in the order of the table and compute the checksum of a block as `checksum` does.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.catalogue import FORMATS, Catalogue
from servo_msgs_py.quantity import Format, Quantity
from servo_msgs_py.stop_categories import REFUSED
from servo_msgs_py.text_file import read_toml


class AxisConfigError(ValueError):
    """A malformed table or block; the message contains the member."""


@dataclass(frozen=True, kw_only=True)
class Member(Quantity):
    """One number of a block; its name is the C path below ``axis_config_t``."""

    bits: bool  # whether it is a set of flags; the largest raw number has all permitted bits set
    live: bool  # whether it may be changed during motion

    def accepts(self, raw: int) -> bool:
        """Whether the board accepts a raw number."""
        low, high = self.raw_range
        return low <= raw <= high and not (self.bits and raw & ~high)

    def shown(self, raw: int) -> str:
        """Value and unit as text."""
        if self.bits:
            return f"{raw:#x}"
        return f"{self.scale(raw):.6g} {self.unit}".rstrip()


@dataclass(frozen=True)
class AxisConfigTable:
    """All members of a block."""

    members: Mapping[str, Member]  # by path, in the order of the table
    layout: int  # CRC-32 of all properties that determine the meaning of a block

    @classmethod
    def load(cls, catalogue: Catalogue | None = None) -> AxisConfigTable:
        """The packaged table, with the ranges of a table of variables, by default of the packaged one."""
        return _packaged() if catalogue is None else cls.parse(read_toml(_PACKAGED), catalogue)

    @classmethod
    def parse(cls, table: Mapping[str, Any], catalogue: Catalogue) -> AxisConfigTable:
        """Build the table from the parsed TOML file.

        Raises
        ------
        AxisConfigError
            If it is malformed.
        """
        members = {
            path: _member(path, {**table["formats"].get(entry.get("format", ""), {}), **entry}, catalogue)
            for path, entry in table["members"].items()
        }
        lines = "\n".join(
            f"{m.name} {m.format.size} {m.format.signed} {m.raw_range[0]} {m.raw_range[1]} {m.bits} {m.live} {m.lsb!r}"
            for m in members.values()
        )
        return cls(members, zlib.crc32(lines.encode()))

    def __len__(self) -> int:
        return len(self.members)

    def value(self, path: str, block: Mapping[str, int]) -> float:
        """Value of a member of a block, in its unit."""
        return float(self.members[path].scale(block[path]))

    def check(self, block: Mapping[str, int]) -> None:
        """Check that the board accepts the block.

        Raises
        ------
        AxisConfigError
            If a member is missing, unknown or out of range; the message contains the first one.
        """
        for path in block:
            if path not in self.members:
                raise AxisConfigError(f"{path} is not a member of a configuration block")
        for path in self.members:
            if path not in block:
                raise AxisConfigError(f"{path} is missing")
        for path, member in self.members.items():
            if not member.accepts(block[path]):
                span = f"{member.minimum:g} .. {member.maximum:g} {member.unit}".rstrip()
                allowed = f"bits of {member.raw_range[1]:#x}" if member.bits else span
                raise AxisConfigError(f"{path} = {member.shown(block[path])}: allowed: {allowed}")

    def words(self, block: Mapping[str, int]) -> list[int]:
        """Raw numbers in the order of the table.

        Raises
        ------
        AxisConfigError
            As `check`.
        """
        self.check(block)
        return [block[path] for path in self.members]

    def block(self, words: Sequence[int]) -> dict[str, int]:
        """The block from raw numbers in the order of the table, signed or modulo 2^32.

        Raises
        ------
        AxisConfigError
            If the number of members is wrong, or one is out of range.
        """
        if len(words) != len(self):
            raise AxisConfigError(f"{len(words)} members, {len(self)} expected")
        result = {
            member.name: word if member.format.signed else word % (1 << 32)
            for member, word in zip(self.members.values(), words, strict=True)
        }
        self.check(result)
        return result

    def encode(self, block: Mapping[str, int]) -> bytes:
        """Little-endian bytes of all members, without padding.

        Raises
        ------
        AxisConfigError
            As `check`.
        """
        self.check(block)
        return b"".join(member.pack([block[name]]) for name, member in self.members.items())

    def decode(self, data: bytes) -> dict[str, int]:
        """The block from the bytes of `encode`.

        Raises
        ------
        AxisConfigError
            If the number of bytes is wrong, or a member is out of range.
        """
        size = sum(member.format.size for member in self.members.values())
        if len(data) != size:
            raise AxisConfigError(f"{len(data)} bytes, {size} expected")
        words, at = list[int](), 0
        for member in self.members.values():
            words += member.elements(data[at : at + member.format.size])
            at += member.format.size
        return self.block(words)

    def checksum(self, axis: int, block: Mapping[str, int]) -> int:
        """CRC-32 of layout, number of members, axis and all members, as the board computes it.

        Parameters
        ----------
        axis : int
            Index of the axis.
        block : mapping
            Raw numbers.
        """
        head = b"".join(word.to_bytes(4, "little") for word in (self.layout, len(self), axis))
        return zlib.crc32(head + self.encode(block))

    def changes(self, old: Mapping[str, int], new: Mapping[str, int]) -> list[Member]:
        """Members with different values in two blocks."""
        return [member for path, member in self.members.items() if old[path] != new[path]]


_PACKAGED: Final = Path(__file__).with_name("axis_config.toml")


@lru_cache(maxsize=1)
def _packaged() -> AxisConfigTable:
    """The packaged table, cached: parsing takes milliseconds."""
    return AxisConfigTable.load(Catalogue.load())


def _member(path: str, entry: Mapping[str, Any], catalogue: Catalogue) -> Member:
    known = {
        "format", "type", "bits", "minimum", "maximum", "fixed", "scale", "answer", "live",
    }  # fmt: skip
    if unknown := set(entry) - known:
        raise AxisConfigError(f"{path}: unknown key {', '.join(sorted(unknown))}")
    parameter = next((v for v in catalogue.variables.values() if v.default == f"axis.{path}"), None)
    if "type" in entry and entry["type"] in FORMATS:
        type_ = FORMATS[entry["type"]]
        format_ = Format(type_.size, type_.signed, entry.get("bits", 0))
        full, unit = _scale(path, entry.get("scale", ""), catalogue)
        lsb = math.ldexp(full, -format_.fraction_bits)
    elif parameter is not None and "type" not in entry:
        format_, lsb, unit = parameter.format, parameter.lsb, parameter.unit
    else:
        raise AxisConfigError(f"{path}: no type, no format that contains one, and no parameter with this default")
    low, high = entry.get("minimum", 0), entry.get("maximum", 0)
    if parameter is not None:  # a default that its parameter does not accept could not be restored from the flash
        raw_low, raw_high = parameter.raw_range
        low, high = max(entry.get("minimum", raw_low), raw_low), min(entry.get("maximum", raw_high), raw_high)
    if "fixed" in entry:
        low = high = entry["fixed"]
    if "answer" in entry:
        high = sum(f.mask for f in catalogue.flags["faults"] if entry["answer"] not in REFUSED.get(f.name.lower(), {}))
    if not format_.low <= low <= high <= min(format_.high, (1 << 31) - 1):
        raise AxisConfigError(f"{path}: the range {low} .. {high} does not fit its format and int32_t")
    return Member(
        name=path,
        unit=unit,
        minimum=low * lsb,
        maximum=high * lsb,
        format=format_,
        lsb=lsb,
        bits="answer" in entry,
        live=entry.get("live", False),
    )


def _scale(path: str, text: str, catalogue: Catalogue) -> tuple[float, str]:
    """Factor and unit of a scale, or of the quotient of two."""
    names = [name for name in text.split("/") if name]
    for name in names:
        if name not in catalogue.scales:
            raise AxisConfigError(f"{path}: unknown scale {name!r}")
    scales = [catalogue.scales[name] for name in names]
    values = [scale.full_scale if scale.full_scale is not None else (scale.lsb or 1.0) for scale in scales]
    if not scales:
        return 1.0, ""
    if len(scales) == 1:
        return values[0], scales[0].unit
    over = scales[1].unit if "/" not in scales[1].unit else f"({scales[1].unit})"
    return values[0] / values[1], f"{scales[0].unit}/{over}"
