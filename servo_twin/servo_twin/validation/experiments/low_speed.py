"""Closed-loop ripple at very low speed, plain M/T against enhanced M/T with the same gains."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.trace import Trace

from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments.outcome import NOT_SHOWN, Curve, Item, Judge, Panel, experiment
from servo_twin.validation.experiments.rig import COUNT, RPM, record, set_up, spinning

NAME: Final = "low-speed"
HELP: Final = """\
Speed control at 1, 5 and 20 rpm, with plain and with enhanced M/T, with unchanged gains. According to the reference
design the stagnation of M/T impairs the steady state at very low speed unless the gains are lowered (2.4.5), and the
enhanced method improves it (2.4.6). It gives no figures; the two are compared by the root mean square of the deviation
of the true speed. The true mean speed has to equal the set-point with both methods."""

SPEEDS: Final = (1.0, 5.0, 20.0)  # [rpm]
SETTLE: Final = 1.0  # [s]
MEASURED: Final = 4.0  # [s]

RARE_EDGES: Final = 10.0
"""Below this speed, with at most one edge of track B per six slow loops, the enhanced method must be better [rpm]."""

DEVIATION_RATIO_MAX: Final = 0.9
"""Permitted ratio of the deviations, enhanced to plain, at the most favourable speed."""

NOISE_RATIO_MAX: Final = 1.25
"""Permitted ratio of the deviations at any speed: with the same edges, the difference is noise."""

POSITION_ERROR_MAX: Final = 8.0
"""Permitted position error after the measured time [counts]."""


def hold_speed(plant: PlantConfig, seed: int, axis: int, speed: float, enhanced: bool) -> Trace:
    """Closed loop at a constant set-point [rad/s], after settling."""
    with spinning(plant, seed) as board:
        set_up(board, axis, "SPEED", speed, ENHANCED_MT=enhanced)
        return record(board, [axis], SETTLE + MEASURED)[axis].part(SETTLE)


def deviation(recording: Trace, speed: float) -> float:
    """RMS deviation of the true speed, relative to the set-point [1]."""
    return float(np.sqrt(np.mean((recording["omega"] - speed) ** 2)) / speed)


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Every speed, both axes, both methods."""
    yield "deviation: root mean square of true speed - set-point, over the set-point; the same gains in both runs"
    for axis in range(AXES):
        rare: list[float] = []
        for rpm in SPEEDS:
            what, speed = f"{axis_name(axis)} {rpm:g} rpm", rpm * RPM
            plain, better = both = [hold_speed(plant, seed, axis, speed, enhanced) for enhanced in (False, True)]
            rms, means = [deviation(r, speed) for r in both], [float(r["omega"].mean()) for r in both]
            ratio = rms[1] / max(rms[0], 1e-9)
            if rpm < RARE_EDGES:
                rare.append(ratio)
            reference = "2.4.6: better" if rpm < RARE_EDGES else "2.4.6: no difference when edges come often"
            position_error = abs(means[1] - speed) * MEASURED / COUNT
            judge = Judge(f"{what}, ", NOT_SHOWN)
            yield judge("deviation, enhanced / plain", ratio, maximum=NOISE_RATIO_MAX, reference=reference)
            yield judge("position error with enhanced M/T", position_error, "counts", maximum=POSITION_ERROR_MAX)
            yield (
                f"{what}: deviation {100 * rms[0]:.3g} % plain, {100 * rms[1]:.3g} % enhanced; true mean "
                f"{means[0] / RPM:.3g} and {means[1] / RPM:.3g} rpm"
            )
            if axis == 0:
                yield _panel(what, rpm, plain, better)
        judge = Judge(f"{axis_name(axis)}, largest improvement, ", "2.4.6: better when edges are rare")
        yield judge("deviation, enhanced / plain", min(rare), maximum=DEVIATION_RATIO_MAX)


def _panel(title: str, rpm: float, plain: Trace, better: Trace) -> Panel:
    parts = {"plain M/T": plain.part(SETTLE, SETTLE + 1.0), "enhanced M/T": better.part(SETTLE, SETTLE + 1.0)}
    curves = [Curve(label, part.time - SETTLE, part["omega"] / RPM) for label, part in parts.items()]
    time = curves[0].x
    curves.append(Curve("set-point", time, np.full(time.size, rpm), "k--"))
    return Panel(f"{title}: true speed", "time [s]", "speed [rpm]", curves)
