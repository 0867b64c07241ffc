"""Test rig: the chip with an environment in Python; tests read and write its registers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from chip_events import Event, event
from native_library import NATIVE, Native, compile_c

NEVER = (1 << 64) - 1
PERIOD, HALF = 6250, 3125
"""Period and half period of the PWM [bus clocks of 10 ns]."""

CDEF = """
/* A call that may end in an error: 0, or -1. */
int try_read(chip_t *chip, uint32_t address);
int try_write(chip_t *chip, uint32_t address, uint16_t value);
/* Charges the software of the tests, in 1/16 instruction. */
void try_spend(int units);
"""

PREAMBLE = """
#include <setjmp.h>
#include <string.h>
#include "chip/core_time.h"

static void try_spend(int units) { core_spend(units); }

/* The tests act as software from outside of chip_run, and from handlers: errors return to here. */
static int try_read(chip_t *chip, uint32_t address)
{
    jmp_buf outer;
    volatile int value = -1;
    memcpy(&outer, &chip->core.bus.escape, sizeof outer);
    if (setjmp(chip->core.bus.escape) == 0) {
        value = chip_read(chip, address);
    }
    memcpy(&chip->core.bus.escape, &outer, sizeof outer);
    return value;
}

static int try_write(chip_t *chip, uint32_t address, uint16_t value)
{
    jmp_buf outer;
    memcpy(&outer, &chip->core.bus.escape, sizeof outer);
    const int reason = setjmp(chip->core.bus.escape);
    if (reason == 0) {
        chip_write(chip, address, value);
    }
    memcpy(&chip->core.bus.escape, &outer, sizeof outer);
    return (reason == ESCAPE_FAILURE) ? -1 : 0;
}
"""


def build(folder: Path) -> Native:
    sources = [NATIVE / "flash.c", NATIVE / "serial_line.c", *sorted((NATIVE / "chip").glob("*.c"))]
    return compile_c(folder, "_chip_under_test", ["chip/chip.h"], sources, cdef=CDEF, preamble=PREAMBLE)


def pin(name: str) -> int:
    """Number of a pin from its name, such as "C3"."""
    return (ord(name[0]) - ord("A")) << 4 | int(name[1:])


WIRING = {
    "gate": [
        [[pin("E1"), pin("E0")], [pin("E3"), pin("E2")], [pin("E5"), pin("E4")]],
        [[pin("G3"), pin("G2")], [pin("G1"), pin("G0")], [pin("E7"), pin("E6")]],
    ],
    "txd": pin("C7"),
    "rxd": pin("C8"),
}

# ---- addresses, from the register definitions of the part ----------------------------------------------------------

_SUB = {
    "CNT": 0x00, "INIT": 0x01, "CTRL2": 0x02, "CTRL": 0x03, "VAL0": 0x05, "FRACVAL1": 0x06, "VAL1": 0x07, "VAL2": 0x09,
    "VAL3": 0x0B, "VAL4": 0x0D, "VAL5": 0x0F, "FRCTRL": 0x10, "OCTRL": 0x11, "STS": 0x12, "INTEN": 0x13, "DMAEN": 0x14,
    "TCTRL": 0x15, "DISMAP0": 0x16, "DISMAP1": 0x17, "DTCNT0": 0x18, "DTCNT1": 0x19,
}  # fmt: skip
_MODULE = {
    "OUTEN": 0xC0, "MASK": 0xC1, "SWCOUT": 0xC2, "DTSRCSEL": 0xC3, "MCTRL": 0xC4, "FCTRL0": 0xC6, "FSTS0": 0xC7,
    "FFILT0": 0xC8, "FTST0": 0xC9,
}  # fmt: skip
_TIMER = {
    "COMP1": 0, "COMP2": 1, "CAPT": 2, "LOAD": 3, "HOLD": 4, "CNTR": 5, "CTRL": 6, "SCTRL": 7, "CMPLD1": 8,
    "CSCTRL": 10, "FILT": 11, "ENBL": 15,
}  # fmt: skip


def _addresses() -> Iterator[tuple[str, int]]:
    for letter, base in (("A", 0xE600), ("B", 0xE700)):
        for n in range(4):
            for name, offset in _SUB.items():
                yield f"PWM{letter}{n}_{name}", base + 0x30 * n + offset
        for name, offset in _MODULE.items():
            yield f"PWM{letter}_{name}", base + offset
    for letter, base in (("A", 0xE140), ("B", 0xE180)):
        for n in range(4):
            for name, offset in _TIMER.items():
                yield f"TMR{letter}{n}_{name}", base + 0x10 * n + offset
    adc = ["CTRL1", "CTRL2", "ZXCTRL1", "ZXCTRL2", "CLIST1", "CLIST2", "CLIST3", "CLIST4", "SDIS", "STAT", "RDY"]
    for offset, name in enumerate(adc):
        yield f"ADC_{name}", 0xE500 + offset
    for n in range(16):
        yield f"ADC_RSLT{n}", 0xE50E + n
        yield f"ADC_OFFST{n}", 0xE53E + n
    for offset, name in enumerate(["PWR", "CAL", "GC1", "GC2", "SCTRL", "PWR2", "CTRL3", "SCHLTEN"]):
        yield f"ADC_{name}", 0xE54E + offset
    for n, base in enumerate((0xE080, 0xE090, 0xE0A0)):
        for offset, name in enumerate(["RATE", "CTRL1", "CTRL2", "STAT", "DATA", "CTRL3"]):
            yield f"SCI{n}_{name}", base + offset
    for n in range(30):
        yield f"XBARA_SEL{n}", 0xE340 + n
    for n in range(8):
        yield f"XBARB_SEL{n}", 0xE360 + n
    for n in range(4):
        yield f"AOI_BFCRT01_{n}", 0xE380 + 2 * n
        yield f"AOI_BFCRT23_{n}", 0xE381 + 2 * n
    for n in range(13):
        yield f"INTC_IPR{n}", 0xE300 + n
    yield "INTC_CTRL", 0xE31B
    for offset, name in enumerate(["CTRL", "TOUT", "CNTR"]):
        yield f"COP_{name}", 0xE320 + offset
    for offset, name in enumerate(["CTRL", "DIVBY", "STAT"]):
        yield f"OCCS_{name}", 0xE2B0 + offset
    yield from {"OCCS_OSCTL1": 0xE2B4, "OCCS_OSCTL2": 0xE2B5}.items()
    for n in range(4):
        yield f"SIM_PCE{n}", 0xE40C + n
    yield from {"SIM_CTRL": 0xE400, "SIM_RSTAT": 0xE401, "SIM_PCR": 0xE40B, "SIM_IPS0": 0xE422}.items()
    for offset, name in enumerate(["AL", "BH", "CL", "CH", "DL", "EL", "EH", "FL", "FH", "GL", "GH"]):
        yield f"SIM_GPS{name}", 0xE417 + offset
    for offset, name in enumerate(["FSTAT", "FSEC", "FCCOB3", "FCCOB1", "FCCOB7", "FCCOB5"]):
        yield f"FTFL_{name}", 0xE3C0 + offset
    for n, letter in enumerate("ABCDEFG"):
        for name, offset in {"DR": 1, "DDR": 2, "PER": 3, "IENR": 5, "RAWDATA": 10}.items():
            yield f"GPIO{letter}_{name}", 0xE200 + 0x10 * n + offset


ADDRESS = dict(_addresses())


class ChipError(Exception):
    """The chip has stopped with an error."""


class ChipRig:
    """A chip with running clocks and all clock gates open, in an environment that the test defines."""

    def __init__(
        self,
        native: Native,
        *,
        baud: float = 115200.0,
        crossbar_clocks: int = 0,
        start: bool = True,
        core: tuple[float, int] = (0.0, 0),
    ) -> None:
        self.ffi, self.lib = native.ffi, native.lib
        # conversion results of the pins ANA0-7, ANB0-7, or functions of the clock
        self.codes: list[int | Callable[[int], int]] = [100 * k for k in range(16)]
        self.handlers: dict[int, Callable[[], int | None]] = {}  # by vector; each returns its duration [clocks]
        self.edges: list[tuple[int, str, bool]] = []  # future levels at pins: clock, pin, level; sorted by clock
        self.defers_edges = False  # edges of a timer module are delivered on request, if the chip can defer them
        self.edges_deferred = 0  # number of deferred edges
        self.gates: list[tuple[int, int, int, int]] = []
        self.background: Callable[[], None] = lambda: None
        self.boots = 0
        self.raised: list[BaseException] = []
        self._starts_clocks = start
        environment = {
            "advance": ("void(void *, uint64_t)", lambda _, __: None),
            "next_event": ("uint64_t(void *)", lambda _: self._next()),
            "handle_events": ("void(void *)", lambda _: self._events()),
            "deferrable_edges_changed": ("void(void *)", lambda _: None),
            "report_deferred": ("void(void *)", lambda _: self._late()),
            "set_gates": ("void(void *, unsigned, unsigned, unsigned)", lambda _, *gates: self._gates(*gates)),
            "outputs_changed": ("void(void *)", lambda _: None),
            "convert": ("uint16_t(void *, unsigned)", lambda _, channel: self._convert(channel)),
            "boot": ("void(void *)", lambda _: self._boot()),
            "interrupt": ("uint32_t(void *, unsigned)", lambda _, vector: self._interrupt(vector)),
            "background": ("void(void *)", lambda _: self.background()),
        }
        calls = {name: self.ffi.callback(kind, call) for name, (kind, call) in environment.items()}
        self._environment = self.ffi.new("chip_environment_t *", calls)
        self._keep = calls
        self.chip = self.ffi.new("chip_t *")
        config = {"wiring": WIRING, "baud": baud, "crossbar_clocks": crossbar_clocks, "core": core}
        self.lib.chip_init(self.chip, self.ffi.new("chip_config_t *", config), self._environment, self.ffi.NULL)
        self.line = self.ffi.addressof(self.chip, "sci")
        self._trace = self.ffi.new("trace_entry_t[]", 200_000)
        self.run(0)
        self.clear()

    # ---- the environment -------------------------------------------------------------------------------------------

    def _next(self) -> int:
        first = 0
        if self.defers_edges and self.edges:
            first = min(self.lib.chip_deferrable_edges(self.chip, pin(name)) for _, name, _ in self.edges[:2])
        return self.edges[first][0] if first < len(self.edges) else NEVER

    def _late(self) -> None:
        while self.defers_edges and self.edges and self.edges[0][0] <= self.chip.core.bus.now:
            if self.lib.chip_deferrable_edges(self.chip, pin(self.edges[0][1])) == 0:
                break  # an event
            clock, name, level = self.edges.pop(0)
            self.edges_deferred += clock < self.chip.core.bus.now
            self.lib.chip_pin_late(self.chip, pin(name), level, clock)

    def _events(self) -> None:
        self._late()
        while self.edges and self.edges[0][0] <= self.chip.core.bus.now:
            _, name, level = self.edges.pop(0)
            self.lib.chip_pin(self.chip, pin(name), level)

    def _gates(self, module: int, submodule: int, levels: int) -> None:
        self.gates.append((self.chip.core.bus.now, module, submodule, levels))

    def _convert(self, channel: int) -> int:
        code = self.codes[channel]
        return code(self.chip.core.bus.now) if callable(code) else code

    def _interrupt(self, vector: int) -> int:
        return self.handlers[vector]() or 100

    def _boot(self) -> None:
        self.boots += 1
        if self._starts_clocks:
            self.lib.chip_write(self.chip, ADDRESS["COP_CTRL"], 0)
            self.start_clocks()
            for n, value in enumerate((0xFF7F, 0x1C00, 0x0080, 0x00FF)):
                self.lib.chip_write(self.chip, ADDRESS[f"SIM_PCE{n}"], value)

    def start_clocks(self, divby: int = 0x2031) -> None:
        """Start the PLL on the internal oscillator, for a bus clock of 100 MHz."""
        write, read = self.lib.chip_write, self.lib.chip_read
        write(self.chip, ADDRESS["OCCS_DIVBY"], divby)
        write(self.chip, ADDRESS["OCCS_CTRL"], 0x0080)
        while read(self.chip, ADDRESS["OCCS_STAT"]) & 0x0060 != 0x0060:
            pass
        write(self.chip, ADDRESS["OCCS_CTRL"], 0x0081)
        while read(self.chip, ADDRESS["OCCS_STAT"]) & 3 != 1:
            pass

    # ---- the test --------------------------------------------------------------------------------------------------

    @property
    def now(self) -> int:
        return int(self.chip.core.bus.now)

    def _check(self, good: bool) -> None:
        if not good:
            raise ChipError(self.ffi.string(self.chip.core.bus.error).decode())

    def run(self, until: int) -> None:
        """Run up to and including a clock."""
        self._check(self.lib.chip_run(self.chip, until))

    def step(self, clocks: int) -> None:
        self.run(self.now + clocks)

    def read(self, name: str) -> int:
        return self.read_at(ADDRESS[name])

    def read_at(self, address: int) -> int:
        value = self.lib.try_read(self.chip, address)
        self._check(value >= 0)
        return int(value)

    def write(self, name: str, value: int) -> None:
        self.write_at(ADDRESS[name], value)

    def write_at(self, address: int, value: int) -> None:
        self._check(self.lib.try_write(self.chip, address, value & 0xFFFF) == 0)

    def write_all(self, values: dict[str, int]) -> None:
        for name, value in values.items():
            self.write(name, value)

    def pin(self, name: str, level: bool) -> None:
        self.lib.chip_pin(self.chip, pin(name), level)

    def interrupts(self) -> None:
        self.lib.chip_interrupts(self.chip, True)

    def on(self, vector: int, values: dict[str, int], read: str = "") -> list[Any]:
        """Install a handler that writes values; return the clocks of its calls, with the value of `read` before."""
        calls: list[Any] = []

        def handler() -> None:
            calls.append((self.now, self.read(read)) if read else self.now)
            self.write_all(values)

        self.handlers[vector] = handler
        return calls

    def clear(self) -> None:
        """Clear the recorded events."""
        self.chip.core.bus.trace = {"entry": self._trace, "size": 0, "remaining": 200_000}
        self.gates.clear()

    def events(self, *kinds: str) -> list[Event]:
        log = self._trace[0 : self.chip.core.bus.trace.size]
        events = [event(e.clock, e.kind, e.a, e.b) for e in log]
        return [e for e in events if not kinds or e.kind in kinds]

    def clocks(self, kind: str, a: int | None = None, b: int | None = None) -> list[int]:
        """Clocks of the recorded events of a kind."""
        return [e.clock for e in self.events(kind) if (a is None or e.a == a) and (b is None or e.b == b)]

    def host_write(self, data: bytes) -> None:
        assert self.lib.sci_line_write(self.line, data, len(data)) == len(data)

    def host_read(self) -> bytes:
        buffer = self.ffi.new("uint8_t[]", 70_000)
        return bytes(
            self.ffi.buffer(buffer, self.lib.serial_line_read(self.ffi.addressof(self.line.line), buffer, 70_000))
        )

    def name(self, address: int) -> str:
        buffer = self.ffi.new("char[]", 64)
        self.lib.chip_register_name(address, buffer, 64)
        name: bytes = self.ffi.string(buffer)
        return name.decode()


PWM_PINS = {"GPIOE_PER": 0x01FF, "GPIOG_PER": 0x000F, "SIM_GPSEL": 0xA000, "SIM_GPSEH": 0x0001, "GPIOF_PER": 0x4000,
            "SIM_GPSFH": 0x1000}  # fmt: skip
"""Gates of both motors, and the fault pins E8 (PWMA_FAULT0) and F14 (PWMB_FAULT0)."""


def pwm_module(letter: str, half: int = 1000, **changes: int) -> dict[str, int]:
    """Registers of a module in the reference design: centre-aligned, half-cycle reload, 1 us dead time."""
    values: dict[str, int] = {}
    for n in range(3):
        follower = (0x0204 if letter == "A" else 0x0304) if n else (0x0000 if letter == "A" else 0x0300)
        values |= {
            f"PWM{letter}{n}_INIT": -HALF, f"PWM{letter}{n}_VAL0": 0, f"PWM{letter}{n}_VAL1": HALF - 1,
            f"PWM{letter}{n}_VAL2": -half, f"PWM{letter}{n}_VAL3": half, f"PWM{letter}{n}_VAL4": -HALF + 100,
            f"PWM{letter}{n}_VAL5": -HALF + 400, f"PWM{letter}{n}_CTRL2": follower, f"PWM{letter}{n}_CTRL": 0x0800,
            f"PWM{letter}{n}_DTCNT0": 100, f"PWM{letter}{n}_DTCNT1": 100, f"PWM{letter}{n}_DISMAP0": 0xFF11,
            f"PWM{letter}{n}_DISMAP1": 0xFF00, f"PWM{letter}{n}_TCTRL": 0,
        }  # fmt: skip
    values |= {f"PWM{letter}_FCTRL0": 0xF0F0, f"PWM{letter}_FSTS0": 0x00FF}
    return values | changes


def start_pwm(rig: ChipRig, letter: str, *, outputs: bool = True) -> None:
    """Set LDOK and RUN, and enable the outputs."""
    rig.write(f"PWM{letter}_MCTRL", 0x0007)
    rig.write(f"PWM{letter}_MCTRL", 0x0700)
    if outputs:
        rig.write(f"PWM{letter}_OUTEN", 0x0770)
