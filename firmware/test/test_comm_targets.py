"""The same answers with a 16-bit int, and the size on a small target."""

from __future__ import annotations

import random
import re
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from firmware_compiler import FIRMWARE, CompileProgram, has_library
from freemaster_model import COMM_SOURCES, ENTRIES, SERVO, Layout, c_bytes, request, sleb, uleb
from freemaster_recorder import SIGNED, START, STOP, VARIABLE, memory, variable

AVR = ["-mmcu=atmega1284p", "-Os"]
CORTEX_M3 = ["-mcpu=cortex-m3", "-mthumb", "-Os", "-ffreestanding", "-nostdlib", "-r"]
CODE_SIZE_MAX = 8192  # bytes of code and constants on a Cortex-M3
RUN_TIME = 120.0  # limit of a simulator [s]
LINE = 700


def script() -> list[bytes]:
    """Requests that visit every command with small, large and wrong operands."""
    source = random.Random(20)
    base = SERVO.variables
    frames = [request(0x20, uleb(index)) for index in range(1, 13)] + [request(0x20, sleb(-1))]
    frames += [request(0x29, uleb(index)) for index in (0, 1, 0x8000)]
    frames += [request(0x21, uleb(SERVO.table + 96 * i) + uleb(96)) for i in range(4)]
    frames += [request(0x2A, uleb(SERVO.strings + offset)) for offset in (0, 5, 200, len(SERVO.blob))]
    for size in (0, 1, 20, 200, 252, 253, 300, 301, 2**16, 2**31, 2**32 - 1):
        frames.append(request(0x21, uleb(base + 0x100) + uleb(size)))
        frames.append(request(0x22, sleb(0x100) + uleb(size)))
    for offset in (-1, -(2**31), 2**31 - 1, 0x8000, 0xFFFF, 0x22E):
        frames.append(request(0x22, sleb(offset) + b"\x02"))
    for entry in ENTRIES:
        data = source.randbytes(min(entry.size, 100))
        mask = source.randbytes(len(data))
        head = uleb(SERVO.address(entry)) + uleb(len(data))
        frames.append(request(0x23, b"\x00" + head + data))
        frames.append(request(0x23, b"\x01" + head + data + mask))
        frames.append(request(0x21, head))
    frames.append(request(0x26, b"\x00\x01\x01\x18"))
    for slot in range(25):
        operand = bytes([slot]) + uleb(base + 0x100 + 8 * slot) + b"\x08"
        frames.append(request(0x26, bytes([0, 2, len(operand)]) + operand))
    frames.append(request(0x27, b"\x00"))
    frames += [request(0x31), request(0x30, b"\x11" + bytes(range(0x20, 0x40))), request(0x32, b"\x01\x00")]
    frames += [request(0x31), request(0x32, b"\x20\x00"), request(0x32, b"\x02" + uleb(2**32 - 1))]
    frames += recordings()
    frames += [request(0x28, bytes([port, 3, 0x2B])) for port in (1, 1, 0x81, 2)]
    frames += [request(0x2F, bytes([flags, 1 - flags, what])) for flags in (0, 1) for what in (0x81, 0x82)]
    frames += [request(0x2C, bytes([level])) for level in range(4)] + [request(0x2D, b"\x03" + bytes(20))]
    frames += [source.randbytes(40) for _ in range(20)]
    return frames


def recordings() -> list[bytes]:
    """Recordings of everything, with every trigger and with samples of every alignment."""
    frames = [request(0x25, bytes([which, what])) for which in range(3) for what in range(0x80, 0x86)]
    recordable = [entry for entry in ENTRIES if not entry.absolute and entry.size in (1, 2, 4, 8)]
    for which, slots in ((0, recordable[:8]), (1, recordable[3:6]), (0, recordable[-8:])):
        for mode in (0, 0x11, 0x22, 0x51, 0x62, 0x92, 0x33):
            frames.append(request(0x24, bytes([which]) + memory(len(slots), 6, 2, 1)))
            for k, entry in enumerate(slots):
                address = SERVO.address(entry)
                threshold = uleb(address) if mode & VARIABLE else sleb(-100) if mode & 3 == SIGNED else uleb(5)
                frames.append(request(0x24, bytes([which]) + variable(k, address, entry.size, mode, threshold)))
            frames += [request(0x24, bytes([which]) + START), request(0x25, bytes([which, 0x83])), request(0x31)]
            frames += [request(0x24, bytes([which]) + STOP), request(0x25, bytes([which, 0x83]))]
            frames.append(request(0x21, uleb(SERVO.samples) + uleb(96)))
    return frames


@pytest.fixture(scope="module")
def build_script(
    compile_program: CompileProgram,
    freemaster_sources: Callable[[Layout], list[str | Path]],
    tmp_path_factory: pytest.TempPathFactory,
) -> Callable[[str, str, Sequence[str]], Path]:
    """Build the script runner: name, compiler, options."""
    frames = script()
    assert max(map(len, frames)) < 256
    text = c_bytes(b"".join(bytes([len(frame)]) + frame for frame in frames) + b"\0")
    source = tmp_path_factory.mktemp("script") / "script.c"
    source.write_text(f"#include <stdint.h>\nconst uint8_t fixture_script[] = {{{text}}};\n", encoding="ascii")

    def build(name: str, compiler: str, options: Sequence[str]) -> Path:
        sources = [*freemaster_sources(SERVO), "test/freemaster_script.c", source]
        return compile_program(name, sources, options, [*SERVO.defines, f"HARNESS_LINE={LINE}"], compiler)

    return build


def answers(output: str) -> list[str]:
    """Answers between the marks; a simulator decorates what the target prints."""
    plain = re.sub(r"\x1b\[[0-9;]*m", "", output)
    found = re.search(r"begin(.*)end", plain, re.DOTALL)
    assert found, output[-500:]
    return re.sub(r"[^0-9A-F;]", "", found[1]).split(";")


def test_compiles_with_16_bit_int(build_script: Callable[[str, str, Sequence[str]], Path]) -> None:
    if not has_library("avr-gcc", "libc.a"):
        pytest.skip("avr-gcc with avr-libc is not installed")
    assert build_script("script_avr_compile.elf", "avr-gcc", AVR).exists()


def test_same_answers_with_16_bit_int(build_script: Callable[[str, str, Sequence[str]], Path]) -> None:
    if shutil.which("simavr") is None or not has_library("avr-gcc", "libc.a"):
        pytest.skip("simavr or avr-gcc with avr-libc is not installed")
    program = build_script("script_host", "gcc", ["-O1"])
    host = subprocess.run([str(program)], capture_output=True, text=True, check=True)
    elf = build_script("script_avr.elf", "avr-gcc", AVR)
    target = subprocess.run(
        ["simavr", "-m", "atmega1284p", "-f", "16000000", str(elf)],
        capture_output=True,
        text=True,
        errors="replace",
        timeout=RUN_TIME,
        check=False,
    )
    expected = answers(host.stdout)
    assert sum(map(bool, expected)) > 150
    assert answers(target.stdout + target.stderr) == expected


def test_size_on_cortex_m3(compile_program: CompileProgram) -> None:
    if not has_library("arm-none-eabi-gcc", "libc.a") or shutil.which("arm-none-eabi-size") is None:
        pytest.skip("arm-none-eabi-gcc with newlib is not installed")
    image = compile_program("comm_cortex_m3.o", COMM_SOURCES, CORTEX_M3, (), "arm-none-eabi-gcc")
    listing = subprocess.run(["arm-none-eabi-size", str(image)], capture_output=True, text=True, check=True).stdout
    text, data, bss = map(int, listing.splitlines()[1].split()[:3])
    assert text <= CODE_SIZE_MAX, f"{text} bytes"
    assert (data, bss) == (0, 0), "no file-scope state"


def test_model_knows_every_source() -> None:
    generated = {"comm/variables_gen.c"}
    sources = {f"comm/{path.name}" for path in (FIRMWARE / "comm").glob("*.c")}
    assert sources - generated == set(COMM_SOURCES)
