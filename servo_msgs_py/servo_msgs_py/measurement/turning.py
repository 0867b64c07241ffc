"""Pole pairs, encoder direction, flux and gains of the current sensors from a vector that turns. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from servo_msgs_py.measurement.access import MeasurementError, Recording
from servo_msgs_py.measurement.least_squares import Floats, fit_linear
from servo_msgs_py.measurement.motor_values import Estimate

PAIRS_OFF_MAX: Final = 0.12
"""Distance from a whole number that says that the rotor has not followed."""


@dataclass(frozen=True)
class Turning:
    """What a turning vector shows."""

    pole_pairs: int
    direction: int  # 1: the encoder counts upwards when the phases follow each other as a, b, c; -1: downwards
    measured: float  # electrical turns per turn of the shaft, before rounding


def turning(position: Floats, theta_e: Floats) -> Turning:
    """Pole pairs and direction from a turn of the vector.

    Parameters
    ----------
    position : ndarray
        Of the shaft [rad].
    theta_e : ndarray
        Angle of the vector [rad].

    Raises
    ------
    MeasurementError
        If the shaft has not followed it.
    """
    usable = np.isfinite(position) & np.isfinite(theta_e)
    electrical = np.unwrap(theta_e[usable])
    shaft = position[usable]
    (slope, _), covariance, rms = fit_linear(np.column_stack([electrical, np.ones_like(electrical)]), shaft)
    turned = slope * float(np.ptp(electrical))
    if abs(turned) < 0.2 * float(np.ptp(electrical)) / 50.0:
        raise MeasurementError(
            "the shaft does not follow the turning vector: it is held, needs more current, or the encoder is dead"
        )
    measured = 1.0 / abs(slope)
    pairs = round(measured)
    if pairs < 1 or abs(measured - pairs) > PAIRS_OFF_MAX * max(1.0, pairs / 4.0):
        raise MeasurementError(
            f"{measured:.2f} electrical turns per turn of the shaft are no whole number: the rotor slips,"
            " the shaft is held for a part of the way, or encoder.lines is wrong"
        )
    del covariance, rms
    return Turning(pairs, 1 if slope > 0 else -1, measured)


def sensor_errors(recordings: list[Recording], axis: str, r: float) -> dict[str, Estimate]:
    """Gain of phase a over b and c (ratio) and offsets [A], with the resistance `r` [ohm].

    A current that is measured too small is made too large: the voltage along a phase shows the current that flows.
    Once per electrical turn of the imposed frame is an offset, twice is a gain.
    """
    rows: list[Floats] = []
    values: list[Floats] = []
    for recording in recordings:
        theta, u_d, i_d = (recording.columns[f"{axis}.{name}"] for name in ("test_angle", "u_d", "i_d"))
        usable = np.isfinite(theta) & np.isfinite(u_d) & np.isfinite(i_d)
        theta, u_d, i_d = theta[usable], u_d[usable], i_d[usable]
        level = np.ones_like(theta)
        rows.append(
            np.column_stack(
                [level, np.cos(theta), np.sin(theta), np.cos(2 * theta), np.sin(2 * theta), np.cos(6 * theta)]
            )
        )
        values.append(u_d - r * (i_d - float(i_d.mean())))
    x, covariance, _ = fit_linear(np.vstack(rows), np.concatenate(values))
    errors = np.sqrt(np.diag(covariance)) * 3.0  # neighbouring samples are not independent
    mean = float(x[0])
    return {
        "offset_alpha": Estimate(-float(x[1]) / r, float(errors[1]) / r),
        "offset_beta": Estimate(-float(x[2]) / r, float(errors[2]) / r),
        "gain_ratio": Estimate(1.0 - 2.0 * float(x[3]) / mean, 2.0 * float(errors[3]) / mean),
    }
