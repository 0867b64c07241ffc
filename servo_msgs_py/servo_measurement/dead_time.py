"""Smallest current of a test: phase currents that vanish in the dead time of the switches hide the winding."""

from __future__ import annotations

from typing import Final

from servo_msgs_py.rounding import rounded_up
from servo_tuning.errors import higher

from servo_measurement.access import MeasurementError
from servo_measurement.motor_values import Limits

BAND: Final = "dead time"
"""What these refusals are about."""

BAND_MAX: Final = 0.25
"""Largest range in which the voltage lost in a leg depends on its current, relative to the current limit. With 0.28 and
more, errors of resistance and inductance were 5 % to several times the value."""
BAND_LEFT: Final = 0.55
"""Range, relative to the largest current, below which the current of phase a leaves it."""
LOST_MIN: Final = 0.7
"""Smallest lost voltage of a fit, relative to the nominal one, of phase currents that leave the range."""
BAND_MARGIN: Final = 1.5
"""Margin of a remedy: the range grows with the ripple, and with it the current."""

ESTIMATE_MARGIN: Final = 1.5
"""The same for the value of `band_of`, which is an upper estimate."""


def check_band(band: float, estimate: float, current: float, limits: Limits, maximum: float, *, complete: bool) -> None:
    """Check that the phase currents are above the range in which the voltage lost in a leg is uncertain.

    Parameters
    ----------
    band : float
        This range [A]; it is too small if the phase currents do not leave it.
    estimate : float
        Another value of it, for the remedy: that of `band_of` [A]; it is too large if they leave it.
    current : float
        Largest current of the test, reduced if the voltage is too low for `limits.current` [A].
    limits : Limits
        Of the user.
    maximum : float
        Largest current of the board [A].
    complete : bool
        Whether the fit that gave `band` has found the lost voltage.

    Raises
    ------
    MeasurementError
        If the current is too small, with one that is enough, if it is known and the board can do it.
    """
    if current >= band / BAND_MAX:
        return
    left = complete and band < BAND_LEFT * current
    needed = (BAND_MARGIN * band if left else ESTIMATE_MARGIN * max(band, estimate)) / BAND_MAX
    text = f"phase currents up to {band:.2g} A vanish in the dead time of the switches"
    if current < limits.current:
        text = f"{text}, and {current:.2g} A take the voltage: the board cannot measure this winding"
        raise MeasurementError(text, about=BAND)
    if needed < maximum:
        raise MeasurementError(text, higher("--current", min(rounded_up(needed), maximum)), about=BAND)
    others = "use a supply of a lower voltage", "add inductance to the motor cable"
    if limits.current < maximum:
        untold = f"whether the {maximum:g} A of the board are enough cannot be told with {current:.2g} A"
        raise MeasurementError(f"{text}, and {untold}", "use more current", *others, about=BAND)
    text = f"{text}, and {maximum:g} A, the largest current of the board, are not enough"
    raise MeasurementError(text, *others, about=BAND)


def band_of(slope: float, lost_voltage: float) -> float:
    """Range of sign changes [A] from the change of the voltage of a vector with its current, all within this range.

    Parameters
    ----------
    slope : float
        Voltage over current [ohm]: 3/2 of the lost voltage over the range.
    lost_voltage : float
        Voltage lost in a leg with full current [V].
    """
    return 1.5 * lost_voltage / slope
