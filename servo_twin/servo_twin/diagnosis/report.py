"""Findings and estimates as text."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime
from typing import Final

from servo_msgs_py.units import PERIOD_NS

from servo_twin.diagnosis.change_detector import Estimate, Finding, Kind
from servo_twin.diagnosis.monitor import SUPPLY, LocatedFinding

NOTHING_CHANGED: Final = "nothing has changed"

_WORDS: Final = {
    "resistance": "resistance",
    "flux": "magnet flux",
    "inertia": "inertia",
    "friction": "friction",
    "load": "load",
    "encoder_angle": "encoder angle",
    SUPPLY: "supply voltage",
}
_ABSOLUTE: Final = {"load": (1e3, "mN m"), "encoder_angle": (180.0 / math.pi, "deg electrical")}
"""Changes that are not factors: scale and unit."""


def _quantity(name: str, unknown: float) -> float:
    """Reported quantity for an unknown of the equations: a factor, [N m], or [rad]; the angle is at most 90 degrees."""
    if name == "encoder_angle":
        return math.asin(min(max(unknown, -1.0), 1.0))
    return unknown if name in _ABSOLUTE else 1.0 + unknown


def _size(name: str, value: float, low: float, high: float) -> str:
    width = high - low  # of the unknown: that of an angle at 90 degrees would be zero
    value, low, high = (_quantity(name, x) for x in (value, low, high))
    if name in _ABSOLUTE:
        scale, unit = _ABSOLUTE[name]
        middle, minimum, maximum = (_rounded(scale * x, scale * width) for x in (value, low, high))
        return f"{middle} {unit} ({minimum}..{maximum})"
    middle, minimum, maximum = (_rounded(max(x, 0.0), width, sign=False) for x in (value, low, high))
    return f"{middle} times ({minimum}..{maximum})"


def _rounded(value: float, width: float, *, sign: bool = True) -> str:
    """Value with the significant digits for an interval of this width."""
    digits = min(max(-math.floor(math.log10(max(width, 1e-9))), 0), 4)
    return f"{value:+.{digits}f}" if sign else f"{value:.{digits}f}"


def finding_text(finding: Finding, tick: int, stamp_ns: int) -> str:
    """A finding as text.

    Parameters
    ----------
    finding : Finding
    tick, stamp_ns : int
        Tick and time stamp of any sample, to convert ticks to time of day.
    """
    since = datetime.fromtimestamp((stamp_ns - (tick - finding.since) * PERIOD_NS) * 1e-9)
    delay = (finding.detected - finding.since) * PERIOD_NS * 1e-9
    comma = "" if finding.kind is Kind.SINGLE else ","
    return f"{change_text(finding)}{comma} since {since:%H:%M:%S}, detected after {delay:.1f} s"


def change_text(finding: Finding) -> str:
    """What has changed, without the time."""
    names = [_WORDS[name] for name in finding.changes]
    if finding.kind is Kind.UNKNOWN:
        return "unknown cause of the residual"
    if finding.kind is Kind.SEVERAL:
        return f"several changes, {' and '.join(names)} among them"
    size = _size(finding.changes[0], finding.value, finding.low, finding.high)
    if finding.kind is Kind.ONE_OF:
        return f"{' or '.join(names)}, not distinguishable with this motion; as {names[0]} {size}"
    return f"{names[0]} {size}"


def findings_text(findings: Sequence[LocatedFinding], joints: Sequence[str], tick: int, stamp_ns: int) -> str:
    """All findings in one line."""
    if not findings:
        return NOTHING_CHANGED
    return "; ".join(
        f"{'bus' if one.axis is None else joints[one.axis]}: {finding_text(one.finding, tick, stamp_ns)}"
        for one in findings
    )


def estimate_text(estimate: Estimate) -> str:
    """Value and interval; "not excited yet" without excitation."""
    if not math.isfinite(estimate.half_width):
        return "not excited yet"
    value, half = estimate.value, estimate.half_width
    return _size(estimate.name, value, value - half, value + half)


def estimate_numbers(estimate: Estimate) -> dict[str, float]:
    """``value``, ``low`` and ``high``: a factor, or [N m], or [rad]; empty without excitation."""
    if not math.isfinite(estimate.half_width):
        return {}
    half = estimate.half_width
    unknowns = {"value": estimate.value, "low": estimate.value - half, "high": estimate.value + half}
    return {part: _quantity(estimate.name, unknown) for part, unknown in unknowns.items()}
