"""Test rig: the STM32F405 port on a fake chip (``fake_stm32.c``), with register addresses."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from c_declarations import declarations
from firmware_compiler import FIRMWARE, TEST, CompileC
from recorded_accesses import SERVO, RecordedAccesses
from servo_msgs_py.board_description import BoardDescription
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.codegen import c_files, update

BOARD: Final = "odrive36"
PORT: Final = FIRMWARE / "port" / "stm32f405"
SOURCES: Final = [
    "test/fake_stm32.c",
    *sorted(f"port/stm32f405/{p.name}" for p in PORT.glob("*.c") if p.stem != "startup"),
]

INIT, M1, M2, EDGE, BREAK, BACKGROUND = range(6)

TIM = (0x4001_0000, 0x4001_0400)
ENCODER = (0x4000_0400, 0x4000_0800)
TIM2, USART2, DMA1, DMA2 = 0x4000_0000, 0x4000_4400, 0x4002_6000, 0x4002_6400
ADC = (0x4001_2000, 0x4001_2100, 0x4001_2200)
GPIO = {port: 0x4002_0000 + 0x400 * i for i, port in enumerate("ABCD")}
EXTI, FLASH, IWDG = 0x4001_3C00, 0x4002_3C00, 0x4000_3000
TIM5_CNT, DBGMCU = 0x4000_0C24, 0xE004_2000


def generated(folder: Path) -> Path:
    """Generated files of the firmware for the board in a folder."""
    files = c_files(FIRMWARE, Catalogue.load(board=BoardDescription.load(BOARD)))
    update(((folder / path, text) for path, text in files.items()), check=False)
    return folder


class Stm32Board(RecordedAccesses):
    """The port, initialised or not, with its recorded accesses."""

    def __init__(self, compile_c: CompileC, folder: Path, initialised: bool = True) -> None:
        include = (folder, FIRMWARE, TEST)
        cdef = declarations("fake_stm32.h", "hal/hal.h", include=include, defines=("CHIP_ON_HOST",))
        self.ffi, self.lib = compile_c("stm32", SOURCES, cdef, ["CHIP_ON_HOST"], quoted=[folder])
        self.chip = self.ffi.gc(self.lib.fake_new(), self.lib.fake_free)
        self.hal = self.lib.fake_hal(self.chip)
        if initialised:
            assert self.init()
            self.forget()

    @property
    def calls(self) -> list[tuple[int, int]]:
        """Calls of the application, and axes."""
        return [(a.address, a.value) for a in self.accesses if a.kind == SERVO]

    def __getitem__(self, address: int) -> int:
        return int(self.lib.fake_get(self.chip, address))

    def __setitem__(self, address: int, value: int) -> None:
        self.lib.fake_set(self.chip, address, value)

    def pass_time(self, seconds: float) -> None:
        self.clock += round(168e6 * seconds)

    @property
    def clock(self) -> int:
        """Core clocks that the port counts, by twos."""
        return 2 * self[TIM5_CNT]

    @clock.setter
    def clock(self, value: int) -> None:
        self[TIM5_CNT] = value // 2 & 0xFFFF_FFFF

    def is_on(self, axis: int) -> bool:
        """Main output enable of an inverter."""
        return bool(self[TIM[axis] + 0x44] & 0x8000)

    def sample(self, axis: int, b: int, c: int, offsets: tuple[int, int] = (2048, 2048), bus: int = 1568) -> None:
        """Results of the converters at the low-side centre of an axis, and the interrupt."""
        if axis == 0:
            for base, (own, other) in zip(ADC[1:], zip((b, c), offsets, strict=True), strict=True):
                self[base + 0x3C], self[base + 0x40] = own, other
                self[base] |= 1 << 2
            self[ADC[0] + 0x3C] = bus
            self.lib.port_m1(self.hal)
            return
        for i in range(2):
            self.hal.dma.adc2[i] = (b, offsets[0])[i]
            self.hal.dma.adc3[i] = (c, offsets[1])[i]
        self[ADC[0] + 0x4C] = bus
        self[DMA2] |= 1 << 21 | 1 << 5  # both transfers complete
        self.lib.port_m2(self.hal)
