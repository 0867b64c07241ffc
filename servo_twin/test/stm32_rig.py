"""Test rig: the STM32F405 with an environment in Python; tests read and write its registers.

Addresses and fields are those of the reference manual RM0090, not of the header that model and port share.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from chip_events import Event, event
from native_library import NATIVE, Native, compile_c
from servo_twin._build_native import generated_for

FIRMWARE = NATIVE.parents[1] / "firmware"
NEVER = (1 << 64) - 1
ARR, PERIOD = 5250, 10_500
"""Half period and period of the PWM, 16 kHz [clocks of 168 MHz]."""
APB1, MS = 4, 168_000
"""Clocks of 168 MHz per clock of 42 MHz, and per millisecond."""
RAM = 0x2000_0000

CDEF = """
typedef struct rig rig_t;
rig_t *rig_new(const chip_environment_t *environment, void *board, double baud);
void rig_free(rig_t *rig);
int64_t rig_read(rig_t *rig, uint32_t address, unsigned size); /* -1: an error */
int rig_write(rig_t *rig, uint32_t address, unsigned size, uint32_t value);
int rig_run(rig_t *rig, uint64_t until); /* -1: an error, 1: a reset */
uint64_t rig_now(const rig_t *rig);
const char *rig_error(const rig_t *rig);
bool rig_requested(const rig_t *rig, unsigned irq);
void rig_pin(rig_t *rig, unsigned pin, bool level);
bool rig_level(const rig_t *rig, unsigned pin);
uint8_t *rig_ram(rig_t *rig);
uint8_t *rig_flash(rig_t *rig);
uint64_t rig_stall(rig_t *rig);
size_t rig_send(rig_t *rig, const uint8_t *data, size_t size);
size_t rig_receive(rig_t *rig, uint8_t *data, size_t room);
uint32_t rig_overruns(const rig_t *rig);
void rig_over_current(rig_t *rig, unsigned driver, bool tripped);
unsigned rig_gain(const rig_t *rig, unsigned driver);
void rig_trace(rig_t *rig, trace_entry_t *log, size_t room);
size_t rig_traced(const rig_t *rig);
"""

PREAMBLE = """
#include <stdlib.h>
#include <string.h>
#include "stm32f405/chip.h"

#define RAM_BYTES 0x20000u
#define FLASH_BYTES 0x10000u

typedef struct rig {
    chip_t chip;
    uint8_t ram[RAM_BYTES], flash[FLASH_BYTES];
    void *board;
} rig_t;

static rig_t *rig_of_chip; /* the tests have one at a time */

static uint8_t *rig_memory(void *board, uint32_t address, unsigned size)
{
    (void)board;
    if (address - 0x20000000u < RAM_BYTES && RAM_BYTES - (address - 0x20000000u) >= size) {
        return rig_of_chip->ram + (address - 0x20000000u);
    }
    return (address - 0x08000000u < FLASH_BYTES) ? rig_of_chip->flash + (address - 0x08000000u) : NULL;
}

static rig_t *rig_new(const chip_environment_t *environment, void *board, double baud)
{
    rig_t *rig = calloc(1, sizeof *rig);
    const chip_config_t config = {
        .baud = baud, .enable_pin = SOC_PIN('B', 12), .select_pin = {SOC_PIN('C', 13), SOC_PIN('C', 14)},
        .fault_pin = SOC_PIN('D', 2), .memory = rig_memory,
    };
    rig_of_chip = rig;
    chip_init(&rig->chip, &config, environment, board);
    chip_show_storage(&rig->chip);
    return rig;
}

static void rig_free(rig_t *rig) { free(rig); }

static int64_t rig_read(rig_t *rig, uint32_t address, unsigned size)
{
    volatile int64_t result = -1;
    uint32_t value = 0;
    if (setjmp(rig->chip.soc.bus.escape) == 0 && chip_load(&rig->chip, address, size, &value)) {
        result = value;
    }
    return result;
}

static int rig_write(rig_t *rig, uint32_t address, unsigned size, uint32_t value)
{
    const int reason = setjmp(rig->chip.soc.bus.escape);
    if (reason != 0) {
        return (reason == ESCAPE_FAILURE) ? -1 : 1;
    }
    rig->chip.soc.bus.flash_stall = 0;
    return chip_store(&rig->chip, address, size, value) ? 0 : -1;
}

static int rig_run(rig_t *rig, uint64_t until)
{
    uint64_t next;
    const int reason = setjmp(rig->chip.soc.bus.escape);
    if (reason != 0) {
        return (reason == ESCAPE_FAILURE) ? -1 : 1;
    }
    while (bus_step(&rig->chip.soc.bus, until, &next)) {
    }
    return 0;
}

static uint64_t rig_now(const rig_t *rig) { return rig->chip.soc.bus.now; }
static const char *rig_error(const rig_t *rig) { return rig->chip.soc.bus.error; }
static bool rig_requested(const rig_t *rig, unsigned irq)
{
    return rig->chip.soc.bus.request[irq / 64] >> (irq % 64) & 1;
}
static void rig_pin(rig_t *rig, unsigned pin, bool level) { chip_pin(&rig->chip, pin, level); }
static bool rig_level(const rig_t *rig, unsigned pin) { return chip_pin_level(&rig->chip, pin); }
static uint8_t *rig_ram(rig_t *rig) { return rig->ram; }
static uint8_t *rig_flash(rig_t *rig) { return rig->flash; }
static uint64_t rig_stall(rig_t *rig) { return rig->chip.soc.bus.flash_stall; }
static size_t rig_send(rig_t *rig, const uint8_t *data, size_t size) { return chip_line_write(&rig->chip, data, size); }
static size_t rig_receive(rig_t *rig, uint8_t *data, size_t room)
{
    return serial_line_read(&rig->chip.usart.line, data, room);
}
static uint32_t rig_overruns(const rig_t *rig) { return rig->chip.usart.line.overruns; }
static void rig_over_current(rig_t *rig, unsigned driver, bool tripped)
{
    drv8301_over_current(&rig->chip.drivers, driver, tripped);
}
static unsigned rig_gain(const rig_t *rig, unsigned driver) { return drv8301_gain(&rig->chip.drivers, driver); }
static void rig_trace(rig_t *rig, trace_entry_t *log, size_t room)
{
    rig->chip.soc.bus.trace = (trace_t){.entry = log, .size = 0, .remaining = room};
}
static size_t rig_traced(const rig_t *rig) { return rig->chip.soc.bus.trace.size; }
"""


def build(folder: Path) -> Native:
    sources = [
        *(NATIVE / name for name in ("flash.c", "serial_line.c", "chip/bus.c", "chip/names.c")),
        *sorted((NATIVE / "stm32f405").glob("*.c")),
    ]
    return compile_c(
        folder,
        "_stm32_under_test",
        ["chip/environment.h", "chip/trace.h"],
        sources,
        (generated_for("odrive36", folder / "generated"), NATIVE, FIRMWARE),
        ["BOARD_ODRIVE36"],
        CDEF,
        PREAMBLE,
    )


def pin(name: str) -> int:
    """Number of a pin from its name, such as "C13"."""
    return (ord(name[0]) - ord("A")) << 4 | int(name[1:])


# ---- addresses -------------------------------------------------------------------------------------------------------

_TIMERS = {"TIM1": 0x4001_0000, "TIM8": 0x4001_0400, "TIM12": 0x4000_1800} | {
    f"TIM{n}": 0x4000_0000 + 0x400 * (n - 2) for n in range(2, 6)
}
_TIMER = (
    "CR1", "CR2", "SMCR", "DIER", "SR", "EGR", "CCMR1", "CCMR2", "CCER", "CNT", "PSC", "ARR", "RCR", "CCR1", "CCR2",
    "CCR3", "CCR4", "BDTR",
)  # fmt: skip
_ADC = (
    "SR", "CR1", "CR2", "SMPR1", "SMPR2", "JOFR1", "JOFR2", "JOFR3", "JOFR4", "HTR", "LTR", "SQR1", "SQR2", "SQR3",
    "JSQR", "JDR1", "JDR2", "JDR3", "JDR4", "DR",
)  # fmt: skip
_GPIO = ("MODER", "OTYPER", "OSPEEDR", "PUPDR", "IDR", "ODR", "BSRR", "LCKR", "AFRL", "AFRH")
_RCC = {"CR": 0, "PLLCFGR": 4, "CFGR": 8, "AHB1ENR": 0x30, "APB1ENR": 0x40, "APB2ENR": 0x44, "CSR": 0x74}


def _addresses() -> Iterator[tuple[str, int]]:
    for name, base in _TIMERS.items():
        yield from ((f"{name}_{register}", base + 4 * k) for k, register in enumerate(_TIMER))
    for n in range(3):
        yield from ((f"ADC{n + 1}_{register}", 0x4001_2000 + 0x100 * n + 4 * k) for k, register in enumerate(_ADC))
    yield from {"ADC_CSR": 0x4001_2300, "ADC_CCR": 0x4001_2304}.items()
    for n, letter in enumerate("ABCD"):
        yield from ((f"GPIO{letter}_{name}", 0x4002_0000 + 0x400 * n + 4 * k) for k, name in enumerate(_GPIO))
    yield from ((f"RCC_{name}", 0x4002_3800 + offset) for name, offset in _RCC.items())
    yield "PWR_CR", 0x4000_7000
    yield from ((f"FLASH_{name}", 0x4002_3C00 + 4 * k) for k, name in enumerate(("ACR", "KEYR", "", "SR", "CR")))
    yield from ((f"EXTI_{name}", 0x4001_3C00 + 4 * k) for k, name in enumerate(("IMR", "EMR", "RTSR", "FTSR", "SWIER")))
    yield "EXTI_PR", 0x4001_3C14
    yield from ((f"SYSCFG_EXTICR{k + 1}", 0x4001_3808 + 4 * k) for k in range(4))
    yield from (
        (f"USART2_{name}", 0x4000_4400 + 4 * k) for k, name in enumerate(("SR", "DR", "BRR", "CR1", "CR2", "CR3"))
    )
    yield from ((f"SPI3_{name}", 0x4000_3C00 + 4 * k) for k, name in enumerate(("CR1", "CR2", "SR", "DR")))
    yield from ((f"IWDG_{name}", 0x4000_3000 + 4 * k) for k, name in enumerate(("KR", "PR", "RLR", "SR")))
    for n in (1, 2):
        base = 0x4002_6000 + 0x400 * (n - 1)
        yield from ((f"DMA{n}_{name}", base + 4 * k) for k, name in enumerate(("LISR", "HISR", "LIFCR", "HIFCR")))
        for s in range(8):
            for k, name in enumerate(("CR", "NDTR", "PAR", "M0AR", "M1AR", "FCR")):
                yield f"DMA{n}_S{s}{name}", base + 0x10 + 0x18 * s + 4 * k


ADDRESS = dict(_addresses())


class Stm32Error(Exception):
    """The chip has stopped with an error."""


class Stm32Rig:
    """A chip at 168 MHz with open clock gates, in an environment that the test defines."""

    def __init__(self, native: Native, *, baud: float = 115200.0, start: bool = True) -> None:
        self.ffi, self.lib = native.ffi, native.lib
        self.codes: list[int | Callable[[int], int]] = [
            100 * k for k in range(16)
        ]  # by input, or functions of the clock
        self.gates: list[tuple[int, int, int, int]] = []  # clock, axis, phase, levels
        self.edges: list[tuple[int, str, bool]] = []  # future levels at pins, sorted by clock
        environment = {
            "advance": ("void(void *, uint64_t)", lambda _, __: None),
            "next_event": ("uint64_t(void *)", lambda _: self.edges[0][0] if self.edges else NEVER),
            "handle_events": ("void(void *)", lambda _: self._events()),
            "outputs_changed": ("void(void *)", lambda _: None),
            "set_gates": ("void(void *, unsigned, unsigned, unsigned)", lambda _, *gates: self._gates(*gates)),
            "convert": ("uint16_t(void *, unsigned)", lambda _, channel: self._convert(channel)),
        }
        self._keep = {name: self.ffi.callback(kind, call) for name, (kind, call) in environment.items()}
        self._environment = self.ffi.new("chip_environment_t *", self._keep)
        self.rig = self.ffi.NULL
        self.rig = self.ffi.gc(self.lib.rig_new(self._environment, self.ffi.NULL, baud), self.lib.rig_free)
        self._trace = self.ffi.new("trace_entry_t[]", 100_000)
        if start:
            self.start_clocks()
            self.write_all({"RCC_AHB1ENR": 0x0070_000F, "RCC_APB1ENR": 0x1002_804F, "RCC_APB2ENR": 0x0000_4703})
        self.clear()

    def start_clocks(self) -> None:
        """Crystal, PLL, flash wait states, buses, system clock."""
        self.write("RCC_APB1ENR", 1 << 28)
        self.write_all({"PWR_CR": 1 << 14, "RCC_CR": 0x0001_0081})
        self.step(3 * MS)
        self.write_all({"RCC_PLLCFGR": 0x0740_2A04, "RCC_CR": 0x0101_0081})
        self.step(MS)
        self.write_all({"FLASH_ACR": 0x705, "RCC_CFGR": 0x9400})
        self.write("RCC_CFGR", 0x9402)

    def _events(self) -> None:
        while self.edges and self.edges[0][0] <= self.now:
            _, name, level = self.edges.pop(0)
            self.pin(name, level)

    def _gates(self, axis: int, phase: int, levels: int) -> None:
        self.gates.append((self.now, axis, phase, levels))

    def _convert(self, channel: int) -> int:
        code = self.codes[channel]
        return code(self.now) if callable(code) else code

    @property
    def now(self) -> int:
        return int(self.lib.rig_now(self.rig)) if self.rig != self.ffi.NULL else 0

    def _check(self, good: bool) -> None:
        if not good:
            raise Stm32Error(self.ffi.string(self.lib.rig_error(self.rig)).decode())

    def run(self, until: int) -> bool:
        """Run up to and including a clock; True if the chip was reset, which ends the run."""
        reason = self.lib.rig_run(self.rig, until)
        self._check(reason >= 0)
        return bool(reason)

    def step(self, clocks: int) -> bool:
        return self.run(self.now + clocks)

    def read(self, name: str) -> int:
        return self.read_at(ADDRESS[name])

    def read_at(self, address: int, size: int = 4) -> int:
        value = self.lib.rig_read(self.rig, address, size)
        self._check(value >= 0)
        return int(value)

    def write(self, name: str, value: int) -> None:
        self.write_at(ADDRESS[name], value)

    def write_at(self, address: int, value: int) -> None:
        self._check(self.lib.rig_write(self.rig, address, 4, value) >= 0)

    def write_all(self, values: dict[str, int]) -> None:
        for name, value in values.items():
            self.write(name, value)

    def set_bits(self, name: str, bits: int) -> None:
        self.write(name, self.read(name) | bits)

    def function(self, name: str, number: int) -> None:
        """Give a pin to an alternate function."""
        port, n = f"GPIO{name[0]}", int(name[1:])
        half = f"{port}_AFR{'LH'[n // 8]}"
        self.write(half, self.read(half) & ~(15 << 4 * (n % 8)) | number << 4 * (n % 8))
        self.mode(name, 2)

    def mode(self, name: str, mode: int) -> None:
        """Mode of a pin: 0 input, 1 output, 2 function, 3 analogue."""
        port, n = f"GPIO{name[0]}", int(name[1:])
        self.write(f"{port}_MODER", self.read(f"{port}_MODER") & ~(3 << 2 * n) | mode << 2 * n)

    def pin(self, name: str, level: bool) -> None:
        self.lib.rig_pin(self.rig, pin(name), level)

    def level(self, name: str) -> bool:
        return bool(self.lib.rig_level(self.rig, pin(name)))

    def requested(self, irq: int) -> bool:
        return bool(self.lib.rig_requested(self.rig, irq))

    def send(self, data: bytes) -> None:
        assert self.lib.rig_send(self.rig, data, len(data)) == len(data)

    def received(self) -> bytes:
        buffer = self.ffi.new("uint8_t[]", 70_000)
        return bytes(self.ffi.buffer(buffer, self.lib.rig_receive(self.rig, buffer, 70_000)))

    def ram(self, offset: int, size: int) -> bytes:
        return bytes(self.ffi.buffer(self.lib.rig_ram(self.rig) + offset, size))

    def clear(self) -> None:
        """Clear the recorded events."""
        self.lib.rig_trace(self.rig, self._trace, 100_000)
        self.gates.clear()

    def events(self, *kinds: str) -> list[Event]:
        log = self._trace[0 : self.lib.rig_traced(self.rig)]
        events = [event(e.clock, e.kind, e.a, e.b) for e in log]
        return [e for e in events if not kinds or e.kind in kinds]
