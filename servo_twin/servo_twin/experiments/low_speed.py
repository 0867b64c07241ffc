"""Closed-loop ripple at very low speed, plain M/T against enhanced M/T with the same gains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.catalogue import AXES, axis_name

from servo_twin.experiments.outcome import Bound, Curve, Outcome, Panel, Row
from servo_twin.experiments.rig import RPM, TICK, Recording, choose_mode, command_speed, features, spinning, watch
from servo_twin.plant import PlantConfig

NAME: Final = "low-speed"
HELP: Final = """\
Speed control at 1, 5 and 20 rpm, once with plain, once with enhanced M/T, the gains as they are.
The reference design says: the stagnation of M/T spoils the steady state at very low speed unless the gains are lowered
(2.4.5); the enhanced method makes it better (2.4.6). It gives no figures; the two are judged against each other."""

SPEEDS: Final = (1.0, 5.0, 20.0)  # [rpm]
SETTLE: Final = 1.0  # [s]
MEASURED: Final = 4.0  # [s]
WINDOW: Final = 1.0
"""Ripple is the mean over windows of this length: the highest of all peaks would be chance [s]."""

RARE: Final = 10.0
"""Below, an edge of track B comes every six slow loops at most: here the enhanced method has to help [rpm]."""

CHANCE: Final = 1.1
"""Allowed ratio where both methods see the same edges."""

MEAN_WORSE_MOST: Final = 1.0  # [% of the set-point]


@dataclass(frozen=True)
class Ripple:
    """One run at one speed.

    Attributes
    ----------
    mean : float
        True mean speed [rad/s].
    ripple : float
        Half the way from the lowest to the highest true speed, over the mean.
    rms : float
        Root mean square of the deviation from the set-point, over the set-point.
    recording : Recording
        The measured part.
    """

    mean: float
    ripple: float
    rms: float
    recording: Recording


def hold_speed(plant: PlantConfig, seed: int, axis: int, speed: float, enhanced: bool) -> Ripple:
    """Closed loop at a constant set-point [rad/s]."""
    with spinning(plant, seed) as board:
        features(board, axis, ENHANCED_MT=enhanced)
        choose_mode(board, axis, "SPEED")
        command_speed(board, axis, speed)
        recording = watch(board, [axis], SETTLE + MEASURED)[axis].part(SETTLE)
    windows = recording.omega.reshape(-1, round(WINDOW / TICK))
    mean = float(recording.omega.mean())
    span = float(np.ptp(windows, axis=1).mean())
    rms = float(np.sqrt(np.mean((recording.omega - speed) ** 2)) / speed)
    return Ripple(mean, 0.5 * span / max(abs(mean), 1e-3 * speed), rms, recording)


def run(plant: PlantConfig, seed: int) -> Outcome:
    """Every speed, both axes, both methods."""
    rows: list[Row] = []
    notes = ["ripple: half of highest minus lowest true speed, over the true mean; the same gains in both runs"]
    panels: list[Panel] = []
    for rpm in SPEEDS:
        for axis in range(AXES):
            plain = hold_speed(plant, seed, axis, rpm * RPM, enhanced=False)
            better = hold_speed(plant, seed, axis, rpm * RPM, enhanced=True)
            what = f"{axis_name(axis)} {rpm:g} rpm"
            rows.extend(_rows(what, rpm, plain, better))
            notes.append(
                f"{what}: ripple {plain.ripple:.3g} plain, {better.ripple:.3g} enhanced; true mean "
                f"{plain.mean / RPM:.3g} and {better.mean / RPM:.3g} rpm; rms deviation from the set-point "
                f"{100 * plain.rms:.3g} and {100 * better.rms:.3g} %"
            )
            if axis == 0:
                panels.append(_panel(what, rpm, plain, better))
    return Outcome(NAME, tuple(rows), tuple(panels), tuple(notes))


def _rows(what: str, rpm: float, plain: Ripple, better: Ripple) -> tuple[Row, Row]:
    ratio = better.ripple / max(plain.ripple, 1e-9)
    set_point = rpm * RPM
    worse = 100.0 * (abs(better.mean / set_point - 1.0) - abs(plain.mean / set_point - 1.0))
    rare = rpm < RARE
    says = "2.4.6: better when edges are rare" if rare else "2.4.6: no difference when edges come often"
    return (
        Row(f"{what}, ripple enhanced over plain", says, ratio, "", Bound(most=1.0 if rare else CHANCE)),
        Row(f"{what}, error of the mean, enhanced minus plain", says, worse, "%", Bound(most=MEAN_WORSE_MOST)),
    )


def _panel(title: str, rpm: float, plain: Ripple, better: Ripple) -> Panel:
    curves: list[Curve] = []
    for label, ripple in (("plain M/T", plain), ("enhanced M/T", better)):
        part = ripple.recording.part(SETTLE, SETTLE + 1.0)
        curves.append(Curve(label, part.time - SETTLE, part.omega / RPM))
    time = curves[0].x
    curves.append(Curve("set-point", time, np.full(time.size, rpm), "k--"))
    return Panel(f"{title}: true speed", "time [s]", "speed [rpm]", tuple(curves))
