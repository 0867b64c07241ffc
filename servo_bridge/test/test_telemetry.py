"""Samples to snapshots: 64-bit positions, states, required variables."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_bridge.telemetry import Telemetry, required_variables, telemetry_variables
from servo_bridge.wire.scope import Sample, ScopeLayout
from servo_msgs_py.catalogue import Catalogue

CATALOGUE = Catalogue.load()
NAMES = telemetry_variables(CATALOGUE, ["axis1.position_ref"])
LAYOUT = ScopeLayout([CATALOGUE[name] for name in NAMES])
LSB = CATALOGUE["axis1.position"].lsb


def sample(tick: int = 8, epoch: int = 0, **values: int) -> Sample:
    raw = tuple(values.get(name.replace(".", "_"), 0) for name in NAMES)
    return Sample(tick, epoch, 0, 5, b"", raw, LAYOUT)


def wrapped(counts: int) -> int:
    return (counts + 2**31) % 2**32 - 2**31


@given(st.lists(st.integers(-(2**30), 2**30), max_size=30), st.integers(-(2**31), 2**31 - 1))
def test_positions_are_unwrapped_beyond_32_bits(steps: list[int], start: int) -> None:
    telemetry = Telemetry(CATALOGUE, LAYOUT.variables)
    counts = start
    for step in [0, *steps]:
        counts += step
        snapshot = telemetry.snapshot(sample(axis2_position=wrapped(counts)), 0)
        assert snapshot.values["axis2.position"] == counts * LSB
        assert snapshot.axes[1].position == counts


def test_the_set_point_is_extended_with_the_position() -> None:
    telemetry = Telemetry(CATALOGUE, LAYOUT.variables)
    top = 2**31 - 10
    snapshot = telemetry.snapshot(sample(axis1_position=top, axis1_position_ref=wrapped(top + 50)), 0)
    assert snapshot.values["axis1.position_ref"] == (top + 50) * LSB
    snapshot = telemetry.snapshot(sample(axis1_position=wrapped(top + 60), axis1_position_ref=top), 0)
    assert snapshot.values["axis1.position_ref"] == top * LSB


def test_new_epoch_restarts_unwrapping() -> None:
    telemetry = Telemetry(CATALOGUE, LAYOUT.variables)
    telemetry.snapshot(sample(axis1_position=2**31 - 1), 0)
    snapshot = telemetry.snapshot(sample(epoch=1, axis1_position=-(2**31)), 0)
    assert snapshot.axes[0].position == -(2**31)


def test_states_and_faults_are_decoded() -> None:
    snapshot = Telemetry(CATALOGUE, LAYOUT.variables).snapshot(
        sample(axis1_state=3, axis1_substate=3, axis2_state=0, axis2_faults=6, applied_tick=7, applied_count=9), 0
    )
    assert [a.label for a in snapshot.axes] == ["RUN/SPIN", "FAULT"]
    assert [(a.accepts_set_points, a.faulted) for a in snapshot.axes] == [(True, False), (False, True)]
    assert (snapshot.faults, snapshot.applied_tick, snapshot.applied_count) == ((0, 6), 7, 9)


def test_an_axis_without_an_encoder_waits_in_ready_for_its_set_point() -> None:
    telemetry = Telemetry(CATALOGUE, LAYOUT.variables)

    def accepts(tick: int, substate: int, epoch: int = 0) -> bool:
        snapshot = telemetry.snapshot(sample(tick=tick, epoch=epoch, axis1_state=3, axis1_substate=substate), 0)
        return snapshot.axes[0].accepts_set_points

    assert [accepts(8, 1), accepts(16, 2)] == [False, False], "READY as a transition to ALIGN"
    assert [accepts(tick, 1) for tick in (24, 32, 40, 48, 56)] == [False, False, False, True, True]
    assert accepts(64, 5), "STARTUP"
    assert not accepts(72, 4), "FREEWHEEL"
    assert [accepts(80, 1), accepts(160, 1)] == [False, True]
    assert not accepts(8, 1, epoch=1), "another board"


def test_values_are_si_in_the_order_of_the_columns() -> None:
    telemetry = Telemetry(CATALOGUE, LAYOUT.variables)
    snapshot = telemetry.snapshot(sample(axis2_i_q=CATALOGUE["axis2.i_q"].to_raw(1.5)), 0)
    assert list(snapshot.values) == telemetry.columns
    assert snapshot.values["axis2.i_q"] == pytest.approx(1.5, abs=1e-3)


def test_snapshot_has_the_extended_tick() -> None:
    assert Telemetry(CATALOGUE, LAYOUT.variables).snapshot(sample(tick=2**40), 0).values["tick"] == 2**40


def test_required_variables_come_first_and_once() -> None:
    names = telemetry_variables(CATALOGUE, ["u_dc", "tick", "u_dc"])
    assert names == [*required_variables(), "u_dc"]


def test_the_default_telemetry_fits_the_scope_of_the_firmware() -> None:
    from servo_bridge.parameters import PARAMETERS

    names = telemetry_variables(CATALOGUE, PARAMETERS["telemetry"].default)
    assert len(names) <= 28
    assert sum(CATALOGUE[name].size for name in names) <= 80  # more than 100 samples per second at 115200 baud


@pytest.mark.parametrize(("name", "text"), [("axis3.position", "no variable"), ("snapshot", "is a block")])
def test_variables_that_cannot_be_sampled_are_reported(name: str, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        telemetry_variables(CATALOGUE, [name])
