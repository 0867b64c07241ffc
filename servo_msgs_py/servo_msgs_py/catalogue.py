"""The table of firmware variables (``variables.toml``) as typed objects."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.text_file import TextFileError, read_toml
from servo_msgs_py.units import frac_lsb, to_raw

AXES: Final = 2
"""Axes of one board."""

Value = float | int | list[float] | list[int] | bytes
"""A decoded variable: a number, a list with one number per axis, or the bytes of a block."""


class CatalogueError(ValueError):
    """The table of variables is malformed; the message contains position and cause."""


@dataclass(frozen=True)
class _RawType:
    """Memory format of a type of the table (little endian)."""

    size: int
    signed: bool
    tsa: int  # FreeMASTER base type byte, 111 S TT ZZ
    fractional: bool = False

    @property
    def low(self) -> int:
        return -(1 << (8 * self.size - 1)) if self.signed else 0

    @property
    def high(self) -> int:
        return (1 << (8 * self.size - (1 if self.signed else 0))) - 1

    def pack(self, raw: int) -> bytes:
        """One element in memory format; an `OverflowError` if it does not fit."""
        return raw.to_bytes(self.size, "little", signed=self.signed)


_RAW_TYPES: Final[Mapping[str, _RawType]] = {
    "uint16": _RawType(2, False, 0xE1),
    "uint32": _RawType(4, False, 0xE2),
    "int16": _RawType(2, True, 0xF1),
    "int32": _RawType(4, True, 0xF2),
    "frac16": _RawType(2, True, 0xF5, fractional=True),
    "frac32": _RawType(4, True, 0xF6, fractional=True),
    "enum": _RawType(2, False, 0xE1),
    "flags": _RawType(2, False, 0xE1),
    "flags32": _RawType(4, False, 0xE2),
    "block": _RawType(1, False, 0xE0),
}


@dataclass(frozen=True)
class Scale:
    """Unit of a quantity and the value of its full scale (fractions) or of one raw unit (integers)."""

    name: str
    unit: str
    full_scale: float | None  # SI value of 1.0; fractions only
    lsb: float | None  # SI value of one raw unit; integers only


@dataclass(frozen=True)
class Flag:
    """One bit of a flag word, with cause and remedy."""

    name: str
    bit: int
    cause: str
    remedy: str
    always: bool = False  # a fault that cannot be disabled

    @property
    def mask(self) -> int:
        return 1 << self.bit


@dataclass(frozen=True)
class Variable:
    """One firmware variable."""

    name: str  # name on the wire and, with dots as slashes, of its topic
    path: str  # C path below ``servo_t`` in the memory shared by host and board; empty: local variable of a loop
    type: str  # type word of the table: ``frac16``, ``int32``, ``enum`` ...
    count: int  # elements; more than one for arrays with one element per axis
    lsb: float  # SI value of one raw unit
    unit: str  # SI unit; empty for pure numbers
    full_scale: float | None  # SI value of 1.0; fractional types only
    access: str  # ``ro`` or ``rw``
    minimum: float  # smallest permitted value, SI
    maximum: float  # largest permitted value, SI
    description: str
    enum: str | None = None  # name of the enumeration
    flags: str | None = None  # name of the flag set
    source: str | None = None  # C path below ``servo_t`` to the value in the loop
    part: int = 0  # offset of the variable in the source [bytes]

    @property
    def raw_type(self) -> _RawType:
        return _RAW_TYPES[self.type]

    @property
    def element_size(self) -> int:
        """Bytes of one element; 1 for blocks."""
        return self.raw_type.size

    @property
    def size(self) -> int:
        """Bytes of the whole variable; 0 for blocks, whose size is read from the board."""
        return 0 if self.type == "block" else self.element_size * self.count

    @property
    def writable(self) -> bool:
        return self.access == "rw"

    @property
    def whole(self) -> bool:
        """Whether only whole numbers are valid: enumerations, flags, switches, counts."""
        return self.lsb == 1.0 and not self.raw_type.fractional

    @property
    def raw_range(self) -> tuple[int, int]:
        """Limits as raw numbers; the board refuses numbers outside."""
        return self.to_raw(self.minimum), self.to_raw(self.maximum)

    def decode_raw(self, data: bytes) -> list[int]:
        """Integers, one per element, from the bytes read from the board.

        Raises
        ------
        ValueError
            If the number of bytes does not match the variable.
        """
        if self.type != "block" and len(data) != self.size:
            raise ValueError(f"{self.name}: {len(data)} bytes read, {self.size} expected")
        return self.elements(data)

    def elements(self, data: bytes) -> list[int]:
        """Integers from the bytes of consecutive elements."""
        step, signed = self.element_size, self.raw_type.signed
        return [int.from_bytes(data[k : k + step], "little", signed=signed) for k in range(0, len(data), step)]

    def encode_raw(self, raw: Sequence[int]) -> bytes:
        """Bytes for the board from one integer per element.

        Raises
        ------
        ValueError
            If the number of elements is wrong or one does not fit the type.
        """
        self._check_count(len(raw))
        low, high = self.raw_type.low, self.raw_type.high
        for value in raw:
            if not low <= value <= high:
                raise ValueError(f"{self.name}: {value} does not fit {self.type} ({low} .. {high})")
        return b"".join(self.raw_type.pack(int(value)) for value in raw)

    def scale(self, raw: int) -> float | int:
        """SI value of one raw number; an integer if one raw unit is 1."""
        return raw if self.lsb == 1.0 else raw * self.lsb

    def to_raw(self, value: float) -> int:
        """Raw number of one SI value.

        Raises
        ------
        ValueError
            If the value is not finite, not whole for an integer variable, or outside the limits of the variable.
        """
        if not math.isfinite(value):
            raise ValueError(f"{self.name}: {value!r} is not a finite number")
        if self.whole and not float(value).is_integer():
            raise ValueError(f"{self.name}: {value:g} is not a whole number")
        if not self.minimum <= value <= self.maximum:
            raise ValueError(self.outside_text(value))
        return to_raw(value, self.lsb, self.raw_type.low, self.raw_type.high)

    def outside_text(self, value: float, element: int | None = None) -> str:
        """Error text for a value outside the limits, optionally with the index of its element."""
        name = self.name if element is None or self.count == 1 else f"{self.name}[{element}]"
        unit = f" {self.unit}" if self.unit else ""
        return f"{name}: {value:g} is outside {self.minimum:g} .. {self.maximum:g}{unit}"

    def decode(self, data: bytes) -> Value:
        """SI value (list for arrays, bytes for blocks) from the bytes read from the board."""
        if self.type == "block":
            return data
        values = [self.scale(raw) for raw in self.decode_raw(data)]
        return values[0] if self.count == 1 else values

    def encode(self, value: float | Sequence[float]) -> bytes:
        """Bytes for the board from an SI value (a sequence for arrays).

        Raises
        ------
        ValueError
            If a value is not finite or outside the limits, or the number of elements is wrong.
        """
        values = [value] if isinstance(value, (int, float)) else list(value)
        self._check_count(len(values))
        return self.encode_raw([self.to_raw(v) for v in values])

    def _check_count(self, count: int) -> None:
        if self.type == "block":
            raise ValueError(f"{self.name}: a block is read-only")
        if count != self.count:
            raise ValueError(f"{self.name}: {count} values given, {self.count} expected")


def numbers(value: Value) -> list[float]:
    """One number per element of a value, or per byte of a block."""
    return list(value) if isinstance(value, (list, bytes)) else [value]


def axis_name(axis: int) -> str:
    """Name of an axis in variable names: ``axis1`` for index 0."""
    return f"axis{axis + 1}"


AXIS_NAMES: Final = tuple(axis_name(axis) for axis in range(AXES))


@dataclass(frozen=True)
class Catalogue:
    """All variables, enumerations and flag sets of one table."""

    variables: Mapping[str, Variable]
    enums: Mapping[str, Mapping[str, int]]
    flags: Mapping[str, tuple[Flag, ...]]
    bits: Mapping[str, Mapping[str, int]]
    scales: Mapping[str, Scale]
    hash: int
    structs: Mapping[str, tuple[Variable, ...]] = field(default_factory=dict)
    """Members of blocks without variables, in memory order; name and path are the C name."""

    @classmethod
    def load(cls, path: Path | None = None) -> Catalogue:
        """Read a table.

        Parameters
        ----------
        path : Path, optional
            Another table than the packaged one.

        Raises
        ------
        CatalogueError
            If the table is malformed.
        OSError
            If the file cannot be read.
        """
        return _packaged() if path is None else _read(path)

    @classmethod
    def parse(cls, table: Mapping[str, Any]) -> Catalogue:
        """Build a catalogue from the parsed table; see `load`."""
        scales = {
            name: Scale(name, entry["unit"], entry.get("full_scale"), entry.get("lsb"))
            for name, entry in table.get("scales", {}).items()
        }
        enums = {name: dict(entries) for name, entries in table.get("enums", {}).items()}
        flags = {
            name: tuple(
                Flag(n, e["bit"], e["cause"], e.get("remedy", ""), e.get("always", False)) for n, e in entries.items()
            )
            for name, entries in table.get("flags", {}).items()
        }
        bits = {name: dict(entries) for name, entries in table.get("bits", {}).items()}
        variables: dict[str, Variable] = {}
        for entry in _expand(table):
            variable = _variable(entry, scales, enums, flags)
            if variable.name in variables:
                raise CatalogueError(f"{variable.name}: named twice")
            variables[variable.name] = variable
        structs = {
            name: tuple(
                _variable({"name": key, "path": key, "description": "", **entry}, scales, enums, flags)
                for key, entry in members.items()
            )
            for name, members in table.get("structs", {}).items()
        }
        return cls(variables, enums, flags, bits, scales, _hash(variables, enums, flags, structs), structs)

    def __getitem__(self, name: str) -> Variable:
        """Variable by name; the text of the `KeyError` contains the closest names."""
        try:
            return self.variables[name]
        except KeyError:
            import difflib

            near = difflib.get_close_matches(name, self.variables, n=3)
            hint = f"; did you mean {', '.join(near)}?" if near else ""
            raise KeyError(f"no variable {name!r}{hint}") from None

    def label(self, enum: str, raw: int) -> str:
        """Name of an enumeration value, or the number if it has no name."""
        return next((name for name, value in self.enums[enum].items() if value == raw), str(raw))

    def active(self, flags: str, raw: int) -> list[Flag]:
        """Flags that are set in a flag word."""
        return [flag for flag in self.flags[flags] if raw & flag.mask] if raw else []

    def flag(self, word: str, name: str) -> Flag:
        """A flag of a word by its name, such as ``flag("faults", "WATCHDOG")``."""
        return next(flag for flag in self.flags[word] if flag.name == name)

    def snapshot_variables(self) -> list[Variable]:
        """Variables in the telemetry block, in the order of the table."""
        return [v for v in self.variables.values() if v.path.startswith("snapshot.")]


@lru_cache(maxsize=1)
def _packaged() -> Catalogue:
    """Catalogue of the packaged table, cached: parsing takes milliseconds."""
    return _read(Path(__file__).with_name("variables.toml"))


def _read(source: Path) -> Catalogue:
    try:
        return Catalogue.parse(read_toml(source))
    except (CatalogueError, TextFileError) as error:
        raise CatalogueError(f"{source}: {error}") from None


def _expand(table: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Entries of the table in order; each ``axis_variable`` once per axis."""
    entries = [dict(entry) for entry in table.get("variable", [])]
    for axis in range(AXES):
        for entry in table.get("axis_variable", []):
            expanded = dict(entry)
            expanded["name"] = f"{axis_name(axis)}.{entry['name']}"
            for key in {"path", "source"} & set(entry):
                expanded[key] = str(entry[key]).replace("{i}", str(axis))
            entries.append(expanded)
    return entries


def _variable(
    entry: Mapping[str, Any],
    scales: Mapping[str, Scale],
    enums: Mapping[str, Mapping[str, int]],
    flags: Mapping[str, tuple[Flag, ...]],
) -> Variable:
    name = str(entry.get("name", "?"))
    unknown = set(entry) - {
        "name", "path", "type", "count", "scale", "access", "minimum", "maximum", "description", "enum", "flags",
        "source", "part",
    }  # fmt: skip
    if unknown:
        raise CatalogueError(f"{name}: unknown key {', '.join(sorted(unknown))}")
    missing = {"name", "type", "description"} - set(entry)
    if not {"path", "source"} & set(entry):
        missing.add("path or source")
    if missing:
        raise CatalogueError(f"{name}: {', '.join(sorted(missing))} missing")
    type_ = str(entry["type"])
    if type_ not in _RAW_TYPES:
        raise CatalogueError(f"{name}: unknown type {type_!r}; known are {', '.join(_RAW_TYPES)}")
    if "source" in entry and (type_ == "block" or "count" in entry):
        raise CatalogueError(f"{name}: only a single number can have a source")
    raw = _RAW_TYPES[type_]
    if "scale" in entry and entry["scale"] not in scales:
        raise CatalogueError(f"{name}: unknown scale {entry['scale']!r}")
    scale = scales[entry["scale"]] if "scale" in entry else Scale("", "", None, 1.0)
    if raw.fractional != (scale.full_scale is not None):
        raise CatalogueError(f"{name}: a fraction needs a scale with full_scale, an integer one with lsb")
    lsb = frac_lsb(scale.full_scale, 8 * raw.size) if scale.full_scale is not None else scale.lsb
    assert lsb is not None
    for kind, known in (("enum", enums), ("flags", flags)):
        if type_.startswith(kind) != (kind in entry) or (kind in entry and entry[kind] not in known):
            raise CatalogueError(
                f"{name}: type {kind!r} needs a key {kind!r} with the name of one of the table's {kind}"
            )
    if "flags" in entry and any(flag.mask > raw.high for flag in flags[entry["flags"]]):
        raise CatalogueError(f"{name}: {type_} is too small for all bits of {entry['flags']!r}")
    access = str(entry.get("access", "ro"))
    if access not in ("ro", "rw"):
        raise CatalogueError(f"{name}: access is {access!r}, not 'ro' or 'rw'")
    low, high = raw.low * lsb, raw.high * lsb
    if type_ == "enum":
        low, high = min(enums[entry["enum"]].values()), max(enums[entry["enum"]].values())
    if "flags" in entry and access == "rw":
        high = sum(flag.mask for flag in flags[entry["flags"]])
    if access == "rw" and "path" not in entry:
        raise CatalogueError(f"{name}: only a variable with a path can be writable")
    minimum, maximum = float(entry.get("minimum", low)), float(entry.get("maximum", high))
    if not low - lsb <= minimum <= maximum <= high + lsb:
        raise CatalogueError(f"{name}: limits {minimum:g} .. {maximum:g} do not fit {low:g} .. {high:g}")
    return Variable(
        name, str(entry.get("path", "")), type_, int(entry.get("count", 1)), lsb, scale.unit, scale.full_scale, access,
        minimum, maximum, str(entry["description"]), entry.get("enum"), entry.get("flags"),
        entry.get("source"), int(entry.get("part", 0)),
    )  # fmt: skip


def _hash(
    variables: Mapping[str, Variable],
    enums: Mapping[str, Mapping[str, int]],
    flags: Mapping[str, tuple[Flag, ...]],
    structs: Mapping[str, tuple[Variable, ...]],
) -> int:
    """CRC-32 of all properties that determine the meaning of transferred numbers, without descriptions."""
    lines = [
        f"{v.name} {v.type} {v.count} {v.lsb!r} {v.unit} {v.access} {v.enum} {v.flags}" for v in variables.values()
    ]
    lines += [f"{name} {sorted(entries.items(), key=lambda e: e[1])}" for name, entries in sorted(enums.items())]
    lines += [f"{name} {[(f.name, f.bit) for f in entries]}" for name, entries in sorted(flags.items())]
    lines += [f"{name} {[(m.name, m.type, m.count, m.lsb) for m in members]}" for name, members in structs.items()]
    return zlib.crc32("\n".join(lines).encode())
