"""Effects of real shafts, at switching level, against an independent integration of the same gate edges."""

from __future__ import annotations

import math
import random

import pytest
from native_library import Native
from servo_twin.plant import PlantConfig
from switching_reference import Reference
from switching_rig import Switching
from test_switching_reference import AMPERES, ANY_AMPERES, PERIOD, compare, modulated, plant

PARTS: dict[str, dict[str, float]] = {
    "two masses": {"load_inertia": 1.0e-5, "shaft_stiffness": 100.0, "shaft_damping": 2e-3},
    "backlash": {"load_inertia": 1.0e-5, "shaft_stiffness": 100.0, "shaft_damping": 2e-3, "backlash": 1e-4},
    "cogging": {"cogging_torque": 0.02, "cogging_periods": 24.0, "cogging_phase": 0.7},
    "saturation": {"i_saturation_d": 3.0, "i_saturation_q": 2.0},
}
PARTS["all"] = {name: value for part in PARTS.values() for name, value in part.items()}


@pytest.mark.parametrize("part", PARTS)
def test_real_shaft_agrees_with_an_independent_integration(switching_c: Native, part: str) -> None:
    config = plant()
    for axis in range(2):
        config = config.with_axis(axis, i_break=100.0, **PARTS[part])
    switching, reference = Switching(switching_c, config), Reference(config)
    for axis, omega in enumerate((120.0, -60.0)):
        switching.spin(axis, omega)
        reference.axes[axis].omega = omega
        switching.lib.switching_set_load(switching.c, axis, 0.01)
        reference.axes[axis].load = 0.01
    rnd = random.Random(5)
    edges = modulated(lambda period, axis: [rnd.uniform(0.2, 0.8) for _ in range(3)], 20)
    # the leapfrog integration of the shaft: phase error 4e-5 at 750 Hz, 0.06 rad/s at an oscillation of 100 rad/s
    two = config.axes[0].load_inertia > 0.0
    roughness, amperes = (60.0, ANY_AMPERES) if two else (5.0, AMPERES)
    largest = compare(switching, reference, edges, 21 * PERIOD, step=1250, roughness=roughness, amperes=amperes)
    assert largest > 1.0
    for axis, machine in enumerate(reference.axes):
        truth = switching.truth(axis)
        if config.axes[axis].load_inertia > 0.0:
            assert truth.theta_load == pytest.approx(machine.theta_load, abs=2e-5)
            assert truth.omega_load == pytest.approx(machine.omega_load, abs=0.05)
            assert math.dist((truth.theta,), (truth.theta_load,)) > 1e-5


def test_comparison_detects_a_stiffer_shaft(switching_c: Native) -> None:
    """The comparison can fail."""
    config = plant().with_axis(0, **PARTS["two masses"])
    softer: PlantConfig = config.with_axis(0, shaft_stiffness=90.0)
    switching, reference = Switching(switching_c, config), Reference(softer)
    switching.spin(0, 100.0)
    reference.axes[0].omega = 100.0
    with pytest.raises(AssertionError):
        compare(switching, reference, [], 4 * PERIOD, roughness=20.0)
