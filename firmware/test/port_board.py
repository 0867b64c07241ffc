"""Test rig: the register-level port on a fake chip (``fake_chip.c``), with register addresses."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from c_declarations import declarations
from firmware_compiler import FIRMWARE, CompileC
from recorded_accesses import Access, RecordedAccesses

PORT = FIRMWARE / "port" / "mc56f84789"

SOURCES = ["test/fake_chip.c", *(f"port/mc56f84789/{name}" for name in sorted(path.name for path in PORT.glob("*.c")))]

INIT, M1, M2, EDGE, BREAK = range(5)

PWM = (0xE600, 0xE700)
TMR = (0xE140, 0xE180)
GPIO = {port: 0xE200 + 0x10 * i for i, port in enumerate("ABCDEFG")}


class FakeBoard(RecordedAccesses):
    """The port, initialised or not, with its recorded accesses."""

    def __init__(self, compile_c: CompileC, initialised: bool = True) -> None:
        cdef = declarations("fake_chip.h", "hal/hal.h", defines=("CHIP_ON_HOST",))
        self.ffi, self.lib = compile_c("port", SOURCES, cdef, ["CHIP_ON_HOST"])
        self.chip = self.ffi.gc(self.lib.fake_new(), self.lib.fake_free)
        self.hal = self.lib.fake_hal(self.chip)
        if initialised:
            assert self.init()

    def isr(self, vector: int) -> list[Access]:
        """Accesses of the handler of a vector."""
        self.forget()
        self.lib.port_isr(self.hal, vector)
        return self.accesses

    def __getitem__(self, address: int) -> int:
        return int(self.chip.memory[address])

    def __setitem__(self, address: int, value: int) -> None:
        self.chip.memory[address] = value

    def results(self, ready: int, codes: dict[int, int]) -> None:
        """Fill the result registers of the converter, left-aligned in bits 14:3."""
        for sample, code in codes.items():
            self[0xE50E + sample] = code << 3
        self[0xE50A] = ready


def pairs(axis: int) -> Iterator[int]:
    """The three parallel pairs that are converted at the low-side centre of an axis."""
    return iter(range(3 * axis, 3 * axis + 3))


def names_of(header: Path) -> Sequence[str]:
    """Object-like macros of a header."""
    return re.findall(r"^#define (\w+) ", header.read_text(encoding="ascii"), re.MULTILINE)
