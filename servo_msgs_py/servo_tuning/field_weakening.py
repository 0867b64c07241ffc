"""Field weakening: integers of its controller, stability of its loops, and the available torque."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol

import numpy as np
from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.catalogue import Catalogue

from servo_tuning.configuration import Axis, Board, Scales
from servo_tuning.conversion import Converter, Value
from servo_tuning.errors import either
from servo_tuning.layout import notes, table

_LARGEST: Final = ("field_weakening.current_use", "field_weakening.magnet_current")
_STEPS: Final = 201  # values of i_d in the search for the largest torque
_SHARE_MAX: Final = 1.0 - 2.0**-15
_SPEEDS: Final = (0.6, 0.7, 0.8, 0.9, 1.0)  # of the rated speed, in the report


def i_d_max(axis: Axis) -> float:
    """Largest current against the flux, limited by the current limit and the magnets [A]."""
    share = axis("field_weakening.current_use") * axis("limits.current")
    return min(share, axis("field_weakening.magnet_current"))


def _voltage_per_current(axis: Axis, board: Board) -> tuple[float, float]:
    """Largest change of the voltage by i_d and by i_q, at the speed whose back-EMF equals the voltage limit [V/A]."""
    omega = board.voltage_max / axis("motor.psi_m")
    across = omega * axis("motor.l_q")
    leaning = min(across * axis("limits.current") / board.voltage_max, 1.0)  # fraction of the voltage in the d axis
    return omega * axis("motor.l_d"), axis("motor.r_s") + across * leaning


def field_weakening_constants(to: Converter) -> dict[str, Value]:
    """Fields of ``field_weakening_config_t``.

    The integral gain gives the bandwidth at the speed whose back-EMF equals the voltage limit; below it the loop is
    slower in proportion to the speed. The gain is limited to the range of its format; the report shows the result.
    """
    axis, board, s = to.axis, to.board, to.s
    by_d, by_q = _voltage_per_current(axis, board)
    integral = 2.0 * math.pi * axis("field_weakening.bandwidth") * board.tick / by_d
    gain = integral / (2.0 * board.voltage_max) * s.u_s**2 / s.i
    group = "field_weakening"
    return {
        f"{group}.margin": to.at("field_weakening.margin", 1.0 / s.u_s),
        f"{group}.gain": to.of("gain of field weakening", min(max(gain, 2.0**-8), 127.0), "correct motor.l_d"),
        f"{group}.i_d_max": to.of("largest i_d against the flux", i_d_max(axis) / s.i, *map(either, _LARGEST)),
        f"{group}.q_share": to.of("i_q in the place of i_d", min(max(by_d / by_q, 2.0**-15), _SHARE_MAX)),
    }


# ---- torque within the limits of voltage and current -----------------------------------------------------------------


class Motor(Protocol):
    """Motor data of the voltage equations; the plant of the twin has them, too."""

    @property
    def r_s(self) -> float:
        """Resistance of a phase [ohm]."""

    @property
    def l_d(self) -> float:
        """Inductance of the d axis [H]."""

    @property
    def l_q(self) -> float:
        """Inductance of the q axis [H]."""

    @property
    def psi_m(self) -> float:
        """Flux linkage of the magnets [V s]."""

    @property
    def pole_pairs(self) -> float:
        """Pole pairs."""


class _Nominal(NamedTuple):
    """Motor data of the configuration."""

    r_s: float  # resistance of a phase [ohm]
    l_d: float  # inductance, d axis [H]
    l_q: float  # inductance, q axis [H]
    psi_m: float  # flux linkage of the magnets [V s]
    pole_pairs: float  # electrical turns per mechanical turn

    @classmethod
    def of(cls, axis: Axis) -> _Nominal:
        return cls(*(axis(f"motor.{name}") for name in cls._fields))


class LargestTorque(NamedTuple):
    """Largest motoring torque at one speed."""

    i_d: float  # [A]
    i_q: float  # [A]
    torque: float  # of the air gap [N m]; 0 if the voltage is too low for any current


def largest_torque(motor: Motor, limit: float, speed: float, voltage: float, i_d_min: float) -> LargestTorque:
    """Largest torque at a speed with ``|u| <= voltage``, ``|i| <= limit`` and ``i_d_min <= i_d <= 0``.

    Parameters
    ----------
    motor : Motor
        Motor data.
    limit : float
        Largest magnitude of the current vector [A].
    speed : float
        Mechanical speed [rad/s].
    voltage : float
        Largest stator voltage [V].
    i_d_min : float
        Smallest i_d, at most 0 [A]; 0: without field weakening.
    """
    p, psi, r_s, l_d, l_q = motor.pole_pairs, motor.psi_m, motor.r_s, motor.l_d, motor.l_q
    omega = p * speed
    d = np.linspace(min(i_d_min, 0.0), 0.0, _STEPS)
    # (R i_d - w L_q i_q)^2 + (R i_q + w (psi + L_d i_d))^2 = u^2, for i_q
    a = r_s**2 + (omega * l_q) ** 2
    b = r_s * omega * (psi + (l_d - l_q) * d)
    c = (r_s * d) ** 2 + (omega * (psi + l_d * d)) ** 2 - voltage**2
    square = b**2 - a * c
    by_voltage = (np.sqrt(np.maximum(square, 0.0)) - b) / a
    q = np.minimum(by_voltage, np.sqrt(np.maximum(limit**2 - d**2, 0.0)))
    q[(square < 0.0) | (q < 0.0)] = 0.0
    torque = 1.5 * p * q * (psi + (l_d - l_q) * d)
    best = int(torque.argmax())
    return LargestTorque(float(d[best]), float(q[best]), float(torque[best]))


def top_speed(motor: Motor, limit: float, voltage: float, i_d_min: float, torque: Callable[[float], float]) -> float:
    """Highest speed at which the available torque exceeds `torque(speed)` [rad/s], to 0.1 %."""
    low, high = 0.0, 2.0 * voltage / (motor.pole_pairs * motor.psi_m)
    while high - low > 1e-3 * high:
        middle = 0.5 * (low + high)
        if largest_torque(motor, limit, middle, voltage, i_d_min).torque > torque(middle):
            low = middle
        else:
            high = middle
    return low


def idle_speed(axis: Axis, board: Board) -> float:
    """Highest no-load speed at the nominal bus voltage, with field weakening if it is on after reset [rad/s]."""
    flux, voltage = axis("motor.psi_m"), board.voltage_max
    if axis.features["field_weakening"]:
        flux = max(flux - axis("motor.l_d") * i_d_max(axis), 0.5 * flux)
        voltage -= axis("field_weakening.margin")
    return voltage / (axis("motor.pole_pairs") * flux)


# ---- the loop --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Loop:
    """Integrator with one tick of delay, ``K z^-1 / (z - 1)``."""

    gain: float  # K, of the open loop per tick
    tick: float  # [s]

    @property
    def stable(self) -> bool:
        return self.gain < 1.0

    @property
    def turn(self) -> float:
        """Crossover frequency times tick [rad]."""
        return 2.0 * math.asin(min(0.5 * self.gain, 1.0))

    @property
    def crossover(self) -> float:
        """Crossover frequency [Hz]."""
        return self.turn / self.tick / (2.0 * math.pi)

    @property
    def phase(self) -> float:
        """Phase margin [deg]."""
        return 90.0 - math.degrees(1.5 * self.turn)


def field_weakening_loops(axis: Axis, board: Board, block: Mapping[str, int]) -> dict[str, Loop]:
    """Return the loops with the integer gains: by i_d, by i_d while i_q is on the current circle, and by i_q.

    On the circle i_q decreases by i_d / i_q of the increase of i_d, most at the largest i_d.
    """
    by_d, by_q = _voltage_per_current(axis, board)
    s, table = Scales.of(Catalogue.load()), AxisConfigTable.load()
    per_volt = table.value("field_weakening.gain", block) * s.i / s.u_s**2 * 2.0 * board.voltage_max
    q_share = table.value("field_weakening.q_share", block)
    limit, maximum = axis("limits.current"), i_d_max(axis)
    giving_way = maximum / math.sqrt(max(limit**2 - maximum**2, (0.01 * limit) ** 2))
    gains = {"by i_d": by_d, "by i_d on the circle": by_d + giving_way * by_q, "by i_q": q_share * by_q}
    return {name: Loop(per_volt * gain, board.tick) for name, gain in gains.items()}


def field_weakening_text(axis: Axis, board: Board, block: Mapping[str, int]) -> Iterator[str]:
    """Yield the lines of the report: loops, and torque over speed. `block` has the integers of the axis."""
    yield "  field weakening"
    maximum, margin = i_d_max(axis), axis("field_weakening.margin")
    rows = [
        (
            "largest i_d",
            f"{maximum:.2f} A",
            f"lowers the back-EMF by {_lowered(axis, maximum):.2f} V at the rated speed",
        ),
        ("voltage reserve", f"{margin:g} V", f"of {board.voltage_max:.2f} V at {board('nominal_voltage'):g} V"),
    ]
    for name, loop in field_weakening_loops(axis, board, block).items():
        state = f"phase margin {loop.phase:.1f} deg, gain margin {1.0 / loop.gain:.1f}" if loop.stable else "UNSTABLE"
        rows.append((f"loop {name}", f"{loop.crossover:.4g} Hz", state))
    yield from notes(rows)
    yield from table(_torque_table(axis, board))


def _lowered(axis: Axis, current: float) -> float:
    return axis("motor.pole_pairs") * axis("motor.rated_speed") * axis("motor.l_d") * current


def _torque_table(axis: Axis, board: Board) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [("speed", "torque without", "torque with", "i_d", "i_q")]
    motor, limit = _Nominal.of(axis), axis("limits.current")
    for part in _SPEEDS:
        speed = part * axis("motor.rated_speed")
        without = largest_torque(motor, limit, speed, board.voltage_max, 0.0)
        best = largest_torque(motor, limit, speed, board.voltage_max - axis("field_weakening.margin"), -i_d_max(axis))
        cells = (f"{1e3 * without.torque:.1f} mN m", f"{1e3 * best.torque:.1f} mN m")
        rows.append((f"{speed:.4g} rad/s", *cells, f"{best.i_d:.2f} A", f"{best.i_q:.2f} A"))
    return rows
