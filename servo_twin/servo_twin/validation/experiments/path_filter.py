"""F23 and F24: the path filter converts a ramp to an S curve."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.board_port import read_axis, word, write_word
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import COUNTS_PER_TURN, TICK

from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import rig
from servo_twin.validation.experiments.outcome import Curve, Item, Judge, Panel, Row, experiment
from servo_twin.validation.experiments.plant_limits import current_limits, move_speeds
from servo_twin.validation.experiments.rig import COUNT

NAME: Final = "path-filter"
HELP: Final = """\
One position step of axis 1, which the firmware turns into a ramp and the ramp into an S curve (2.6, E38 to E40). The
acceleration limit, not part of the reference design, is at its maximum. The reference design shows: smooth start and
end of the position (F23); speed steps with the ramp, continuous speed with the S curve (F24); damping 1, hence no
overshoot."""

AXIS: Final = 0
TURNS: Final = 10.0
REST: Final = 0.6  # recorded after the end of the ramp [s]


def analytic(time: NDArray[np.float64], speed: float, duration: float, omega_n: float) -> NDArray[np.float64]:
    """Response of E38 to a ramp of `speed` that ends after `duration`.

    Parameters
    ----------
    time : ndarray
        Since the start of the ramp [s].
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
    """Natural frequency with the best fit of a path [rad/s]: golden-section search of the squared error."""

    def misfit(omega_n: float) -> float:
        return float(np.sum((analytic(time, speed, duration, omega_n) - path) ** 2))

    low, high = 5.0, 500.0
    golden = 0.5 * (5.0**0.5 - 1.0)
    for _ in range(80):
        a, b = high - golden * (high - low), low + golden * (high - low)
        low, high = (low, b) if misfit(a) < misfit(b) else (a, high)
    return 0.5 * (low + high)


def record(plant: PlantConfig, seed: int, limit: float) -> tuple[Trace, float, int]:
    """One long move with a speed limit [rad/s]: recording, speed limit [counts/s] and distance [counts]."""
    with rig.spinning(plant, seed) as board:
        target = word(board, AXIS, "position") + round(TURNS * COUNTS_PER_TURN)
        parameters = {"speed_limit": limit, "acceleration_limit": rig.largest(board, "acceleration_limit")}
        rig.set_up(board, AXIS, parameters=parameters)
        speed, distance = read_axis(board, "param.speed_limit", AXIS) / COUNT, target - word(board, AXIS, "position")
        move = rig.at({0.0: lambda: write_word(board, "cmd.position", AXIS, target)})
        return rig.record(board, [AXIS], distance / speed + REST, move)[AXIS], speed, distance


def figures(recording: Trace, speed: float, distance: int, axis_limit: float) -> Iterator[Row]:
    """Rows for a path; `axis_limit` is the largest acceleration of the drive [counts/s^2]."""
    duration = distance / speed
    path = recording["position_ref"] - (recording["position_ref"][-1] - distance)
    omega_n = fit_omega_n(recording.time, path, speed, duration)
    ideal = analytic(recording.time, speed, duration, omega_n)
    ramp = np.minimum(speed * recording.time, float(distance))
    # The set-point is in whole counts; the slope over five ticks has a resolution of a fifth of a count per tick.
    slope = (path[5:] - path[:-5]) / (5.0 * TICK)
    misfit, over = np.abs(ideal - path).max() / distance, max(path.max() - distance, 0.0)
    backwards, required = int(np.count_nonzero(np.diff(path) < 0.0)), speed * omega_n / np.e / axis_limit
    jumps, jump = (_jump(which, speed) for which in (ramp, path))
    judge, slow_loop = Judge(), "speed per slow loop"
    yield judge(
        f"largest jump of the ramp's {slow_loop}", jumps, "of v", 0.5, 1.0 + 1e-6, reference="F24: steps at both ends"
    )
    yield judge(
        f"largest jump of the S curve's {slow_loop}", jump, "of v", maximum=0.1, reference="F24: changes evenly"
    )
    yield judge(
        "deviation of the S curve from E38", misfit, "of the distance", maximum=0.01, reference="E38, damping 1"
    )
    yield judge("overshoot of the S curve", over, "counts", 0.0, 0.0, reference="E38: damping 1")
    yield judge("end error of the S curve", abs(path[-1] - distance), "counts", 0.0, 0.0, reference="F23: arrives")
    yield judge.none("steps backwards", backwards, reference="F23: monotonous")
    yield judge(
        "highest speed of the S curve", slope.max() / speed, "of v", 0.95, 1.02, reference="F24: that of the ramp"
    )
    yield judge("required acceleration", required, "of the limit", maximum=1.0, reference="E38: v omega_n / e")


def _jump(path: NDArray[np.float64], speed: float) -> float:
    """Largest change of speed between slow loops, including the start, relative to the speed of the ramp."""
    steps = np.diff(path, prepend=[0.0, 0.0])
    return float(np.abs(np.diff(steps)).max() / (speed * TICK))


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """One long move."""
    axis = plant.axes[AXIS]
    speeds, lowered = move_speeds(plant, seed, together=False)
    r, speed, distance = record(plant, seed, speeds[AXIS])
    maximum = current_limits(plant, seed)[AXIS]
    feasible = (axis.torque_constant * maximum - axis.friction) / axis.inertia / COUNT
    yield from figures(r, speed, distance, feasible)
    start, turn = r["position_ref"][-1] - distance, float(COUNTS_PER_TURN)
    ramp, path = np.minimum(speed * r.time, float(distance)), r["position_ref"] - start
    positions = {"ramp": ramp / turn, "S curve": path / turn, "shaft": (r["position"] - start) / turn}
    turning = {"ramp": np.gradient(ramp, TICK) / turn, "S curve": np.gradient(path, TICK) / turn}
    turning["shaft"] = r["omega"] / (2.0 * np.pi)
    for title, label, lines in (
        ("F23: path", "position [turns]", positions),
        ("F24: speed", "speed [turns/s]", turning),
    ):
        curves = [Curve(name, r.time, y, "--" if name == "shaft" else "-") for name, y in lines.items()]
        yield Panel(title, "time [s]", label, curves)
    yield f"axis {AXIS + 1}, {TURNS:g} turns"
    yield lowered
