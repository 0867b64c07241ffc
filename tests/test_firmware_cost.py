"""Cost of the firmware: the committed table is that of these programs."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
from bench.firmware import TABLE
from firmware_cost.measurement import REFERENCE, fingerprint
from firmware_cost.programs import TARGET, Programs, compiler
from firmware_cost.table import origin_of
from servo_twin._core_time import WEIGHTS
from targets.machines import missing_text
from targets.sources import Sources

pytestmark = pytest.mark.slow


def test_committed_table_is_that_of_these_programs(c_sources: Sources, tmp_path: Path) -> None:
    """The programs are compared only if the compiler is the same."""
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
