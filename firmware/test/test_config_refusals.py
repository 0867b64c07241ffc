"""The tuning tool refuses an invalid configuration with entry, value, reason and remedy."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import Any

import pytest
from servo_msgs_py.board_description import DEFAULT_BOARD, BoardDescription
from servo_msgs_py.quantity import VALUE_MAX, Quantity
from servo_tuning.assessment import assess
from servo_tuning.braking import brake_constants
from servo_tuning.constants import time_outs
from servo_tuning.errors import ConfigError
from servo_tuning.findings import findings
from servo_tuning.optional import PARTS
from servo_tuning.passwords import password_constants
from servo_tuning.reading import parse, read_table
from servo_tuning.remedies import explained
from servo_tuning.source import c_source
from servo_tuning.tuned import tuned
from tuning_tool import CATALOGUE, case, configuration, entries, table


def compute(**changes: object) -> str:
    """The C text of a changed configuration."""
    whole = configuration(**changes)
    axes = [tuned(axis, whole).constants for axis in whole.axes]
    return c_source(axes, brake_constants(whole), time_outs(whole.board))


def test_the_committed_configuration_is_accepted() -> None:
    assert "servo_config" in compute()


# ---- single numbers -------------------------------------------------------------------------------------------------


ENTRIES = [pytest.param(name, entry, id=name) for name, entry in entries()]


def optional(row: Any) -> bool:
    return bool(row.values[1].optional)


@pytest.mark.parametrize(("name", "entry"), ENTRIES)
def test_invalid_value_of_an_entry_is_refused(name: str, entry: Quantity) -> None:
    wrong: list[tuple[object, str]] = [
        (-1.0, "too small"),
        (-1e-300, "too small"),
        (1e-300, "too small"),
        (1e300, "too large"),
        (math.nan, "not a finite number"),
        (math.inf, "not a finite number"),
        (-math.inf, "not a finite number"),
        (10**400, "not a finite number"),
        ("7", "not a number"),
        (True, "not a number"),
        ([1.0], "not a number"),
        ({}, "not a number"),
    ]
    if entry.minimum < 0.0:
        wrong[0] = (-1e300, "too small")
    if entry.minimum > 0.0:
        wrong.append((0.0, "too small"))
    if entry.whole:
        wrong.append((entry.minimum + 0.5, "not a whole number"))
    if entry.maximum < VALUE_MAX:
        wrong.append((entry.maximum * 1.001 if not entry.whole else entry.maximum + 1.0, "too large"))
    for value, reason in wrong:
        with pytest.raises(ConfigError) as refusal:
            compute(**{name.replace(".", "__"): value})
        message = str(refusal.value)
        assert message.startswith(f"{name} = "), message
        assert reason in message
        assert entry.text in message, "the message contains the meaning of the entry"


@pytest.mark.parametrize(("name", "entry"), [row for row in ENTRIES if not optional(row)])
def test_missing_entry_is_refused(name: str, entry: Quantity) -> None:
    whole = table()
    *groups, key = name.split(".")
    for owner in (groups[0], "defaults"):
        part: dict[str, Any] = whole.get(owner, {})
        for group in groups[1:]:
            part = part.get(group, {})
        part.pop(key, None)
    with pytest.raises(ConfigError, match=f"^{name} is missing; add it to \\[{name.rsplit('.', 1)[0]}\\]$"):
        parse(whole, CATALOGUE)


# ---- names and shapes -----------------------------------------------------------------------------------------------

NAMES: list[tuple[str, dict[str, object], str]] = [
    ("key", {"axis2__motor__inertai": 1e-5}, "axis2.motor.inertai is unknown; did you mean inertia?"),
    ("strange key", {"board__x": 1.0}, "board.x is unknown; known are nominal_voltage"),
    ("group", {"defaults__timign__settle": 0.01}, "defaults.timign is unknown; did you mean timing?"),
    ("group of an axis", {"axis1__moter__r_s": 1.0}, "axis1.moter is unknown; did you mean motor?"),
    ("board among the defaults", {"defaults__board__host_timeout": 1.0}, "defaults.board is unknown"),
    ("axis", {"axis3__motor__r_s": 1.0}, "[axis3] is unknown; did you mean axis"),
    ("switch", {"defaults__features__fricton": True}, "axis1.features.fricton is unknown; did you mean friction?"),
    ("number instead of a switch", {"axis1__features__friction": 1}, "axis1.features.friction = 1: neither on nor off"),
    ("number instead of a group", {"axis1__motor": 5}, "axis1.motor = 5: not a table"),
    ("number instead of an axis", {"axis1": 5}, "axis1 = 5: not a table"),
    ("list instead of defaults", {"defaults": [1]}, "defaults = [1]: not a table"),
    ("text instead of the board", {"board": "mine"}, "board = 'mine': not a table"),
    ("other board", {"board__name": "mine"}, "board.name = 'mine': the file is for another board"),
    ("number instead of a name", {"board__name": 7}, "board.name = 7: the file is for another board"),
    ("one point", {"board__temperature__table": [[0.0, 0]]}, "and strictly monotonic codes 0 .. 4096"),
]


@pytest.mark.parametrize(("changes", "message"), [row[1:] for row in NAMES], ids=[row[0] for row in NAMES])
def test_misspelt_names_and_wrong_types_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        configuration(**changes)
    assert message in str(refusal.value)


@pytest.mark.parametrize("name", ["axis1", "axis2", "board"])
def test_missing_table_is_refused(name: str) -> None:
    whole = table()
    del whole[name]
    with pytest.raises(ConfigError, match=rf"{name}.*is missing"):
        parse(whole, CATALOGUE)


def test_a_file_that_names_no_board_is_for_the_default_board() -> None:
    whole = table()
    del whole["board"]["name"]
    whole["board"] |= {"pwm_frequency": 16000.0, "slow_divider": 8, "timer_clock": 781250.0, "dead_time": 1e-6}  # older
    assert parse(whole, CATALOGUE).board.description == BoardDescription.load(DEFAULT_BOARD)


def test_missing_switch_is_refused() -> None:
    whole = table()
    del whole["defaults"]["features"]["dead_time"]
    with pytest.raises(ConfigError, match=r"features\.dead_time is missing"):
        parse(whole, CATALOGUE)


def test_an_inherited_entry_is_named_with_its_place() -> None:
    with pytest.raises(ConfigError, match=r"^axis1\.limits\.current \(in \[defaults\.limits\]\) = 9: "):
        configuration(defaults__limits__current=9.0)
    with pytest.raises(ConfigError, match=r"^axis1\.limits\.current = 9: "):
        configuration(axis1__limits__current=9.0)
    with pytest.raises(ConfigError, match=r"^axis2\.limits\.current = -9: "):
        configuration(axis2__limits__current=-9.0)


# ---- combined numbers -----------------------------------------------------------------------------------------------

K: dict[str, object] = {"axis1__observer__k_1": -5200.0, "axis1__observer__k_2": 5300.0}
HEAVY: dict[str, object] = {
    "axis1__motor__inertia": 4e-4,
    "axis1__control__speed_bandwidth": 15.0,
    "axis1__start_up__speed_time": 0.25,
    "axis1__control__position_gain": 10.0,
}

FITTED: dict[str, object] = {"board__brake__fitted": True}


def slow_current(bandwidth: float, r_s: float, **others: object) -> dict[str, object]:
    """Current controllers that take long to overcome the voltage that dead time and switches take."""
    control = {"current_bandwidth": bandwidth, "speed_bandwidth": bandwidth / 12.0, "position_gain": 0.1 * bandwidth}
    return {f"axis1__control__{key}": value for key, value in control.items()} | {"axis1__motor__r_s": r_s} | others


TOGETHER = [
    # limits beyond the full scales of the contract
    case("axis1.limits.current = 9", "0.1 .. 4 A"),
    case("axis1.limits.current = 4.5", "param.i_q_limit"),
    case("axis1.rotor_search.current = 4.5", "write 4 or less"),
    case(
        "axis1.rotor_search.current (in [defaults.rotor_search]) = 4",
        "above the current limit of 1 A (limits.current); write 1 or less",
        axis1__limits__current=1.0,
    ),
    case(
        "axis1.rotor_search.current (in [defaults.rotor_search]) = 4",
        "friction can hold the rotor 0.28 rad (electrical) off the current vector at 4 A, more than 0.25 rad; correct",
        axis1__friction__coulomb=0.05,
    ),
    case(
        "axis1.rotor_search.current = 4",
        "than 0.25 rad; above this current the reluctance of this rotor turns it off the vector; correct",
        axis1__friction__coulomb=0.0157,
        axis1__motor__l_q=5e-3,
    ),
    case("axis1.limits.speed = 600", "0.1 .. 419 rad/s of param.speed_limit; write 419 or less"),
    case("axis1.limits.acceleration = 60000", "50000"),
    case("axis1.limits.position = 2e+06", "param.position_max"),
    case("axis1.limits.following_error = 2000", "1000 rad"),
    case("axis1.limits.over_speed = 520", "500 rad/s"),
    # not possible with supply and shaft
    case(
        "axis1.limits.speed = 400",
        "above the no-load speed of 352.4 rad/s at 20 V",
        axis1__limits__over_speed=450.0,
        board__nominal_voltage=20.0,
    ),
    case("axis1.limits.speed (in [defaults.limits]) = 314", "65.13 rad/s", axis1__motor__psi_m=0.1),
    case("axis1.friction.coulomb = 0.2", "gives 0.185 N m"),
    case("axis1.motor.rotor_inertia = 2e-05", "8e-06 kg m^2"),
    case("axis1.load.stiffness is missing", "or remove the group", axis1__load__inertia=4e-6),
    case("axis1.load.inertia = 8e-06", "8e-06 kg m^2", axis1__load__stiffness=1.0, axis1__load__damping=0.02),
    # consistency of the limits
    case("axis1.timing.stop_speed = 314", "speed limit"),
    case("board.under_voltage = 25", "nominal_voltage = 24 V"),
    case("board.nominal_voltage = 33", "over_voltage = 33 V"),
    case("board.over_voltage = 36.3", "36.3 V"),
    case("board.nominal_voltage = 48", "36.3 V, the largest bus voltage of the board mc56f84789"),
    case("board.dead_time = 2e-06", "the board mc56f84789 has 1e-06; remove the entry"),
    # fixed by the contract
    case("axis1.limits.speed (in [defaults.limits]) = 314", "239.7 rad/s", defaults__encoder__lines=16384),
    case(
        "axis1.encoder.lines (in [defaults.encoder]) = 16385",
        "16384",
        defaults__encoder__lines=16385,
        defaults__limits__speed=200.0,
    ),
    case("axis1.encoder.lines (in [defaults.encoder]) = 99", "100", defaults__encoder__lines=99),
    case("board.slow_divider = 16", "has 8; remove the entry"),
    case("board.pwm_frequency = 20000", "has 16000; remove the entry"),
    case("axis1.control.anti_windup = 1", "E35"),
    # order of the loops
    case("axis1.control.position_gain = 600", "speed loop"),
    case("axis1.control.speed_bandwidth = 1000", "current_bandwidth = 1000 Hz"),
    case("axis1.control.current_bandwidth = 8000", "16000 Hz"),
    # rotor search
    case("axis1.rotor_search.interval = 60", "torque"),
    case("axis1.rotor_search.move_counts = 250", "the rest is for friction"),
    case("axis1.rotor_search.move_counts = 2", "dither"),
    case("axis1.rotor_search.time_max = 0.5", "8 vectors"),
    # without an encoder
    case("axis1.observer.k_1 = -5000", "observer.k_2 is missing"),
    case("axis1.observer.k_1 = -5200", "400 Hz specifies the same", **K, axis1__observer__bandwidth=400.0),
    # gains and scales out of range
    case("axis1: speed controller Kp = 2", "does not fit speed.kp (0 .. 127)", axis1__motor__inertia=4e-4),
    case(
        "axis1: current controller q Kp = 214.",
        "does not fit current_loop.q.kp",
        axis1__motor__l_q=0.1,
        axis1__rotor_search__current=0.076,
        axis1__sensing__sign_current=0.035,
        axis1__friction__coulomb=1e-4,
    ),
    case(
        "axis1: gains added in u_d = 314.",
        "one sum of a PI",
        axis1__motor__l_d=0.055,
        axis1__motor__l_q=0.055,
        axis1__motor__pole_pairs=20,
        axis1__motor__psi_m=0.00154,
        axis1__rotor_search__interval=4.0,
        axis1__observer__bandwidth=1500.0,
    ),
    case("axis1: current controller d Kp Ki Ts = 133.", "current_loop.d.ki", axis1__motor__r_s=1000.0),
    case("axis1.control.position_gain = 1e-05", "vanish"),
    case("axis1: omega_n Ts", "path_omega_n_ts", axis1__motor__inertia=1.6e-6, axis1__control__path_current_use=1.0),
    case("axis1.rotor_search.ramp_time: current", "rotor_search.current_step", axis1__rotor_search__ramp_time=1e-4),
    # times
    case(
        "axis1: slow ticks of the search = 100000",
        "write axis1.rotor_search.time_max = 32.7",
        axis1__rotor_search__time_max=50.0,
    ),
    case(
        "axis1: slow ticks of the search = 137869",
        "write axis1.control.current_bandwidth = 41",
        **slow_current(20.0, 0.05),
    ),
    case(
        "axis1.rotor_search.ramp_time (in [defaults.rotor_search]): current per slow tick",
        "write axis1.control.current_bandwidth",
        **slow_current(1.0, 5e-4, axis1__rotor_search__current=0.1, axis1__friction__coulomb=1e-5),
    ),
    case(
        "axis1: slow ticks of the hold = 80000",
        "write axis1.rotor_search.hold_time = 32.7",
        axis1__rotor_search__hold_time=40.0,
        axis1__rotor_search__time_max=400.0,
    ),
    case("axis1.timing.stall_max = 32.7675", "65534"),
    case("axis1.timing.stall_max = 40", "write 32.7 or less"),
    case("axis1.timing.settle = 0.0001", "vanish"),
    case("board.host_timeout = 60", "0.05 .. 30 s"),
    case("board.command_timeout = 60", "0 .. 30 s"),
    # bus, brake resistor, stop categories
    case("board.regeneration.start_voltage = 23", "24"),
    case("board.regeneration.full_voltage = 28", "29"),
    case("board.over_voltage = 33", "not above", board__regeneration__full_voltage=33.0),
    case("board.brake.on_voltage = 28", "not above", **FITTED, board__brake__off_voltage=28.0),
    case("board.brake.off_voltage = 24", "nominal", **FITTED),
    case("board.regeneration.start_voltage = 29", "29.5", **FITTED, board__brake__on_voltage=29.5),
    case("board.brake.resistance = 10", "9.11 or less", **FITTED),
    case("board.brake.energy = 0.9", "0.986 J", **FITTED),
    case("board.brake.power = 200", "167 W", **FITTED),
    case("axis1.stop.short_current = 9", "8.25 A"),
    case("axis1.stop.time_max = 0.5", "0.579 s"),
    # PWM ripple, dead time and switch drops
    case(
        "axis1.limits.current = 4",
        "3.12 A, above 6.6 A, 0.8 of the range of the current sensors; write 3.47 or less",
        axis1__motor__l_d=20e-6,
        axis1__motor__l_q=20e-6,
    ),
    case(
        "axis1.motor.inertia = 8e-06",
        "below 1.8 A the PWM ripple hides the direction of its current",
        axis1__motor__l_d=60e-6,
        axis1__motor__l_q=60e-6,
        axis1__limits__current=1.5,
        axis1__rotor_search__current=1.4,
    ),
    # loops that are unstable by sampling
    case("axis1.control.current_bandwidth = 6000", "unstable"),
    case("axis1.control.speed_bandwidth = 250", "unstable"),
    case(
        "axis1.control.position_gain = 700",
        "unstable",
        axis1__control__speed_bandwidth=180.0,
        axis1__control__observer_bandwidth=300.0,
    ),
]


@pytest.mark.parametrize(("beginning", "reason", "changes"), TOGETHER)
def test_inconsistent_numbers_are_refused(beginning: str, reason: str, changes: dict[str, object]) -> None:
    with pytest.raises(ConfigError) as refusal:
        compute(**changes)
    message = str(explained(refusal.value))
    assert message.startswith(beginning), message
    assert reason in message, message
    assert message.count("; ") >= 1, f"no remedy: {message}"


@pytest.mark.parametrize(
    "changes", [row[2] for row in TOGETHER if all(path.startswith("axis1") for path in row[2])][::6]
)
def test_axis_2_is_checked_like_axis_1(changes: dict[str, object]) -> None:
    with pytest.raises(ConfigError, match=r"^axis2"):
        compute(**{path.replace("axis1", "axis2"): value for path, value in changes.items()})


OPTIONAL: dict[str, list[tuple[str, str, dict[str, object]]]] = {
    "axis1__feedback": [
        case(
            "axis1.start_up.swing_current (in [defaults.start_up]) = 0.5",
            "4.02 A, more than limits.current",
            axis1__start_up__current_final=0.9,
        ),
        case("axis1.observer.k_1 = 0", "not below 0", **K),
        case("axis1.observer.k_2 = -5000", "not above 0", **K),
        case("axis1.observer.k_1 = -17000", "overshoots the measured current", **K),
        case("axis1.observer.k_2 = 900000", "outside the unit circle", **K),
        case("axis1.observer.k_2 = 50", "it must be below", **K),
        case("axis1.observer.bandwidth = 2000", "sampling rate of 16000 Hz"),
        case("axis1.observer.bandwidth = 100", "105 Hz at limits.speed"),
        case("axis1.observer.damping = 10", "it must be below", axis1__motor__r_s=0.1),
        case("axis1.observer.bandwidth (in", "natural frequency of the PLL", axis1__observer__pll_i=9e8),
        case("axis1.observer.pll_i = 1.4e+07", "its sampling", axis1__observer__pll_damping=9.0),
        case("axis1.observer.pll_i = 10000", "lag the start-up ramp"),
        case("axis1.observer.pll_load = 1", "oscillates"),
        case("axis1.reliability.variance_threshold", "twice its mean", axis1__reliability__variance_threshold=0.5),
        case("axis1.start_up.speed_time = 0.008", "9812 rad/s^2"),
        case("axis1.start_up.swings = 0.2", "of the start-up current"),
        case("axis1.start_up.speed_time = 0.25", "correct motor.inertia", **HEAVY),
        case("axis1.start_up.current_first = 0.2", "0.037 N m", axis1__friction__coulomb=0.04),
        case("axis1.start_up.minimum_speed = 0.3", "94.2 rad/s"),
        case("axis1.start_up.mean_max = 1", "not above 1"),
        case("axis1.start_up.mean_min = 1", "not below 1"),
        case("axis1.start_up.wait_max (in [defaults.start_up])", "64 speeds", axis1__reliability__period=60),
    ],
    "axis1__features__speed_observer": [
        case("axis1.control.observer_bandwidth = 19", "not within 19.1 .. 1000 Hz"),
        case("axis1.control.observer_bandwidth = 1000", "not within"),
    ],
    "axis1__features__friction": [
        case("axis1.friction.smooth", "does not fit friction.slope", axis1__friction__smooth=0.01),
    ],
    "axis1__features__over_speed": [
        case("axis1.limits.over_speed = 314", "314 rad/s"),
    ],
}
"""Refusals of an axis that uses a part, by the entry that selects the part."""

USE: dict[str, object] = {switch: "observer" if switch.endswith("feedback") else True for switch in OPTIONAL}
OPTIONAL_CASES = [(switch, *row) for switch, rows in OPTIONAL.items() for row in rows]


@pytest.mark.parametrize(("switch", "beginning", "reason", "changes"), OPTIONAL_CASES)
def test_only_what_an_axis_uses_is_refused(
    switch: str, beginning: str, reason: str, changes: dict[str, object]
) -> None:
    """Else the members are off, and a warning has the same text."""
    with pytest.raises(ConfigError) as refusal:
        compute(**{switch: USE[switch], **changes})
    assert str(refusal.value).startswith(beginning)
    assert reason in str(refusal.value)
    whole = configuration(**changes)
    design = tuned(whole.axes[0], whole)
    warnings = list(map(str, findings(design, assess(design))))
    assert any(beginning in warning and reason in warning for warning in warnings), warnings
    for name in design.unusable:
        assert {field: design.constants[field] for field in PARTS[name].off} == PARTS[name].off


# ---- stop categories ------------------------------------------------------------------------------------------------

STOPS = [
    ("over_voltage", "ramp", "regeneration would raise"),
    ("over_current", "short", "may be broken"),
    ("encoder_lost", "ramp", "angle of the rotor"),
    ("encoder_lost", "short", "speed is not known"),
    ("runaway", "hold", "angle of the rotor"),
    ("under_voltage", "ramp", "too low for gate drivers"),
    ("over_temperature", "hold", "heats the winding"),
    ("phase_lost", "ramp", "currents are not valid"),
    ("host_silent", "halt", "not a stop category"),
    ("following_error", 1, "not a stop category"),
]


@pytest.mark.parametrize(("fault", "category", "reason"), STOPS)
def test_an_impossible_stop_category_is_refused(fault: str, category: object, reason: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        configuration(**{f"axis2__stop__{fault}": category})
    message = str(refusal.value)
    assert message.startswith(f"axis2.stop.{fault} = ")
    assert reason in message
    assert "; write coast" in message


def test_invalid_names_of_stop_categories_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"axis1\.stop\.following_eror .*unknown; did you mean following_error"):
        configuration(axis1__stop__following_eror="ramp")
    whole = table()
    del whole["defaults"]["stop"]["disable"]
    with pytest.raises(ConfigError, match=r"axis1\.stop\.disable.*every command"):
        parse(whole, CATALOGUE)


def test_stop_categories_are_written_to_the_c_file() -> None:
    text = compute(axis1__stop__following_error="short", axis1__stop__over_speed="ramp", axis1__stop__disable="coast")
    axis1 = text.split("},\n        {")[0]
    assert ".stop.disable = STOP_CATEGORY_COAST," in axis1
    assert ".stop.shorted = FAULT_FOLLOWING_ERROR | FAULT_OSCILLATION," in axis1
    assert ".stop.ramp = FAULT_HOMING | FAULT_HOST_SILENT | FAULT_LIMIT_SWITCH | FAULT_OVER_SPEED," in axis1
    assert ".stop.hold = 0," in axis1


# ---- passwords ------------------------------------------------------------------------------------------------------


def test_passwords_are_written_as_hashes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SERVO_PASSWORD", "secret")
    constants = password_constants(
        configuration(board__passwords={"command": "env:SERVO_PASSWORD", "tune": "sha1:" + 20 * "0A"}).board.passwords
    )
    assert constants == {"password[1]": tuple(hashlib.sha1(b"secret").digest()), "password[2]": 20 * (10,)}
    text = c_source([], {}, constants)
    assert f".password[2] = {{{', '.join(['10'] * 20)}}}," in text
    assert password_constants(configuration().board.passwords) == {}, "off by default"


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"command": "open sesame"}, r"board\.passwords\.command = \.\.\.: neither a hash"),
        ({"view": "sha1:12"}, r"board\.passwords\.view = \.\.\.: neither a hash"),
        ({"view": 12}, r"board\.passwords\.view = 12: not a string"),
        ({"tune": "env:SERVO_NOT_SET"}, r"env:SERVO_NOT_SET: the environment variable is not set"),
        ({"tunes": "env:HOME"}, r"board\.passwords\.tunes is unknown; did you mean tune"),
    ],
)
def test_invalid_passwords_are_refused(entries: dict[str, object], message: str) -> None:
    """The message does not contain the password."""
    with pytest.raises(ConfigError, match=message) as error:
        password_constants(configuration(board__passwords=entries).board.passwords)
    assert "sesame" not in str(error.value)


# ---- base of a file --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("files", [{"a": "a"}, {"a": "b", "b": "a"}, {"a": "b", "b": "c", "c": "b"}])
def test_a_base_that_leads_back_to_its_file_is_refused(tmp_path: Path, files: dict[str, str]) -> None:
    (tmp_path / "folder").mkdir()
    for name, base in files.items():
        (tmp_path / name).write_text(f'base = "folder/../{base}"\n', encoding="utf-8")
    with pytest.raises(ConfigError, match=r"base = .* leads back to this file; remove it"):
        read_table(tmp_path / "a")


def test_a_base_that_is_missing_is_named(tmp_path: Path) -> None:
    (tmp_path / "a").write_text('base = "b"\n', encoding="utf-8")
    with pytest.raises(FileNotFoundError, match=str(tmp_path / "b")):
        read_table(tmp_path / "a")


def test_a_table_within_a_table_changes_single_entries_of_its_base(tmp_path: Path) -> None:
    (tmp_path / "a").write_text('base = "b"\n[x.y]\nk = 1\n[z]\n', encoding="utf-8")
    (tmp_path / "b").write_text("[x]\nm = 2\n[x.y]\nk = 3\nn = [4]\n[w]\n", encoding="utf-8")
    assert read_table(tmp_path / "a") == {"x": {"m": 2, "y": {"k": 1, "n": [4]}}, "w": {}, "z": {}}
