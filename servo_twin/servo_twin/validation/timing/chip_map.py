"""Resources of the chip used by the servo (DRM 4.3): submodules, vectors, registers of the start."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

PHASES: Final = ((0, 1, 2), (4, 5, 6))
"""Submodules (4 * module + submodule) of the phases a, b, c of both motors."""

VECTOR_M1: Final = 85
"""PWMA SM1, compare (VAL5)."""
VECTOR_M2: Final = 30
"""ADC, end of scan."""
VECTOR_START: Final = 87
"""PWMA SM0, compare (VAL5)."""

SLOTS: Final = {
    0: "with slow loop",
    1: "with protection",
    2: "with estimates",
    3: "with checks",
    4: "with current monitors",
    5: "with encoder monitor",
    6: "with test signal and supervision",
    7: "with latch",
}
"""Tasks after the fast loops in the PWM periods of a slow tick (firmware/app/servo.c)."""


@dataclass(frozen=True)
class Loop:
    """One of the two fast loops."""

    name: str
    vector: int
    phases: tuple[int, ...]  # submodules
    sample: int  # number of the first sample of the motor
    release: int  # address of MCTRL; LDOK releases the duties
    outputs: int  # address of OUTEN


LOOPS: Final = (
    Loop("M1", VECTOR_M1, PHASES[0], 0, 0xE6C4, 0xE6C0),
    Loop("M2", VECTOR_M2, PHASES[1], 3, 0xE7C4, 0xE7C0),
)

_SM0_A, _SM1_A, _SM0_B = 0xE600, 0xE630, 0xE700
_STS, _INTEN, _TCTRL = 0x12, 0x13, 0x15
_VAL4, _VAL5 = 1 << 4, 1 << 5

START_STEPS: Final = (
    ("clear the flag of PWMA SM1 VAL5", _SM1_A + _STS, _VAL5),
    ("enable the trigger of PWMA SM1 VAL4", _SM1_A + _TCTRL, _VAL4),
    ("enable the interrupt of PWMA SM1 VAL5", _SM1_A + _INTEN, _VAL5),
    ("enable the trigger of PWMB SM0 VAL4", _SM0_B + _TCTRL, _VAL4),
    ("clear the flag of PWMA SM0 VAL5", _SM0_A + _STS, _VAL5),
    ("disable the interrupt of PWMA SM0 VAL5", _SM0_A + _INTEN, 0),
)
"""Steps of the start interrupt, in order: step, address, written value (DRM 4.3.3)."""
