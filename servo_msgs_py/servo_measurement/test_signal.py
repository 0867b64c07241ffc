"""Test signals of the board (firmware/doc/test-signals.md) in SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from servo_measurement.access import BoardAccess, MeasurementError, step_of

TRIGGER: Final = "test_point"
"""Variable of an axis that is above zero while its test signal is active."""

FAST_POINTS: Final = ("I_D", "I_Q")
"""Inputs in the fast loop, called once per PWM period; the others are called once per slow tick."""


@dataclass(frozen=True)
class SweptSine:
    """A sine with exponentially increasing frequency."""

    point: str  # input, a name of ``test_point_t``
    amplitude: float  # [A] or [rad/s], depending on the input
    f_min: float  # initial frequency [Hz]
    f_max: float  # final frequency [Hz]
    seconds: float  # length [s]

    @property
    def period(self) -> float:
        """Time between two calls [s]."""
        return step_of(1, self.point not in FAST_POINTS)

    @property
    def calls(self) -> int:
        """Length in calls."""
        return max(round(self.seconds / self.period), 1)

    @property
    def step(self) -> float:
        """Cycles of the sine in the first call [1]."""
        return self.f_min * self.period

    @property
    def growth(self) -> float:
        """Relative growth of the step per call, for a whole number of cycles; final frequency: at most `f_max`."""
        ratio = self.f_max / self.f_min
        if ratio <= 1.0:
            return 0.0
        whole = math.floor(self._cycles(ratio))
        low, high = 1.0, ratio
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._cycles(middle) < whole else (low, middle)
        return math.expm1(math.log(high) / self.calls)

    def _cycles(self, ratio: float) -> float:
        """Cycles in all calls for this ratio of final to initial frequency."""
        if ratio <= 1.0 + 1e-12:
            return self.step * self.calls
        growth = math.expm1(math.log(ratio) / self.calls)
        return self.step * (ratio - 1.0) / growth


def full_scale(access: BoardAccess, point: str) -> float:
    """Full scale of a test signal [A], [rad/s]."""
    scale = access.catalogue["axis1.speed" if point == "SPEED" else "axis1.i_q"].full_scale
    assert scale is not None
    return scale


def _numbers(access: BoardAccess, signal: SweptSine) -> dict[str, float]:
    """Values of the variables of a test signal."""
    return {
        "cmd.test_amplitude": signal.amplitude / full_scale(access, signal.point),
        "cmd.test_step": signal.step,
        "cmd.test_growth": signal.growth,
        "cmd.test_calls": signal.calls,
    }


def refuse_test_signal(access: BoardAccess, signal: SweptSine) -> None:
    """Raise a `MeasurementError` if the board cannot generate a test signal; the message contains the invalid value."""
    for name, value in _numbers(access, signal).items():
        try:
            access.catalogue[name].to_raw(value)
        except ValueError as error:
            text = f"{signal.amplitude:.3g}, {signal.f_min:.3g} .. {signal.f_max:.3g} Hz in {signal.seconds:.3g} s"
            raise MeasurementError(
                f"the board cannot generate the test signal ({text}): {error}; use another amplitude or band"
            ) from None


def prepare_test_signal(access: BoardAccess, axis: int, signal: SweptSine) -> None:
    """Write a test signal without starting it.

    Raises
    ------
    ValueError
        If the board cannot generate it; the message contains the invalid value. See `refuse_test_signal`.
    """
    for name, value in _numbers(access, signal).items():
        access.write(name, [value], axis)


def start_test_signal(access: BoardAccess, axis: int, point: str) -> None:
    """Start the prepared signal."""
    access.write("cmd.test_point", [access.catalogue.enums["test_point_t"][point]], axis)


def end_test_signal(access: BoardAccess, axis: int) -> None:
    """End the active signal."""
    start_test_signal(access, axis, "NONE")
