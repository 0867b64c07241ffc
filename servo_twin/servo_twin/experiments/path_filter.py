"""F23 and F24: the path filter makes an S curve out of a ramp."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.units import COUNTS_PER_TURN

from servo_twin.experiments.outcome import Bound, Curve, Outcome, Panel, Row
from servo_twin.experiments.plant_limits import current_limits, move_speeds
from servo_twin.experiments.rig import COUNT, TICK, Recording, command_position, position_of, set_axis, spinning, watch
from servo_twin.plant import PlantConfig

NAME: Final = "path-filter"
HELP: Final = """\
One position step of axis 1, which the firmware turns into a ramp and the ramp into an S curve (2.6, E38 to E40). The
acceleration limit, which the reference design has not, is at its maximum.
The reference design shows: position smooth at beginning and end (F23); the speed of the ramp jumps, that of the S curve
changes evenly (F24); damping 1, hence no overshoot."""

AXIS: Final = 0
TURNS: Final = 10.0
REST: Final = 0.6  # recorded after the end of the ramp [s]


def analytic(time: NDArray[np.float64], speed: float, duration: float, omega_n: float) -> NDArray[np.float64]:
    """E38's answer to a ramp of `speed` that ends after `duration`.

    Parameters
    ----------
    time : ndarray
        Since the beginning of the ramp [s].
    speed : float
        Slope of the ramp, any unit per second.
    duration : float
        Length of the ramp [s].
    omega_n : float
        Natural frequency [rad/s].
    """

    def ramp(t: NDArray[np.float64]) -> NDArray[np.float64]:
        t = np.maximum(t, 0.0)
        settled = t - 2.0 / omega_n
        return np.asarray(speed * (settled + (t + 2.0 / omega_n) * np.exp(-omega_n * t)))

    return ramp(time) - ramp(time - duration)


def fit_omega_n(time: NDArray[np.float64], path: NDArray[np.float64], speed: float, duration: float) -> float:
    """Natural frequency that explains a path best [rad/s]: golden section of the squared error."""

    def misfit(omega_n: float) -> float:
        return float(np.sum((analytic(time, speed, duration, omega_n) - path) ** 2))

    low, high = 5.0, 500.0
    golden = 0.5 * (5.0**0.5 - 1.0)
    for _ in range(80):
        a, b = high - golden * (high - low), low + golden * (high - low)
        low, high = (low, b) if misfit(a) < misfit(b) else (a, high)
    return 0.5 * (low + high)


def record(plant: PlantConfig, seed: int, limit: float) -> tuple[Recording, float, int]:
    """One long move with a speed limit [rad/s]: recording, that limit [counts/s] and distance [counts]."""
    with spinning(plant, seed) as board:
        start = position_of(board, AXIS)
        distance = round(TURNS * COUNTS_PER_TURN)
        set_axis(board, "param.speed_limit", AXIS, limit)
        set_axis(board, "param.acceleration_limit", AXIS, board.catalogue["param.acceleration_limit"].maximum)
        limits = board.read("param.speed_limit")
        assert isinstance(limits, list)
        speed = limits[AXIS] / COUNT

        def act(k: int) -> None:
            if k == 0:
                command_position(board, AXIS, start + distance)

        recording = watch(board, [AXIS], distance / speed + REST, act)[AXIS]
    return recording, speed, distance


def judge(recording: Recording, speed: float, distance: int, axis_limit: float) -> tuple[Row, ...]:
    """Rows for a path; `axis_limit` is the acceleration that the drive can give [counts/s^2]."""
    duration = distance / speed
    path = recording.position_ref - (recording.position_ref[-1] - distance)
    omega_n = fit_omega_n(recording.time, path, speed, duration)
    ideal = analytic(recording.time, speed, duration, omega_n)
    ramp = np.minimum(speed * recording.time, float(distance))
    # The set-point comes in whole counts: its slope over five ticks is as fine as a fifth of a count per tick.
    slope = (path[5:] - path[:-5]) / (5.0 * TICK)
    misfit = float(np.abs(ideal - path).max())
    return (
        Row(
            "largest jump of the ramp's speed per slow loop",
            "F24: steps at both ends",
            _jump(ramp, speed),
            "of v",
            Bound(0.5, 1.0 + 1e-6),
        ),
        Row(
            "largest jump of the S curve's speed per slow loop",
            "F24: changes evenly",
            _jump(path, speed),
            "of v",
            Bound(most=0.1),
        ),
        Row("S curve against E38", "E38, damping 1", misfit / distance, "of the way", Bound(most=0.01)),
        Row(
            "overshoot of the S curve",
            "E38: damping 1",
            float(max(path.max() - distance, 0.0)),
            "counts",
            Bound(0.0, 0.0),
        ),
        Row("end of the S curve", "F23: arrives", float(abs(path[-1] - distance)), "counts", Bound(0.0, 0.0)),
        Row("steps backwards", "F23: monotonous", float(np.count_nonzero(np.diff(path) < 0.0)), "", Bound(0.0, 0.0)),
        Row(
            "highest speed of the S curve",
            "F24: that of the ramp",
            float(slope.max() / speed),
            "of v",
            Bound(0.95, 1.02),
        ),
        Row(
            "acceleration asked for",
            "E38: v omega_n / e",
            speed * omega_n / np.e / axis_limit,
            "of the drive's",
            Bound(most=1.0),
        ),
    )


def _jump(path: NDArray[np.float64], speed: float) -> float:
    """Largest change of speed from one slow loop to the next, from standstill on, over the speed of the ramp."""
    steps = np.diff(path, prepend=[0.0, 0.0])
    return float(np.abs(np.diff(steps)).max() / (speed * TICK))


def run(plant: PlantConfig, seed: int) -> Outcome:
    """One long move."""
    axis = plant.axes[AXIS]
    speeds, lowered = move_speeds(plant, seed, together=False)
    recording, speed, distance = record(plant, seed, speeds[AXIS])
    most = current_limits(plant, seed)[AXIS]
    able = (axis.torque_constant * most - axis.friction) / axis.inertia / COUNT
    rows = judge(recording, speed, distance, able)
    start = recording.position_ref[-1] - distance
    ramp = np.minimum(speed * recording.time, float(distance))
    path = recording.position_ref - start
    turn = float(COUNTS_PER_TURN)
    panels = (
        Panel(
            "F23: path",
            "time [s]",
            "position [turns]",
            (
                Curve("ramp", recording.time, ramp / turn),
                Curve("S curve", recording.time, path / turn),
                Curve("shaft", recording.time, (recording.position - start) / turn, "--"),
            ),
        ),
        Panel(
            "F24: speed",
            "time [s]",
            "speed [turns/s]",
            (
                Curve("ramp", recording.time, np.gradient(ramp, TICK) / turn),
                Curve("S curve", recording.time, np.gradient(path, TICK) / turn),
                Curve("shaft", recording.time, recording.omega / (2.0 * np.pi), "--"),
            ),
        ),
    )
    return Outcome(NAME, rows, panels, (f"axis {AXIS + 1}, {TURNS:g} turns", *([lowered] if lowered else [])))
