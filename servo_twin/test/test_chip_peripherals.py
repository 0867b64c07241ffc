"""Each peripheral of the chip alone: its header, its own C files, and a bus whose signals the test records."""

from __future__ import annotations

import re
import subprocess
import sysconfig
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any, Final

import pytest
from chip_rig import ADDRESS, NEVER
from native_library import NATIVE, Native, compile_c

CHIP: Final = NATIVE / "chip"
BASE: Final = [CHIP / "bus.c", CHIP / "names.c"]
PARTS: Final[Mapping[str, list[str]]] = {
    **{name: [f"chip/{name}.c"] for name in ("adc", "cop", "intc", "occs", "pins", "qtmr", "sci", "sim", "xbar")},
    "ftfl": ["chip/ftfl.c", "flash.c"],
    "pwm": ["chip/pwm.c", "chip/pwm_outputs.c", "chip/pwm_registers.c"],
}
"""C files of each peripheral, in addition to those of the bus."""

EVENTS: Final = {
    "adc": [("SOURCE_ADC", 2, "adc_event")],
    "cop": [("SOURCE_COP", 1, "cop_event")],
    "pwm": [("SOURCE_PWM", 8, "pwm_event"), ("SOURCE_FAULT", 1, "pwm_fault_event")],
    "qtmr": [("SOURCE_TIMER", 2, "qtmr_event")],
    "xbar": [],
}
"""First event source, number of event sources and handler of the peripherals that a test runs."""

CDEF: Final = """
typedef struct {{ bus_t bus; {name}_t peripheral; }} rig_t;
void rig_reset(rig_t *rig);
int rig_read(rig_t *rig, uint32_t address);
int rig_write(rig_t *rig, uint32_t address, uint16_t value);
uint64_t rig_next(const rig_t *rig);
void rig_run(rig_t *rig, uint64_t until);
"""

PREAMBLE: Final = """
typedef struct {{ bus_t bus; {name}_t peripheral; }} rig_t;

static void rig_reset(rig_t *rig)
{{
    rig->peripheral.bus = &rig->bus;
    events_reset(&rig->bus.events);
    {handlers}
    {name}_reset(&rig->peripheral);
}}

static int rig_read(rig_t *rig, uint32_t address)
{{
    return (setjmp(rig->bus.escape) == 0) ? {name}_read(&rig->peripheral, address) : -1;
}}

static int rig_write(rig_t *rig, uint32_t address, uint16_t value)
{{
    if (setjmp(rig->bus.escape) != 0) {{
        return -1;
    }}
    {name}_write(&rig->peripheral, address, value);
    return 0;
}}

static uint64_t rig_next(const rig_t *rig) {{ return EVENT_CLOCK(events_next(&rig->bus.events)); }}

static void rig_run(rig_t *rig, uint64_t until)
{{
    uint64_t key;
    while (EVENT_CLOCK(key = events_next(&rig->bus.events)) <= until) {{
        rig->bus.now = EVENT_CLOCK(key);
        events_handle(&rig->bus.events, EVENT_SOURCE(key));
    }}
    rig->bus.now = until;
}}
"""


class Peripheral:
    """One peripheral on a separate bus, with all clock gates open."""

    def __init__(self, native: Native) -> None:
        self.ffi, self.lib = native.ffi, native.lib
        self.rig: Any = self.ffi.new("rig_t *")
        self.bus, self.peripheral = self.rig.bus, self.rig.peripheral
        # clock, name and arguments of each signal and each call of the environment
        self.calls: list[tuple[Any, ...]] = []
        self.codes = [100 * k for k in range(16)]  # conversion results of the analogue pins
        self._tables = [self._table("chip_signals_t"), self._table("chip_environment_t")]
        self.bus.signals, self.bus.environment = (table for table, _ in self._tables)
        self.bus.sim.pce = [0xFFFF] * 4
        self.lib.rig_reset(self.rig)
        self.calls.clear()

    def _table(self, kind: str) -> tuple[Any, Any]:
        """A table of functions that record their calls, and the references that keep the functions alive."""
        functions = {
            name: self.ffi.callback(field.type, partial(self._record, name))
            for name, field in self.ffi.typeof(kind).fields
        }
        return self.ffi.new(f"{kind} *", functions), functions

    def _record(self, name: str, _: Any, *arguments: int) -> int | None:
        self.calls.append((int(self.bus.now), name, *arguments))
        return self.codes[arguments[0]] if name == "convert" else NEVER if name == "next_event" else None

    def read(self, name: str) -> int:
        value = self.lib.rig_read(self.rig, ADDRESS[name])
        assert value >= 0, self.ffi.string(self.bus.error).decode()
        return int(value)

    def write(self, values: Mapping[str, int]) -> None:
        for name, value in values.items():
            done = self.lib.rig_write(self.rig, ADDRESS[name], value & 0xFFFF)
            assert done == 0, self.ffi.string(self.bus.error).decode()

    def run(self, until: int) -> None:
        self.lib.rig_run(self.rig, until)

    def called(self, name: str) -> list[tuple[int, ...]]:
        """Clock and arguments of the calls of one function."""
        return [(clock, *arguments) for clock, what, *arguments in self.calls if what == name]

    def requested(self, vector: int) -> bool:
        return bool(self.bus.request[vector // 64] >> (vector % 64) & 1)


@pytest.fixture(scope="module")
def new_peripheral(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Peripheral]:
    """Build one peripheral."""

    @cache
    def build(name: str) -> Native:
        handlers = "".join(
            f"for (unsigned n = 0; n < {count}u; n++) {{ rig->bus.events.handler[{source} + n] ="
            f" (event_handler_t){{{handle}, &rig->peripheral}}; }}"
            for source, count, handle in EVENTS[name]
        )
        return compile_c(
            tmp_path_factory.mktemp(name),
            f"_{name}_alone",
            [f"chip/{name}.h"],
            [NATIVE / path for path in PARTS[name]] + BASE,
            cdef=CDEF.format(name=name),
            preamble=PREAMBLE.format(name=name, handlers=handlers),
        )

    return lambda name: Peripheral(build(name))


@pytest.mark.parametrize("name", PARTS)
def test_peripheral_is_linked_without_the_others(name: str, tmp_path: Path) -> None:
    """A peripheral includes only the bus and its own headers, and links with these alone."""
    sources = [NATIVE / path for path in PARTS[name]]
    for source in [*sources, *CHIP.glob(f"{name}*.h")]:
        included = set(re.findall(r'#include "(.*)"', source.read_text(encoding="utf-8")))
        assert included <= {"chip/bus.h", "flash.h", *(f"chip/{path.name}" for path in CHIP.glob(f"{name}*.h"))}
    subprocess.run(
        [*sysconfig.get_config_var("CC").split(), "-std=c99", "-shared", "-fPIC", "-Wl,-z,defs", f"-I{NATIVE}", "-o",
         tmp_path / name, *sources, *BASE],
        check=True,
    )  # fmt: skip


def test_the_watchdog_resets_the_chip_unless_it_is_serviced(new_peripheral: Callable[..., Peripheral]) -> None:
    cop = new_peripheral("cop")
    cop.write({"COP_CTRL": 0x0140, "COP_TOUT": 99})
    cop.write({"COP_CTRL": 0x0142})  # bus clock / 16
    cop.run(1000)
    cop.write({"COP_CNTR": 0x5555})
    cop.write({"COP_CNTR": 0xAAAA})
    cop.run(2599)
    assert cop.called("reset") == []
    assert cop.lib.rig_next(cop.rig) == 2600
    cop.lib.cop_event(cop.ffi.addressof(cop.peripheral), 0)
    assert cop.called("reset") == [(2599, cop.lib.RESET_COP)]


def test_converters_sample_in_pairs_after_a_sync_pulse(new_peripheral: Callable[..., Peripheral]) -> None:
    adc = new_peripheral("adc")
    adc.peripheral.connected = 0xFFFF
    adc.write({"ADC_PWR": 0x01A0, "ADC_CTRL2": 0x0044, "ADC_SDIS": 0xFCFC, "ADC_PWR2": 0x040F})
    adc.run(200)
    adc.write({"ADC_CTRL1": 0x1805})
    adc.lib.adc_sync(adc.ffi.addressof(adc.peripheral), 0)
    adc.run(400)
    assert adc.called("convert") == [(213, 0), (213, 8), (243, 1), (243, 9)]
    assert [adc.read(f"ADC_RSLT{n}") for n in (0, 1, 8, 9)] == [8 * code for code in (0, 100, 800, 900)]
    assert adc.requested(30)  # ADC_CC0


def test_a_timer_counts_the_edges_of_an_encoder(new_peripheral: Callable[..., Peripheral]) -> None:
    timer = new_peripheral("qtmr")
    timer.write({"TMRA0_CTRL": 0x8080})  # quadrature, A at input 0, B at input 1
    inputs = [(0, True), (1, True), (0, False), (1, False), (0, True)]
    for clock, (pin, level) in enumerate(inputs, 1):
        timer.run(clock)
        timer.lib.qtmr_input(timer.ffi.addressof(timer.peripheral), 0, pin, level, clock)
    assert timer.read("TMRA0_CNTR") == len(inputs)
    assert timer.called("crossbar") == []


def test_a_timer_on_the_bus_clock_drives_its_output(new_peripheral: Callable[..., Peripheral]) -> None:
    timer = new_peripheral("qtmr")
    timer.write({"TMRA2_COMP1": 9, "TMRA2_CTRL": 0x3023})  # bus clock, LENGTH, toggle
    timer.run(30)
    assert timer.called("crossbar") == [(9, 38, 18, 1), (19, 38, 18, 0), (29, 38, 18, 1)]


def test_the_crossbar_passes_a_trigger_to_the_converter(new_peripheral: Callable[..., Peripheral]) -> None:
    xbar = new_peripheral("xbar")
    xbar.write({"XBARA_SEL6": 20})  # PWMA0_TRG0 to ADC_SYNC0
    for source in (20, 21):
        xbar.lib.xbar_signal(xbar.ffi.addressof(xbar.peripheral), source, -1, xbar.lib.XBAR_PULSE)
    assert xbar.called("adc_sync") == [(0, 0)]


def test_a_pwm_inserts_dead_time_at_both_edges(new_peripheral: Callable[..., Peripheral]) -> None:
    pwm = new_peripheral("pwm")
    pwm.peripheral.module[0].sub[0].pin = [pwm.lib.GATE_PWM] * 2
    pwm.write({"PWMA0_INIT": 0, "PWMA0_VAL1": 999, "PWMA0_VAL2": 200, "PWMA0_VAL3": 600, "PWMA0_DTCNT0": 50,
               "PWMA0_DTCNT1": 50, "PWMA0_DISMAP0": 0, "PWMA_OUTEN": 0x0110})  # fmt: skip
    pwm.write({"PWMA_MCTRL": 0x0001})
    pwm.write({"PWMA_MCTRL": 0x0100})
    pwm.calls.clear()
    pwm.run(999)
    assert pwm.called("set_gates") == [(200, 0, 0, 0), (250, 0, 0, 1), (600, 0, 0, 0), (650, 0, 0, 2)]
