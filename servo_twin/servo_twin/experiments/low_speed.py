"""Closed-loop ripple at very low speed, plain M/T against enhanced M/T with the same gains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.catalogue import AXES, axis_name

from servo_twin.experiments.outcome import Bound, Curve, Outcome, Panel, Row
from servo_twin.experiments.rig import COUNT, RPM, Recording, choose_mode, command_speed, features, spinning, watch
from servo_twin.plant import PlantConfig

NAME: Final = "low-speed"
HELP: Final = """\
Speed control at 1, 5 and 20 rpm, once with plain, once with enhanced M/T, the gains as they are.
The reference design says: the stagnation of M/T spoils the steady state at very low speed unless the gains are lowered
(2.4.5); the enhanced method makes it better (2.4.6). It gives no figures; the two are judged against each other, by the
root mean square of the true speed's deviation. The true mean has to be the set-point whatever the method."""

SPEEDS: Final = (1.0, 5.0, 20.0)  # [rpm]
SETTLE: Final = 1.0  # [s]
MEASURED: Final = 4.0  # [s]

RARE: Final = 10.0
"""Below, an edge of track B comes every six slow loops at most: here the enhanced method has to help [rpm]."""

BETTER_MOST: Final = 0.9
"""Deviation with the enhanced method over that with the plain one, at the speed at which it helps most."""

CHANCE: Final = 1.25
"""The same at any speed: where both methods see the same edges, the rest is noise."""

WAY_MOST: Final = 8.0
"""The shaft is so far from where the set-point wants it, at the most, after the time measured [counts]."""


@dataclass(frozen=True)
class Run:
    """One run at one speed.

    Attributes
    ----------
    mean : float
        True mean speed [rad/s].
    rms : float
        Root mean square of the deviation from the set-point, over the set-point.
    recording : Recording
        The measured part.
    """

    mean: float
    rms: float
    recording: Recording


def hold_speed(plant: PlantConfig, seed: int, axis: int, speed: float, enhanced: bool) -> Run:
    """Closed loop at a constant set-point [rad/s]."""
    with spinning(plant, seed) as board:
        features(board, axis, ENHANCED_MT=enhanced)
        choose_mode(board, axis, "SPEED")
        command_speed(board, axis, speed)
        recording = watch(board, [axis], SETTLE + MEASURED)[axis].part(SETTLE)
    rms = float(np.sqrt(np.mean((recording.omega - speed) ** 2)) / speed)
    return Run(float(recording.omega.mean()), rms, recording)


def run(plant: PlantConfig, seed: int) -> Outcome:
    """Every speed, both axes, both methods."""
    rows: list[Row] = []
    notes = ["deviation: root mean square of true speed - set-point, over the set-point; the same gains in both runs"]
    panels: list[Panel] = []
    for axis in range(AXES):
        rare: list[float] = []
        for rpm in SPEEDS:
            plain, better = (hold_speed(plant, seed, axis, rpm * RPM, enhanced) for enhanced in (False, True))
            what = f"{axis_name(axis)} {rpm:g} rpm"
            ratio = better.rms / max(plain.rms, 1e-9)
            if rpm < RARE:
                rare.append(ratio)
            rows.extend(_rows(what, rpm, ratio, better))
            notes.append(
                f"{what}: deviation {100 * plain.rms:.3g} % plain, {100 * better.rms:.3g} % enhanced; true mean "
                f"{plain.mean / RPM:.3g} and {better.mean / RPM:.3g} rpm"
            )
            if axis == 0:
                panels.append(_panel(what, rpm, plain, better))
        best = f"{axis_name(axis)}, where it helps most, deviation enhanced over plain"
        rows.append(Row(best, "2.4.6: better when edges are rare", min(rare), "", Bound(most=BETTER_MOST)))
    return Outcome(NAME, tuple(rows), tuple(panels), tuple(notes))


def _rows(what: str, rpm: float, ratio: float, better: Run) -> tuple[Row, Row]:
    says = "2.4.6: better" if rpm < RARE else "2.4.6: no difference when edges come often"
    lost = abs(better.mean - rpm * RPM) * MEASURED / COUNT
    return (
        Row(f"{what}, deviation enhanced over plain", says, ratio, "", Bound(most=CHANCE)),
        Row(f"{what}, way lost with enhanced", "not shown", lost, "counts", Bound(most=WAY_MOST)),
    )


def _panel(title: str, rpm: float, plain: Run, better: Run) -> Panel:
    curves: list[Curve] = []
    for label, ripple in (("plain M/T", plain), ("enhanced M/T", better)):
        part = ripple.recording.part(SETTLE, SETTLE + 1.0)
        curves.append(Curve(label, part.time - SETTLE, part.omega / RPM))
    time = curves[0].x
    curves.append(Curve("set-point", time, np.full(time.size, rpm), "k--"))
    return Panel(f"{title}: true speed", "time [s]", "speed [rpm]", tuple(curves))
