"""The register-level port on a fake chip (``fake_chip.c``), and its register names in Python."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from firmware_compiler import FIRMWARE, CompileC

PORT = FIRMWARE / "port" / "mc56f84789"

SOURCES = [
    "test/fake_chip.c",
    *(f"port/mc56f84789/{name}" for name in sorted(path.name for path in PORT.glob("*.c"))),
]

CDEF = """
typedef struct { uint16_t first, second; } adc_pair_t;
typedef struct { uint16_t count, time; } edge_capture_t;
typedef struct { int kind; uint32_t address; uint16_t value; } fake_access_t;
typedef struct {
    uint16_t memory[65536]; fake_access_t access[8192]; int accesses; uint16_t data[16]; int data_in, data_out;
    bool takes_edge; edge_capture_t taken; int slip;
} fake_chip_t;
typedef ... hal_t;
typedef ... servo_t;
fake_chip_t *fake_new(void);
void fake_free(fake_chip_t *chip);
hal_t *fake_hal(fake_chip_t *chip);
void fake_baud(fake_chip_t *chip, uint32_t baud);
servo_t *fake_servo(fake_chip_t *chip);
void fake_receive(fake_chip_t *chip, uint8_t byte);
bool port_init(hal_t *hal, servo_t *servo);
void port_isr(hal_t *hal, uint16_t vector);
void hal_adc_select(hal_t *hal, uint16_t axis, int pair);
adc_pair_t hal_adc_currents(hal_t *hal, uint16_t axis);
adc_pair_t hal_adc_offsets(hal_t *hal, uint16_t axis);
uint16_t hal_adc_bus(hal_t *hal);
void hal_pwm_duty(hal_t *hal, uint16_t axis, int16_t duty_a, int16_t duty_b, int16_t duty_c);
void hal_pwm_enable(hal_t *hal, uint16_t axis, bool on);
bool hal_break_active(hal_t *hal, uint16_t axis);
uint16_t hal_late_loops(hal_t *hal);
void hal_break_clear(hal_t *hal, uint16_t axis);
uint16_t hal_inputs(hal_t *hal, uint16_t axis);
void hal_enable_input(hal_t *hal, uint16_t axis, bool used);
void hal_holding_brake(hal_t *hal, uint16_t axis, bool release);
uint16_t hal_encoder_count(hal_t *hal, uint16_t axis);
void hal_encoder_preset(hal_t *hal, uint16_t axis, uint16_t count);
uint16_t hal_index_count(hal_t *hal, uint16_t axis);
void hal_capture_arm(hal_t *hal, uint16_t axis);
bool hal_capture_take(hal_t *hal, uint16_t axis, edge_capture_t *capture);
uint32_t hal_edge_age(hal_t *hal, uint16_t axis);
bool hal_serial_get(hal_t *hal, uint8_t *byte);
bool hal_serial_put(hal_t *hal, uint8_t byte);
void hal_watchdog_service(hal_t *hal);
bool hal_flash_present(hal_t *hal);
uint32_t hal_flash_read(hal_t *hal, uint16_t word);
void hal_flash_erase(hal_t *hal, uint16_t sector);
void hal_flash_program(hal_t *hal, uint16_t word, uint32_t value);
int hal_flash_result(hal_t *hal);
"""

READ, WRITE, INTERRUPTS, SERVO = range(4)
INIT, M1, M2, EDGE, BREAK = range(5)

PWM = (0xE600, 0xE700)
TMR = (0xE140, 0xE180)
GPIO = {port: 0xE200 + 0x10 * i for i, port in enumerate("ABCDEFG")}


class Access(NamedTuple):
    """One entry of the fake chip's list."""

    kind: int
    address: int
    value: int


class FakeBoard:
    """The port, initialised or not, with every access that it makes."""

    def __init__(self, compile_c: CompileC, initialised: bool = True) -> None:
        self.ffi, self.lib = compile_c("port", SOURCES, CDEF, ["CHIP_ON_HOST"])
        self.chip = self.ffi.gc(self.lib.fake_new(), self.lib.fake_free)
        self.hal = self.lib.fake_hal(self.chip)
        if initialised:
            assert self.init()

    def init(self) -> bool:
        return bool(self.lib.port_init(self.hal, self.lib.fake_servo(self.chip)))

    def isr(self, vector: int) -> list[Access]:
        """Everything that the handler of a vector does."""
        self.forget()
        self.lib.port_isr(self.hal, vector)
        return self.accesses

    def forget(self) -> None:
        self.chip.accesses = 0

    @property
    def accesses(self) -> list[Access]:
        return [Access(a.kind, a.address, a.value) for a in self.chip.access[0 : self.chip.accesses]]

    @property
    def writes(self) -> list[tuple[int, int]]:
        return [(a.address, a.value) for a in self.accesses if a.kind == WRITE]

    def writes_of(self, address: int) -> list[int]:
        return [value for register, value in self.writes if register == address]

    def __getitem__(self, address: int) -> int:
        return int(self.chip.memory[address])

    def __setitem__(self, address: int, value: int) -> None:
        self.chip.memory[address] = value

    def results(self, ready: int, codes: dict[int, int]) -> None:
        """Fill result registers as the converter does, left-aligned in bits 14:3."""
        for sample, code in codes.items():
            self[0xE50E + sample] = code << 3
        self[0xE50A] = ready


def pairs(axis: int) -> Iterator[int]:
    """The three parallel pairs that are converted at the low-side centre of an axis."""
    return iter(range(3 * axis, 3 * axis + 3))


def names_of(header: Path) -> Sequence[str]:
    """Object-like macros of a header."""
    return re.findall(r"^#define (\w+) ", header.read_text(encoding="ascii"), re.MULTILINE)
