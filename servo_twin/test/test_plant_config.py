"""Reading plant.toml: packaged values, changed copies, error messages."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from servo_twin.plant import AxisPlant, PlantConfig, PlantError


def test_packaged_plant_agrees_with_the_data_sheet() -> None:
    plant = PlantConfig.load()
    first, second = plant.axes
    assert (first.r_s, first.l_d, first.l_q, first.psi_m, first.pole_pairs) == (0.55, 0.403e-3, 0.512e-3, 0.0154, 2)
    assert (second.r_s, second.l_d, second.l_q, second.psi_m) == (0.45, 0.375e-3, 0.429e-3, 0.0138)
    assert (first.inertia, second.inertia) == (0.8e-5, 1.2e-5)
    assert (first.friction, second.friction) == (2.0e-3, 1.5e-3)
    assert {(a.viscous, a.i_full_scale, a.dead_time, a.v_drop, a.r_on, a.encoder_lines) for a in plant.axes} == {
        (1e-5, 8.25, 1e-6, 0.7, 0.03, 1000)
    }
    assert (plant.bus.u_source, plant.bus.r_source, plant.bus.capacitance) == (24.0, 0.1, 4.7e-3)
    assert plant.pwm_frequency == 16000.0
    assert first.torque_constant == pytest.approx(0.0462)


def test_a_file_contains_only_differing_values(tmp_path: Path) -> None:
    file = tmp_path / "stiff.toml"
    file.write_text("[axis2]\nfriction = 5e-3\n[bus]\nu_source = 22\n")
    plant, packaged = PlantConfig.load(file), PlantConfig.load()
    assert plant.axes[1].friction == 5e-3
    assert plant.bus.u_source == 22
    assert plant.axes[0] == packaged.axes[0]
    assert plant.axes[1].inertia == packaged.axes[1].inertia


def test_changed_copies_do_not_affect_the_original() -> None:
    plant = PlantConfig.load()
    changed = plant.with_axis(1, friction=0.01).with_bus(u_source=20.0)
    assert (changed.axes[1].friction, changed.bus.u_source) == (0.01, 20.0)
    assert changed.axes[0] is plant.axes[0]
    assert plant == PlantConfig.load()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[axis1]\nr_s = 0.0", r"axis1\.r_s: 0\.0 is too small; write a number above 0"),
        ("[axis2]\nfriction = -1e-3", r"axis2\.friction: -0\.001 is too small; write a number from 0"),
        ("[axis1]\npole_pairs = 2.5", r"axis1\.pole_pairs: 2\.5 is not a whole number"),
        ("[axis1]\ninertia = nan", r"axis1\.inertia: nan is not a finite number"),
        ("[axis1]\ntheta_start = inf", r"axis1\.theta_start: inf is not a finite number"),
        ("[axis1]\nl_d = true", r"axis1\.l_d: True is not a number"),
        ("[axis1]\nl_d = '1 mH'", r"axis1\.l_d: '1 mH' is not a number"),
        ("[axis1]\ni_offset = [0.1, 0.2]", r"axis1\.i_offset: .* is not a list of three currents"),
        ("[axis1]\nresistance = 1.0", r"unknown name 'resistance'; known names: r_s, "),
        ("[axis3]\nr_s = 1.0", r"unknown name 'axis3'"),
        ("axis1 = 5", r"axis1 is not a table"),
        ("[bus]\ncapacitance = 0", r"bus\.capacitance: 0 is too small"),
        ("pwm_frequency = 15999.0", r"pwm_frequency: 15999\.0 Hz does not divide"),
        ("[axis1\n", r"bad\.toml: "),
    ],
)
def test_messages_contain_file_and_name(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "bad.toml"
    file.write_text(text)
    with pytest.raises(PlantError, match=message) as error:
        PlantConfig.load(file)
    assert str(error.value).startswith(str(file))


def test_a_missing_file_is_an_os_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        PlantConfig.load(tmp_path / "none.toml")


def test_parse_requires_all_entries() -> None:
    table: dict[str, Any] = {"axis1": {}, "axis2": {}, "bus": {}, "pwm_frequency": 16000.0}
    with pytest.raises(PlantError, match="axis1: r_s is missing"):
        PlantConfig.parse(table)


def test_objects_do_not_change() -> None:
    axis: AxisPlant = PlantConfig.load().axes[0]
    with pytest.raises(AttributeError):
        axis.r_s = 1.0  # type: ignore[misc]
