"""The flash controller: commands on the data flash, their duration and result, and refused accesses."""

from __future__ import annotations

import pytest
from chip_rig import ChipError, ChipRig
from native_library import Native

DATA = 0x8000
CCIF, RDCOLERR, ACCERR, MGSTAT0 = 0x80, 0x40, 0x20, 0x01
PROGRAM_CLOCKS, ERASE_CLOCKS = 6_500, 1_400_000


@pytest.fixture
def rig(registers_c: Native) -> ChipRig:
    return ChipRig(registers_c)


def launch(rig: ChipRig, command: int, byte: int, value: int = 0) -> None:
    """A command with the address of a byte of the data flash."""
    rig.write("FTFL_FCCOB3", byte & 0xFFFF)
    rig.write("FTFL_FCCOB1", command << 8 | 0x80 | byte >> 16)
    rig.write("FTFL_FCCOB7", value & 0xFFFF)
    rig.write("FTFL_FCCOB5", value >> 16)
    rig.write("FTFL_FSTAT", CCIF)


def status(rig: ChipRig) -> int:
    return rig.read("FTFL_FSTAT") & 0xFF


def word(rig: ChipRig, word: int) -> int:
    return rig.read_at(DATA + 2 * word) | rig.read_at(DATA + 2 * word + 1) << 16


def test_an_erased_flash_is_ones(rig: ChipRig) -> None:
    assert {rig.read_at(address) for address in (DATA, DATA + 1, 0xB800, 0xBFFF)} == {0xFFFF}
    assert status(rig) == CCIF


def test_a_word_is_programmed_after_its_time(rig: ChipRig) -> None:
    launch(rig, 0x06, 4 * 7000, 0x1234_5678)
    rig.step(PROGRAM_CLOCKS - 100)
    assert status(rig) == 0
    rig.step(100)
    assert status(rig) == CCIF
    assert word(rig, 7000) == 0x1234_5678
    assert word(rig, 7001) == word(rig, 6999) == 0xFFFF_FFFF


def test_programming_only_clears_bits(rig: ChipRig) -> None:
    for value, result in ((0xFFFF_00FF, CCIF), (0x00FF_FFFF, CCIF | MGSTAT0)):
        launch(rig, 0x06, 0, value)
        rig.step(PROGRAM_CLOCKS)
        assert status(rig) == result
    assert word(rig, 0) == 0x00FF_00FF


def test_an_erase_makes_ones_of_one_sector(rig: ChipRig) -> None:
    for at in (255, 256, 511, 512):
        launch(rig, 0x06, 4 * at, 0)
        rig.step(PROGRAM_CLOCKS)
    launch(rig, 0x09, 1024)
    rig.step(ERASE_CLOCKS - 100)
    assert status(rig) == 0
    rig.step(100)
    assert status(rig) == CCIF
    assert [word(rig, at) for at in (255, 256, 511, 512)] == [0, 0xFFFF_FFFF, 0xFFFF_FFFF, 0]


def test_a_read_meanwhile_is_a_collision(rig: ChipRig) -> None:
    launch(rig, 0x09, 0)
    rig.read_at(DATA + 5000)
    assert status(rig) == RDCOLERR
    rig.step(ERASE_CLOCKS)
    assert status(rig) == CCIF | RDCOLERR
    rig.write("FTFL_FSTAT", RDCOLERR)
    assert status(rig) == CCIF


def test_invalid_address_is_an_access_error(rig: ChipRig) -> None:
    for byte in (2, 0x8000):
        launch(rig, 0x06, byte, 0)
        assert status(rig) == CCIF | ACCERR
        launch(rig, 0x06, 0, 0)
        assert word(rig, 0) == 0xFFFF_FFFF, "a pending error blocks the next command"
        rig.write("FTFL_FSTAT", ACCERR)
    launch(rig, 0x06, 0, 0)
    assert status(rig) == 0


def test_commands_during_a_command_are_ignored(rig: ChipRig) -> None:
    launch(rig, 0x06, 0, 0x0000_0001)
    launch(rig, 0x06, 4, 0x0000_0002)
    rig.step(2 * PROGRAM_CLOCKS)
    assert [word(rig, at) for at in (0, 1)] == [1, 0xFFFF_FFFF]


@pytest.mark.parametrize(
    ("register", "value", "text"),
    [
        ("FTFL_FSTAT", 0x8080, "interrupts and suspended erases are not modelled"),
        ("FTFL_FSEC", 0, "protection is not modelled"),
    ],
)
def test_unmodelled_functions_stop_the_chip(rig: ChipRig, register: str, value: int, text: str) -> None:
    with pytest.raises(ChipError, match=text):
        rig.write(register, value)


def test_other_commands_and_the_program_flash_stop_the_chip(registers_c: Native) -> None:
    rig = ChipRig(registers_c)
    with pytest.raises(ChipError, match="command 44h is not modelled"):
        launch(rig, 0x44, 0)
    rig = ChipRig(registers_c)
    rig.write("FTFL_FCCOB1", 0x0900)
    with pytest.raises(ChipError, match="09h on the program flash"):
        rig.write("FTFL_FSTAT", CCIF)
    rig = ChipRig(registers_c)
    with pytest.raises(ChipError):
        rig.write_at(DATA, 0)
