"""Pole pairs, encoder direction and gains of the current sensors from a rotating current vector."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.trace import Trace

from servo_measurement.access import MeasurementError
from servo_measurement.least_squares import Floats, fit_linear
from servo_measurement.motor_values import Estimate

PAIRS_OFF_MAX: Final = 0.12
"""Largest distance from an integer of the number of pole pairs with a rotor that follows."""


class NotFollowingError(MeasurementError):
    """The shaft does not follow a rotating vector."""


@dataclass(frozen=True)
class VectorFollowing:
    """Rotation of the shaft with a rotating vector."""

    pole_pairs: int
    direction: int  # 1: the encoder counts upwards with the phase sequence a, b, c; -1: downwards
    measured: float  # electrical per mechanical revolutions, before rounding


def follow_vector(position: Floats, theta_e: Floats) -> VectorFollowing:
    """Pole pairs and direction from a rotation of the vector.

    Parameters
    ----------
    position : ndarray
        Position of the shaft [rad].
    theta_e : ndarray
        Angle of the vector [rad].

    Raises
    ------
    NotFollowingError
        If the shaft has not followed the vector.
    """
    usable = np.isfinite(position) & np.isfinite(theta_e)
    electrical = np.unwrap(theta_e[usable])
    shaft = position[usable]
    (slope, _), covariance, rms = fit_linear(np.column_stack([electrical, np.ones_like(electrical)]), shaft)
    rotation = slope * float(np.ptp(electrical))
    if abs(rotation) < 0.2 * float(np.ptp(electrical)) / 50.0:
        raise NotFollowingError(
            "the shaft does not follow the rotating vector: it is blocked, the current is too small, or the "
            "encoder is defective"
        )
    measured = 1.0 / abs(slope)
    pairs = round(measured)
    if pairs < 1 or abs(measured - pairs) > PAIRS_OFF_MAX * max(1.0, pairs / 4.0):
        raise NotFollowingError(
            f"{measured:.2f} electrical revolutions per revolution of the shaft are not an integer: the rotor slips,"
            " the shaft is temporarily blocked, or encoder.lines is wrong"
        )
    del covariance, rms
    return VectorFollowing(pairs, 1 if slope > 0 else -1, measured)


def sensor_errors(recordings: list[Trace], axis: str, r: float) -> dict[str, Estimate]:
    """Gain of phase a over b and c (ratio) and offsets [A], with the resistance `r` [ohm].

    A current that is measured too small is controlled to be too large; the voltage of the phase reveals the actual
    current. An offset causes one period per electrical revolution of the imposed frame, a gain error two.
    """
    rows: list[Floats] = []
    values: list[Floats] = []
    for recording in recordings:
        theta, u_d, i_d = (recording[f"{axis}.{name}"] for name in ("test_angle", "u_d", "i_d"))
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
    errors = np.sqrt(np.diag(covariance)) * 3.0  # neighbouring samples are correlated
    mean = float(x[0])
    return {
        "offset_alpha": Estimate(-float(x[1]) / r, float(errors[1]) / r),
        "offset_beta": Estimate(-float(x[2]) / r, float(errors[2]) / r),
        "gain_ratio": Estimate(1.0 - 2.0 * float(x[3]) / mean, 2.0 * float(errors[3]) / mean),
    }
