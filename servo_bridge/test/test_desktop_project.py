"""The project file of the desktop tool is complete and has the scales of the catalogue."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from servo_bridge.desktop_project import desktop_project
from servo_msgs_py.catalogue import Catalogue

from servo_bridge import tool

CATALOGUE = Catalogue.load()
OBJECTS = {str(element.get("name")): element for element in ET.fromstring(desktop_project(CATALOGUE)).iter("object")}


def members(element: ET.Element) -> dict[str, str]:
    return {str(member.get("name")): member.text or "" for member in element}


VARIABLES = {m["name"]: m for m in map(members, OBJECTS.values()) if "byte_size" in m}


def test_every_reference_has_its_object() -> None:
    values = [member.text or "" for element in OBJECTS.values() for member in element]
    references = {value for value in values if value.startswith("ObjId")}
    assert references | {"ObjId0000"} == OBJECTS.keys()
    assert all(element.get("type") for element in OBJECTS.values())


def test_project_contains_every_number_of_the_catalogue() -> None:
    expected = {v.name for v in CATALOGUE.variables.values() if v.type != "block" and v.count == 1}
    assert expected <= VARIABLES.keys()
    assert {"cmd.position[0]", "cmd.position[1]"} <= VARIABLES.keys()
    assert len(VARIABLES) == sum(v.count for v in CATALOGUE.variables.values() if v.type != "block")


@pytest.mark.parametrize("name", ["axis1.i_q", "axis2.position", "u_dc", "cmd.speed[1]"])
def test_values_are_scaled_to_si(name: str) -> None:
    variable, found = CATALOGUE.variables[name.split("[")[0]], VARIABLES[name]
    linear = members(OBJECTS[found["value_trf"]])
    assert (float(linear["a"]), float(linear["b"])) == (variable.lsb, 0.0)
    assert (found["unit"], int(found["byte_size"])) == (variable.unit, variable.element_size)
    assert (found["treat_as"], found["address"]) == (str(int(variable.format.signed)), name)


def test_states_have_their_labels_and_only_commands_are_writable() -> None:
    assert (VARIABLES["axis1.state"]["enum"], VARIABLES["axis1.state"]["enum_enabled"]) == ("state_t", "1")
    items = [members(e) for e in OBJECTS.values() if e.get("type") == "CEnumItem"]
    assert {"FAULT": "0", "STOP": "2"}.items() <= {item["name"]: item["value_min"] for item in items}.items()
    assert VARIABLES["axis1.state"]["modif_mode"] == "0"
    assert VARIABLES["cmd.speed[0]"]["modif_mode"] == "1"
    limit = CATALOGUE.variables["param.i_q_limit"].maximum
    assert float(VARIABLES["param.i_q_limit[0]"]["modif_set_max"]) == pytest.approx(limit)


def test_desktop_project_is_written_without_a_board(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "servo.pmpx"
    assert tool.main(["--baud", "19200", "project", str(file)]) == 0
    assert "speed=19200" in file.read_text(encoding="utf-8")
    with pytest.raises(SystemExit):
        tool.main(["project", str(tmp_path / "servo.txt")])
    assert "does not end in .pmpx" in capsys.readouterr().err
