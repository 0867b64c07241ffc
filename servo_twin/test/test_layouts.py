"""Layouts of other viewers: every plot is there, with the names that those programs give the values."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from servo_twin.runs.command import main

JOINTS = ["pan", "tilt"]


def written(path: Path) -> str:
    assert main(["layout", "-o", str(path), "--joints", *JOINTS, "--namespace", "robot/servo"]) == 0
    return path.read_text()


def test_plotjuggler_gets_the_curves_of_both_joints(tmp_path: Path) -> None:
    root = ElementTree.fromstring(written(tmp_path / "servo.xml"))
    curves = [[curve.attrib["name"] for curve in plot] for plot in root.iter("plot")]
    assert len(curves) == 8
    assert curves[5] == [
        "/robot/servo/var/tilt/speed_ref/data",
        "/robot/servo/joint_states/tilt/velocity",
        "/twin/joint_states/tilt/velocity",
    ]
    for splitter in root.iter("DockSplitter"):
        shares = splitter.attrib["sizes"].split(";")
        assert len(splitter) == int(splitter.attrib["count"]) == len(shares)
        assert sum(map(float, shares)) == pytest.approx(1.0, abs=1e-5)


def panels(node: Any) -> list[str]:
    """Panels of a layout tree, in the order of reading."""
    if isinstance(node, str):
        return [node]
    assert 0.0 < node["splitPercentage"] < 100.0
    return panels(node["first"]) + panels(node["second"])


def test_foxglove_gets_the_curves_of_both_joints(tmp_path: Path) -> None:
    document = json.loads(written(tmp_path / "servo.json"))
    configured = document["configById"]
    assert panels(document["layout"]) == list(configured)
    assert [panel["foxglovePanelTitle"].split(":")[0] for panel in configured.values()] == ["pan"] * 4 + ["tilt"] * 4
    paths = {path["value"]: path for panel in configured.values() for path in panel["paths"]}
    assert paths["/robot/servo/joint_states.velocity[1]"]["timestampMethod"] == "headerStamp"
    assert paths["/robot/servo/var/tilt/i_q.data"]["timestampMethod"] == "receiveTime"
    assert "/twin/residual.position[0]" in paths


def test_another_suffix_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["layout", "-o", str(tmp_path / "servo.yaml")]) == 2
    assert ".xml, .json" in capsys.readouterr().err
