"""Test signals of the board (firmware/doc/test-signals.md) in numbers of a measurement. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from servo_msgs_py.measurement.access import BoardAccess, MeasurementError, step_of

FAST_POINTS: Final = ("I_D", "I_Q")
"""Points of the fast loop, which call once per PWM period; the others call once per slow tick."""


@dataclass(frozen=True)
class SweptSine:
    """A sine whose frequency grows exponentially."""

    point: str  # what it is added to: a name of ``test_point_t``
    amplitude: float  # [A] or [rad/s], by the point
    f_min: float  # frequency at its beginning [Hz]
    f_max: float  # frequency at its end [Hz]
    seconds: float  # its length [s]

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
        """Turns of the sine in the first call [1]."""
        return self.f_min * self.period

    @property
    def growth(self) -> float:
        """Relative growth of the step per call, for a sine that ends after whole turns: `f_max` or a little less."""
        ratio = self.f_max / self.f_min
        if ratio <= 1.0:
            return 0.0
        whole = math.floor(self._turns(ratio))
        low, high = 1.0, ratio
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._turns(middle) < whole else (low, middle)
        return math.expm1(math.log(high) / self.calls)

    def _turns(self, ratio: float) -> float:
        """Turns of all calls when the frequency grows by this factor."""
        if ratio <= 1.0 + 1e-12:
            return self.step * self.calls
        growth = math.expm1(math.log(ratio) / self.calls)
        return self.step * (ratio - 1.0) / growth


def full_scale(access: BoardAccess, point: str) -> float:
    """What 1.0 of a test signal stands for [A], [rad/s]."""
    scale = access.catalogue["axis1.speed" if point == "SPEED" else "axis1.i_q"].full_scale
    assert scale is not None
    return scale


def _numbers(access: BoardAccess, signal: SweptSine) -> dict[str, float]:
    """What is written for a test signal, by variable."""
    return {
        "cmd.test_amplitude": signal.amplitude / full_scale(access, signal.point),
        "cmd.test_step": signal.step,
        "cmd.test_growth": signal.growth,
        "cmd.test_calls": signal.calls,
    }


def refuse_test_signal(access: BoardAccess, signal: SweptSine) -> None:
    """Raise a `MeasurementError` if the board cannot make a test signal; names the number that it cannot."""
    for name, value in _numbers(access, signal).items():
        try:
            access.catalogue[name].to_raw(value)
        except ValueError as error:
            text = f"{signal.amplitude:.3g}, {signal.f_min:.3g} .. {signal.f_max:.3g} Hz in {signal.seconds:.3g} s"
            raise MeasurementError(
                f"the board cannot make the test signal ({text}): {error}; give another amplitude or band"
            ) from None


def prepare_test_signal(access: BoardAccess, axis: int, signal: SweptSine) -> None:
    """Write a test signal without starting it.

    Raises
    ------
    ValueError
        If the board cannot make it; names the number that it cannot. See `refuse_test_signal`.
    """
    for name, value in _numbers(access, signal).items():
        access.write(name, [value], axis)


def start_test_signal(access: BoardAccess, axis: int, point: str) -> None:
    """Start the signal that has been written."""
    access.write("cmd.test_point", [access.catalogue.enums["test_point_t"][point]], axis)


def end_test_signal(access: BoardAccess, axis: int) -> None:
    """End a signal that runs."""
    start_test_signal(access, axis, "NONE")
