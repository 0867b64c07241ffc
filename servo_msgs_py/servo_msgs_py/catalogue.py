"""The table of firmware variables (``variables.toml``) as typed objects."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.board_description import BoardDescription
from servo_msgs_py.quantity import Format, Quantity
from servo_msgs_py.text_file import TextFileError, read_toml
from servo_msgs_py.units import SLOW_PERIODS, to_raw

AXES: Final = 2
"""Axes of one board."""

ANALOG_OUTS: Final = 2
"""Monitor outputs of one board."""

_COUNTS: Final[Mapping[str, int]] = {"axes": AXES, "analog_outs": ANALOG_OUTS}

Value = float | int | list[float] | list[int] | bytes
"""A decoded variable: a number, a list with one number per axis, or the bytes of a block."""


class CatalogueError(ValueError):
    """The table of variables is malformed; the message contains position and cause."""


FORMATS: Final[Mapping[str, Format]] = {
    "uint16": Format(2),
    "uint32": Format(4),
    "int16": Format(2, signed=True),
    "int32": Format(4, signed=True),
    "frac16": Format(2, signed=True, fraction_bits=15),
    "frac32": Format(4, signed=True, fraction_bits=31),
    "enum": Format(2),
    "flags": Format(2),
    "flags32": Format(4),
    "block": Format(1),
}
"""Formats by the type words of the tables."""


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


@dataclass(frozen=True, kw_only=True)
class Variable(Quantity):
    """One firmware variable; its name is that on the wire and, with dots as slashes, of its topic."""

    path: str  # C path below ``servo_t`` in the memory shared by host and board; empty: local variable of a loop
    type: str  # type word of the table: ``frac16``, ``int32``, ``enum`` ...
    count: int  # elements
    elements_of: str  # ``axes`` or ``analog_outs``: one element each; empty for others
    full_scale: float | None  # SI value of 1.0; fractional types only
    writable: bool  # whether the host may write it
    enum: str | None = None  # name of the enumeration
    flags: str | None = None  # name of the flag set
    source: str | None = None  # C path below ``servo_t`` to the value in the loop
    part: int = 0  # offset of the variable in the source [bytes]
    default: str = ""  # of a parameter; see `servo_msgs_py.parameter_code`

    @property
    def element_size(self) -> int:
        """Bytes of one element; 1 for blocks."""
        return self.format.size

    @property
    def size(self) -> int:
        """Bytes of the whole variable; 0 for blocks, whose size is read from the board."""
        return 0 if self.type == "block" else self.format.size * self.count

    @property
    def access(self) -> str:
        """``ro`` or ``rw``."""
        return "rw" if self.writable else "ro"

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

    def encode_raw(self, raw: Sequence[int]) -> bytes:
        """Bytes for the board from one integer per element.

        Raises
        ------
        ValueError
            If the number of elements is wrong or one does not fit the type.
        """
        self._check_count(len(raw))
        return self.pack(raw)

    def encode_part(self, raw: Sequence[int], first: int = 0) -> tuple[int, bytes]:
        """Encode neighbouring elements.

        Parameters
        ----------
        raw : sequence of int
            Firmware integers, one per element.
        first : int
            Index of the first element.

        Returns
        -------
        offset, data : int, bytes
            Offset from the address of the variable, and bytes to write.

        Raises
        ------
        ValueError
            If the variable is read-only, an element does not exist, or a number does not fit.
        """
        if not self.writable:
            raise ValueError(f"{self.name} can only be read")
        if not raw or first < 0 or first + len(raw) > self.count:
            raise ValueError(f"{self.name} has {self.count} element(s), not {first} .. {first + len(raw) - 1}")
        return first * self.format.size, self.pack(raw)

    def to_raw(self, value: float) -> int:
        """Raw number of one SI value.

        Raises
        ------
        ValueError
            If the value is not finite, not whole for an integer variable, or outside the limits of the variable.
        """
        if problem := self.problem(value):
            outside = math.isfinite(value) and not self.minimum <= value <= self.maximum
            raise ValueError(self.outside_text(value) if outside else f"{self.name}: {value!r} is {problem}")
        return to_raw(value, self.lsb, self.format.low, self.format.high)

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
    board: BoardDescription  # whose ranges are full scales
    structs: Mapping[str, tuple[Variable, ...]] = field(default_factory=dict)
    """Members of blocks without variables, in memory order; name and path are the C name."""

    @classmethod
    def load(cls, path: Path | None = None, board: BoardDescription | None = None) -> Catalogue:
        """Read a table.

        Parameters
        ----------
        path : Path, optional
            Another table than the packaged one.
        board : BoardDescription, optional
            Board whose ranges are full scales; `board_description.DEFAULT_BOARD` by default.

        Raises
        ------
        CatalogueError
            If the table is malformed.
        OSError
            If the file cannot be read.
        """
        if path is None and board is None:
            return _packaged()
        return _read(path or _PACKAGED, board or BoardDescription.load())

    def full_scale(self, name: str) -> float:
        """SI value of 1.0 of the scale of a fraction."""
        value = self.scales[name].full_scale
        assert value is not None, name
        return value

    @classmethod
    def parse(cls, table: Mapping[str, Any], board: BoardDescription | None = None) -> Catalogue:
        """Build a catalogue from the parsed table; see `load`."""
        board = board or BoardDescription.load()
        scales = _scales(table.get("scales", {}), board)
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
        return cls(variables, enums, flags, bits, scales, _hash(variables, enums, flags, structs), board, structs)

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
        return self._labels[enum].get(raw) or str(raw)

    @cached_property
    def _labels(self) -> dict[str, dict[int, str]]:
        """Names by value of every enumeration; the first one if several have it."""
        return {enum: {raw: name for name, raw in reversed(list(names.items()))} for enum, names in self.enums.items()}

    def active(self, flags: str, raw: int) -> list[Flag]:
        """Flags that are set in a flag word."""
        return [flag for flag in self.flags[flags] if raw & flag.mask] if raw else []

    def flag(self, word: str, name: str) -> Flag:
        """A flag of a word by its name, such as ``flag("faults", "WATCHDOG")``."""
        return next(flag for flag in self.flags[word] if flag.name == name)

    def snapshot_variables(self) -> list[Variable]:
        """Variables in the telemetry block, in the order of the table."""
        return [v for v in self.variables.values() if v.path.startswith("snapshot.")]


_PACKAGED: Final = Path(__file__).with_name("variables.toml")


@lru_cache(maxsize=1)
def _packaged() -> Catalogue:
    """Catalogue of the packaged table, cached: parsing takes milliseconds."""
    return _read(_PACKAGED, BoardDescription.load())


def _read(source: Path, board: BoardDescription) -> Catalogue:
    try:
        return Catalogue.parse(read_toml(source), board)
    except (CatalogueError, TextFileError) as error:
        raise CatalogueError(f"{source}: {error}") from None


def _scales(table: Mapping[str, Mapping[str, Any]], board: BoardDescription) -> dict[str, Scale]:
    """Scales in their order: numbers, ranges and times of the board, and multiples of earlier scales."""
    scales: dict[str, Scale] = {}
    times = {"period": board.period, "slow_tick": SLOW_PERIODS * board.period}

    def full(name: str) -> float:
        if name not in scales or (value := scales[name].full_scale) is None:
            raise CatalogueError(f"{name} is no earlier scale with a full scale")
        return value

    for name, entry in table.items():
        full_scale, lsb = entry.get("full_scale"), entry.get("lsb")
        if "range" in entry:
            full_scale = board.ranges[entry["range"]]
        elif "of" in entry:
            multiple, divisor = entry.get("ratio", (1, 1))
            value = full(entry["of"]) * multiple / divisor / (full(entry["over"]) if "over" in entry else 1.0)
            value /= times[entry["over_time"]] if "over_time" in entry else 1.0
            full_scale, lsb = (None, math.ldexp(value, -entry["bits"])) if "bits" in entry else (value, None)
        elif "time" in entry:
            lsb = times[entry["time"]]
        elif "turn_bits" in entry:
            lsb = math.ldexp(2.0 * math.pi / times[entry["over_time"]], -entry["turn_bits"])
        scales[name] = Scale(name, entry["unit"], full_scale, lsb)
    return scales


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
        "source", "part", "default",
    }  # fmt: skip
    if unknown:
        raise CatalogueError(f"{name}: unknown key {', '.join(sorted(unknown))}")
    missing = {"name", "type", "description"} - set(entry)
    if not {"path", "source"} & set(entry):
        missing.add("path or source")
    if missing:
        raise CatalogueError(f"{name}: {', '.join(sorted(missing))} missing")
    type_ = str(entry["type"])
    if type_ not in FORMATS:
        raise CatalogueError(f"{name}: unknown type {type_!r}; known are {', '.join(FORMATS)}")
    count = entry.get("count", 1)
    elements_of = count if isinstance(count, str) else ""
    if elements_of and elements_of not in _COUNTS:
        raise CatalogueError(f"{name}: unknown count {elements_of!r}; known are numbers, {', '.join(_COUNTS)}")
    if "source" in entry and (type_ == "block" or "count" in entry):
        raise CatalogueError(f"{name}: only a single number can have a source")
    format_ = FORMATS[type_]
    if "scale" in entry and entry["scale"] not in scales:
        raise CatalogueError(f"{name}: unknown scale {entry['scale']!r}")
    scale = scales[entry["scale"]] if "scale" in entry else Scale("", "", None, 1.0)
    if (format_.fraction_bits > 0) != (scale.full_scale is not None):
        raise CatalogueError(f"{name}: a fraction needs a scale with full_scale, an integer one with lsb")
    lsb = scale.lsb if scale.full_scale is None else math.ldexp(scale.full_scale, -format_.fraction_bits)
    assert lsb is not None
    for kind, known in (("enum", enums), ("flags", flags)):
        if type_.startswith(kind) != (kind in entry) or (kind in entry and entry[kind] not in known):
            raise CatalogueError(
                f"{name}: type {kind!r} needs a key {kind!r} with the name of one of the table's {kind}"
            )
    if "flags" in entry and any(flag.mask > format_.high for flag in flags[entry["flags"]]):
        raise CatalogueError(f"{name}: {type_} is too small for all bits of {entry['flags']!r}")
    access = str(entry.get("access", "ro"))
    if access not in ("ro", "rw"):
        raise CatalogueError(f"{name}: access is {access!r}, not 'ro' or 'rw'")
    low, high = format_.low * lsb, format_.high * lsb
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
        name=name,
        unit=scale.unit,
        text=str(entry["description"]),
        minimum=minimum,
        maximum=maximum,
        whole=lsb == 1.0 and not format_.fraction_bits,
        format=format_,
        lsb=lsb,
        path=str(entry.get("path", "")),
        type=type_,
        count=_COUNTS[elements_of] if elements_of else int(count),
        elements_of=elements_of,
        full_scale=scale.full_scale,
        writable=access == "rw",
        enum=entry.get("enum"),
        flags=entry.get("flags"),
        source=entry.get("source"),
        part=int(entry.get("part", 0)),
        default=str(entry.get("default", "")),
    )


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
