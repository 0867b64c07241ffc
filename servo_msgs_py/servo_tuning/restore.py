"""Restore a configuration file from configuration blocks: the tuning code computes the same bits from it.

Many entries are computed from a member by its scale. The others are searched: an entry is changed until the tuning code
computes the member of the block from it. Members that still differ (blocks of another origin, rounding) are written as
raw numbers to the group ``[axisN.exact]``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.catalogue import Catalogue, axis_name
from servo_msgs_py.stop_categories import CATEGORIES
from servo_msgs_py.units import COUNTS_PER_TURN, PERIOD_NS, SLOW_PERIODS

from servo_tuning.block import block_of
from servo_tuning.configuration import FEEDBACKS, PINS, Axis, Board, Configuration, Scales
from servo_tuning.errors import ConfigError
from servo_tuning.reading import parse
from servo_tuning.schema import AXIS_GROUPS
from servo_tuning.stops import COMMANDS, Stops
from servo_tuning.temperature import Temperature
from servo_tuning.tuned import integers, tuned

Block = Mapping[str, int]

_TICK: Final = PERIOD_NS * SLOW_PERIODS * 1e-9
_ROUNDS: Final = 30
_DIGITS: Final = (2, 3, 4, 5, 6, 7, 8, 9, 10, 12)
_CODES: Final = 4096


@dataclass(frozen=True)
class _SearchedEntry:
    """An entry that is searched with the tuning code."""

    entry: str  # changed by the search
    member: str  # determined by the entry
    start: float  # start value of the search
    power: int = 1  # 1: the member rises with the entry; -1: it falls


_SEARCHED: Final = (
    _SearchedEntry("control.current_bandwidth", "current_loop.d.kp", 1000.0),
    _SearchedEntry("control.speed_bandwidth", "speed.kp", 75.0),
    _SearchedEntry("control.speed_ratio", "speed.ki", 5.0, -1),
    _SearchedEntry("control.path_current_use", "path_omega_n_ts", 0.5),
    _SearchedEntry("rotor_search.follow_flux", "rotor_search.follow.flux_min", 0.3),
    _SearchedEntry("observer.k_1", "observer.k1", -5000.0),
    _SearchedEntry("observer.k_2", "observer.k2", 5000.0),
    _SearchedEntry("observer.pll_i", "pll.ki", 6e6),
    _SearchedEntry("observer.pll_damping", "pll.kp", 1.0),
    _SearchedEntry("observer.pll_torque", "pll.acceleration", 1.0),
    _SearchedEntry("observer.pll_size", "pll.amplitude_gain", 75.0),
    _SearchedEntry("observer.pll_load", "pll.load_gain", 0.125),
    _SearchedEntry("observer.speed_part", "observed_speed.kp", 0.6),
    _SearchedEntry("start_up.swings", "startup.speed_step", 6.0, -1),
    _SearchedEntry("start_up.current_time", "startup.current_step", 0.1, -1),
    _SearchedEntry("start_up.swing_damping", "startup.damping", 0.7),
    _SearchedEntry("field_weakening.bandwidth", "field_weakening.gain", 80.0),
    _SearchedEntry("start_up.fade_time", "startup.fade_step", 0.02, -1),
    _SearchedEntry("winding.heat_capacity", "winding_model.heating", 25.0, -1),
    _SearchedEntry("winding.thermal_resistance", "winding_model.cooling", 20.0, -1),
)
"""In the order of the search: no entry depends on a later one."""


_NOT_ON_A_BOARD: Final = {"motor.rotor_inertia": "motor.inertia", "motor.rated_speed": "limits.speed"}
"""Entries that are used in a report only, and the entries that replace them."""


def restore_table(blocks: Sequence[Block], timeouts: tuple[float, float], catalogue: Catalogue) -> dict[str, Any]:
    """Return the contents of the configuration file.

    Parameters
    ----------
    blocks : sequence of mapping
        Configuration blocks of both axes, raw numbers by member.
    timeouts : tuple of float
        Timeouts of host and commands [s]; they are not part of a block.
    catalogue : Catalogue
        The contract.

    Returns
    -------
    dict
        A table for `tuning.reading.parse`, without [board.brake] and [board.regeneration], which do not belong to an
        axis.

    Raises
    ------
    ConfigError
        If no file gives these blocks: the tuning code refuses the closest one.
    """
    scales = Scales.of(catalogue)
    board = _board(blocks[0], timeouts, scales)
    table: dict[str, Any] = {"board": board}
    for number, block in enumerate(blocks):
        table[axis_name(number)] = _Restorer(axis_name(number), block, board, catalogue).table()
    configuration = parse(table, catalogue)
    for axis, block in zip(configuration.axes, blocks, strict=True):
        differs = [path for path, raw in tuned(axis, configuration).block.items() if raw != block[path]]
        assert not differs, differs
    return table


def _value(path: str, block: Block) -> float:
    return float(AxisConfigTable.load().members[path].scale(block[path]))


def _board(block: Block, timeouts: tuple[float, float], s: Scales) -> dict[str, Any]:
    hot, cool = block["heat.hot"], block["heat.cool"]
    rising = hot > cool
    codes = [0, _CODES] if rising else [_CODES, 0]
    celsius = [150.0 * (code if rising else _CODES - code) / _CODES for code in (hot, cool)]
    ratio = _value("mt_speed.speed_per_ratio", block)
    return {
        "pwm_frequency": 1e9 / PERIOD_NS,
        "slow_divider": SLOW_PERIODS,
        "timer_clock": _short(ratio * s.speed * COUNTS_PER_TURN / (2.0 * math.pi), 6),
        "nominal_voltage": _nearest("u_dc_nominal", block, 1.0),
        "over_voltage": _nearest("u_dc_max", block, 1.0),
        "under_voltage": _nearest("u_dc_min", block, 1.0),
        "host_timeout": timeouts[0],
        "command_timeout": timeouts[1],
        "dead_time": _nearest("current_loop.dead_time.duty", block, PERIOD_NS * 1e-9),
        "switch_drop": _nearest("current_loop.dead_time.v_drop", block, 1.0),
        "voltage_use": min(_nearest("current_loop.modulation_limit", block, math.sqrt(4.0 / 3.0)), 1.0),
        "temperature": {
            "threshold_c": celsius[0],
            "hysteresis_c": celsius[0] - celsius[1],
            "table": [[0.0, codes[0]], [150.0, codes[1]]],
        },
    }


def _nearest(path: str, block: Block, factor: float) -> float:
    """Shortest number within half a raw unit of a member times a factor."""
    lsb = AxisConfigTable.load().members[path].lsb
    exact = block[path] * lsb * factor
    return _shortest(exact, lambda x: abs(x - exact) < 0.49 * lsb * factor)


def _shortest(exact: float, fits: Callable[[float], bool]) -> float:
    """Number with the fewest digits that `fits`."""
    return next((x for n in _DIGITS if fits(x := _short(exact, n))), exact)


def _short(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")


class _Restorer:
    """Restores the entries of one axis."""

    def __init__(self, name: str, block: Block, board: Mapping[str, Any], catalogue: Catalogue) -> None:
        self._name, self._block, self._catalogue = name, block, catalogue
        self._scales = Scales.of(catalogue)
        plain = {key: value for key, value in board.items() if key != "temperature"}
        self._board = Board(plain, Temperature.of(board["temperature"]), passwords={}, brake=False, complete=False)

    def _at(self, path: str, factor: float = 1.0) -> float:
        return _nearest(path, self._block, factor)

    def table(self) -> dict[str, Any]:
        """Contents of ``[axisN]``."""
        stop = {
            "disable": CATEGORIES[self._block["stop.disable"]],
            "quick_stop": CATEGORIES[self._block["stop.quick_stop"]],
            **{
                flag.name.lower(): category
                for member, category in (("shorted", "short"), ("ramp", "ramp"), ("hold", "hold"))
                for flag in self._catalogue.active("faults", self._block[f"stop.{member}"])
            },
        }
        names = {flag.name.lower(): flag.mask for flag in self._catalogue.flags["features"]}
        features = {name: bool(self._block["features"] & mask) for name, mask in names.items()}
        commands = {key: stop[key] for key in COMMANDS}
        axis = Axis(
            name=self._name,
            groups=self._start(),
            features=features,
            stops=Stops(commands, {key: value for key, value in stop.items() if key not in COMMANDS}),
            inherited=frozenset(),
            feedback=FEEDBACKS[self._block["feedback"]],
            pins={pin: bool(self._block["pins.fitted"] >> bit & 1) for bit, pin in enumerate(PINS)},
        )
        for found in _SEARCHED:
            axis = self._find(axis, found)
        axis = self._shorten(axis)
        for entry, same in _NOT_ON_A_BOARD.items():
            axis = _with(axis, entry, axis(same))
        result: dict[str, Any] = {"feedback": axis.feedback, **{group: dict(v) for group, v in axis.groups.items()}}
        result["stop"] = {**axis.groups["stop"], **stop}
        result["features"] = features
        result["pins"] = {**axis.groups["pins"], **axis.pins}
        got = self._computed(axis)
        exact = {path: raw for path, raw in self._block.items() if got is None or got.get(path) != raw}
        if exact:
            result["exact"] = exact
        return result

    # ---- entries computed from a member by its scale
    def _start(self) -> dict[str, dict[str, float]]:
        b, s, at = self._block, self._scales, self._at
        p = b["encoder.pole_pairs"]
        psi = at("current_loop.omega_psi", 1.0 / p)
        k_t = 1.5 * p * psi
        per_henry = 1.0 / (p * s.speed)
        current, speed = at("i_q_limit"), at("speed_limit")
        per_count = 2.0 * math.pi / COUNTS_PER_TURN
        gained, torque = "speed_observer.acceleration_per_current", k_t * s.i * _TICK**2 / per_count
        lsb = AxisConfigTable.load().members[gained].lsb
        inertia = _shortest(torque / (b[gained] * lsb), lambda x: abs(torque / x - b[gained] * lsb) < 0.49 * lsb)
        step, ticks = b["rotor_search.follow.step"], b["rotor_search.follow.ticks"]
        turn_time = at("rotor_search.follow.ticks")
        degrees = 360.0 / 65536.0
        decay = (1.0 - _value("speed_observer.l_position", b)) ** (1.0 / 3.0)
        first = {"current_loop.omega_l_d": "l_d", "current_loop.omega_l_q": "l_q"}
        ramp = _value("rotor_search.current_step", b) / _TICK
        final, resistance = b["startup.final_current"], _value("winding.resistance", b)
        groups: dict[str, dict[str, float]] = {
            "motor": {
                "r_s": at("winding.resistance"),
                **{key: at(path, per_henry) for path, key in first.items()},
                "psi_m": psi,
                "pole_pairs": p,
                "inertia": inertia,
                "rotor_inertia": inertia,
                "rated_speed": speed,
                "rated_current": at("winding_model.rated_current"),
            },
            "encoder": {"lines": COUNTS_PER_TURN / 4},
            "friction": {
                "coulomb": at("friction.coulomb", k_t),
                "viscous": at("friction.viscous", k_t),
                "smooth": at("friction.smooth"),
            },
            "limits": {
                "current": current,
                "speed": speed,
                "acceleration": at("acceleration_limit"),
                "position": at("position_limit"),
                "following_error": at("following_error"),
                "over_speed": at("over_speed"),
            },
            "control": {
                "anti_windup": at("speed.kc"),
                "position_gain": at("position_gain", 1.0 / per_count),
                "observer_bandwidth": -math.log(max(decay, 1e-9)) / (2.0 * math.pi * _TICK),
            },
            "rotor_search": {
                "current": at("rotor_search.current_limit"),
                "ramp_time": at("rotor_search.current_limit") / ramp,
                "hold_time": at("rotor_search.hold_ticks"),
                "rest_time": at("rotor_search.rest_ticks"),
                "move_counts": b["rotor_search.move_counts"],
                "interval": at("rotor_search.interval", degrees),
                "verify_angle": at("rotor_search.verify_angle", degrees),
                "verify_time": b["rotor_search.verify_angle"] / b["rotor_search.verify_step"] * _TICK,
                "turn_angle": _shortest(step * ticks * degrees, lambda x: round(x / degrees / ticks) == step),
                "turn_time": turn_time,
                "time_max": at("search_ticks_max"),
            },
            "observer": {},
            "reliability": {
                "period": max(b["reliability.period"], 1),
                "variance_threshold": at("reliability.variance_threshold") or 0.0625,
                "hysteresis": b["reliability.hysteresis"] or 1,
            },
            "emf_check": {
                "floor": at("emf_check.floor") or 0.35,
                "spin_floor": at("emf_check.floor_spin") or 0.12,
                "resistance": _value("emf_check.resistance", b) / resistance if resistance else 0.0,
                "part": at("emf_check.part") or 0.5,
                "spin_time": at("emf_check.ticks_spin") or 0.02,
                "stand_time": at("emf_check.ticks_stand") or 0.04,
                "check_time": at("emf_check.ticks_check") or 0.002,
            },
            "start_up": {
                "current_first": at("startup.first_current") / current or 0.375,
                "current_final": at("startup.final_current") / current or 0.5,
                "speed_final": at("startup.final_speed") / speed or 0.25,
                "wait_max": self._wait(),
                "consecutive_tests": b["startup.tests"] or 5,
                "minimum_speed": at("startup.minimum_speed") / speed or 0.04,
                "mean_min": at("startup.mean_min") or 0.8,
                "mean_max": at("startup.mean_max") or 1.2,
                "swing_current": b["startup.damping_limit"] / final if final else 0.5,
                "catch_time": at("startup.catch_ticks") or 0.02,
            },
            "timing": {
                "settle": at("settle_ticks"),
                "runaway_margin": at("shaft.runaway_margin"),
                "runaway_max": at("shaft.runaway_ticks_max"),
                "rest_max": at("rest_ticks_max"),
                "stall_max": at("shaft.stall_ticks_max"),
                "stop_speed": at("stop_speed"),
                "stop_max": at("stop_ticks_max"),
                "following_max": at("shaft.following_ticks_max"),
                "over_speed_max": at("shaft.over_speed_ticks_max"),
            },
            "stop": {
                "time_max": at("stop.ticks_max"),
                "hold_time": at("stop.hold_ticks"),
                "short_current": at("stop.short_current", 1.0 / (1.0 - 2.0**-15)),
                "copper_use": min(at("copper_current") / current, 1.0),
            },
            "winding": {
                key: at(f"winding_model.{key}") for key in ("ambient", "initial", "derating", "maximum", "fault")
            },
            "field_weakening": {
                "margin": at("field_weakening.margin"),
                "current_use": min(at("field_weakening.i_d_max") / current, 1.0) or 0.5,
                "magnet_current": at("field_weakening.i_d_max") or current,
            },
            "home": {
                "speed": at("home.speed"),
                "current": at("home.current"),
                "back_off": at("home.back_off"),
                "spread": at("home.spread_max"),
                "turns_max": b["home.turns_max"],
                "reach": at("home.reach"),
            },
            "pins": {"open_time": at("pins.open_ticks"), "close_time": at("pins.close_ticks")},
            "sensing": {
                "sign_current": s.i / _value("current_loop.dead_time.slope", b),
                "offset_tolerance": b["offset_tolerance"],
                "offset_duty": at("offset_duty_min"),
            },
        }
        for found in _SEARCHED:
            group, key = found.entry.split(".")
            groups[group][key] = found.start if b[found.member] or found.power < 0 or group == "control" else 0.0
        if not b["observer.drive"]:  # the motor cannot be observed: the entries are unknown
            for key in ("k_1", "k_2"):
                del groups["observer"][key]
            groups["observer"] |= {"bandwidth": 500.0, "damping": 1.0, "pll_i": 6026968.0, "pll_damping": 1.0}
            groups["observer"] |= {"pll_torque": 1.0, "pll_size": 75.0, "pll_load": 0.125, "speed_part": 0.6}
            groups["start_up"] |= {"swing_damping": 0.7, "swings": 6.0}
        return groups

    def _wait(self) -> float:
        """Duration of the start-up after its ramp [s]."""
        b = self._block
        ramp = b["startup.final_speed"] / b["startup.speed_step"] if b["startup.speed_step"] else 0.0
        return max(b["startup.duration_ticks"] - ramp, 1.0) * _TICK

    # ---- searched entries
    def _computed(self, axis: Axis) -> dict[str, int] | None:
        """Block computed from the present entries; None if they are refused."""
        configuration = Configuration(self._board, (axis,), self._scales)
        try:
            return block_of(integers(axis, configuration, {})[1], axis.name)
        except (ConfigError, ArithmeticError, ValueError):
            return None

    def _find(self, axis: Axis, found: _SearchedEntry) -> Axis:
        target = self._block[found.member]
        group, key = found.entry.split(".")
        if key not in axis.groups[group] or target == 0:
            return axis
        for _ in range(_ROUNDS):
            got = self._computed(axis)
            if got is None or got[found.member] == target or not got[found.member]:
                break
            factor = target / got[found.member]
            if factor <= 0.0:
                break
            axis = _with(axis, found.entry, axis(found.entry) * factor**found.power)
        return axis

    def _shorten(self, axis: Axis) -> Axis:
        """Reduce the digits of the entries as far as the block stays the same."""
        best = self._mistakes(axis)
        for group, entries in axis.groups.items():
            for key, value in entries.items():
                if AXIS_GROUPS[group][key].whole:
                    continue
                for digits in _DIGITS:
                    shorter = _with(axis, f"{group}.{key}", _short(value, digits))
                    mistakes = self._mistakes(shorter)
                    if mistakes <= best:
                        axis, best = shorter, mistakes
                        break
        return axis

    def _mistakes(self, axis: Axis) -> int:
        got = self._computed(axis)
        return len(self._block) + 1 if got is None else sum(got[path] != raw for path, raw in self._block.items())


def _with(axis: Axis, path: str, value: float) -> Axis:
    group, key = path.split(".")
    return replace(axis, groups={**axis.groups, group: {**axis.groups[group], key: value}})


# ---- text ------------------------------------------------------------------------------------------------------------


def toml_text(table: Mapping[str, Any], heading: str) -> str:
    """Text of the table as TOML, with the unit of every entry."""
    lines = [f"# {line}" for line in heading.splitlines()]
    _write(lines, "", table)
    return "\n".join(lines) + "\n"


def _write(lines: list[str], where: str, table: Mapping[str, Any]) -> None:
    plain = {key: value for key, value in table.items() if not isinstance(value, Mapping)}
    if where and plain:
        lines += ["", f"[{where}]"]
    unit = _unit_of(where.rpartition(".")[2])
    lines += [f"{_key(key)} = {_literal(value)}{unit(key)}" for key, value in plain.items()]
    for key, value in table.items():
        if isinstance(value, Mapping) and value:
            _write(lines, f"{where}.{key}" if where else key, value)


def _unit_of(group: str) -> Callable[[str], str]:
    entries = AXIS_GROUPS.get(group, {})
    return lambda key: f"  # {entries[key].unit}" if key in entries and entries[key].unit else ""


def _key(key: str) -> str:
    return f'"{key}"' if "." in key else key


def _literal(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, Sequence):
        return f"[{', '.join(map(_literal, value))}]"
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return f"{value:.1f}"
    return repr(value)
