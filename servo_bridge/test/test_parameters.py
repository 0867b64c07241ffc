"""Parameters of the bridge: descriptors, checks and settings."""

from __future__ import annotations

from typing import Any

import pytest
from servo_bridge.parameters import PARAMETERS, ParameterError, settings_from
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.joints import Joint, JointLimits

CATALOGUE = Catalogue.load()
DEFAULTS = {name: spec.default for name, spec in PARAMETERS.items()}


def test_descriptors_have_text_range_and_access() -> None:
    for name, spec in PARAMETERS.items():
        descriptor = spec.descriptor()
        assert len(descriptor.description) > 10, name
        assert descriptor.read_only == spec.read_only
        managed = spec.descriptor(managed=True)
        assert (managed.read_only, bool(managed.additional_constraints)) == (False, spec.read_only)
    assert PARAMETERS["baud"].descriptor().integer_range[0].to_value == 4_000_000
    assert PARAMETERS["variable_rate"].descriptor().floating_point_range[0].from_value == 0.1


def test_defaults_are_valid_and_used_in_the_settings() -> None:
    settings = settings_from(DEFAULTS, CATALOGUE)
    assert settings.names == ["axis1", "axis2"]
    assert settings.joints[1] == Joint("axis2", limits=JointLimits(velocity_max=419.0, effort_max=1.0))
    assert settings.telemetry[:3] == ("tick", "applied_tick", "applied_count")
    assert "axis2.limits" in settings.telemetry


def test_an_empty_name_means_an_empty_list() -> None:
    settings = settings_from(DEFAULTS | {"variables": [""], "telemetry": [""]}, CATALOGUE)
    assert settings.variables == ()
    assert "u_dc" not in settings.telemetry


@pytest.mark.parametrize(
    ("name", "value"), [("position_max", [float("nan"), 1.0]), ("effort_max", [1.0, -0.1]), ("velocity_max", [])]
)
def test_wrong_limits_are_reported(name: str, value: Any) -> None:
    with pytest.raises(ParameterError, match=f"parameter {name}"):
        settings_from(DEFAULTS | {name: value}, CATALOGUE)


def test_joints_have_gears_and_limits_in_their_units() -> None:
    given = {
        "joints": ["arm", "wheel"],
        "gear_ratio": [50.0, 1.0],
        "direction": [-1, 1],
        "offset": [0.25, 0.0],
        "position_min": [-1.0, -1.0e15],
        "position_max": [2.0, 1.0e15],
    }
    arm, wheel = settings_from(DEFAULTS | given, CATALOGUE).joints
    assert arm == Joint("arm", 50.0, -1, 0.25, JointLimits(-1.0, 2.0, 419.0, 1.0))
    assert arm.limits.bounded
    assert not wheel.limits.bounded


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("gear_ratio", [1.0], "parameter gear_ratio is [1.0]; write 2 numbers, one per joint"),
        ("gear_ratio", [1.0, 0.0], "parameter gear_ratio of axis2 is 0; give motor revolutions"),
        ("direction", [0, 1], "parameter direction of axis1 is 0; give 1, or -1"),
        ("offset", [float("nan"), 0.0], "parameter offset is [nan, 0.0]"),
        ("offset", [0.0, 1e7], "parameter offset of axis2 is 1e+07 rad"),
        (
            "home_positions",
            [0.0, 1e9],
            "parameter home_positions of axis2 is 1e+09 rad, outside -1.5e+06 .. 1.5e+06 rad",
        ),
        ("joints", ["a"] * 257, "parameter joints has 257 entries, more than 256"),
        ("board_parameters", ["x" * 4097], "parameter board_parameters has a text of 4097 characters, more than 4096"),
        ("recording", "x" * 4097, "parameter recording has a text of 4097 characters, more than 4096"),
    ],
)
def test_wrong_gears_and_sizes_are_reported(name: str, value: Any, message: str) -> None:
    with pytest.raises(ParameterError) as caught:
        settings_from(DEFAULTS | {name: value}, CATALOGUE)
    assert message in str(caught.value)


def test_the_preferred_source_must_be_a_set_point_topic() -> None:
    named = settings_from(DEFAULTS | {"preferred_source": "arm/position", "joints": ["arm", "hand"]}, CATALOGUE)
    assert named.preferred_source == "arm/position"
    with pytest.raises(ParameterError, match=r"preferred_source is 'joint_states'; write one of joint_commands, "):
        settings_from(DEFAULTS | {"preferred_source": "joint_states"}, CATALOGUE)
