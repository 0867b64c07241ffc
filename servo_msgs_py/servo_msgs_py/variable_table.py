"""The table of variables that the firmware shows its clients (TSA): its rows and the pool of their texts.

The code generator writes both to C. A client that meets a firmware of the same catalogue knows the texts of the rows by
their places in the pool and need not read them.
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

    name: bytes  # text of its name
    type: bytes  # text of its type
    owner: str = ""  # structure of which it is a member; empty for all others
    value: int | None = None  # number of a constant
    variable: Variable | None = None  # the variable; None for the parts of types

    @property
    def is_structure(self) -> bool:
        """Whether it begins a structure."""
        return self.type == _STRUCT


@dataclass
class TextPool:
    """Zero-terminated texts one after the other, each only once."""

    offsets: dict[bytes, int] = field(default_factory=dict)  # place of each text from the beginning of the pool [bytes]
    size: int = 0  # bytes of all texts

    def offset(self, text: bytes) -> int:
        """Place of a text, which is appended if it is new."""
        if text not in self.offsets:
            self.offsets[text] = self.size
            self.size += len(text) + 1
        return self.offsets[text]


def block_type(variable: Variable) -> str:
    """C type of a block: that of its name."""
    return variable.name.rsplit(".", 1)[-1] + "_t"


def type_text(variable: Variable) -> bytes:
    """Type text of a variable."""
    if variable.enum is not None:
        return variable.enum.encode()
    return block_type(variable).encode() if variable.type == "block" else bytes((variable.raw_type.tsa,))


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
    """C types of the blocks and of what is inside them, with their members; what is unused stays unnamed.

    Those of the snapshot are the paths of its variables: ``snapshot.tick``, ``snapshot.axis[0].speed``.
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


def texts_of(catalogue: Catalogue, places: Sequence[tuple[int, int]]) -> dict[int, bytes]:
    """Texts of a table whose rows lie where those of the catalogue do.

    Parameters
    ----------
    places : sequence of (int, int)
        Addresses of name and type of each row.

    Returns
    -------
    dict
        Text by address; empty if the rows are others. Texts of the same lengths in the same order would pass, hence the
        hash of the catalogue has to be compared too.
    """
    pool = TextPool()
    offsets = [(pool.offset(row.name), pool.offset(row.type)) for row in table_rows(catalogue)]
    base = places[0][0] if places else 0
    if [(name - base, kind - base) for name, kind in places] != offsets:
        return {}
    return {base + offset: text for text, offset in pool.offsets.items()}
