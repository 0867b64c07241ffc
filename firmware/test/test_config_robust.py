"""Bandwidths that keep their margins with every shaft of a set: they do, the next higher ones do not."""

from __future__ import annotations

import math
from typing import Final

import pytest
from servo_tuning.errors import ConfigError
from servo_tuning.findings import BANDWIDTH_STEP, GAIN_MIN
from servo_tuning.motor import Load
from servo_tuning.remedies import refusal_of, value_in, with_value
from servo_tuning.robust import ShaftModel, robust, stable
from servo_tuning.tuned import Tuned, tuned_axis
from tuning_tool import table

PHASE: Final = 40.0
SPEED, POSITION = "axis1.control.speed_bandwidth", "axis1.control.position_gain"


def sprung(inertia: float, frequency: float, ratio: float, damping: float = 0.02) -> ShaftModel:
    """A load [Hz] whose inertia is `ratio` times that of the rotor; `inertia`: of the whole shaft [kg m^2]."""
    part = ratio / (1.0 + ratio)
    reduced = part / (1.0 + ratio) * inertia
    return ShaftModel(inertia, Load(part * inertia, (2.0 * math.pi * frequency) ** 2 * reduced, damping))


def about(inertia: float, frequency: float, ratio: float) -> list[ShaftModel]:
    return [sprung(inertia, factor * frequency, ratio) for factor in (1.0, 0.9, 1.1)]


def margins_kept(design: Tuned, shaft: ShaftModel) -> bool:
    """By the definition, without the search."""
    loops = shaft.within(design.shaft())
    found = (loops.speed_margins(), loops.position_margins())
    return stable(shaft, design) and all(
        (one.phase is None or abs(one.phase) >= PHASE) and (one.gain is None or one.gain >= GAIN_MIN) for one in found
    )


@pytest.mark.parametrize(("frequency", "ratio", "whole"), [(80.0, 1.0, 1.0), (150.0, 3.0, 2.0)])
def test_the_highest_bandwidths_with_margins_for_every_shaft(
    frequency: float,
    ratio: float,
    whole: float,
) -> None:
    base = table()
    inertia = whole * tuned_axis(base, 0).motor.inertia
    shafts = about(inertia, frequency, ratio)
    found = robust(base, 0, shafts[0], shafts, PHASE)
    assert refusal_of(found) is None
    design = tuned_axis(found, 0)
    assert all(margins_kept(design, shaft) for shaft in shafts)
    assert design.axis("motor.inertia") == pytest.approx(inertia, rel=1e-3)
    load = shafts[0].load
    assert load is not None
    assert design.axis("load.inertia") == pytest.approx(load.inertia, rel=1e-3)
    bandwidth = design.axis("control.speed_bandwidth")
    if bandwidth < tuned_axis(base, 0).axis("control.speed_bandwidth"):
        faster = with_value(found, SPEED, bandwidth / BANDWIDTH_STEP)
        assert not all(margins_kept(tuned_axis(faster, 0), shaft) for shaft in shafts)


def test_a_rigid_shaft_keeps_the_bandwidths_of_the_file() -> None:
    base = table()
    shaft = ShaftModel(tuned_axis(base, 0).motor.inertia)
    found = robust(base, 0, shaft, [shaft], PHASE)
    for entry in (SPEED, POSITION):
        assert value_in(found, entry) == pytest.approx(value_in(base, entry))


def test_a_heavier_shaft_accelerates_more_slowly() -> None:
    """Else the current limit would be too low for its set-points."""
    base = table()
    shaft = ShaftModel(6.0 * tuned_axis(base, 0).motor.inertia)
    found = robust(base, 0, shaft, [shaft], PHASE)
    assert refusal_of(found) is None
    assert float(str(value_in(found, "axis1.limits.acceleration"))) < float(
        str(value_in(base, "axis1.limits.acceleration"))
    )


def test_members_of_the_file_are_not_dropped() -> None:
    """They replace what the search determines."""
    base = table(axis1__members__following_error=0.5)
    shaft = ShaftModel(tuned_axis(table(), 0).motor.inertia)
    with pytest.raises(ConfigError, match=r"\[axis1.members\]"):
        robust(base, 0, shaft, [shaft], PHASE)


def test_a_load_of_both_axes_remains_that_of_the_other_one() -> None:
    base = table(defaults__load__inertia=1e-6, defaults__load__stiffness=10.0, defaults__load__damping=0.02)
    shaft = ShaftModel(tuned_axis(base, 0).motor.inertia)
    found = robust(base, 0, shaft, [shaft], PHASE)
    assert tuned_axis(found, 0).axis.load is None
    assert tuned_axis(found, 1).axis.load == tuned_axis(base, 1).axis.load


def test_a_refusal_names_a_phase_margin_that_is_possible() -> None:
    base = table()
    shafts = about(tuned_axis(base, 0).motor.inertia, 50.0, 8.0)
    with pytest.raises(ConfigError) as refusal:
        robust(base, 0, shafts[0], shafts, 60.0)
    (remedy,) = refusal.value.problem.remedies
    assert remedy.entry == "--phase-margin"
    assert remedy.value is not None
    assert remedy.value < 60.0
    assert refusal_of(robust(base, 0, shafts[0], shafts, remedy.value)) is None
