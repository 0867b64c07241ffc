"""Figures of the loops of one axis: margins, poles, design rule of the reference, moves and load steps."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.units import COUNTS_PER_TURN

from servo_tuning.linear import Margins, Pole, System, Tracking, poles, spectral_radius
from servo_tuning.loops import In, Out
from servo_tuning.optional import SPEED_OBSERVER
from servo_tuning.sensorless_figures import SensorlessFigures, sensorless_figures
from servo_tuning.sensors import edge_delay
from servo_tuning.tuned import Tuned

INERTIAS: Final = (0.5, 1.0, 2.0, 3.0)
"""Inertias of the report, over the nominal inertia."""

SPEEDS: Final = (100.0, 10.0, 5.0, 3.0, 2.0, 1.0)
"""Speeds of the report of the M/T delay [rad/s]."""

_TICKS_MAX: Final = 12_000


@dataclass(frozen=True)
class Loop:
    """One loop."""

    name: str  # displayed name
    in_force: bool  # whether it is enabled after reset
    wanted: float  # designed bandwidth [Hz]
    margins: Margins  # of the open loop
    tracking: Tracking  # of the closed loop
    poles: tuple[Pole, ...]  # of the closed loop


@dataclass(frozen=True)
class DesignRule:
    """DRM E43..E45, and the corresponding values of the tuned speed loop."""

    t_n_rotor: float  # E43 with the inertia of the rotor alone [s]
    t_n_shaft: float  # E43 with the inertia of the whole shaft [s]
    k_p: float  # E45 with `t_n_shaft` [rpm/rad]
    k_v_rule: float  # the same as `k_p` [1/s]
    t_n_tuned: float  # time constant of a first-order lag with the crossover of the tuned speed loop [s]
    k_v: float  # chosen gain of the position loop [1/s]
    k_v_t: float  # product of `k_v` and `t_n_tuned`; E45 takes 0.5


@dataclass(frozen=True)
class Arrival:
    """Overshoot and lag of a position move."""

    bare: float  # overshoot of a step without shaping, over the step
    shaped: float  # overshoot of a move at the speed limit that ramp and path filter shape [counts]
    lag: float  # between shaped set-point and shaft at the speed limit [rad]


@dataclass(frozen=True)
class LoadStep:
    """Step of the load torque in position control."""

    torque: float  # the load [N m]
    deflection: float  # largest angle by which it displaces the shaft [rad]
    stiffness: float  # torque over deflection [N m/rad]
    recovery: float  # until the shaft stays within a tenth of the deflection [s]


@dataclass(frozen=True)
class Inertia:
    """Stability of the same gains with another inertia."""

    factor: float  # over the nominal one
    observed: bool  # with the speed observer instead of the M/T method
    stable: bool  # whether speed and position loop are stable
    margins: Margins  # of the speed loop
    overshoot: float | None  # of a position step without shaping; None when unstable


@dataclass(frozen=True)
class Reach:
    """Possible speeds, and currents of the set-points."""

    speed_idle: float  # voltage limit at the nominal bus without load [rad/s]
    speed_rated: float  # voltage limit at the nominal bus and the rated current [rad/s]
    path_omega_n: float  # of E40 [rad/s]
    path_acceleration: float  # largest one of shaped set-points [rad/s^2]
    path_current: float  # largest one of shaped set-points [A]
    ramp_current: float  # of the ramp of speed set-points [A]
    friction_current: float  # against the friction at the speed limit [A]


@dataclass(frozen=True)
class Assessment:
    """All figures of one axis."""

    name: str
    loops: tuple[Loop, ...]
    edges: tuple[tuple[float, Margins], ...]  # speed [rad/s], margins of the speed loop there
    rule: DesignRule
    arrival: Arrival
    load_step: LoadStep
    reach: Reach
    inertias: tuple[Inertia, ...]
    sensorless: SensorlessFigures


def assess(design: Tuned) -> Assessment:
    """Compute all figures."""
    bare = _bare_overshoot(design.shaft().position, design.used.position)
    return Assessment(
        name=design.axis.name,
        loops=tuple(_loops(design)),
        edges=tuple((speed, _at_speed(design, speed)) for speed in SPEEDS),
        rule=design_rule(design, design.shaft().speed_margins()),
        arrival=Arrival(bare, *shaped_arrival(design)),
        load_step=_load_step(design),
        reach=_reach(design),
        inertias=tuple(_with_inertia(design, factor, observed) for observed in _sensors(design) for factor in INERTIAS),
        sensorless=sensorless_figures(design),
    )


def _loops(design: Tuned) -> Iterator[Loop]:
    for which in "dq":
        loop = design.current_loop(which)
        wanted = design.axis("control.current_bandwidth")
        closed = loop.closed
        yield Loop(f"current {which}", True, wanted, loop.margins(), closed.tracking(), poles(closed.a, loop.period))
    for observed in _sensors(design):
        yield from _shaft_loops(design, observed)


def _sensors(design: Tuned) -> Sequence[bool]:
    """Whether the speed comes from the speed observer: the cases that are possible."""
    return (False,) if SPEED_OBSERVER in design.unusable else (False, True)


def _shaft_loops(design: Tuned, observed: bool) -> Iterator[Loop]:
    shaft, tick, in_force = design.shaft(observed=observed), design.board.tick, observed == design.observed
    suffix = ", observer" if observed else ""
    wanted = design.axis("control.speed_bandwidth")
    tracking = shaft.speed.channel(Out.SPEED, In.SET_POINT).tracking()
    closed = poles(shaft.speed_alone, tick)
    yield Loop(f"speed{suffix}", in_force, wanted, shaft.speed_margins(), tracking, closed)
    wanted = design.axis("control.position_gain") / (2.0 * math.pi)
    tracking = shaft.position.channel(Out.ANGLE, In.SET_POINT).tracking()
    closed = poles(shaft.position.a, tick)
    yield Loop(f"position{suffix}", in_force, wanted, shaft.position_margins(), tracking, closed)


def design_rule(design: Tuned, speed: Margins) -> DesignRule:
    """DRM E43..E45 from rated data, and the lag of the tuned speed loop."""
    axis = design.axis
    rated_torque = axis.torque_constant * axis("motor.rated_current")
    t_n = {key: axis("motor.rated_speed") * axis(f"motor.{key}") / rated_torque for key in ("rotor_inertia", "inertia")}
    k_p = 15.0 / (math.pi * t_n["inertia"])
    crossover = axis("control.speed_bandwidth") if speed.crossover is None else speed.crossover
    t_tuned = 1.0 / (2.0 * math.pi * crossover)
    k_v = design.used.position
    return DesignRule(
        t_n_rotor=t_n["rotor_inertia"],
        t_n_shaft=t_n["inertia"],
        k_p=k_p,
        k_v_rule=k_p * math.pi / 30.0,
        t_n_tuned=t_tuned,
        k_v=k_v,
        k_v_t=k_v * t_tuned,
    )


def _ticks(design: Tuned, *rates: float) -> int:
    """Slow ticks until transients of these rates [1/s] have decayed."""
    return min(math.ceil(12.0 / min(rates) / design.board.tick), _TICKS_MAX)


def _bare_overshoot(position: System, k_v: float) -> float:
    ticks = min(math.ceil(12.0 / k_v / position.dt), _TICKS_MAX)
    u = np.zeros((ticks, len(In)))
    u[:, In.SET_POINT] = 1.0
    return max(float(position.simulate(u)[:, Out.ANGLE].max()) - 1.0, 0.0)


def _filtered(ramp: NDArray[np.float64], omega_n_ts: float) -> NDArray[np.float64]:
    """Output of the path filter, DRM E40."""
    m = y = 0.0
    result = np.empty_like(ramp)
    for k, x in enumerate(ramp):
        m += omega_n_ts * (x - 2.0 * m - y)
        y += omega_n_ts * m
        result[k] = y
    return result


def shaped_arrival(design: Tuned) -> tuple[float, float]:
    """Simulate a move that reaches the speed limit.

    Returns
    -------
    tuple of float
        Overshoot [counts], and the lag of the shaft behind its set-point at the speed limit [rad].
    """
    speed, tick = design.axis("limits.speed"), design.board.tick
    settled = _ticks(design, design.used.path_omega_n, design.used.position)
    ramp = speed * tick * np.minimum(np.arange(2 * settled), settled)
    u = np.zeros((ramp.size, len(In)))
    u[:, In.SET_POINT] = _filtered(ramp, design.used.path_omega_n * tick)
    angle = design.shaft().position.simulate(u)[:, Out.ANGLE]
    beyond = float(angle.max()) - float(ramp[-1])
    return max(beyond, 0.0) * COUNTS_PER_TURN / (2.0 * math.pi), float(u[settled, In.SET_POINT] - angle[settled])


def _load_step(design: Tuned) -> LoadStep:
    torque = design.axis.torque_constant * design.axis("motor.rated_current")
    corner = 2.0 * math.pi * design.axis("control.speed_bandwidth") / design.axis("control.speed_ratio")
    u = np.zeros((_ticks(design, design.used.position, corner), len(In)))
    u[:, In.LOAD] = torque
    angle = np.abs(design.shaft().position.simulate(u)[:, Out.ANGLE])
    deflection = float(angle.max())
    outside = np.nonzero(angle > 0.1 * deflection)[0]
    return LoadStep(torque, deflection, torque / deflection, (int(outside[-1]) + 1) * design.board.tick)


def _at_speed(design: Tuned, speed: float) -> Margins:
    return design.shaft(observed=False).speed_margins(
        edge_delay(design.axis("encoder.lines"), design.board.tick, speed)
    )


def _with_inertia(design: Tuned, factor: float, observed: bool) -> Inertia:
    shaft = design.shaft(factor, observed)
    position = shaft.position
    stable = max(spectral_radius(shaft.speed_alone), spectral_radius(position.a)) < 1.0
    overshoot = _bare_overshoot(position, design.used.position) if stable else None
    return Inertia(factor, observed, stable, shaft.speed_margins(), overshoot)


def _top_speed(design: Tuned, current: float) -> float:
    """Speed at which (R i + p psi w)^2 + (p L_q i w)^2 equals the square of the voltage limit [rad/s]."""
    p = design.axis("motor.pole_pairs")
    flux, coupling = p * design.axis("motor.psi_m"), p * design.axis("motor.l_q") * current
    drop, maximum = design.axis("motor.r_s") * current, design.board.voltage_max
    square, half = flux**2 + coupling**2, drop * flux
    square_root = half**2 + square * (maximum**2 - drop**2)
    return max((math.sqrt(square_root) - half) / square, 0.0) if square_root > 0.0 else 0.0


def _reach(design: Tuned) -> Reach:
    axis, k_t = design.axis, design.axis.torque_constant
    path_acceleration = design.axis("limits.speed") * design.used.path_omega_n / math.e
    per_acceleration = axis("motor.inertia") / k_t
    return Reach(
        speed_idle=_top_speed(design, 0.0),
        speed_rated=_top_speed(design, axis("motor.rated_current")),
        path_omega_n=design.used.path_omega_n,
        path_acceleration=path_acceleration,
        path_current=path_acceleration * per_acceleration,
        ramp_current=axis("limits.acceleration") * per_acceleration,
        friction_current=(axis("friction.coulomb") + axis("friction.viscous") * axis("limits.speed")) / k_t,
    )
