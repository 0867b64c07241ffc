"""The image of the board odrive36: what lies where, and what the interrupts call."""

from __future__ import annotations

import os
import re
import shutil
import struct
import subprocess
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import pytest
from firmware_compiler import FIRMWARE
from servo_msgs_py.board_description import BoardDescription
from servo_msgs_py.catalogue import Catalogue
from servo_tuning.errors import ConfigError
from servo_tuning.reading import load
from stm32_board import BOARD, PORT, generated

TOOLS = "arm-none-eabi-"
USED = {6: "enable_1", 7: "enable_2", 8: "gate_fault", 18: "m1", 23: "stamp", 40: "edge", 58: "m2"}
"""Handlers by the numbers of the interrupts (RM0090, table 62)."""
PRIORITY = {6: 0, 7: 0, 8: 0, 23: 1, 18: 2, 58: 2, 40: 3}


class Section(NamedTuple):
    """A section with its address at run time and in the flash."""

    address: int
    loaded: int
    data: bytes


class Image:
    """Sections and symbols of the ELF file."""

    def __init__(self, elf: Path) -> None:
        self.elf = elf
        table = re.findall(r"(\w+) (\w) (\w+)$", self.run("nm"), re.MULTILINE)
        self.symbols = {name: int(address, 16) for address, _, name in table}
        self.code = {name for _, kind, name in table if kind in "tT"}

    def run(self, tool: str, *options: str) -> str:
        command = [f"{TOOLS}{tool}", *options, str(self.elf)]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout

    def section(self, name: str) -> Section:
        found = re.search(rf"^ +\d+ \{name} +(\w+)  (\w+)  (\w+)  (\w+)", self.run("objdump", "-h"), re.MULTILINE)
        assert found is not None
        size, address, loaded, offset = (int(text, 16) for text in found.groups())
        return Section(address, loaded, self.elf.read_bytes()[offset : offset + size])


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Image:
    if shutil.which(f"{TOOLS}gcc") is None:
        pytest.skip(f"{TOOLS}gcc is not installed")
    folder = tmp_path_factory.mktemp("image")
    files = generated(folder / "generated")
    shutil.copy(FIRMWARE / "config" / "servo_config_gen.c", files / "config")  # any configuration
    options = [f"BOARD={BOARD}", f"GENERATED={files}", f"BUILD={folder}", "OPT=-Os"]
    command = ["make", "--silent", "-j2", "-C", str(FIRMWARE / "port"), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return Image(folder / "servo.elf")


def test_the_vector_table_calls_the_handlers(image: Image) -> None:
    text = image.section(".text")
    assert text.address % 512 == 0
    table = struct.unpack("<98I", text.data[: 4 * 98])
    assert table[0] == image.symbols["image_stack"] == 0x1001_0000
    unexpected = image.symbols["unexpected"] | 1
    assert table[1] == image.symbols["image_reset"] | 1
    assert set(table[2:16]) == {unexpected}
    for number, entry in enumerate(table[16:]):
        handler = image.symbols[f"isr_port_{USED[number]}"] | 1 if number in USED else 0
        assert entry == handler, number


def test_priorities_follow_the_order_of_safety() -> None:
    """Breaks first, then the time of an edge, then the loops, which share one, then what is done with the edge."""
    text = (PORT / "vectors.h").read_text(encoding="ascii")
    quantities = dict(re.findall(r"#define (PRIORITY_\w+) (\d)U", (PORT / "settings.h").read_text(encoding="ascii")))
    numbers = dict(re.findall(r"#define (IRQ_\w+) (\d+)U", (PORT / "registers.h").read_text(encoding="ascii")))
    rows = re.findall(r"V\((\w+), (\w+), port_(\w+)\)", text)
    assert {int(numbers[irq]): handler for irq, _, handler in rows} == USED
    assert {int(numbers[irq]): int(quantities[priority]) for irq, priority, _ in rows} == PRIORITY


def test_out_of_reset_the_core_finds_stack_and_reset(image: Image) -> None:
    start = image.section(".start")
    assert start.address == start.loaded == 0x0800_0000
    assert struct.unpack("<2I", start.data[:8]) == (0x1001_0000, image.symbols["image_reset"] | 1)
    assert len(start.data) <= 0x4000


def test_storage_and_settings_of_the_vendor_are_left_alone(image: Image) -> None:
    for name in (".text", ".data"):
        section = image.section(name)
        assert section.loaded >= 0x0801_0000
        assert section.loaded + len(section.data) <= 0x080C_0000  # sector 10


def sectors(address: int, size: int) -> set[int]:
    """Sectors of the flash with a range (RM0090, table 5)."""
    begins = [*range(0, 0x1_0000, 0x4000), 0x1_0000, *range(0x2_0000, 0x10_0000, 0x2_0000)]
    first, last = address - 0x0800_0000, address - 0x0800_0000 + size - 1
    return {n for n, (a, b) in enumerate(pairwise([*begins, 0x10_0000])) if a <= last and first < b}


@pytest.mark.parametrize("tool", ["openocd", "st-flash", "dfu-util"])
def test_make_flash_writes_the_image_and_leaves_the_stored_parameters(image: Image, tool: str) -> None:
    """Each file is written with an erase of every sector from its beginning to its end."""
    command = ["make", "--no-print-directory", "--dry-run", "-C", str(FIRMWARE.parent), "flash", f"FLASH_TOOL={tool}"]
    outside = {name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS")}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=outside)
    assert done.returncode == 0, done.stderr
    plan = done.stdout.splitlines()[-1]
    assert plan.startswith(tool)
    files = re.findall(r"/build/(\S+) (?:-s )?(0x\w+)", plan)
    assert len(files) == plan.count("/build/")
    flash = bytearray(b"\xff" * 0x10_0000)
    erased: set[int] = set()
    for name, address in files:
        data = (image.elf.parent / name).read_bytes()
        erased |= sectors(int(address, 16), len(data))
        at = int(address, 16) - 0x0800_0000
        flash[at : at + len(data)] = data
    stored = BoardDescription.load(BOARD).flash_sectors
    assert erased.isdisjoint(range(1, 1 + stored))
    for name in (".start", ".text", ".data"):
        section = image.section(name)
        at = section.loaded - 0x0800_0000
        assert flash[at : at + len(section.data)] == section.data


def test_behind_the_start_nothing_is_fetched_from_the_flash(image: Image) -> None:
    in_flash = {name for name in image.code if image.symbols[name] >> 24 == 0x08}
    assert in_flash == {"image_reset", "boot_exception", "boot", "__main_veneer"}
    assert all(image.symbols[name] >> 24 == 0x20 for name in image.code - in_flash)
    listing = image.run("objdump", "-d", "-j", ".text")
    assert len(listing) > 100_000
    assert not re.search(r"\tbl?\w*(?:\.[nw])?\t8\w{6} ", listing)


def test_memory_of_dma_is_in_the_sram_that_dma_reaches(image: Image) -> None:
    assert image.symbols["dma"] >> 16 == 0x2001
    assert image.symbols["servo"] >> 16 == 0x1000  # the rest is not


def test_the_firmware_names_its_board(image: Image) -> None:
    assert b"servo/odrive36\0" in image.section(".text").data


def test_the_configuration_of_the_board_is_accepted_for_it_only() -> None:
    path = FIRMWARE / "config" / f"{BOARD}.toml"
    catalogue = Catalogue.load(board=BoardDescription.load(BOARD))
    configuration = load(path, catalogue)
    assert configuration.board("voltage_use") <= configuration.board.description.voltage_use_max
    assert configuration.axes[0]("motor.r_s") == 0.55  # of servo.toml
    with pytest.raises(ConfigError, match="the file is for another board"):
        load(path, Catalogue.load())


def test_a_duty_that_leaves_no_time_for_sampling_is_refused(tmp_path: Path) -> None:
    own = FIRMWARE / "config" / f"{BOARD}.toml"
    file = tmp_path / "own.toml"
    file.write_text(f'base = "{own}"\n[board]\nvoltage_use = 0.94\n', encoding="utf-8")
    with pytest.raises(
        ConfigError, match=r"board\.voltage_use = 0\.94: the board odrive36 samples currents with 0\.872"
    ):
        load(file, Catalogue.load(board=BoardDescription.load(BOARD)))
