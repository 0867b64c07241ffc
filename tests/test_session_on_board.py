"""Which texts of the board's table of variables a client reads."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import pytest
from line_world import World
from servo_bridge.freemaster.client import Client
from servo_bridge.freemaster.line import Line
from servo_bridge.freemaster.tsa import TargetVariable
from servo_bridge.wire.session import Session, connect
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.variable_table import table_rows, texts_by_address

CATALOGUE: Final = Catalogue.load()
ROWS: Final = list(table_rows(CATALOGUE))
TABLES_BASE: Final = 0x0020_0000  # firmware/comm/tsa.h


class CountingClient(Client):
    """Counts the texts that it reads, and may receive damaged memory.

    Attributes
    ----------
    texts : int
        Texts whose length it has asked for.
    inverted : int
        Address at which the lowest bit of a memory byte arrives inverted.
    """

    texts = 0
    inverted = -1

    def string_length(self, address: int) -> int:
        self.texts += 1
        return super().string_length(address)

    def read_memory(self, address: int, size: int) -> bytes:
        data = bytearray(super().read_memory(address, size))
        if address <= self.inverted < address + size:
            data[self.inverted - address] ^= 1
        return bytes(data)


@pytest.fixture
def world() -> Iterator[World]:
    world = World("ideal", 1_000_000)
    yield world
    world.close()


@pytest.fixture
def client(world: World) -> CountingClient:
    return CountingClient(Line(world.line, baud=1_000_000, clock=world.line.clock))


def targets(session: Session) -> dict[str, TargetVariable]:
    return {name: variable.target for name, variable in session.variables.items()}


def test_a_board_of_the_same_catalogue_need_not_name_its_variables(client: CountingClient) -> None:
    session = connect(client, CATALOGUE)
    assert client.texts == 0
    assert session.mismatch is None
    client.inverted = TABLES_BASE + 16 * (len(ROWS) - 1)  # the name of the last row seems to be elsewhere
    named = targets(connect(client, CATALOGUE))
    assert client.texts > len(CATALOGUE.variables)
    last = ROWS[-1].name.decode()
    assert {**named, last: targets(session)[last]}.items() >= targets(session).items()


def test_a_board_of_another_catalogue_names_its_variables(client: CountingClient, world: World) -> None:
    client.inverted = world.board.address("catalogue_hash")
    session = connect(client, CATALOGUE)
    assert client.texts > len(CATALOGUE.variables)
    assert session.mismatch is not None
    assert "has another table of variables" in session.mismatch.reason
    assert set(session.variables) >= set(CATALOGUE.variables)


def test_texts_are_known_by_the_places_of_all_rows() -> None:
    places: list[tuple[int, int]] = []
    address: dict[bytes, int] = {}
    for row in ROWS:
        for text in (row.name, row.type):
            address.setdefault(text, 0x1000 + sum(len(known) + 1 for known in address))
        places.append((address[row.name], address[row.type]))
    assert texts_by_address(CATALOGUE, places) == {at: text for text, at in address.items()}
    assert texts_by_address(CATALOGUE, places[:-1]) == {}
    assert texts_by_address(CATALOGUE, [*places[:-1], (places[-1][0] + 1, places[-1][1])]) == {}
    assert texts_by_address(CATALOGUE, []) == {}
