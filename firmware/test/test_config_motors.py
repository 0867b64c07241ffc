"""Any motor: the tuning tool writes constants that fit their C types, or refuses the motor; it never fails."""

from __future__ import annotations

import json
import math
import random
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from core_library import Core
from firmware_compiler import FIRMWARE, run_compiler
from hypothesis import given, settings
from hypothesis import strategies as st
from servo_msgs_py.stop_categories import CATEGORIES
from servo_tuning.braking import brake_constants
from servo_tuning.command import main
from servo_tuning.configuration import Configuration
from servo_tuning.constants import time_outs
from servo_tuning.conversion import AxisConstants, Category, FaultSet, PiRaw, Switches
from servo_tuning.errors import ConfigError
from servo_tuning.linear import spectral_radius
from servo_tuning.reading import parse
from servo_tuning.schema import AXIS_GROUPS, BOARD, BOARD_GROUPS
from servo_tuning.source import c_source
from servo_tuning.tuned import Tuned, tuned
from tuning_tool import CATALOGUE, logarithmic, table

FAULTS = {flag.name.lower(): flag.mask for flag in CATALOGUE.flags["faults"]}
FEATURES = {flag.name.lower(): flag.mask for flag in CATALOGUE.flags["features"]}


MOTORS = st.fixed_dictionaries(
    {
        "motor__r_s": logarithmic(0.05, 5.0),
        "motor__l_d": logarithmic(0.05e-3, 5e-3),
        "motor__l_q": logarithmic(0.05e-3, 5e-3),
        "motor__psi_m": logarithmic(0.003, 0.05),
        "motor__inertia": logarithmic(1e-6, 1e-3),
        "motor__pole_pairs": st.integers(1, 8),
        "control__current_bandwidth": logarithmic(200.0, 2000.0),
        "control__speed_bandwidth": logarithmic(3.0, 150.0),
        "control__position_gain": logarithmic(1.0, 200.0),
        "limits__current": logarithmic(0.2, 4.0),
        "limits__speed": logarithmic(10.0, 400.0),
    }
)


def with_motor(motor: Mapping[str, float], axis: str = "axis1") -> dict[str, Any]:
    """The committed configuration with another motor, its rotor and its friction in proportion."""
    changes: dict[str, object] = {f"{axis}__{path}": value for path, value in motor.items()}
    push = 1.5 * motor["motor__pole_pairs"] * motor["motor__psi_m"] * motor["limits__current"]
    changes[f"{axis}__motor__rotor_inertia"] = 0.3 * motor["motor__inertia"]
    changes[f"{axis}__friction__coulomb"] = 0.05 * push
    changes[f"{axis}__limits__over_speed"] = 1.2 * motor["limits__speed"]
    changes[f"{axis}__rotor_search__current"] = motor["limits__current"]
    return table(**changes)


def tune(whole: Mapping[str, Any]) -> tuple[Configuration, list[Tuned]]:
    configuration = parse(whole, CATALOGUE)
    assert brake_constants(configuration)
    assert time_outs(configuration.board)
    return configuration, [tuned(axis, configuration) for axis in configuration.axes]


def tune_or_refuse(whole: Mapping[str, Any]) -> tuple[Configuration, list[Tuned]] | str:
    """Tuned constants, or the refusal without its remedies (`test_config_remedies.py`), whose search takes time."""
    try:
        return tune(whole)
    except ConfigError as refusal:
        return refusal.problem.fact


def fill(config: Any, constants: AxisConstants) -> None:
    """Write the constants into a C structure; cffi refuses values out of range."""
    for path, value in constants.items():
        *groups, field = path.split(".")
        place = config
        for group in groups:
            place = getattr(place, group)
        if isinstance(value, Switches):
            setattr(place, field, sum(FEATURES[name] for name in value))
        elif isinstance(value, FaultSet):
            setattr(place, field, sum(FAULTS[name] for name in value))
        elif isinstance(value, Category):
            setattr(place, field, CATEGORIES.index(value))
        elif isinstance(value, PiRaw):
            gains = getattr(place, field)
            gains.kp, gains.ki, gains.kc = value
            assert (gains.kp, gains.ki, gains.kc) == value
        elif field.endswith("]"):
            name, _, index = field[:-1].partition("[")
            getattr(place, name)[int(index)] = value
        else:
            setattr(place, field, value)
            assert getattr(place, field) == value, path


def fields_of(core: Core, type_: Any, prefix: str = "") -> set[str]:
    """C paths of all fields of a structure; the gains of a PI controller count as one."""
    found: set[str] = set()
    for name, field in type_.fields:
        if field.type.kind == "struct" and field.type.cname != "pi_gains_t":
            found |= fields_of(core, field.type, f"{prefix}{name}.")
        elif field.type.kind == "array":
            found |= {f"{prefix}{name}[{k}]" for k in range(field.type.length)}
        else:
            found.add(prefix + name)
    return found


def test_every_field_of_the_structure_is_written(core: Core) -> None:
    """A field that is not initialised would be 0 without a warning."""
    _, axes = tune(table())
    assert set(axes[0].constants) == fields_of(core, core.ffi.typeof("axis_config_t"))


@settings(max_examples=400)
@given(MOTORS)
def test_constants_of_any_motor_fit_their_types(core: Core, motor: dict[str, float]) -> None:
    outcome = tune_or_refuse(with_motor(motor))
    if isinstance(outcome, str):
        assert outcome.startswith("axis1"), outcome
        return
    configuration, axes = outcome
    config = core.ffi.new("servo_config_t *")
    for place, it in zip(config.axis, axes, strict=True):
        fill(place, it.constants)
    fill(config.bus_braking, brake_constants(configuration))
    for name, ticks in time_outs(configuration.board).items():
        setattr(config, name, ticks)
    it = axes[0]
    assert max(spectral_radius(it.current_loop(which).closed.a) for which in "dq") < 1.0
    assert spectral_radius(it.shaft().speed_alone) < 1.0
    assert spectral_radius(it.shaft().position.a) < 1.0


def sample(count: int, seed: int) -> list[dict[str, Any]]:
    """Random motors with gains in proportion, for slow tests and for counting."""
    draw = random.Random(seed)

    def log(low: float, high: float) -> float:
        return math.exp(draw.uniform(math.log(low), math.log(high)))

    motors: list[dict[str, float]] = []
    for _ in range(count):
        speed = log(5.0, 75.0)
        inductance = log(0.05e-3, 5e-3)
        motors.append(
            {
                "motor__r_s": log(0.05, 5.0),
                "motor__l_d": inductance,
                "motor__l_q": inductance * draw.uniform(1.0, 1.5),
                "motor__psi_m": log(0.003, 0.05),
                "motor__inertia": log(1e-6, 1e-3),
                "motor__pole_pairs": draw.randint(1, 8),
                "control__current_bandwidth": log(500.0, 1200.0),
                "control__speed_bandwidth": speed,
                "control__position_gain": 0.8 * speed,
                "limits__current": log(0.5, 4.0),
                "limits__speed": log(20.0, 150.0),
            }
        )
    return [with_motor(motor) for motor in motors]


def test_most_motors_can_be_tuned() -> None:
    """With matching bandwidths; the others have too much or too little inertia for their current, or are too fast."""
    outcomes = [tune_or_refuse(whole) for whole in sample(200, seed=1)]
    reasons = [outcome for outcome in outcomes if isinstance(outcome, str)]
    assert len(reasons) <= 80, reasons
    kinds = (
        "does not fit speed.",
        "does not fit path_omega_n_ts",
        "no-load speed",
        "reluctance of this rotor",
        "a dead time",
        "hides the direction",
    )
    assert [sum(kind in reason for kind in kinds) for reason in reasons] == [1] * len(reasons), reasons
    assert all(any(kind in reason for reason in reasons) for kind in kinds)


def written(whole: Mapping[str, Any]) -> str:
    """TOML of a table with two levels of groups."""
    lines = []
    for owner, groups in whole.items():
        flat = {key: value for key, value in groups.items() if not isinstance(value, dict)}
        nested = {f"{owner}.{key}": value for key, value in groups.items() if isinstance(value, dict)}
        for name, entries in (({owner: flat} if flat else {}) | nested).items():
            lines.append(f"[{name}]")
            lines += [f"{key} = {json.dumps(value)}" for key, value in entries.items()]
    return "\n".join(lines) + "\n"


def test_command_works_for_other_motors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Written files compile without a warning; refused motors write no file; the report never fails."""
    outcomes = []
    for number, whole in enumerate(sample(8, seed=2)):
        config, output = tmp_path / f"{number}.toml", tmp_path / f"{number}.c"
        config.write_text(written(whole), encoding="utf-8")
        status = main(["--config", str(config), "--output", str(output)])
        assert main(["report", "--config", str(config)]) == status
        errors = capsys.readouterr().err
        outcomes.append(status)
        if status == 0:
            run_compiler(tmp_path / f"{number}.o", [output], ["-c"], "gcc")
        else:
            assert not output.exists()
            assert errors.startswith(f"{config}: axis1")
    assert set(outcomes) == {0, 1}, "both outcomes occur"


def places() -> list[str]:
    """Paths of all numbers of the file."""
    return (
        [f"board__{key}" for key in BOARD]
        + [f"board__{group}__{key}" for group, entries in BOARD_GROUPS.items() for key in entries]
        + [f"axis1__{group}__{key}" for group, entries in AXIS_GROUPS.items() for key in entries]
    )


@settings(max_examples=600)
@given(st.dictionaries(st.sampled_from(places()), st.floats(-13.0, 13.0), min_size=1, max_size=4))
def test_absurd_numbers_are_tuned_or_refused(core: Core, exponents: dict[str, float]) -> None:
    """Some entries changed by powers of ten, alone and together."""
    whole = table()
    for place, exponent in exponents.items():
        *groups, key = place.split("__")
        entries = whole
        for group in groups:
            entries = entries.setdefault(group, {})
        default = whole["defaults"].get(groups[-1], {}).get(key, 1.0)
        entries[key] = entries.get(key, default) * 10.0**exponent
    outcome = tune_or_refuse(whole)
    if isinstance(outcome, str):
        return
    configuration, axes = outcome
    config = core.ffi.new("servo_config_t *")
    for target, it in zip(config.axis, axes, strict=True):
        fill(target, it.constants)
    assert c_source([it.constants for it in axes], brake_constants(configuration), time_outs(configuration.board))


def test_the_folder_of_the_tool_is_not_compiled() -> None:
    """The build compiles every C file of a firmware folder; the package of the tool contains none."""
    assert not list((FIRMWARE / "config" / "tuning").glob("*.[ch]"))
