"""Cost of the firmware: the committed table is that of these programs."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from bench.firmware import TABLE
from firmware_cost.calibration import Charges, kept
from firmware_cost.instructions import FAST, Setup
from firmware_cost.measurement import REFERENCE, fingerprint
from firmware_cost.programs import TARGET, Programs, compiler
from firmware_cost.table import origin_of
from servo_twin._core_time import COMMON, WEIGHTS
from targets.machines import missing_text
from targets.sources import Sources


@pytest.mark.parametrize(("total", "keeps"), [(1.029, True), (0.971, True), (1.031, False), (0.969, False)])
def test_the_weights_change_only_if_a_mean_charge_does_by_3_percent(total: float, keeps: bool) -> None:
    """The fit has moved between two files, of which the run determines the sum only."""
    files = ("control/pi", "control/pll", "new")
    charge = Charges(files, {(Setup.CONFIGURED, "hold", FAST): np.array([100.0, 100.0, 0.0])})
    committed = {COMMON: 0.7, "control/pi": 0.5, "control/pll": 0.5, "removed": 0.7}
    fitted = {COMMON: 0.7, "control/pi": total - 0.4, "control/pll": 0.4, "new": 0.3}
    expected = {COMMON: 0.7, "control/pi": 0.5, "control/pll": 0.5, "new": 0.3} if keeps else fitted
    assert kept(committed, fitted, charge) == expected


@pytest.mark.slow
def test_committed_table_is_that_of_these_programs(c_sources: Sources, tmp_path: Path) -> None:
    """The programs are compared only if the compiler is the same.

    The weights are those of a new fit, or charge within 3 % the same: the table says how far the charges are off.
    """
    if not TARGET.available():
        pytest.skip(missing_text(TARGET))
    made_with, committed = origin_of(TABLE.read_text(encoding="utf-8"))
    assert made_with, f"{TABLE.name} does not name its compiler"
    if made_with != compiler():
        warnings.warn(f"{TABLE.name} was made with {made_with}, here is {compiler()}: not compared", stacklevel=1)
        return
    programs = Programs.compile(c_sources, tmp_path / "programs", REFERENCE)
    found = fingerprint(programs, WEIGHTS.read_text(encoding="utf-8"))
    assert found == committed, "`make bench-firmware UPDATE=1` measures them"
