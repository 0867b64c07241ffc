"""Harmonics of the torque ripple in a configuration: members of the block, and refusals."""

from __future__ import annotations

import math
from typing import Any, Final

import pytest
from servo_msgs_py.catalogue import Catalogue
from servo_tuning.configuration import Axis
from servo_tuning.errors import ConfigError
from servo_tuning.reading import SERVO_TOML, parse, read_table
from servo_tuning.torque_ripple import Harmonic
from servo_tuning.tuned import tuned

WAVE: Final = {"order": 12, "amplitude": 0.01, "phase": 0.0}
SLOW: Final = {"current_bandwidth": 13.0, "speed_bandwidth": 5.0, "position_gain": 5.0}
"""A time constant of more than a turn at full-scale speed."""


def configured(harmonics: Any, **groups: dict[str, float]) -> tuple[Axis, dict[str, int]]:
    """Axis 1 of the committed file with these harmonics and entries of other groups, and its block."""
    table = read_table(SERVO_TOML)
    axis = {**table["axis1"], "torque_ripple": {"harmonics": harmonics}}
    table["axis1"] = {**axis, **{name: {**axis.get(name, {}), **entries} for name, entries in groups.items()}}
    configuration = parse(table, Catalogue.load())
    return configuration.axes[0], tuned(configuration.axes[0], configuration).block


def test_members_are_the_current_opposite_to_the_torque() -> None:
    waves = [Harmonic(12, 0.02, 0.7), Harmonic(24, 0.001, -2.0)]
    axis, block = configured([vars(wave) for wave in waves])
    assert axis.harmonics == tuple(waves)
    for angle in (0.0, 0.3, 2.0):
        current = 0.0
        for k in range(8):
            order, amplitude, phase = (block[f"torque_ripple.{name}[{k}]"] for name in ("order", "amplitude", "phase"))
            current += amplitude / 2**15 * 8.25 * math.sin(order * angle + phase * math.pi / 2**15)
        torque = sum(wave.amplitude * math.sin(wave.order * angle + wave.phase) for wave in waves)
        assert current * axis.torque_constant == pytest.approx(-torque, abs=2e-5)
    assert [block[f"torque_ripple.order[{k}]"] for k in range(8)] == [12, 24, 0, 0, 0, 0, 0, 0]


def test_lead_is_the_delay_of_schedule_and_current_loop() -> None:
    """7.2 PWM periods and the time constant of a current loop of 1 kHz, at 5000 rpm."""
    _, block = configured([WAVE])
    seconds = block["torque_ripple.lead"] / 2**31 / (5000.0 / 60.0)
    assert seconds == pytest.approx(7.2 / 16000.0 + 1.0 / (2.0 * math.pi * 1000.0), rel=1e-6)


def test_a_slow_current_loop_is_refused_only_with_harmonics() -> None:
    _, block = configured([], control=SLOW)
    assert block["torque_ripple.lead"] == 0
    with pytest.raises(ConfigError, match=r"delay of the ripple compensation.*raise axis1\.control.current_bandwidth"):
        configured([WAVE], control=SLOW)


def test_a_printed_harmonic_is_read_again() -> None:
    wave = Harmonic(84, 0.0301, 5.123)
    axis, _ = configured([vars(wave)])
    assert wave.toml() == "{ order = 84, amplitude = 0.0301, phase = 5.123 }"
    assert axis.harmonics == (wave,)


@pytest.mark.parametrize(
    ("harmonics", "message"),
    [
        ([{"order": 12, "amplitude": 0.01}], r"harmonics\[0\].phase is missing"),
        ([{"order": 12, "amplitude": 0.01, "phase": 0.0, "cos": 1.0}], "cos is unknown"),
        ([{"order": 1.5, "amplitude": 0.01, "phase": 0.0}], r"harmonics\[0\].order"),
        ([{"order": 256, "amplitude": 0.01, "phase": 0.0}], r"harmonics\[0\].order"),
        ([{"order": 12, "amplitude": -0.01, "phase": 0.0}], r"harmonics\[0\].amplitude"),
        ([{"order": 12, "amplitude": 0.5, "phase": 0.0}], "does not fit"),
        ([{"order": 12, "amplitude": 0.01, "phase": 0.0}] * 2, "given twice"),
        ([{"order": k + 1, "amplitude": 0.01, "phase": 0.0} for k in range(9)], "at most 8"),
        (12, "not a list"),
        ([12], "not a table"),
    ],
)
def test_refusals_name_the_entry(harmonics: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as refusal:
        configured(harmonics)
    assert "axis1.torque_ripple" in str(refusal.value)
