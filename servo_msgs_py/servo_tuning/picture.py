"""Plot of the report."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.figure import new_figure, write_figure
from servo_msgs_py.units import COUNTS_PER_TURN

from servo_tuning.assessment import INERTIAS
from servo_tuning.linear import Omega
from servo_tuning.loops import In, Out
from servo_tuning.report import AxisReport
from servo_tuning.sensorless_figures import WINDINGS
from servo_tuning.tuned import Tuned


def draw(reports: Sequence[AxisReport], path: Path) -> None:
    """Plot one column per axis: open loops, closed loops, speed step, load step, observer poles, start-up."""
    panels = (_open_gain, _open_phase, _closed_gain, _speed_step, _load_step, _observer_poles, _start_up)
    figure = new_figure(7.0 * len(reports), 3.2 * len(panels))
    plots = figure.subplots(len(panels), len(reports), squeeze=False)
    for column, report in enumerate(reports):
        for row, panel in enumerate(panels):
            plot = plots[row][column]
            panel(plot, report.tuned)
            plot.set_title(f"{report.figures.name}: {plot.get_title()}", fontsize="medium")
            plot.grid(alpha=0.3)
            plot.legend(fontsize="x-small")
    write_figure(figure, path)


Response = Callable[[Omega], NDArray[np.complex128]]


def _open_loops(design: Tuned) -> list[tuple[str, Response, float]]:
    """Name, frequency response and highest frequency [rad/s]."""
    current, shaft, nyquist = design.current_loop("q").open, design.shaft(), math.pi / design.board.tick
    return [
        ("current q", current.response, current.nyquist),
        ("speed", shaft.speed_open, nyquist),
        ("position", shaft.position_open, nyquist),
    ]


def _spectrum(plot: Any, name: str, response: Response, nyquist: float, show: Callable[[Any], Any]) -> None:
    hertz = np.geomspace(0.5, nyquist / (2.0 * math.pi), 400)
    plot.semilogx(hertz, show(response(2.0 * math.pi * hertz)), label=name, linewidth=1.1)
    plot.set_xlabel("frequency [Hz]")


def _decibels(response: Any) -> Any:
    return 20.0 * np.log10(np.maximum(np.abs(response), 1e-9))


def _degrees(response: Any) -> Any:
    return np.degrees(np.unwrap(np.angle(response)))


def _open_gain(plot: Any, design: Tuned) -> None:
    for name, response, nyquist in _open_loops(design):
        _spectrum(plot, name, response, nyquist, _decibels)
    plot.axhline(0.0, color="black", linewidth=0.6)
    plot.set_ylim(-40.0, 60.0)
    plot.set_ylabel("gain [dB]")
    plot.set_title("open loops")


def _open_phase(plot: Any, design: Tuned) -> None:
    for name, response, nyquist in _open_loops(design):
        _spectrum(plot, name, response, nyquist, _degrees)
    plot.axhline(-180.0, color="black", linewidth=0.6)
    plot.set_ylim(-360.0, 0.0)
    plot.set_ylabel("phase [degrees]")
    plot.set_title("open loops")


def _closed_gain(plot: Any, design: Tuned) -> None:
    shaft = design.shaft()
    for name, loop in (
        ("current q", design.current_loop("q").closed),
        ("speed", shaft.speed.channel(Out.SPEED, In.SET_POINT)),
        ("position", shaft.position.channel(Out.ANGLE, In.SET_POINT)),
    ):
        _spectrum(plot, name, loop.response, loop.nyquist, _decibels)
    plot.set_ylim(-40.0, 10.0)
    plot.set_ylabel("gain [dB]")
    plot.set_title("closed loops")


def _speed_step(plot: Any, design: Tuned) -> None:
    ticks = math.ceil(8.0 / design.axis("control.speed_bandwidth") / design.board.tick)
    u = np.zeros((ticks, len(In)))
    u[:, In.SET_POINT] = 1.0
    for factor in INERTIAS:
        speed = design.shaft(factor).speed.simulate(u)[:, Out.SPEED]
        plot.plot(1e3 * design.board.tick * np.arange(ticks), speed, label=f"inertia x {factor:g}", linewidth=1.1)
    plot.set_ylim(-0.5, 2.5)
    plot.set_xlabel("time [ms]")
    plot.set_ylabel("speed")
    plot.set_title("step of the speed set-point")


def _load_step(plot: Any, design: Tuned) -> None:
    ticks = math.ceil(8.0 / design.axis("control.position_gain") / design.board.tick)
    torque = design.axis.torque_constant * design.axis("motor.rated_current")
    u = np.zeros((ticks, len(In)))
    u[:, In.LOAD] = torque
    for factor in INERTIAS:
        angle = design.shaft(factor).position.simulate(u)[:, Out.ANGLE] * COUNTS_PER_TURN / (2.0 * math.pi)
        plot.plot(1e3 * design.board.tick * np.arange(ticks), angle, label=f"inertia x {factor:g}", linewidth=1.1)
    plot.set_xlabel("time [ms]")
    plot.set_ylabel("deflection [counts]")
    plot.set_title(f"step of the load, {torque:.3g} N m")


def _observer_poles(plot: Any, design: Tuned) -> None:
    circle = np.exp(1j * np.linspace(-0.6, 0.6, 200))
    plot.plot(circle.real, circle.imag, color="black", linewidth=0.6, label="unit circle")
    if design.used_sensorless is not None:
        p = design.axis("motor.pole_pairs")
        speeds = p * np.linspace(0.0, design.axis("limits.speed"), 40)
        for r_s, inductance in WINDINGS:
            observer = design.sensorless.observer.winding(r_s, inductance)
            found = np.array([observer.poles(float(omega_e)) for omega_e in speeds]).ravel()
            label = f"R x {r_s:g}, L x {inductance:g}"
            plot.plot(found.real, found.imag, ".", markersize=3, label=label)
    plot.set_xlabel("Re z")
    plot.set_ylabel("Im z")
    plot.set_title("poles of the observer, from standstill to the speed limit")


def _start_up(plot: Any, design: Tuned) -> None:
    plot.set_xlabel("time [ms]")
    plot.set_title("start-up without an encoder")
    if design.used_sensorless is None:
        return
    s = design.used_sensorless.start_up
    time = np.linspace(0.0, 1.3 * max(s.speed_time, s.current_time), 200)
    current = s.current_first + (s.current_final - s.current_first) * np.minimum(time / s.current_time, 1.0)
    speed = s.speed_final * np.minimum(time / s.speed_time, 1.0)
    plot.plot(1e3 * time, speed, label="speed [rad/s]", linewidth=1.1)
    plot.plot(1e3 * time, 10.0 * current, label="current [0.1 A]", linewidth=1.1)
    plot.axhline(s.minimum_speed, color="black", linewidth=0.6, label="minimum speed [rad/s]")
