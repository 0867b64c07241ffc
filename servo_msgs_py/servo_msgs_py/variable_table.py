"""Table of variables in the firmware that its clients can read (TSA): its rows and the pool of their texts.

The code generator writes both to C. If the firmware has the same catalogue as the client, the client derives the texts
of the rows from their addresses in the pool instead of reading them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

from servo_msgs_py.catalogue import Catalogue, Variable

_ENUM, _CONST, _STRUCT = b"\xed:ENUM", b"\xed:CONST", b"\xed:STRUCT"
_SNAPSHOT: Final = "snapshot_t"


@dataclass(frozen=True)
class Row:
    """One row of the table."""

    name: bytes  # text of the name
    type: bytes  # text of the type
    owner: str = ""  # structure that contains this member; empty for other rows
    value: int | None = None  # value of a constant
    variable: Variable | None = None  # the variable; None for rows that describe types

    @property
    def is_structure(self) -> bool:
        """Whether the row begins a structure."""
        return self.type == _STRUCT


@dataclass
class TextPool:
    """Unique zero-terminated texts in sequence."""

    offsets: dict[bytes, int] = field(default_factory=dict)  # offset of each text in the pool [bytes]
    size: int = 0  # bytes of all texts

    def offset(self, text: bytes) -> int:
        """Offset of a text, which is appended if it is new."""
        if text not in self.offsets:
            self.offsets[text] = self.size
            self.size += len(text) + 1
        return self.offsets[text]


def block_type(variable: Variable) -> str:
    """C type of a block, derived from its name."""
    return variable.name.rsplit(".", 1)[-1] + "_t"


def type_text(variable: Variable) -> bytes:
    """Type text of a variable."""
    if variable.enum is not None:
        return variable.enum.encode()
    return block_type(variable).encode() if variable.type == "block" else bytes((variable.format.tsa,))


def table_rows(catalogue: Catalogue) -> Iterator[Row]:
    """Enumerations with their constants, structures with their members, then every variable."""
    for enum, entries in catalogue.enums.items():
        yield Row(enum.encode(), _ENUM)
        for key, value in entries.items():
            yield Row(key.encode(), _CONST, value=value)
    for struct, members in _structures(catalogue).items():
        yield Row(struct.encode(), _STRUCT)
        yield from members
    for variable in catalogue.variables.values():
        yield Row(variable.name.encode(), type_text(variable), variable=variable)


def _structures(catalogue: Catalogue) -> dict[str, list[Row]]:
    """C types of the blocks and of the structures in them, with their members except unused ones.

    For the snapshot they are derived from the paths of its variables: ``snapshot.tick``, ``snapshot.axis[0].speed``.
    """
    blocks = {block_type(v) for v in catalogue.variables.values() if v.type == "block"}
    found: dict[str, list[Row]] = {name: [] for name in (_SNAPSHOT, f"axis_{_SNAPSHOT}") if _SNAPSHOT in blocks}
    for variable in catalogue.snapshot_variables():
        parts = [part.split("[")[0] for part in variable.path.split(".")[1:]]
        owner = _SNAPSHOT
        for part in parts[:-1]:
            inner = f"{part}_{owner}"
            found[owner].append(Row(part.encode(), inner.encode(), owner))
            owner = inner
        found[owner].append(Row(parts[-1].encode(), type_text(variable), owner))
    for name, members in catalogue.structs.items():
        found[name] = [Row(v.name.encode(), type_text(v), name) for v in members if v.name != "unused"]
    return {name: list(dict.fromkeys(members)) for name, members in found.items()}


def texts_by_address(catalogue: Catalogue, addresses: Sequence[tuple[int, int]]) -> dict[int, bytes]:
    """Texts of a table with the same layout as the one of the catalogue.

    Parameters
    ----------
    addresses : sequence of (int, int)
        Addresses of name and type of each row.

    Returns
    -------
    dict
        Text by address; empty if the layout differs. Different texts of equal lengths are not detected, so the hash of
        the catalogue has to be compared too.
    """
    pool = TextPool()
    offsets = [(pool.offset(row.name), pool.offset(row.type)) for row in table_rows(catalogue)]
    base = addresses[0][0] if addresses else 0
    if [(name - base, kind - base) for name, kind in addresses] != offsets:
        return {}
    return {base + offset: text for text, offset in pool.offsets.items()}
