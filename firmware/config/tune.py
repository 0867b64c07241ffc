"""Compute the controller's integer constants from motor data and bandwidths: ``python firmware/config/tune.py``.

Reads ``servo.toml`` (what the controller believes) and the full scales of the contract, and writes
``servo_config_gen.c``. A value that is impossible or does not fit its format is refused with the reason.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.codegen import update
from servo_msgs_py.units import COUNTS_PER_TURN, PERIOD_NS, SLOW_PERIODS

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

GAIN_BITS = 24
HERE = Path(__file__).resolve().parent
AXES = ("axis1", "axis2")


class ConfigError(ValueError):
    """The configuration cannot work; the message says which entry and why."""


@dataclass(frozen=True)
class Scales:
    """Full scales of the contract, SI."""

    u_dc: float
    u_s: float
    i: float
    speed: float
    torque_constant: float

    @classmethod
    def of(cls, catalogue: Catalogue) -> Scales:
        def full(name: str) -> float:
            value = catalogue.scales[name].full_scale
            assert value is not None, name
            return value

        return cls(full("bus_voltage"), full("stator_voltage"), full("current"), full("speed"), full("torque_per_amp"))


def fixed(name: str, value: float, fraction_bits: int, low: int, high: int) -> int:
    """Round to an integer with `fraction_bits`, and refuse what does not fit or vanishes."""
    raw = round(math.ldexp(value, fraction_bits))
    if not low <= raw <= high:
        raise ConfigError(f"{name} = {value:g} does not fit its format ({low} .. {high} / 2^{fraction_bits})")
    if raw == 0 and value != 0.0:
        raise ConfigError(f"{name} = {value:g} is too small for {fraction_bits} fraction bits and would vanish")
    return raw


def frac16(name: str, value: float) -> int:
    return fixed(name, value, 15, -32768, 32767)


def frac32(name: str, value: float) -> int:
    return fixed(name, value, 31, -(2**31), 2**31 - 1)


def gain(name: str, value: float) -> int:
    return fixed(name, value, GAIN_BITS, -(2**31), 2**31 - 1)


def uint16(name: str, value: float) -> int:
    return fixed(name, value, 0, 0, 65535)


KEYS: Mapping[str, tuple[str, ...]] = {
    "board": (
        "pwm_frequency", "slow_divider", "timer_clock", "nominal_voltage", "over_voltage", "under_voltage",
        "host_timeout", "dead_time", "switch_drop", "voltage_use",
    ),
    "motor": ("r_s", "l_d", "l_q", "psi_m", "pole_pairs", "inertia"),
    "encoder": ("lines",),
    "limits": ("current", "speed", "acceleration"),
    "control": (
        "current_bandwidth", "speed_bandwidth", "speed_ratio", "anti_windup", "position_gain", "path_current_use",
    ),
    "rotor_search": ("current", "ramp_time", "hold_time", "rest_time", "move_counts", "interval", "time_most"),
    "timing": (
        "settle", "stop_acceleration", "runaway_margin", "runaway_most", "rest_most", "stall_most",
        "stop_speed", "stop_most",
    ),
    "sensing": ("sign_current", "offset_tolerance", "offset_duty"),
}  # fmt: skip
"""Every group and its keys; a group must have these and no others."""


def check_group(where: str, group: str, entries: Mapping[str, Any]) -> dict[str, float]:
    """A group with exactly its keys, all of them positive numbers.

    Raises
    ------
    ConfigError
        Naming the first entry that is missing, unknown or not a positive number.
    """
    if group not in KEYS:
        raise ConfigError(f"{where} is no group of the configuration; known are {', '.join(KEYS)}")
    for key in entries.keys() - set(KEYS[group]):
        raise ConfigError(f"{where}.{key} is unknown; known are {', '.join(KEYS[group])}")
    for key in KEYS[group]:
        if key not in entries:
            raise ConfigError(f"{where}.{key} is missing")
        value = entries[key]
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value) or value <= 0:
            raise ConfigError(f"{where}.{key} = {value!r}: a positive number is needed")
    return {key: float(value) for key, value in entries.items()}


def check_board(entries: Mapping[str, Any], s: Scales) -> dict[str, float]:
    """The [board] group; its timing is fixed by the contract.

    Raises
    ------
    ConfigError
        If an entry cannot work.
    """
    board = check_group("board", "board", entries)
    for key, wanted in (("pwm_frequency", 1e9 / PERIOD_NS), ("slow_divider", SLOW_PERIODS)):
        if board[key] != wanted:
            raise ConfigError(f"board.{key} = {board[key]:g}: firmware and contract are written for {wanted:g}")
    if not board["under_voltage"] < board["over_voltage"] < s.u_dc:
        raise ConfigError(
            f"board: under_voltage {board['under_voltage']:g} V < over_voltage {board['over_voltage']:g} V"
            f" < full scale {s.u_dc:g} V does not hold"
        )
    if board["voltage_use"] > 1.0:
        raise ConfigError(f"board.voltage_use = {board['voltage_use']:g}: at most 1, the end of linear modulation")
    return board


@dataclass(frozen=True)
class Axis:
    """One axis of the configuration with its groups merged and checked."""

    name: str
    groups: Mapping[str, Mapping[str, float]]

    @classmethod
    def of(cls, table: Mapping[str, Any], name: str) -> Axis:
        if name not in table:
            raise ConfigError(f"[{name}.motor] is missing")
        merged: dict[str, dict[str, Any]] = {k: dict(v) for k, v in table.get("defaults", {}).items()}
        for group, entries in table[name].items():
            merged.setdefault(group, {}).update(entries)
        for group in KEYS.keys() - {"board"}:
            merged.setdefault(group, {})
        axis = cls(name, {group: check_group(f"{name}.{group}", group, e) for group, e in sorted(merged.items())})
        axis.check()
        return axis

    def check(self) -> None:
        """What a single number cannot tell.

        Raises
        ------
        ConfigError
            If an entry cannot work.
        """
        if 4.0 * self("encoder.lines") != COUNTS_PER_TURN:
            raise ConfigError(f"{self.name}.encoder.lines: the contract counts {COUNTS_PER_TURN} per turn, 4 per line")
        if self("motor.pole_pairs") % 1.0 != 0.0:
            raise ConfigError(f"{self.name}.motor.pole_pairs = {self('motor.pole_pairs'):g}: a whole number is needed")
        if self("control.anti_windup") >= 1.0:
            raise ConfigError(f"{self.name}.control.anti_windup: Kc of DRM E35 lies between 0 and 1")

    def __call__(self, path: str) -> float:
        group, key = path.split(".")
        return self.groups[group][key]


def current_pi(axis: Axis, inductance: float, s: Scales, ts: float) -> tuple[float, float]:
    """Kp and Kp Ki Ts of a current controller: pole-zero cancellation at the wanted bandwidth."""
    omega = 2.0 * math.pi * axis("control.current_bandwidth")
    to_fraction = s.i / s.u_s
    return omega * inductance * to_fraction, omega * axis("motor.r_s") * ts * to_fraction


def speed_pi(axis: Axis, s: Scales, ts: float) -> tuple[float, float]:
    """Kp and Kp Ki Ts of the speed controller: symmetric around the wanted bandwidth."""
    omega = 2.0 * math.pi * axis("control.speed_bandwidth")
    k_t = 1.5 * axis("motor.pole_pairs") * axis("motor.psi_m")
    kp = omega * axis("motor.inertia") / k_t * s.speed / s.i
    return kp, kp * omega / axis("control.speed_ratio") * ts


def pi_literal(name: str, kp: float, ki: float, kc: float) -> str:
    return f"{{{gain(name + '.kp', kp)}, {gain(name + '.ki', ki)}, {gain(name + '.kc', kc)}}}"


def axis_literal(axis: Axis, board: Mapping[str, float], s: Scales) -> str:
    """C initialiser of one ``axis_config_t``."""
    ts_fast = 1.0 / board["pwm_frequency"]
    ts = board["slow_divider"] * ts_fast
    p, psi = axis("motor.pole_pairs"), axis("motor.psi_m")
    counts = 4.0 * axis("encoder.lines")
    omega_e = p * s.speed
    k_t = 1.5 * p * psi
    i_limit, v_limit = axis("limits.current"), axis("limits.speed")
    kc = axis("control.anti_windup")
    acceleration = k_t * i_limit * axis("control.path_current_use") / axis("motor.inertia")
    omega_n = math.e * acceleration / v_limit  # E40: a speed step v asks for at most v omega_n / e
    search = axis.groups["rotor_search"]
    d = current_pi(axis, axis("motor.l_d"), s, ts_fast)
    q = current_pi(axis, axis("motor.l_q"), s, ts_fast)
    w = pi_literal("speed", *speed_pi(axis, s, ts), kc)
    per_ratio = board["timer_clock"] * 2.0 * math.pi / counts / s.speed
    fields = [
        ("current_loop.d", pi_literal("d", *d, kc)),
        ("current_loop.q", pi_literal("q", *q, kc)),
        ("current_loop.omega_l_d", gain("omega_l_d", omega_e * axis("motor.l_d") * s.i / s.u_s)),
        ("current_loop.omega_l_q", gain("omega_l_q", omega_e * axis("motor.l_q") * s.i / s.u_s)),
        ("current_loop.omega_psi", gain("omega_psi", omega_e * psi / s.u_s)),
        ("current_loop.angle_step", gain("angle_step", omega_e * ts_fast / math.pi)),
        ("current_loop.dead_time.duty", frac16("dead_time", board["dead_time"] * board["pwm_frequency"])),
        ("current_loop.dead_time.v_drop", frac16("switch_drop", board["switch_drop"] / s.u_dc)),
        ("current_loop.dead_time.slope", gain("sign_current", s.i / axis("sensing.sign_current"))),
        ("current_loop.modulation_limit", frac16("modulation_limit", math.sqrt(0.75) * board["voltage_use"])),
        ("encoder.counts", uint16("counts", counts)),
        ("encoder.pole_pairs", uint16("pole_pairs", p)),
        ("encoder.angle_per_count", fixed("angle_per_count", 1.0 / counts, 32, 1, 2**32 - 1)),
        ("mt_speed.speed_per_ratio", fixed("speed_per_ratio", per_ratio, 16, 1, int(2**32 // (counts / 2)))),
        ("rotor_search.current_step", frac32("current_step", search["current"] / s.i * ts / search["ramp_time"])),
        ("rotor_search.current_limit", frac16("search current", search["current"] / s.i)),
        ("rotor_search.hold_ticks", uint16("hold_time", search["hold_time"] / ts)),
        ("rotor_search.rest_ticks", uint16("rest_time", search["rest_time"] / ts)),
        ("rotor_search.move_counts", uint16("move_counts", search["move_counts"])),
        ("rotor_search.angle_per_count", fixed("search angle", 65536.0 * p / counts, 16, 1, 2**31 - 1)),
        ("rotor_search.interval", fixed("interval", search["interval"] / 360.0, 16, 1, 65535)),
        ("speed", w),
        ("position_gain", frac32("position_gain", axis("control.position_gain") * 2 * math.pi / counts / s.speed)),
        ("path_omega_n_ts", fixed("path_omega_n_ts", omega_n * ts, 16, 1, 16384)),
        ("path_step_per_speed", fixed("path_step_per_speed", s.speed * ts * counts / 2 / math.pi, 16, 1, 2**31 - 1)),
        ("torque_constant", frac16("torque_constant", k_t / s.torque_constant)),
        ("i_q_limit", frac16("limits.current", i_limit / s.i)),
        ("speed_limit", frac32("limits.speed", v_limit / s.speed)),
        ("acceleration_limit", frac32("limits.acceleration", axis("limits.acceleration") * ts / s.speed)),
        ("u_dc_nominal", frac16("nominal_voltage", board["nominal_voltage"] / s.u_dc)),
        ("u_dc_most", frac16("over_voltage", board["over_voltage"] / s.u_dc)),
        ("u_dc_least", frac16("under_voltage", board["under_voltage"] / s.u_dc)),
        ("offset_tolerance", uint16("offset_tolerance", axis("sensing.offset_tolerance"))),
        ("offset_duty_least", frac16("offset_duty", axis("sensing.offset_duty"))),
        ("settle_ticks", uint16("settle", axis("timing.settle") / ts)),
        ("stop_acceleration", frac32("stop_acceleration", axis("timing.stop_acceleration") * ts / s.speed)),
        ("runaway_margin", frac32("runaway_margin", axis("timing.runaway_margin") / s.speed)),
        ("runaway_ticks_most", uint16("runaway_most", axis("timing.runaway_most") / ts)),
        ("rest_ticks_most", uint16("rest_most", axis("timing.rest_most") / ts)),
        ("stall_ticks_most", uint16("stall_most", axis("timing.stall_most") / ts)),
        ("search_ticks_most", uint16("time_most", search["time_most"] / ts)),
        ("stop_speed", frac32("stop_speed", axis("timing.stop_speed") / s.speed)),
        ("stop_ticks_most", uint16("stop_most", axis("timing.stop_most") / ts)),
    ]
    return "\n".join(f"            .{name} = {value}," for name, value in fields)


def check_limits(axis: Axis, catalogue: Catalogue) -> None:
    """Defaults must lie within what the contract lets a host write.

    Raises
    ------
    ConfigError
        If one does not.
    """
    for key, name in (("current", "i_q_limit"), ("speed", "speed_limit"), ("acceleration", "acceleration_limit")):
        variable, value = catalogue[f"param.{name}"], axis(f"limits.{key}")
        if not variable.minimum <= value <= variable.maximum:
            raise ConfigError(
                f"{axis.name}.limits.{key} = {value:g} is outside the contract's"
                f" {variable.minimum:g} .. {variable.maximum:g} {variable.unit}"
            )


def source(table: Mapping[str, Any], catalogue: Catalogue) -> str:
    """Text of ``servo_config_gen.c``.

    Raises
    ------
    ConfigError
        If the configuration cannot work.
    """
    scales = Scales.of(catalogue)
    for name in table.keys() - {"board", "defaults", *AXES}:
        raise ConfigError(f"[{name}] is unknown; known are board, defaults, {', '.join(AXES)}")
    board = check_board(table.get("board", {}), scales)
    ts = board["slow_divider"] / board["pwm_frequency"]
    axis_list = [Axis.of(table, name) for name in AXES]
    for axis in axis_list:
        check_limits(axis, catalogue)
    axes = "\n".join(f"        {{\n{axis_literal(axis, board, scales)}\n        }}," for axis in axis_list)
    return f"""/* Generated by `make generate` from config/servo.toml; edit that file instead. */
#include "config/axis_config.h"

/* clang-format off */
const servo_config_t servo_config = {{
    {{
{axes}
    }},
    .host_timeout = {uint16("host_timeout", board["host_timeout"] / ts)},
}};
"""


def main(argv: list[str] | None = None) -> int:
    """Command line; exit status 1 for a bad configuration or, with ``--check``, a file out of date."""
    parser = argparse.ArgumentParser(description="Compute the controller's integer constants from servo.toml.")
    parser.add_argument("--config", type=Path, default=HERE / "servo.toml", help="configuration (default: %(default)s)")
    parser.add_argument("--output", type=Path, default=HERE / "servo_config_gen.c", help="C file to write")
    parser.add_argument("--check", action="store_true", help="compare only")
    args = parser.parse_args(argv)
    try:
        table = tomllib.loads(args.config.read_text(encoding="utf-8"))
        text = source(table, Catalogue.load())
    except (OSError, tomllib.TOMLDecodeError, ConfigError) as error:
        print(f"{args.config}: {error}", file=sys.stderr)
        return 1
    stale = update([(args.output, text)], check=args.check)
    return 1 if args.check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
