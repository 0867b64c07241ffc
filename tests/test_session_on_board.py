"""Texts of the table of variables that a client reads from the board."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import pytest
from line_simulation import LineSimulation
from servo_bridge.freemaster.client import Client
from servo_bridge.freemaster.line import Line
from servo_bridge.freemaster.tsa import TargetVariable
from servo_bridge.wire.session import Session, connect
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.variable_table import table_rows

CATALOGUE: Final = Catalogue.load()
ROWS: Final = list(table_rows(CATALOGUE))
TABLES_BASE: Final = 0x0020_0000  # firmware/comm/tsa.h


class CountingClient(Client):
    """Client that counts the texts that it reads, and can receive one inverted bit."""

    texts = 0  # number of texts whose length was requested
    addresses: tuple[int, ...] = ()  # addresses of the reads
    inverted = -1  # address of the byte that is received with its lowest bit inverted

    def string_length(self, address: int) -> int:
        self.texts += 1
        return super().string_length(address)

    def read_memory(self, address: int, size: int) -> bytes:
        self.addresses += (address,)
        data = bytearray(super().read_memory(address, size))
        if address <= self.inverted < address + size:
            data[self.inverted - address] ^= 1
        return bytes(data)


@pytest.fixture
def sim() -> Iterator[LineSimulation]:
    sim = LineSimulation("ideal", 1_000_000)
    yield sim
    sim.close()


@pytest.fixture
def client(sim: LineSimulation) -> CountingClient:
    return CountingClient(Line(sim.line, baud=1_000_000, clock=sim.line.clock))


def targets(session: Session) -> dict[str, TargetVariable]:
    return {name: variable.target for name, variable in session.variables.items()}


def test_names_are_not_read_from_a_board_with_the_same_catalogue(client: CountingClient, sim: LineSimulation) -> None:
    session = connect(client, CATALOGUE)
    assert client.texts == 0
    assert client.addresses.count(sim.board.address("catalogue_hash")) == 1
    assert session.mismatch is None
    client.inverted = TABLES_BASE + 16 * (len(ROWS) - 1)  # the address of the name of the last row is wrong
    named = targets(connect(client, CATALOGUE))
    assert client.texts > len(CATALOGUE.variables)
    last = ROWS[-1].name.decode()
    assert {**named, last: targets(session)[last]}.items() >= targets(session).items()


def test_names_are_read_from_a_board_with_another_catalogue(client: CountingClient, sim: LineSimulation) -> None:
    client.inverted = sim.board.address("catalogue_hash")
    session = connect(client, CATALOGUE)
    assert client.texts > len(CATALOGUE.variables)
    assert session.mismatch is not None
    assert "has another table of variables" in session.mismatch.reason
    assert set(session.variables) >= set(CATALOGUE.variables)
