"""tune.py: refuses what cannot work and says why; the committed files are those it writes."""

from __future__ import annotations

import importlib.util
import math
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from core_library import Core, load_core
from firmware_compiler import FIRMWARE, CompileC

from servo_msgs_py import codegen

CONFIG = FIRMWARE / "config"
TEXT = (CONFIG / "servo.toml").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def tune() -> ModuleType:
    spec = importlib.util.spec_from_file_location("firmware_tune", CONFIG / "tune.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def edited(pattern: str, replacement: str, text: str = TEXT) -> str:
    """servo.toml with one place changed."""
    result, count = re.subn(pattern, replacement, text, count=1, flags=re.MULTILINE)
    assert count == 1, pattern
    return result


def run(tune: ModuleType, folder: Path, text: str) -> int:
    path = folder / "servo.toml"
    path.write_text(text, encoding="utf-8")
    return int(tune.main(["--config", str(path), "--output", str(folder / "out.c")]))


# ---- refused --------------------------------------------------------------------------------------------------------

REFUSED = [
    ("negative inertia", r"^inertia    = 0.8e-5", "inertia = -0.8e-5", "axis1.motor.inertia"),
    ("zero inductance", r"^l_q        = 0.512e-3", "l_q = 0.0", "axis1.motor.l_q"),
    ("not a number", r"^r_s        = 0.55", "r_s = nan", "axis1.motor.r_s"),
    ("infinite", r"^psi_m      = 0.0154", "psi_m = inf", "axis1.motor.psi_m"),
    ("text", r"^l_d        = 0.375e-3", 'l_d = "small"', "axis2.motor.l_d"),
    ("truth value", r"^pole_pairs = 2", "pole_pairs = true", "pole_pairs"),
    ("half a pole pair", r"^pole_pairs = 2", "pole_pairs = 2.5", "pole_pairs"),
    ("anti-windup of 1", r"^anti_windup       = 0.5", "anti_windup = 1.0", "anti_windup"),
    ("gain that does not fit", r"^speed_bandwidth   = 80.0", "speed_bandwidth = 8000.0", "speed.kp"),
    ("gain that vanishes", r"^position_gain     = 60.0", "position_gain = 1e-9", "position_gain"),
    ("filter too fast", r"^path_current_use  = 0.5", "path_current_use = 50.0", "path_omega_n_ts"),
    ("current over the full scale", r"^current      = 4.0", "current = 9.0", "current"),
    ("current over the contract", r"^current      = 4.0", "current = 5.0", "current"),
    ("speed over the full scale", r"^speed        = 314.0", "speed = 600.0", "speed"),
    ("other encoder than the contract's", r"^lines = 1000", "lines = 2500", "encoder.lines"),
    ("other slow loop", r"^slow_divider  = 8", "slow_divider = 16", "slow_divider"),
    ("no frequency", r"^pwm_frequency = 16000.0", "pwm_frequency = 0.0", "pwm_frequency"),
    ("limits crossed", r"^under_voltage = 16.0", "under_voltage = 34.0", "under_voltage"),
    ("negative limit", r"^under_voltage = 16.0", "under_voltage = -1.0", "under_voltage"),
    ("voltage beyond linear modulation", r"^voltage_use   = 0.94", "voltage_use = 1.1", "voltage_use"),
    ("missing key", r"^r_s        = 0.55.*\n", "", "axis1.motor.r_s is missing"),
    ("missing search key", r"^ramp_time.*\n", "", "rotor_search.ramp_time is missing"),
    ("missing board key", r"^dead_time.*\n", "", "board.dead_time is missing"),
    ("misspelt key", r"^inertia    = 1.2e-5", "inertai = 1.2e-5", "inertai"),
    ("misspelt group", r"^\[defaults.timing\]", "[defaults.timign]", "timign"),
    ("misspelt axis", r"^\[axis2.motor\]", "[axis3.motor]", "axis"),
]


@pytest.mark.parametrize(("pattern", "replacement", "reason"), [r[1:] for r in REFUSED], ids=[r[0] for r in REFUSED])
def test_impossible_configuration_is_refused_with_the_reason(
    tune: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str], pattern: str, replacement: str, reason: str
) -> None:
    assert run(tune, tmp_path, edited(pattern, replacement)) == 1
    message = capsys.readouterr().err
    assert reason in message
    assert str(tmp_path / "servo.toml") in message
    assert not (tmp_path / "out.c").exists(), "nothing is written"


def test_broken_toml_and_missing_file(tune: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tune, tmp_path, "[board\n") == 1
    assert "line 1" in capsys.readouterr().err
    assert tune.main(["--config", str(tmp_path / "none.toml"), "--output", str(tmp_path / "out.c")]) == 1
    assert "none.toml" in capsys.readouterr().err


# ---- accepted -------------------------------------------------------------------------------------------------------


def test_an_axis_may_override_the_defaults(tune: ModuleType, tmp_path: Path) -> None:
    assert run(tune, tmp_path, TEXT + "\n[axis2.limits]\ncurrent = 2.0\n") == 0
    limits = re.findall(r"\.i_q_limit = (\d+),", (tmp_path / "out.c").read_text(encoding="utf-8"))
    assert [int(x) for x in limits] == [round(4.0 / 8.25 * 2**15), round(2.0 / 8.25 * 2**15)]


def test_committed_files_are_up_to_date(tune: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    assert tune.main(["--check"]) == 0
    assert codegen.main(["--check"]) == 0
    assert capsys.readouterr().err == ""


def test_check_finds_a_stale_file(tune: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stale = tmp_path / "servo_config_gen.c"
    stale.write_text((CONFIG / "servo_config_gen.c").read_text(encoding="utf-8") + "\n", encoding="utf-8")
    assert tune.main(["--check", "--output", str(stale)]) == 1
    assert "out of date" in capsys.readouterr().err
    assert tune.main(["--output", str(stale)]) == 0
    assert tune.main(["--check", "--output", str(stale)]) == 0


# ---- numbers --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def core(compile_c: CompileC) -> Core:
    return load_core(compile_c)


@pytest.fixture(scope="module")
def axes(core: Core) -> Any:
    return core.lib.probe_config().axis


GAIN, Q15, Q31 = 2.0**24, 2.0**15, 2.0**31
U_FS, I_FS, W_FS = 24.2, 8.25, 5000.0 * math.pi / 30.0


def test_gains_follow_from_bandwidth_and_motor(axes: Any) -> None:
    motors = ((0.55, 0.403e-3, 0.512e-3, 0.0154, 0.8e-5, 80.0), (0.45, 0.375e-3, 0.429e-3, 0.0138, 1.2e-5, 60.0))
    for axis, (r, l_d, l_q, psi, inertia, speed_bandwidth) in zip(axes, motors, strict=True):
        loop, k_t = axis.current_loop, 3.0 * psi
        w = 2 * math.pi * 1000.0
        assert loop.d.kp / GAIN == pytest.approx(w * l_d * I_FS / U_FS, rel=1e-6)
        assert loop.q.kp / GAIN == pytest.approx(w * l_q * I_FS / U_FS, rel=1e-6)
        assert loop.q.ki / GAIN == pytest.approx(w * r / 16000 * I_FS / U_FS, rel=1e-6)
        assert loop.omega_psi / GAIN == pytest.approx(2 * W_FS * psi / U_FS, rel=1e-6)
        assert loop.omega_l_q / GAIN == pytest.approx(2 * W_FS * l_q * I_FS / U_FS, rel=1e-6)
        assert loop.angle_step / GAIN * math.pi == pytest.approx(2 * W_FS / 16000, rel=1e-5)
        w = 2 * math.pi * speed_bandwidth
        assert axis.speed.kp / GAIN == pytest.approx(w * inertia / k_t * W_FS / I_FS, rel=1e-6)
        assert axis.torque_constant / Q15 == pytest.approx(k_t, rel=5e-4)


def test_limits_and_sensing(axes: Any) -> None:
    axis = axes[0]
    assert axis.u_dc_most / Q15 * 36.3 == pytest.approx(33.0, abs=1e-3)
    assert axis.u_dc_least / Q15 * 36.3 == pytest.approx(16.0, abs=1e-3)
    assert axis.i_q_limit / Q15 * I_FS == pytest.approx(4.0, abs=1e-3)
    assert axis.speed_limit / Q31 * W_FS == pytest.approx(314.0, rel=1e-8)
    assert (axis.encoder.counts, axis.encoder.pole_pairs) == (4000, 2)
    assert axis.mt_speed.speed_per_ratio / 65536 * 5000 == pytest.approx(781250 * 60 / 4000, rel=1e-6)  # E33 in rpm
    assert axis.position_gain / Q31 * W_FS == pytest.approx(60.0 * 2 * math.pi / 4000, rel=1e-5)  # rad/s per count
    assert axis.path_step_per_speed / 65536 == pytest.approx(W_FS * 0.5e-3 * 4000 / 2 / math.pi, rel=1e-6)


def test_position_loop_cannot_overshoot(axes: Any) -> None:
    """K_v T <= 0.25 with T the speed loop's own lag."""
    for axis in axes:
        k_v = axis.position_gain / Q31 * W_FS / (2 * math.pi / 4000)
        assert k_v / (2 * math.pi * 80.0) <= 0.25


def test_path_asks_for_no_more_acceleration_than_the_current_gives(axes: Any) -> None:
    """omega_n = e a_max / v_max: E40's steepest slope of a speed step v is v omega_n / e."""
    for axis, k_t, inertia in zip(axes, (0.0462, 0.0414), (0.8e-5, 1.2e-5), strict=True):
        omega_n = axis.path_omega_n_ts / 65536 / 0.5e-3
        assert 314.0 * omega_n / math.e <= k_t * 4.0 / inertia * 0.51
