"""Motor and load on a spring from synthetic open speed loops with noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from servo_measurement.access import MeasurementError
from servo_measurement.frequency_response import Response
from servo_measurement.prediction import Prediction
from servo_measurement.resonance import CHANGE, Resonance, Shaft, fitted
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.text_file import parse_toml
from servo_tuning.control_loops import softened
from servo_tuning.motor import Load
from servo_tuning.reading import SERVO_TOML, parse, read_table
from servo_tuning.tuned import tuned

CONFIGURATION = parse(read_table(SERVO_TOML), Catalogue.load())
BLOCK = tuned(CONFIGURATION.axes[0], CONFIGURATION).block
PREDICTION = Prediction(softened(BLOCK, 0.125), "speed", 47.0, observed=False)
FREQUENCY = np.geomspace(16.0, 780.0, 240)


def measured(load: Load | None, inertia: float, noise: float, seed: int) -> Response:
    """Open loop of a shaft; `inertia` over the nominal one, relative noise per point."""
    shaft = PREDICTION.loops.shaft(inertia)
    value = replace(shaft, load=load).speed_open(2.0 * np.pi * FREQUENCY, PREDICTION.delay)
    rng = np.random.default_rng(seed)
    scatter = rng.standard_normal((2, FREQUENCY.size)) * noise / np.sqrt(2.0)
    return Response(
        FREQUENCY, value * (1.0 + scatter[0] + 1j * scatter[1]), np.full(240, noise), np.full(240, 1.0 - noise**2)
    )


def fit(load: Load | None, inertia: float = 1.0, noise: float = 0.02) -> Shaft:
    return fitted(PREDICTION, measured(load, inertia, noise, 1), measured(load, inertia, 2.0 * noise, 2))


def spring(frequency: float, ratio: float, damping: float, inertia: float) -> Load:
    """Load with a resonance [Hz] and an inertia over that of the motor; `inertia` of the shaft [kg m^2]."""
    part = ratio / (1.0 + ratio)
    return Load(part * inertia, (2.0 * np.pi * frequency) ** 2 * part / (1.0 + ratio) * inertia, damping)


@settings(max_examples=5)
@given(
    st.floats(40.0, 450.0),
    st.floats(0.3, 10.0),
    st.floats(0.005, 0.1),
    st.floats(0.5, 2.0),
    st.sampled_from([0.0, 0.02]),
)
@example(80.0, 10.0, 0.02, 1.0, 0.02)
@example(300.0, 10.0, 0.02, 1.3, 0.02)
def test_a_load_on_a_spring_is_found(
    frequency: float, ratio: float, damping: float, inertia: float, noise: float
) -> None:
    """Every value lies within its interval, or within 1 % of the true one."""
    nominal = PREDICTION.loops.motor.inertia
    load = spring(frequency, ratio, damping, inertia * nominal)
    values = {one.name: one for one in fit(load, inertia, max(noise, 1e-4)).values()}
    true = {
        "inertia of the shaft": inertia * nominal,
        "load behind a spring": load.inertia,
        "load over motor": ratio,
        "stiffness": load.stiffness,
        "resonance": frequency,
        "antiresonance": frequency / np.sqrt(1.0 + ratio),
    }
    for name, value in true.items():
        found = values[name]
        assert found.value == pytest.approx(value, rel=max(2.0 * found.relative, 0.01)), name
        assert found.relative < 0.2, name


@pytest.mark.parametrize("inertia", [0.5, 1.0, 3.0])
def test_a_rigid_shaft_has_no_load(inertia: float) -> None:
    shaft = fit(None, inertia)
    assert shaft.load is None
    (value,) = shaft.values()
    assert value.value == pytest.approx(inertia * PREDICTION.loops.motor.inertia, rel=max(value.relative, 0.005))


def test_the_group_is_that_of_the_tuning_and_the_text_names_another_inertia() -> None:
    nominal = PREDICTION.loops.motor.inertia
    found = Resonance(0, (16.0, 780.0), fit(spring(120.0, 3.0, 0.02, 1.3 * nominal), 1.3), nominal)
    group = parse_toml(found.toml())["axis1"]["load"]
    assert group["inertia"] == pytest.approx(0.75 * 1.3 * nominal, rel=0.02)
    assert group.keys() == {"inertia", "stiffness", "damping"}
    assert f"write {found.shaft.inertia:.4g}" in found.text()


def test_too_few_points_are_refused() -> None:
    """Instead of the shaft of the configuration."""
    few = measured(None, 1.0, 0.02, 1)
    few = replace(few, coherence=np.where(np.arange(240) < 19, few.coherence, 0.0))
    with pytest.raises(MeasurementError, match="too few"):
        fitted(PREDICTION, few)


@pytest.mark.parametrize("ratio", [0.5, 2.0, 8.0])
def test_possible_shafts_have_the_lowest_damping_and_other_resonances(ratio: float) -> None:
    """The true shaft is among them or within them: a design for all of them is one for it."""
    inertia = PREDICTION.loops.motor.inertia
    shaft = fit(spring(150.0, ratio, 0.03, inertia))
    loads = [one.load for one in shaft.possible]
    assert all(load is not None for load in loads)
    assert max(load.damping for load in loads if load is not None) < 0.03
    resonances = [one.load.resonance(one.inertia) for one in shaft.possible if one.load is not None]
    assert min(resonances) == pytest.approx(150.0 / CHANGE, rel=0.02)
    assert max(resonances) == pytest.approx(150.0 * CHANGE, rel=0.02)
    inertias = [one.inertia for one in shaft.possible]
    assert min(inertias) < inertia < max(inertias)
