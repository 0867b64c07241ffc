"""``servo-sim export --mjcf``: motors of MuJoCo that are near to the firmware."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from servo_twin.cli import main
from servo_twin.plant import PlantConfig

pytest.importorskip("mujoco", reason="there is no MuJoCo 4 for Python 3.10")

import mujoco
from servo_twin.robot import dcmotor


def test_nearest_motor_is_written_with_its_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    moves = {name: dcmotor.MOVES[name] for name in ("smooth move, 1 turn", "load, 20 mN m")}
    monkeypatch.setattr(dcmotor, "MOVES", moves)
    path = tmp_path / "motors.xml"
    assert main(["export", "--mjcf", str(path), "--json"]) == 0
    errors = json.loads(capsys.readouterr().out)["errors"]
    assert [(e["axis"], e["move"]) for e in errors] == [(f"axis{n}", m) for n in (1, 2) for m in (*moves, "all")]
    for e in errors:
        assert e["rms"] < 0.01, e
        assert e["largest"] < 0.03, e
        assert f"{e['rms']:.5f}" in path.read_text(encoding="utf-8")
    model = mujoco.MjModel.from_xml_path(str(path))
    motor = PlantConfig.load().axes[0]
    assert model.actuator_armature[0] == motor.inertia
    assert model.dof_frictionloss[0] == motor.friction
    assert model.actuator_gainprm[0, :2] == pytest.approx([1.5 * motor.r_s, motor.torque_constant])
