"""Variable table of a target (TSA): type strings, entries, and decoding of numbers.

Processes the texts and words read by `discovery`.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Final, Literal

from servo_bridge.freemaster.errors import CodecError

Number = int | float
ByteOrder = Literal["little", "big"]

_SPECIAL: Final = (0xEC, 0xED)
_STRUCT_TYPE: Final = b"\xed:STRUCT"
_OLD_STRUCT, _OLD_MEMBER = 0, 2
_FIXED_POINT: Final = re.compile(rb":(\d{1,3})\.(\d{1,3})\Z")
_SIZES: Final = (1, 2, 4, 8)

MAX_ELEMENTS: Final = 256
"""Largest array of structures whose elements are listed."""

_MAX_VARIABLES: Final = 65_536  # limit for nested arrays of structures


class EntryKind(Enum):
    """Access bits of an entry."""

    NONE = 0
    READ_ONLY = 1
    READ_ONLY_FLASH = 2
    READ_WRITE = 3


class TypeKind(Enum):
    """Interpretation of the bits of a value."""

    UNSIGNED = "unsigned"
    SIGNED = "signed"
    FLOAT = "float"
    RAW = "raw"


@dataclass(frozen=True)
class Entry:
    """Entry of a table with its texts; `type_text` is empty without a type."""

    name: str
    type_text: bytes
    address: int
    info: int

    @property
    def size(self) -> int:
        """Bytes of the variable."""
        return self.info >> 2

    @property
    def kind(self) -> EntryKind:
        """Access permitted by the target."""
        return EntryKind(self.info & 3)

    @property
    def special(self) -> str:
        """``STRUCT``, ``ENUM``, ``CONST`` ... for entries that are not variables, else empty."""
        if self.type_text[:1] and self.type_text[0] in _SPECIAL:
            return self.type_text[1:].removeprefix(b":").decode("latin-1")
        return ""


def entry_of_version_2(name: str, type_text: bytes, address: int, info: int) -> Entry:
    """Entry of a table of version 2, which marks structures and their members by the access bits only."""
    size, kind = info >> 2 << 2, info & 3
    if kind == _OLD_STRUCT and not type_text:
        return Entry(name, _STRUCT_TYPE, 0, size)
    if kind == _OLD_MEMBER:
        return Entry(name, type_text, address, size)
    return Entry(name, type_text, address, info)


@dataclass(frozen=True)
class ValueType:
    """Type of one element of a variable."""

    kind: TypeKind  # interpretation of the bits
    size: int  # bytes of one element
    name: str  # for display: ``u16``, ``q0.15``, ``float`` or the name of a type of the target
    fraction_bits: int = 0  # the value is the integer divided by two to this power
    labels: tuple[tuple[str, int], ...] = ()  # names of enumeration values

    def decode(self, data: bytes, order: ByteOrder = "little") -> Number:
        """Decode one element."""
        if self.kind is TypeKind.FLOAT:
            return float(struct.unpack(("<" if order == "little" else ">") + ("f" if self.size == 4 else "d"), data)[0])
        raw = int.from_bytes(data, order, signed=self.kind is TypeKind.SIGNED)
        return math.ldexp(raw, -self.fraction_bits) if self.fraction_bits else raw

    def encode(self, value: Number, order: ByteOrder = "little") -> bytes:
        """Encode one element.

        Raises
        ------
        ValueError
            If the value is not finite, not an integer where required, or does not fit.
        """
        if not math.isfinite(value):
            raise ValueError(f"{value!r} is not a finite number")
        if self.kind is TypeKind.FLOAT:
            try:
                return struct.pack(("<" if order == "little" else ">") + ("f" if self.size == 4 else "d"), value)
            except OverflowError:
                raise ValueError(f"{value:g} does not fit {self.name}") from None
        if self.fraction_bits:
            raw = round(math.ldexp(value, self.fraction_bits))
        elif isinstance(value, float) and not value.is_integer():
            raise ValueError(f"{value:g} is not an integer, as required by {self.name}")
        else:
            raw = int(value)
        try:
            return raw.to_bytes(self.size, order, signed=self.kind is TypeKind.SIGNED)
        except OverflowError:
            raise ValueError(f"{value:g} does not fit {self.name}") from None

    def label(self, value: Number) -> str | None:
        """Name of an enumeration value; tables have negative values in two's complement."""
        mask = (1 << 8 * self.size) - 1
        return next((n for n, v in self.labels if isinstance(value, int) and (v ^ value) & mask == 0), None)


@dataclass(frozen=True)
class TargetVariable:
    """Variable as described by the target."""

    name: str  # members of structures are ``variable.member``, elements of arrays of structures ``variable[k]``
    address: int  # of its first byte
    size: int  # bytes
    type: ValueType  # type of one element; `TypeKind.RAW` for memory without a type that can be shown as numbers
    writable: bool  # whether the target permits writes
    order: ByteOrder = "little"  # byte order of the target
    members: tuple[str, ...] = field(default=())  # names of its member variables; empty for numbers and plain memory

    @property
    def count(self) -> int:
        """Elements; 1 for raw memory."""
        return 1 if self.type.kind is TypeKind.RAW else self.size // self.type.size

    def decode(self, data: bytes) -> Number | list[Number] | bytes:
        """Decode to a value, a list of values, or the bytes of raw memory."""
        if len(data) != self.size:
            raise CodecError(f"{self.name}: {len(data)} bytes read, {self.size} expected")
        if self.type.kind is TypeKind.RAW:
            return data
        step = self.type.size
        values = [self.type.decode(data[k : k + step], self.order) for k in range(0, step * self.count, step)]
        return values[0] if self.count == 1 else values

    def encode(self, values: Sequence[Number]) -> bytes:
        """Encode all elements.

        Raises
        ------
        ValueError
            If the number of elements is wrong or a value does not fit.
        """
        if self.type.kind is TypeKind.RAW:
            raise ValueError(f"{self.name}: memory without a type is read-only")
        if len(values) != self.count:
            raise ValueError(f"{self.name}: {len(values)} values given, {self.count} expected")
        return b"".join(self.type.encode(value, self.order) for value in values)


def _storage(bits: int, size: int) -> int:
    """Bytes of a fixed-point element: the smallest word that holds it and divides the size of the variable."""
    word = next((s for s in _SIZES if 8 * s >= bits), 0)
    if word and size % word == 0:
        return word
    return size if size in _SIZES else 0


def parse_type(text: bytes, size: int) -> ValueType | None:
    """Parse a base type of a type string.

    Parameters
    ----------
    text : bytes
        Type string without the terminating zero.
    size : int
        Bytes of the whole variable.

    Returns
    -------
    ValueType or None
        None if `text` is not a base type, or the size of the variable is not a multiple of its size.
    """
    if not text or text[0] < 0xE0 or text[0] in _SPECIAL:
        return None
    code = text[0]
    signed, form, width = bool(code & 0x10), code >> 2 & 3, 1 << (code & 3)
    kind, letter = (TypeKind.SIGNED, "i") if signed else (TypeKind.UNSIGNED, "u")
    if form == 0:
        result = ValueType(kind, width, f"{letter}{8 * width}")
    elif form == 1 and width == 1:
        match = _FIXED_POINT.match(text[1:])
        if match is None:
            return None
        whole, fraction = int(match[1]), int(match[2])
        width = _storage(whole + fraction + signed, size)
        if not width:
            return None
        result = ValueType(kind, width, f"{'' if signed else 'u'}q{whole}.{fraction}", fraction)
    elif form == 1:
        # Unsigned fractions of FreeMASTER have one integer bit: UQ1.15, but Q0.15.
        result = ValueType(kind, width, f"{'q0' if signed else 'uq1'}.{8 * width - 1}", 8 * width - 1)
    elif form == 2 and width >= 4 and signed:
        result = ValueType(TypeKind.FLOAT, width, "float" if width == 4 else "double")
    else:
        return None
    return result if size and size % result.size == 0 else None


def parse_entries(entries: Sequence[Entry], order: ByteOrder = "little") -> list[TargetVariable]:
    """Build the variables of all tables, in their order; structures are followed by their members.

    Unknown entries are skipped; a variable of unknown type is an unsigned number if it has the size of one, else raw
    memory. An array of structures is followed by its elements, ``name[k]``, unless there are more than `MAX_ELEMENTS`.
    """
    structs, enums = _user_types(entries)
    opener = _Opener(structs, enums, order)
    for entry in entries:
        if entry.kind is not EntryKind.NONE and not entry.special and entry.size > 0 and entry.name:
            opener.open(entry.name, entry.address, entry.size, entry.type_text, entry.kind is EntryKind.READ_WRITE)
    return opener.variables


@dataclass(frozen=True)
class _Structure:
    """Structure type: size in bytes, and members."""

    size: int
    members: list[Entry]


def _user_types(entries: Sequence[Entry]) -> tuple[dict[bytes, _Structure], dict[bytes, ValueType]]:
    """Collect structures with their members, and enumerations, by name; the first of several equal names is used."""
    structs: dict[bytes, _Structure] = {}
    enums: dict[bytes, tuple[int, list[tuple[str, int]]]] = {}
    members: list[Entry] | None = None
    labels: list[tuple[str, int]] | None = None
    for entry in entries:
        key = entry.name.encode("utf-8", "replace")
        if entry.special == "STRUCT":
            members, labels = [], None
            structs.setdefault(key, _Structure(entry.size, members))
        elif entry.special == "ENUM":
            members, labels = None, []
            enums.setdefault(key, (entry.size, labels))
        elif entry.special == "CONST":
            if labels is not None:
                labels.append((entry.name, entry.address))
        elif entry.kind is EntryKind.NONE and not entry.special:
            if members is not None:
                members.append(entry)
        else:
            members = labels = None
    types = {
        key: ValueType(TypeKind.UNSIGNED, size, key.decode("utf-8", "replace"), labels=tuple(names))
        for key, (size, names) in enums.items()
        if size in _SIZES
    }
    return structs, types


class _Opener:
    """Appends variables with their members."""

    def __init__(self, structs: dict[bytes, _Structure], enums: dict[bytes, ValueType], order: ByteOrder) -> None:
        self.variables: list[TargetVariable] = []
        self._structs = structs
        self._enums = enums
        self._order = order

    def open(
        self, name: str, address: int, size: int, type_text: bytes, writable: bool, inside: tuple[bytes, ...] = ()
    ) -> None:
        """Append a variable, then its members or elements; `inside` has the enclosing structures."""
        structure = self._structs.get(type_text) if type_text not in inside else None
        count = size // structure.size if structure is not None and structure.size else 1
        names: tuple[str, ...] = ()
        if structure is not None and count > 1:
            names = tuple(f"{name}[{k}]" for k in range(count if count <= MAX_ELEMENTS else 0))
        elif structure is not None:
            names = tuple(f"{name}.{member.name}" for member in structure.members)
        value_type = self._value_type(type_text, size, structured=structure is not None)
        self.variables.append(TargetVariable(name, address, size, value_type, writable, self._order, names))
        if structure is None or len(self.variables) > _MAX_VARIABLES:
            return
        if count > 1:
            for k, element in enumerate(names):
                self.open(element, address + k * structure.size, structure.size, type_text, writable, inside)
            return
        for member, full_name in zip(structure.members, names, strict=True):
            if member.size > 0 and member.address + member.size <= size:
                nested = (*inside, type_text)
                self.open(full_name, address + member.address, member.size, member.type_text, writable, nested)

    def _value_type(self, type_text: bytes, size: int, *, structured: bool) -> ValueType:
        found = parse_type(type_text, size) or self._enums.get(type_text)
        if found is not None and size % found.size == 0:
            return found
        label = type_text.decode("utf-8", "replace") if type_text[:1] < b"\xe0" else ""
        if size in _SIZES and not structured:
            return ValueType(TypeKind.UNSIGNED, size, label or f"u{8 * size}")
        return ValueType(TypeKind.RAW, size, label or "bytes")
