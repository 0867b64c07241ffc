"""Cost of the firmware: the committed table is up to date, and the counts are those of the code."""

from __future__ import annotations

import dataclasses
import warnings

import pytest
from bench.firmware import TABLE, difference
from firmware_cost.calibration import fit
from firmware_cost.instructions import (
    FAST,
    OBSERVED_PHASE,
    Setup,
)
from firmware_cost.measurement import REFERENCE, Measurement, measure
from firmware_cost.programs import TARGET, Programs
from firmware_cost.table import FAST_AIM, SENSORLESS_AIM, compiler_of, core_errors, largest_mean, table
from servo_twin._core_time import load_weights
from targets.machines import missing_text
from targets.sources import Sources

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def needs_tools() -> None:
    if not TARGET.available():
        pytest.skip(missing_text(TARGET))


@pytest.fixture(scope="module")
def measurement(needs_tools: None, c_sources: Sources, tmp_path_factory: pytest.TempPathFactory) -> Measurement:
    return measure(c_sources, tmp_path_factory.mktemp("cost"))


@pytest.fixture(scope="module")
def programs(needs_tools: None, c_sources: Sources, tmp_path_factory: pytest.TempPathFactory) -> Programs:
    return Programs.compile(c_sources, tmp_path_factory.mktemp("programs"), REFERENCE)


# ---- the table ------------------------------------------------------------------------------------------------------


def test_committed_table_is_up_to_date(measurement: Measurement) -> None:
    """The table is compared only if it was made with the same compiler."""
    committed = compiler_of(TABLE.read_text(encoding="utf-8"))
    assert committed, f"{TABLE.name} does not name its compiler"
    lines = difference(table(measurement))
    if committed != measurement.compiler:
        text = f"{TABLE.name} was made with {committed}, here is {measurement.compiler}: not compared"
        warnings.warn("\n".join([text, *lines]), stacklevel=1)
        return
    assert not lines, "\n".join(["`make bench-firmware UPDATE=1` updates the table:", *lines])


def test_virtual_core_agrees_with_counted_instructions(measurement: Measurement) -> None:
    """With the committed weights, for every mode, feature set and feedback; mean error up to 10 %, largest 20 %."""
    charged = measurement.charging.charged(load_weights())
    errors = core_errors(dataclasses.replace(measurement, charged=charged))
    assert len(errors) > 100
    mean = [abs(error) for pair in errors.values() for error in pair]
    assert sum(mean) / len(mean) < 0.10
    assert {label: error for label, error in errors.items() if max(map(abs, error)) > 0.20} == {}


def test_weights_are_valid_for_runs_without_fit(measurement: Measurement) -> None:
    known = {Setup.CONFIGURED: measurement.counts[REFERENCE], Setup.WITHOUT_ENCODERS: measurement.sensorless}
    charged = measurement.charging.charged(fit(measurement.charge, known))
    errors = core_errors(dataclasses.replace(measurement, charged=charged))
    unseen = [abs(mean) for (setup, _, _), (mean, _) in errors.items() if setup == Setup.ALL_FEATURES]
    assert sum(unseen) / len(unseen) < 0.10
    assert max(unseen) < 0.20


def test_fast_loop_reaches_its_aim(measurement: Measurement) -> None:
    """Including reconstruction, decoupling, ripple compensation, dead time, SVM, encoder and state machine."""
    if compiler_of(TABLE.read_text(encoding="utf-8")) == measurement.compiler:
        assert largest_mean(measurement.counts[REFERENCE], FAST) <= FAST_AIM


def test_sensorless_fast_loop_reaches_its_aim(measurement: Measurement) -> None:
    """With observer and PLL instead of the encoder."""
    maximum = measurement.sensorless[OBSERVED_PHASE, FAST].maximum
    assert maximum <= 1.02 * SENSORLESS_AIM, "missed by 1 % since the gains of the observer may change while it runs"
    assert maximum > largest_mean(measurement.counts[REFERENCE], FAST) + 50, "the observer runs"


# ---- bytes ----------------------------------------------------------------------------------------------------------
