"""Bandwidths of speed and position control that keep stated margins with every shaft of a set.

The bandwidths of a configuration are designed for a rigid shaft. A load behind a spring needs lower ones; which ones
depends on values that are measured with an uncertainty and that change with the pose of a machine.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

from servo_msgs_py.catalogue import AXIS_NAMES, axis_name

from servo_tuning.assessment import assess
from servo_tuning.errors import ConfigError, Problem, Table, exactly
from servo_tuning.findings import BANDWIDTH_STEP, BANDWIDTH_STEPS, GAIN_MIN, findings
from servo_tuning.linear import Margins, spectral_radius
from servo_tuning.loops import ShaftLoops
from servo_tuning.members import MEMBERS
from servo_tuning.motor import Load
from servo_tuning.remedies import corrected, refusal_of, value_in, with_value
from servo_tuning.tuned import Tuned, tuned_axis

PHASE_MIN: Final = 40.0
"""Phase margin that speed and position loop keep unless another one is wanted [degrees]."""

PHASES_MIN: Final = (40.0, 35.0, 30.0, 25.0, 20.0)
"""Phase margins that a refusal offers [degrees]."""

PHASE_OPTION: Final = "--phase-margin"
"""Option of the command with another phase margin."""

OBSERVED: Final = "features.speed_observer"
"""Entry of an axis whose speed is that of the observer."""

_SPEED, _POSITION = "control.speed_bandwidth", "control.position_gain"
_OBSERVER: Final = "control.observer_bandwidth"
_OBSERVERS: Final = (2.0, 1.0, 0.5, 0.25)  # bandwidths of observers that are tried, over that of the file
_OBSERVER_BETTER: Final = 1.3  # smallest ratio of the speed bandwidths with and without an observer
_LOWEST: Final = 2.0  # speed bandwidth of a servo [Hz]
_RAMPS: Final = ("limits.acceleration", "control.path_current_use")
"""Accelerations of the set-points: a heavier shaft needs more current for them."""


@dataclass(frozen=True)
class ShaftModel:
    """Inertia of a shaft, and its part behind a spring."""

    inertia: float  # of the whole shaft [kg m^2]
    load: Load | None = None  # behind a spring; None: a rigid shaft

    def within(self, loops: ShaftLoops) -> ShaftLoops:
        """Models of speed and position loop with this shaft instead of their own."""
        return replace(loops, motor=replace(loops.motor, inertia=self.inertia), load=self.load)


def stable(shaft: ShaftModel, design: Tuned) -> bool:
    """Whether speed and position loop of a configuration are stable with a shaft."""
    loops = shaft.within(design.shaft())
    return spectral_radius(loops.speed_alone) < 1.0 and spectral_radius(loops.position.a) < 1.0


def _robust_speed(loops: ShaftLoops, phase_min: float) -> bool:
    """Whether the speed loop is stable with its margins; `phase_min` [degrees]."""
    return _stable_with_gain(loops, GAIN_MIN) and _keeps(loops.speed_margins(), phase_min)


def _robust_position(loops: ShaftLoops, phase_min: float) -> bool:
    """Whether the position loop is stable with its margins; `phase_min` [degrees]."""
    return spectral_radius(loops.position.a) < 1.0 and _keeps(loops.position_margins(), phase_min)


def _stable_with_gain(loops: ShaftLoops, gain: float) -> bool:
    """Whether the speed loop is stable, also with a higher gain: by its poles, which a narrow resonance has, too."""
    speed = loops.gains.speed
    higher = replace(loops.gains, speed=replace(speed, kp=gain * speed.kp, ki=gain * speed.ki))
    return all(spectral_radius(one.speed_alone) < 1.0 for one in (loops, replace(loops, gains=higher)))


def _keeps(margins: Margins, phase_min: float) -> bool:
    phase, gain = margins.phase, margins.gain
    return (phase is None or abs(phase) >= phase_min) and (gain is None or gain >= GAIN_MIN)


def with_shaft(base: Table, axis: int, shaft: ShaftModel) -> dict[str, Any]:
    """A ``servo.toml`` with another shaft of one axis."""
    table, name = copy.deepcopy(dict(base)), axis_name(axis)
    own = table.setdefault(name, {})
    rotor = value_in(table, f"{name}.motor.rotor_inertia")
    motor = {"inertia": _rounded(shaft.inertia)}
    if isinstance(rotor, float) and rotor > motor["inertia"]:
        motor["rotor_inertia"] = motor["inertia"]
    own["motor"] = {**own.get("motor", {}), **motor}
    own.pop("load", None)
    if (shared := table.get("defaults", {}).pop("load", None)) is not None:  # remains that of the other axes
        for other in set(AXIS_NAMES) - {name}:
            table.setdefault(other, {}).setdefault("load", shared)
    if shaft.load is not None:
        entries = {"inertia": shaft.load.inertia, "stiffness": shaft.load.stiffness, "damping": shaft.load.damping}
        own["load"] = {key: _rounded(value) for key, value in entries.items()}
    return table


def robust(
    base: Table,
    axis: int,
    nominal: ShaftModel,
    shafts: Sequence[ShaftModel],
    phase_min: float = PHASE_MIN,
    attend: Callable[[], None] = lambda: None,
) -> Table:
    """Configuration of an axis whose loops keep the margins with every shaft.

    The bandwidths are those of `base` or lower, by steps of `BANDWIDTH_STEP`, with the M/T method or an observer of the
    speed. Accelerations of the set-points for which
    the current limit is too low with this shaft are lowered.

    Parameters
    ----------
    base : mapping
        Parsed ``servo.toml``.
    axis : int
        Index of the axis.
    nominal : ShaftModel
        The shaft that is written into the configuration.
    shafts : sequence of ShaftModel
        All shafts that are possible.
    phase_min : float
        Phase margin of speed and position loop [degrees].
    attend : callable, optional
        Called before each model that is computed.

    Raises
    ------
    ConfigError
        If no bandwidth keeps the margins, or the configuration is not possible with this shaft.
    """
    name, remaining = axis_name(axis), list(shafts)
    if MEMBERS in base.get(name, {}):
        reason = "replaces what the bandwidths determine"
        raise ConfigError(Problem(f"[{name}.{MEMBERS}] {reason}", advice="remove it from the file and the board"))
    searches = [_Search(with_shaft(one, axis, nominal), axis, remaining, attend) for one in _estimates(base, name)]
    if (found := _best(searches, phase_min)) is not None:
        return _with_ramps(found, axis, attend)
    lower = (phase for phase in PHASES_MIN if phase < phase_min)
    possible = next((phase for phase in lower if _best(searches, phase) is not None), None)
    fact = f"{name}: no bandwidth keeps a phase margin of {phase_min:g} degrees and a gain margin of {GAIN_MIN:g}"
    fact = f"{fact} with this load"
    if possible is None:
        raise ConfigError(Problem(fact, advice="stiffen its coupling, or add damping"))
    raise ConfigError(Problem(fact, remedies=(exactly(PHASE_OPTION, possible),)))


def _estimates(base: Table, name: str) -> Iterator[Table]:
    """The configuration with the M/T method, and with observers of the speed."""
    yield with_value(base, f"{name}.{OBSERVED}", False)
    bandwidth = float(str(value_in(base, f"{name}.{_OBSERVER}")))
    for part in _OBSERVERS:
        yield with_value(with_value(base, f"{name}.{OBSERVED}", True), f"{name}.{_OBSERVER}", part * bandwidth)


def _best(searches: Sequence[_Search], phase_min: float) -> Table | None:
    """The configuration with the highest speed bandwidth; None: none keeps the margins.

    The slower an observer, the less it shows of a high resonance, and the more it relies on the inertia of the
    configuration; so it has to be better than the first one, the M/T method, by `_OBSERVER_BETTER`.

    Raises
    ------
    ConfigError
        If every configuration is refused.
    """
    best, highest, refusal, refused_only = None, 0.0, None, True
    for search in searches:
        try:
            found = search.found(phase_min)
        except ConfigError as error:
            refusal = refusal or error
            continue
        refused_only = False
        if found is None:
            continue
        speed = search.speed_of(found) / (1.0 if search is searches[0] else _OBSERVER_BETTER)
        if speed > highest:
            best, highest = found, speed
        if highest >= search.speed_of(search.table) / _OBSERVER_BETTER:
            break  # no other one is better
    if refusal is not None and refused_only:
        raise refusal
    return best


@dataclass(frozen=True)
class _Search:
    """Search of the highest bandwidths."""

    table: Table  # with the shaft
    axis: int  # index
    shafts: list[ShaftModel]  # those that failed last are first
    attend: Callable[[], None]

    def found(self, phase_min: float) -> Table | None:
        """The configuration with the highest bandwidths; None: none keeps the margins.

        Raises
        ------
        ConfigError
            If every configuration is refused.
        """
        name = axis_name(self.axis)
        speed = self.speed_of(self.table)
        position = float(str(value_in(self.table, f"{name}.{_POSITION}")))
        parts = [BANDWIDTH_STEP**k for k in range(BANDWIDTH_STEPS)]
        steps = [part for part in parts if part == 1.0 or part * speed >= _LOWEST]

        def with_parts(of_speed: float, of_position: float) -> Table:
            table = with_value(self.table, f"{name}.{_SPEED}", _rounded(of_speed * speed))
            return with_value(table, f"{name}.{_POSITION}", _rounded(of_position * position))

        # the position loop follows the speed loop, else it would be refused
        part = self._first(steps, lambda step: with_parts(step, step), partial(_robust_speed, phase_min=phase_min))
        if part is None:
            return None
        slower = [part * step for step in parts]
        keeps = partial(_robust_position, phase_min=phase_min)
        of_position = self._first(slower, lambda step: with_parts(part, step), keeps)
        return None if of_position is None else with_parts(part, of_position)

    def speed_of(self, table: Table) -> float:
        """Speed bandwidth of a configuration [Hz]."""
        return float(str(value_in(table, f"{axis_name(self.axis)}.{_SPEED}")))

    def _first(
        self, steps: Iterable[float], table_of: Callable[[float], Table], keeps: Callable[[ShaftLoops], bool]
    ) -> float | None:
        """The first step with which all shafts keep the margins."""
        refusal, refused_only = None, True
        for step in steps:
            self.attend()
            try:
                design = tuned_axis(table_of(step), self.axis)
            except ConfigError as error:
                refusal = error
                continue
            refused_only = False
            failing = next((shaft for shaft in self.shafts if not self._kept(shaft, design, keeps)), None)
            if failing is None:
                return step
            self.shafts.remove(failing)
            self.shafts.insert(0, failing)  # most probably it also fails with the next step
        if refusal is not None and refused_only:
            raise refusal
        return None

    def _kept(self, shaft: ShaftModel, design: Tuned, keeps: Callable[[ShaftLoops], bool]) -> bool:
        self.attend()
        return keeps(shaft.within(design.shaft()))


def _with_ramps(table: Table, axis: int, attend: Callable[[], None]) -> Table:
    """The table with accelerations that the current limit permits."""
    entries = [f"{axis_name(axis)}.{entry}" for entry in _RAMPS]

    def check(changed: Table) -> Problem | None:
        attend()
        if (problem := refusal_of(changed)) is not None:
            return problem
        design = tuned_axis(changed, axis)
        return next((one for one in findings(design, assess(design)) if one.entry in entries), None)

    found = corrected(table, lambda remedy: remedy.entry in entries, check)
    if found.problem is not None:
        raise ConfigError(found.problem)
    return found.table


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")
