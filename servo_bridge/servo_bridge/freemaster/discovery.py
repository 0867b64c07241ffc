"""Discovery of all variables of a target from its tables.

Each string needs two requests: with TSA safety a target permits reading the characters of one string only. Strings used
by several entries are read once, strings known to the caller are not read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final

from servo_bridge.freemaster.client import BoardInfo, Client
from servo_bridge.freemaster.commands import TsaTable
from servo_bridge.freemaster.errors import DiscoveryError, Status, StatusError
from servo_bridge.freemaster.tsa import ByteOrder, Entry, TargetVariable, entry_of_version_2, parse_entries

TableRow = tuple[int, int, int, int]
"""Entry of a table: addresses of name and type, address of the variable, size and access bits."""

KnownTexts = Callable[[Sequence[TableRow]], Mapping[int, bytes]]
"""Returns the texts that need not be read, by address, from the rows of all tables."""

_OLD_VERSION: Final = 2
_MAX_TABLES: Final = 256
_MAX_TABLE_SIZE: Final = 1 << 20
_MAX_STRING: Final = 1024


def discover(client: Client, info: BoardInfo, known_texts: KnownTexts | None = None) -> list[TargetVariable]:
    """Read all tables of an identified target.

    Parameters
    ----------
    client : Client
        Client that has returned `info` from `identify`.
    info : BoardInfo
        Identification, with the byte order.
    known_texts : callable, optional
        Returns known texts.

    Raises
    ------
    DiscoveryError
        If there is no table.
    FreemasterError
        If the line fails.
    """
    order: ByteOrder = "big" if info.big_endian else "little"
    return parse_entries(read_entries(client, order, known_texts), order)


def read_entries(client: Client, order: ByteOrder, known_texts: KnownTexts | None = None) -> list[Entry]:
    """Read the entries of all tables with their texts; see `discover`."""
    rows: list[tuple[int, TableRow]] = []
    for table in _tables(client):
        rows += [(table.version, row) for row in _rows(client, table, order)]
    if not rows:
        raise DiscoveryError("the board has no table of variables; its firmware was built without one")
    strings = _Strings(client, known_texts([row for _, row in rows]) if known_texts is not None else {})
    entries: list[Entry] = []
    for version, (name, type_, address, info) in rows:
        if name:
            text = strings.read(name)
            label = f"0x{name:X}" if text is None else text.decode("utf-8", "replace")
            build = entry_of_version_2 if version <= _OLD_VERSION else Entry
            entries.append(build(label, strings.read(type_) or b"", address, info))
    return entries


def _tables(client: Client) -> list[TsaTable]:
    tables: list[TsaTable] = []
    for index in range(_MAX_TABLES):
        try:
            table = client.tsa_table(index)
        except StatusError as error:
            if error.code == Status.UNKNOWN_COMMAND:
                break
            raise
        # Only the address ends the list: a target with a dynamic table reports a stale size there.
        if table.address == 0:
            break
        tables.append(table)
    return tables


def _rows(client: Client, table: TsaTable, order: ByteOrder) -> list[TableRow]:
    """Read the four words of every entry of a table."""
    width = table.field_size
    count = table.size // (4 * width)
    if table.size > _MAX_TABLE_SIZE:
        raise DiscoveryError(f"the board reports a table of {table.size} bytes, which is not plausible")
    data = client.read_memory(table.address, count * 4 * width)
    words = [int.from_bytes(data[k : k + width], order) for k in range(0, len(data), width)]
    return list(zip(words[0::4], words[1::4], words[2::4], words[3::4], strict=True))


class _Strings:
    """Texts in target memory; unknown ones are read once."""

    def __init__(self, client: Client, known: Mapping[int, bytes]) -> None:
        self._client = client
        self._known: dict[int, bytes | None] = {0: None, **known}

    def read(self, address: int) -> bytes | None:
        """Read the text at `address`; None if there is none or the target refuses access."""
        if address not in self._known:
            try:
                length = min(self._client.string_length(address), _MAX_STRING)
                self._known[address] = self._client.read_memory(address, length) if length else b""
            except StatusError:
                self._known[address] = None
        return self._known[address]
