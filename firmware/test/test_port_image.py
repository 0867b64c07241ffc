"""Parts of the MC56F84789 port that run on silicon only: vector table, linker map, start-up, 16-bit C sources."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from firmware_compiler import CompileProgram
from port_board import PORT

# Vectors that the servo uses, by the numbers of the chip's vector table.
USED = {
    24: "isr_edge_2", 28: "isr_edge_1", 30: "isr_m2", 52: "isr_receive",
    63: "isr_break_2", 77: "isr_break_1", 85: "isr_m1", 87: "isr_start",
}  # fmt: skip


def table() -> list[tuple[str, str, int]]:
    """(instruction, target, number in the comment) of each vector."""
    text = (PORT / "vectors.c").read_text(encoding="ascii")
    found = re.findall(r"^ {4}(JMP|JSR) >(\w+) +/\* +(\d+) ", text, re.MULTILINE)
    return [(instruction, target, int(number)) for instruction, target, number in found]


def test_every_vector_jumps_to_its_handler() -> None:
    assert [number for _, _, number in table()] == list(range(111))
    assert [line[:2] for line in table()[:2]] == [("JMP", "startup_entry")] * 2
    for number, (instruction, target, _) in enumerate(table()[2:], start=2):
        assert (instruction, target) == ("JSR", USED.get(number, "isr_unexpected"))


def test_table_and_interrupt_controller_have_the_same_vectors() -> None:
    """Every handler in the table has a level, and every level a handler."""
    text = (PORT / "vectors.h").read_text(encoding="ascii")
    registers = (PORT / "registers.h").read_text(encoding="ascii")
    numbers = {name: int(value) for name, value in re.findall(r"#define (VECTOR_\w+) (\d+)U", registers)}
    handlers = re.findall(r"V\((VECTOR_\w+), LEVEL_\w+, port_(\w+)\)", text)
    assert {numbers[vector]: f"isr_{handler}" for vector, handler in handlers} == USED


def regions() -> dict[str, tuple[str, int, int]]:
    """Name: (access, origin, length) of the linker map's memory."""
    text = (PORT / "mc56f84789.cmd").read_text(encoding="ascii")
    found = re.findall(r"^ +\.(\w+) +\((\w+)\) +: ORIGIN = (\w+), LENGTH = (\w+)", text, re.MULTILINE)
    return {name: (access, int(origin, 16), int(length, 16)) for name, access, origin, length in found}


def test_memory_regions_have_no_gaps_and_no_overlaps() -> None:
    """256 KB of program flash and 32 KB of RAM, in words, without gaps and overlaps."""
    flash = sorted((origin, length) for name, (_, origin, length) in regions().items() if name.startswith("p_"))
    end = 0
    for origin, length in flash:
        assert origin == end
        end = origin + length
    assert end == 0x20000
    assert regions()["x_ram"] == ("RW", 0, 0x4000)
    assert regions()["x_image"] == ("RX", 0, 0x4000)
    assert regions()["x_flex_nvm"] == ("R", 0x8000, 0x3800)
    assert regions()["x_kept"] == ("RW", 0xB800, 0x0800)
    assert regions()["ram_code"] == ("RX", 0x60000, 0x4000)
    assert regions()["p_vectors"][2] == 2 * len(table())
    assert regions()["p_flash_config"][1:] == (0x200, 8)


def test_flash_configuration_leaves_the_chip_unsecured() -> None:
    """Security byte 7E in the low half of word 206h; every protection byte FF."""
    text = (PORT / "mc56f84789.cmd").read_text(encoding="ascii")
    words = [int(value, 16) for value in re.findall(r"WRITEH\((\w+)\);", text.split("> .p_flash_config")[0])]
    assert words == [0xFFFF] * 6 + [0x3F7E, 0xFFFF]


def test_every_section_has_its_place() -> None:
    text = (PORT / "mc56f84789.cmd").read_text(encoding="ascii")
    assert set(re.findall(r"> \.(\w+)", text)) <= set(regions())
    symbols = set(re.findall(r"^ +F(_\w+) +=", text, re.MULTILINE))
    startup = (PORT / "startup.c").read_text(encoding="ascii")
    assert set(re.findall(r"#>>(_\w+)", startup)) == symbols


@pytest.mark.parametrize("source", sorted(path.name for path in PORT.glob("*.c")))
def test_sources_compile_where_int_has_16_bits(compile_program: CompileProgram, tmp_path: Path, source: str) -> None:
    """Compiled as for silicon: registers at their addresses, no chip in the state of the board."""
    options = ["-mmcu=atmega1284p", "-Os", "-c"]
    compile_program(f"{source}.o", [f"port/mc56f84789/{source}"], options, compiler="avr-gcc")


def test_no_register_is_written_with_a_bare_number() -> None:
    """Values are defined in settings.h; a driver uses names, 0 and counts only."""
    for path in PORT.glob("*.c"):
        text = re.sub(r"/\*.*?\*/", "", path.read_text(encoding="ascii"), flags=re.DOTALL)
        text = text.split("#ifdef __MWERKS__\nextern")[0]
        assert not re.findall(r"\b0x\w+", text.replace("INT32_C(0x4000)", "").replace("INT32_C(0x8000)", "")), path
