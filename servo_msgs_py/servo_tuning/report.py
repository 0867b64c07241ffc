"""Report of the tuning tool, as text and as JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

from servo_msgs_py.units import COUNTS_PER_TURN

from servo_tuning.assessment import Assessment, assess
from servo_tuning.configuration import Configuration
from servo_tuning.errors import Problem
from servo_tuning.field_weakening import field_weakening_text
from servo_tuning.findings import K_V_T_MAX, findings
from servo_tuning.layout import factor, hertz, notes, phase, table
from servo_tuning.sensorless_report import sensorless_text
from servo_tuning.tuned import Tuned, tuned
from servo_tuning.winding import Winding

MODEL: Final = """\
Model: sampled loops with the integer gains and the nominal motor.
Duties are loaded half a PWM period after their sample and held for one period. M/T: the measured speed is the mean over
a slow period whose middle is 1.5 slow periods old; below about 10 rad/s this delay depends on the speed (last table).
Observer: errors of more than a count. Small signals: no limit active, no change of direction."""


@dataclass(frozen=True)
class AxisReport:
    """Gains, figures and findings of one axis."""

    tuned: Tuned
    figures: Assessment
    findings: Sequence[Problem]


def axis_reports(configuration: Configuration) -> list[AxisReport]:
    """Compute the report of every axis.

    Raises
    ------
    ConfigError
        If an axis cannot work.
    """
    result = []
    for axis in configuration.axes:
        design = tuned(axis, configuration)
        figures = assess(design)
        result.append(AxisReport(design, figures, findings(design, figures)))
    return result


# ---- JSON -----------------------------------------------------------------------------------------------------------


def _plain(value: Any) -> Any:
    """Value for JSON: complex numbers as pairs, tuples as lists."""
    if isinstance(value, complex):
        return [value.real, value.imag]
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return value


def as_dict(reports: Iterable[AxisReport]) -> dict[str, Any]:
    """All figures by axis; SI units, frequencies in Hz, margins in degrees and as factors."""
    return {
        report.figures.name: {
            "gains": {row.name: row._asdict() for row in report.tuned.rows()},
            **_plain(asdict(report.figures)),
            "findings": list(map(str, report.findings)),
        }
        for report in reports
    }


# ---- text -----------------------------------------------------------------------------------------------------------


def text(reports: Iterable[AxisReport]) -> str:
    """All figures as text."""
    pages = ["\n".join(_axis(report)) for report in reports]
    return "\n\n".join([*pages, MODEL]) + "\n"


def _axis(report: AxisReport) -> Iterator[str]:
    design, figures = report.tuned, report.figures
    speed = "the speed observer" if design.observed else "M/T"
    yield f"{figures.name}: {len(report.findings) or 'no'} warning{'' if len(report.findings) == 1 else 's'}"
    yield f"    speed from {speed} after reset; position gain, moves and loads below use it"
    yield from (f"    WARNING {finding}" for finding in report.findings)
    yield "  gains"
    yield from _gains(design)
    yield "  loops"
    yield from _loops(figures)
    for name in (loop.name for loop in figures.loops[2:]):
        yield f"  closed-loop poles, {name}"
        yield from _poles(figures, name)
    yield "  position gain"
    yield from _rule(figures)
    yield "  moves and loads"
    yield from _moves(design, figures)
    yield "  winding"
    yield from _winding(design)
    for observed, how in ((False, "M/T"), (True, "speed observer")):
        yield f"  same gains with other inertias, {how}"
        yield from _inertias(figures, observed)
    yield "  speed loop at low speed (rare encoder edges), M/T"
    yield from _edges(figures)
    yield from field_weakening_text(design.axis, design.board, design.block)
    yield from sensorless_text(design, figures.sensorless)


def _gains(design: Tuned) -> Iterator[str]:
    rows = [("", "designed", "as used", "", "integer")]
    rows += [(row.name, f"{row.designed:.6g}", f"{row.used:.6g}", row.unit, str(row.raw)) for row in design.rows()]
    return table(rows)


def _loops(figures: Assessment) -> Iterator[str]:
    rows = [("", "designed", "crossover", "phase margin", "gain margin", "-3 dB", "peak")]
    for loop in figures.loops:
        rows.append(
            (
                loop.name,
                hertz(loop.wanted),
                hertz(loop.margins.crossover),
                phase(loop.margins),
                factor(loop.margins.gain),
                hertz(loop.tracking.bandwidth),
                f"{loop.tracking.peak:.3f}",
            )
        )
    return table(rows)


def _poles(figures: Assessment, name: str) -> Iterator[str]:
    rows = [("z", "|z|", "as s", "damping")]
    for loop in figures.loops:
        if loop.name == name:
            for pole in loop.poles:
                z = f"{pole.z.real:.4f} +- {pole.z.imag:.4f}i" if pole.pair else f"{pole.z.real:.4f}"
                rows.append((z, f"{abs(pole.z):.4f}", hertz(pole.frequency), f"{pole.damping:.3f}"))
    return table(rows)


def _rule(figures: Assessment) -> Iterator[str]:
    rule = figures.rule
    verdict = "no overshoot" if rule.k_v_t <= K_V_T_MAX else "will overshoot"
    maximum = f"largest for K_v T <= {K_V_T_MAX:g}: {K_V_T_MAX / rule.t_n_tuned:.4g} 1/s"
    rows = [
        ("T_N of E43, rotor alone", f"{1e3 * rule.t_n_rotor:.2f} ms", "speed from 0 to rated at rated torque"),
        ("T_N of E43, whole shaft", f"{1e3 * rule.t_n_shaft:.2f} ms", ""),
        ("Kp of E45 from that", f"{rule.k_p:.2f} rpm/rad", f"K_v = {rule.k_v_rule:.2f} 1/s, Kv T = 0.5: damping 0.707"),
        ("T_N of the tuned speed loop", f"{1e3 * rule.t_n_tuned:.2f} ms", "1 / crossover"),
        ("K_v chosen", f"{rule.k_v:.4g} 1/s", maximum),
        ("K_v T", f"{rule.k_v_t:.3f}", verdict),
    ]
    return notes(rows)


def _moves(design: Tuned, figures: Assessment) -> Iterator[str]:
    reach, arrival, load = figures.reach, figures.arrival, figures.load_step
    axis, counts = design.axis, COUNTS_PER_TURN / (2.0 * math.pi)
    limit, speed = axis("limits.current"), axis("limits.speed")
    feature = ", ".join(key for key, on in axis.features.items() if on)
    rows = [
        (
            "path omega_n",
            f"{reach.path_omega_n:.4g} rad/s",
            f"largest acceleration {reach.path_acceleration:.4g} rad/s^2",
        ),
        ("current of the path", f"{reach.path_current:.2f} A", f"of {limit:g} A"),
        ("current of the speed ramp", f"{reach.ramp_current:.2f} A", f"{axis('limits.acceleration'):g} rad/s^2"),
        ("current against friction", f"{reach.friction_current:.3f} A", f"at {speed:g} rad/s"),
        ("top speed, no load", f"{reach.speed_idle:.4g} rad/s", f"at {design.board('nominal_voltage'):g} V"),
        ("top speed, rated current", f"{reach.speed_rated:.4g} rad/s", f"{axis('motor.rated_current'):g} A"),
        ("lag at the speed limit", f"{arrival.lag:.3f} rad", f"at {speed:g} rad/s, without speed_forward"),
        ("overshoot, bare step", f"{100.0 * arrival.bare:.2f} %", "of a position step without shaping"),
        ("overshoot, shaped move", f"{arrival.shaped:.2f} counts", f"from {speed:g} rad/s, limits not reached"),
        ("load step", f"{load.torque:.4g} N m", f"displaces the shaft by {load.deflection * counts:.0f} counts"),
        (
            "stiffness",
            f"{load.stiffness:.3g} N m/rad",
            f"within a tenth of the displacement after {1e3 * load.recovery:.0f} ms",
        ),
        (
            "oscillations found",
            f"{design.oscillation_swing:.3g} A",
            f"and more, peak to peak; none with i_q_limit below {design.oscillation_swing / 2.0:.3g} A",
        ),
        ("on after reset", "", feature or "nothing"),
    ]
    return notes(rows)


def _winding(design: Tuned) -> Iterator[str]:
    axis, model = design.axis, Winding.of(design.axis)
    current, celsius = model.settled()
    given = "" if axis.given("winding.thermal_resistance") else "from motor.rated_current and winding.maximum"
    full = f"{model.current:g} A from {model.ambient:g} deg C"
    rows = [
        ("thermal resistance", f"{model.resistance:.4g} K/W", given),
        ("time constant", _time(model.resistance * model.capacity), f"of {model.capacity:g} J/K"),
        ("full current until derating", _time(model.time_to(model.derating, model.current)), full),
        ("rated current continuously", _celsius(model.equilibrium(model.rated)), f"{model.rated:g} A"),
        ("largest current continuously", _celsius(celsius), f"derated to {current:.3g} A by the feature winding_model"),
    ]
    return notes(rows)


def _time(seconds: float) -> str:
    return f"{seconds:.3g} s" if math.isfinite(seconds) else "unlimited"


def _celsius(celsius: float) -> str:
    return f"{celsius:.4g} deg C" if math.isfinite(celsius) else "unlimited"


def _inertias(figures: Assessment, observed: bool) -> Iterator[str]:
    rows = [("inertia", "speed crossover", "phase margin", "gain margin", "position step overshoots")]
    for case in (case for case in figures.inertias if case.observed == observed):
        cells = ("UNSTABLE", "-", "-")
        if case.stable and case.overshoot is not None:
            cells = (phase(case.margins), factor(case.margins.gain), f"{100.0 * case.overshoot:.1f} %")
        rows.append((f"x {case.factor:g}", hertz(case.margins.crossover), *cells))
    return table(rows)


def _edges(figures: Assessment) -> Iterator[str]:
    rows = [("speed", "phase margin", "gain margin")]
    for speed, margins in figures.edges:
        steady = margins.phase is not None and margins.phase > 0.0
        cells = (phase(margins), factor(margins.gain)) if steady else ("none: unstable", "-")
        rows.append((f"{speed:g} rad/s", *cells))
    return table(rows)
