"""tune.py as a command: output, files and exit status; the committed integers are up to date."""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from core_library import Core
from firmware_compiler import FIRMWARE
from servo_tuning.command import main
from tuning_tool import FILE, GENERATED

import servo_msgs_py
from servo_msgs_py import codegen

TEXT = FILE.read_text(encoding="utf-8")


def written(folder: Path, pattern: str = "", replacement: str = "") -> Path:
    """A copy of servo.toml with one changed line."""
    text, count = re.subn(pattern, replacement, TEXT, count=1, flags=re.MULTILINE) if pattern else (TEXT, 1)
    assert count == 1, pattern
    path = folder / "servo.toml"
    path.write_text(text, encoding="utf-8")
    return path


def generate(config: Path, *options: str) -> int:
    return main(["--config", str(config), "--output", str(config.with_suffix(".c")), *options])


# ---- generate -------------------------------------------------------------------------------------------------------


def test_committed_files_are_up_to_date(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--check"]) == 0
    assert codegen.main(["--check"]) == 0
    assert capsys.readouterr().err == "", "the committed configuration causes no warning"


def test_refusal_is_printed_and_nothing_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = written(tmp_path, r"^inertia    = 0.8e-5", "inertia = -0.8e-5")
    assert generate(config) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith(
        f"{config}: axis1.motor.inertia = -8e-06: too small; write a number above 0 [kg m^2]"
    )
    assert captured.err.count("\n") == 1
    assert not config.with_suffix(".c").exists()
    assert main(["report", "--config", str(config)]) == 1
    assert capsys.readouterr().err == captured.err


def test_invalid_toml_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    broken = tmp_path / "servo.toml"
    broken.write_bytes(b"[board\n")
    assert generate(broken) == 1
    assert "line 1" in capsys.readouterr().err
    broken.write_bytes(b"\xff\xfe[board]")
    assert generate(broken) == 1
    assert str(broken) in capsys.readouterr().err


def test_an_axis_may_override_the_defaults(tmp_path: Path) -> None:
    config = written(tmp_path, r"\Z", "\n[axis2.limits]\ncurrent = 2.0\n[axis2.rotor_search]\ncurrent = 2.0\n")
    assert generate(config) == 0
    limits = re.findall(r"\.i_q_limit = (\d+),", config.with_suffix(".c").read_text(encoding="utf-8"))
    assert [int(x) for x in limits] == [round(4.0 / 8.25 * 2**15), round(2.0 / 8.25 * 2**15)]


def test_check_finds_a_stale_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = written(tmp_path)
    stale = config.with_suffix(".c")
    stale.write_text(GENERATED.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    assert generate(config, "--check") == 1
    assert "out of date" in capsys.readouterr().err
    assert generate(config) == 0
    assert stale.read_text(encoding="utf-8") == GENERATED.read_text(encoding="utf-8")
    assert generate(config, "--check") == 0


def test_warnings_do_not_prevent_writing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = written(tmp_path, r"^position_gain     = 60.0", "position_gain = 200.0")
    assert generate(config) == 0
    assert config.with_suffix(".c").exists()
    lines = capsys.readouterr().err.splitlines()
    assert all(line.startswith(f"{config}: warning: axis") for line in lines)
    assert any("control.position_gain" in line and "K_v T" in line for line in lines)


def as_script(*arguments: str, output: int | None = subprocess.PIPE) -> tuple[int, str]:
    """Exit status and standard error of the script, as called by `make`: no package of the project is installed."""
    environment = {**os.environ, "PYTHONPATH": str(Path(servo_msgs_py.__file__).parents[1])}
    command = [sys.executable, str(FIRMWARE / "config" / "tune.py"), *arguments]
    result = subprocess.run(command, env=environment, stdout=output, stderr=subprocess.PIPE, text=True, check=False)
    return result.returncode, result.stderr


def test_tool_runs_as_a_script_with_the_contract_alone() -> None:
    assert as_script("--check") == (0, "")


def test_files_and_streams_that_fail_are_named(tmp_path: Path) -> None:
    missing = tmp_path / "none.toml"
    assert as_script("report", "--config", str(missing)) == (2, f"tune.py: {missing}: No such file or directory\n")
    full = "tune.py: /dev/full: No space left on device\n"
    assert as_script("report", "--plot", "/dev/full") == (1, full)
    with open("/dev/full", "w") as stream:
        assert as_script("report", output=stream.fileno()) == (1, full.replace("/dev/full", "output"))
    reader, writer = os.pipe()
    os.close(reader)
    assert as_script("report", output=writer) == (141, "")
    os.close(writer)


# ---- command line ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("arguments", [["tune"], ["report", "--check"], ["--plot", "x.png"], ["generate", "more"]])
def test_wrong_usage_exits_with_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == 2
    assert "usage" in capsys.readouterr().err


# ---- report ---------------------------------------------------------------------------------------------------------


def test_report_contains_the_main_figures(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report"]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    for words in ("axis1", "axis2", "phase margin", "gain margin", "crossover", "closed-loop poles, position", "E43",
                  "E45", "K_v T", "stiffness", "current against friction", "x 0.5", "x 3"):  # fmt: skip
        assert words in captured.out, words
    speed_kp = re.search(r"\.speed = {(\d+),", GENERATED.read_text(encoding="utf-8"))
    assert speed_kp is not None
    assert speed_kp[1] in captured.out, "the integers in use"
    assert max(map(len, captured.out.splitlines())) <= 120


def test_the_report_can_be_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", "--json"]) == 0
    figures = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert list(figures) == ["axis1", "axis2"]
    names = {"current d", "current q", "speed", "position", "speed, observer", "position, observer"}
    for axis in figures.values():
        assert axis["findings"] == []
        assert {loop["name"] for loop in axis["loops"]} == names
        assert all(abs(complex(*pole["z"])) < 1.0 for loop in axis["loops"] for pole in loop["poles"])


def test_the_report_can_be_a_picture(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    picture = tmp_path / "new" / "tuning.png"
    assert main(["report", "--plot", str(picture)]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_without_matplotlib_a_picture_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(SystemExit):
        main(["report", "--plot", str(tmp_path / "tuning.png")])
    assert "matplotlib" in capsys.readouterr().err


# ---- numbers --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def axes(core: Core) -> Any:
    return core.lib.probe_config().axis


GAIN, Q15, Q31 = 2.0**24, 2.0**15, 2.0**31
U_FS, I_FS, W_FS = 24.2, 8.25, 5000.0 * math.pi / 30.0


def value(path: str, section: str = "") -> float:
    """A number of servo.toml, read from its text, independent of the tool."""
    start = TEXT.index(f"[{section}]") if section else 0
    found = re.compile(rf"^{path}\s*=\s*(\S+)", re.MULTILINE).search(TEXT, start)
    assert found is not None
    return float(found[1])


def test_gains_follow_from_bandwidth_and_motor(axes: Any) -> None:
    bandwidths = (value("speed_bandwidth", "defaults.control"), value("speed_bandwidth", "axis2.control"))
    motors = ((0.55, 0.403e-3, 0.512e-3, 0.0154, 0.8e-5), (0.45, 0.375e-3, 0.429e-3, 0.0138, 1.2e-5))
    for axis, (r, l_d, l_q, psi, inertia), bandwidth in zip(axes, motors, bandwidths, strict=True):
        loop, k_t = axis.current_loop, 3.0 * psi
        w = 2 * math.pi * 1000.0
        assert loop.d.kp / GAIN == pytest.approx(w * l_d * I_FS / U_FS, rel=1e-6)
        assert loop.q.kp / GAIN == pytest.approx(w * l_q * I_FS / U_FS, rel=1e-6)
        assert loop.q.ki / GAIN == pytest.approx(w * r / 16000 * I_FS / U_FS, rel=1e-6)
        assert loop.omega_psi / GAIN == pytest.approx(2 * W_FS * psi / U_FS, rel=1e-6)
        assert loop.omega_l_q / GAIN == pytest.approx(2 * W_FS * l_q * I_FS / U_FS, rel=1e-6)
        assert loop.angle_step / GAIN * math.pi == pytest.approx(2 * W_FS / 16000, rel=1e-5)
        w = 2 * math.pi * bandwidth
        assert axis.speed.kp / GAIN == pytest.approx(w * inertia / k_t * W_FS / I_FS, rel=1e-6)
        assert axis.speed.ki / GAIN == pytest.approx(axis.speed.kp / GAIN * w / 5.0 * 0.5e-3, rel=1e-6)
        assert axis.torque_constant / Q15 == pytest.approx(k_t, rel=5e-4)


def test_limits_and_sensing_are_scaled_correctly(axes: Any) -> None:
    axis = axes[0]
    assert axis.u_dc_max / Q15 * 36.3 == pytest.approx(33.0, abs=1e-3)
    assert axis.u_dc_min / Q15 * 36.3 == pytest.approx(16.0, abs=1e-3)
    assert axis.i_q_limit / Q15 * I_FS == pytest.approx(4.0, abs=1e-3)
    assert axis.speed_limit / Q31 * W_FS == pytest.approx(314.0, rel=1e-8)
    assert (axis.encoder.counts, axis.encoder.pole_pairs) == (4000, 2)
    assert axis.mt_speed.speed_per_ratio / 65536 * 5000 == pytest.approx(781250 * 60 / 4000, rel=1e-6)  # E33 in rpm
    assert axis.position_gain / Q31 * W_FS == pytest.approx(60.0 * 2 * math.pi / 4000, rel=1e-5)  # rad/s per count
    assert axis.path_step_per_speed / 65536 == pytest.approx(W_FS * 0.5e-3 * 4000 / 2 / math.pi, rel=1e-6)


def test_feed_forward_constants_follow_from_friction_and_inertia(axes: Any) -> None:
    axis, k_t = axes[0], 3.0 * 0.0154
    assert axis.friction.coulomb / Q31 * I_FS == pytest.approx(2e-3 / k_t, rel=1e-6)
    assert axis.friction.viscous / GAIN * I_FS / W_FS == pytest.approx(1e-5 / k_t, rel=1e-5)
    assert axis.friction.smooth / Q31 * W_FS == pytest.approx(1.0, rel=1e-6)
    assert axis.friction.slope / 65536 / W_FS == pytest.approx(1.0, rel=1e-6)
    assert axis.acceleration_forward / 65536 * I_FS / (W_FS / 0.5e-3) == pytest.approx(0.8e-5 / k_t, rel=1e-6)


def test_path_needs_no_more_acceleration_than_the_current_gives(axes: Any) -> None:
    """omega_n = e a_max / v_max: the largest slope of E40 after a speed step v is v omega_n / e."""
    for axis, k_t, inertia in zip(axes, (0.0462, 0.0414), (0.8e-5, 1.2e-5), strict=True):
        omega_n = axis.path_omega_n_ts / 65536 / 0.5e-3
        assert 314.0 * omega_n / math.e <= k_t * 4.0 / inertia * 0.51
