"""Report of sensorless operation."""

from __future__ import annotations

import math
from collections.abc import Iterator

from servo_tuning.layout import hertz, notes, phase, ratio, table
from servo_tuning.linear import Pole
from servo_tuning.sensorless_figures import SensorlessFigures
from servo_tuning.tuned import Tuned


def sensorless_text(design: Tuned, figures: SensorlessFigures) -> Iterator[str]:
    """Sections about the observer of the back-EMF, the PLL and the start-up."""
    yield f"  without an encoder (feedback after reset: {figures.feedback})"
    if figures.trouble is not None:
        yield f"    NOT POSSIBLE {figures.trouble}"
        return
    observer, constants = design.sensorless.observer, design.constants
    rates = [value / design.board.period for value in (observer.k1, observer.k2)]
    yield from notes(
        [
            (
                "K1, K2",
                f"{rates[0]:.4g} 1/s, {rates[1]:.4g} V/(A s)",
                "of the differential equations of the ST document",
            ),
            ("F1, F2", f"2^{constants['observer.f1']}, 2^{constants['observer.f2']}", "scales of current and back-EMF"),
        ]
    )
    blind = f"below {figures.blind_speed:.4g} rad/s the drop of limits.current in a warm winding exceeds it (braking)"
    yield from notes([("back-EMF", f"{design.axis('motor.pole_pairs') * design.axis('motor.psi_m'):.4g} V s", blind)])
    yield "  observer poles; K1 and K2 as above, other windings"
    yield from _poles(figures)
    yield f"  error of the observed angle at {design.axis('motor.rated_current'):g} A with other windings"
    yield from _errors(figures)
    yield "  phase-locked loop and sensorless speed loop"
    yield from _locks(figures)
    yield "  start-up"
    yield from _start_up(design)


def _winding(r_s: float, inductance: float) -> str:
    parts = [f"{name} x {value:g}" for name, value in (("R", r_s), ("L", inductance)) if value != 1.0]
    return ", ".join(parts) or "nominal"


def _pole(pole: Pole) -> tuple[str, str, str]:
    z = f"{pole.z.real:.4f} {'-' if pole.z.imag < 0.0 else '+'} {abs(pole.z.imag):.4f}i"
    return z, f"{abs(pole.z):.4f}", hertz(-math.log(abs(pole.z)) * pole.frequency / _size(pole))


def _size(pole: Pole) -> float:
    """Magnitude of ln z."""
    return math.hypot(math.log(abs(pole.z)), math.atan2(pole.z.imag, pole.z.real))


def _poles(figures: SensorlessFigures) -> Iterator[str]:
    rows = [("winding", "speed", "z", "|z|", "decay rate", "z", "|z|", "decay rate")]
    for entry in figures.poles:
        slow, fast = (_pole(pole) for pole in entry.poles)
        last = fast[2] if all(abs(pole.z) < 1.0 for pole in entry.poles) else "UNSTABLE"
        speed = f"{entry.speed:g} rad/s"
        rows.append((_winding(entry.r_s, entry.inductance), speed, *slow, *fast[:2], last))
    return table(rows)


def _errors(figures: SensorlessFigures) -> Iterator[str]:
    speeds = sorted({entry.speed for entry in figures.errors})
    rows = [("winding", *(f"{speed:.4g} rad/s" for speed in speeds))]
    windings = dict.fromkeys((entry.r_s, entry.inductance) for entry in figures.errors)
    for winding in windings:
        found = {entry.speed: entry.degrees for entry in figures.errors if (entry.r_s, entry.inductance) == winding}
        rows.append((_winding(*winding), *(_error(found[speed]) for speed in speeds)))
    return table(rows)


def _error(degrees: float) -> str:
    """Text of an angle error; above 90 deg the torque is reversed."""
    return f"{degrees:+.2f} deg" if abs(degrees) < 90.0 else "LOST"


def _locks(figures: SensorlessFigures) -> Iterator[str]:
    head = ("speed", "back-EMF", "omega_n", "damping", "with ST's P", "crossover", "phase margin", "gain margin")
    rows = [(*head, "half and twice J")]
    for lock in figures.locks:
        stable = (lock.half_inertia, lock.twice_inertia)
        rows.append(
            (
                f"{lock.speed:.4g} rad/s",
                f"{lock.back_emf:.3g} V",
                hertz(lock.frequency),
                f"{lock.damping:.2f}",
                f"{lock.slide_damping:.2f}",
                hertz(lock.speed_margins.crossover),
                phase(lock.speed_margins),
                ratio(lock.speed_margins.gain),
                ", ".join("stable" if good else "UNSTABLE" for good in stable),
            )
        )
    return table(rows)


def _start_up(design: Tuned) -> Iterator[str]:
    s = design.sensorless.start_up
    share = f"with friction {100.0 * s.torque:.0f} % of the torque of the current, at most"
    mean = [design.axis(f"start_up.mean_{key}") * s.speed_final for key in ("min", "max")]
    fifo = 64.0 * design.axis("reliability.period") * design.board.tick
    tests = f"{design.axis('start_up.consecutive_tests'):g} tests in a row"
    return notes(
        [
            ("current", f"{s.current_first:.3g} .. {s.current_final:.3g} A", f"in {s.current_time:.3g} s"),
            ("speed", f"0 .. {s.speed_final:.4g} rad/s", f"in {s.speed_time:.3g} s"),
            ("acceleration", f"{s.acceleration:.4g} rad/s^2", share),
            ("rotor oscillation", hertz(s.swing / 2.0 / math.pi), f"damped by {s.damping:.3g} A/V across the vector"),
            (
                "success at a mean of",
                f"{mean[0]:.4g} .. {mean[1]:.4g} rad/s",
                f"above {s.minimum_speed:.4g} rad/s, {tests}",
            ),
            ("mean and variance of", f"{1e3 * fifo:.4g} ms", "64 speeds"),
            ("fails after", f"{s.time_max:.3g} s", ""),
        ]
    )
