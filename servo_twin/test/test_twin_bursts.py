"""Bursts of the board's recorder on the twin: the same ticks and the residual."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from servo_msgs_py.recorder_setup import RecorderSetup, setup_from_message, setup_message
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import PERIOD_NS, SLOW_PERIODS
from servo_twin.fault_injection import HotPowerStage
from servo_twin.lockstep.bursts import BurstAnswer
from servo_twin.plant import PlantConfig
from twin_rig import CATALOGUE, EPOCH_NS, TwinRig

from servo_msgs_py import topics

FAST = RecorderSetup(
    ("tick", "axis1.i_a", "axis1.i_q", "axis1.position", "axis1.theta_e", "axis2.position_ref", "axis2.duty_a"),
    recorder=0,
    period_ns=PERIOD_NS,
    points=500,
)
SLOW = RecorderSetup(("tick", "axis2.speed", "u_dc"), recorder=1, period_ns=PERIOD_NS * SLOW_PERIODS, points=100)


@pytest.fixture
def rig() -> Iterator[TwinRig]:
    with TwinRig() as rig:
        rig.run(0.1)
        yield rig


def begin(rig: TwinRig, setup: RecorderSetup) -> None:
    """Set up the recorder of the real board and send its set-up to the twin before the start."""
    rig.twin.set_recorder(setup)
    elements = [(CATALOGUE.variables[name], 0) for name in setup.names]
    rig.board.sample(setup.recorder, elements, setup.points)


def end(rig: TwinRig, setup: RecorderSetup) -> Trace:
    """The last points, as the bridge publishes them."""
    points = rig.board.sampled()
    rig.board.end_sampling()
    every = setup.period_ns // (SLOW.period_ns if setup.recorder else PERIOD_NS)
    points = points[3::every]  # the divider begins anywhere
    columns: dict[str, NDArray[Any]] = {
        name: points[field] * CATALOGUE[name.partition("[")[0]].lsb
        for field, name in zip(points.dtype.names or (), setup.names, strict=True)
    }
    columns["tick"] = columns["tick"] + rig.tick_base
    columns[topics.BURST_TIME] = (np.arange(len(points)) - len(points) // 2) * setup.period_ns * 1e-9
    stamps = EPOCH_NS + columns["tick"].astype(np.int64) * PERIOD_NS
    columns |= dict(zip(topics.STAMP_COLUMNS, np.divmod(stamps, 1_000_000_000), strict=True))
    return Trace(0.0, {name: column.astype(np.float64) for name, column in columns.items()})


def answer(rig: TwinRig) -> BurstAnswer:
    answers = rig.twin.burst_answers()
    assert len(answers) == 1
    return answers[0]


def signals(burst: BurstAnswer) -> tuple[Trace, Trace]:
    """Signals of the twin and residual."""
    assert burst.twin is not None
    assert burst.residual is not None
    return burst.twin, burst.residual


def recorded(rig: TwinRig, setup: RecorderSetup, turns: tuple[float, float] = (2.0, -1.0)) -> BurstAnswer:
    """Answer of the twin to a burst recorded in a move."""
    begin(rig, setup)
    rig.move(turns, 0.06)
    points = end(rig, setup)
    rig.run(0.1)
    rig.twin.add_burst("a burst", points)
    rig.twin.set_recorder(None)
    return answer(rig)


@pytest.mark.parametrize("setup", [FAST, replace(FAST, period_ns=4 * PERIOD_NS), SLOW])
def test_residual_of_identical_boards_is_exactly_zero(setup: RecorderSetup) -> None:
    with TwinRig(real_seed=7, twin_seed=7) as rig:
        rig.enable_axes()
        burst = recorded(rig, setup)
        assert burst.note == ""
        assert burst.label == "a burst"
        twin, residual = signals(burst)
        unchanged = ["tick", topics.BURST_TIME, *topics.STAMP_COLUMNS]
        assert list(twin.columns) == list(residual.columns) == [*setup.names, *unchanged[1:]]
        assert np.ptp(twin[setup.names[1]]) > 0.0
        assert not residual.table(setup.names[1:]).any()
        assert residual.table(unchanged).tolist() == twin.table(unchanged).tolist()


def test_residual_of_another_plant_is_the_difference_of_the_signals() -> None:
    plant = PlantConfig.load()
    with TwinRig(real_seed=7, twin_seed=7, plant=plant.with_axis(0, r_s=2.0 * plant.axes[0].r_s)) as rig:
        rig.enable_axes()
        burst = recorded(rig, FAST)
        _, residual = signals(burst)
        assert burst.note == ""
        worst = {name: np.abs(column).max() for name, column in residual.columns.items()}
        assert worst["axis1.i_q"] > 0.01
        assert worst["axis1.position"] < 0.5, "in coordinates of the real axis"
        assert worst["axis1.theta_e"] < 1.0, "wrapped to half a revolution"
        assert not np.isnan(residual.table(FAST.names)).any()


def test_a_twin_synchronised_later_has_the_ticks_and_positions_of_the_board() -> None:
    with TwinRig(real_seed=7, twin_seed=8, tick_base=3 << 32) as rig:
        rig.enable_axes()
        rig.move([1.25, -2.5])
        rig.twin.resync("test")
        rig.run(0.5)
        assert rig.twin.status == ""
        burst = recorded(rig, FAST, (-1.0, 2.0))
        assert burst.note == (
            "no residual of axis1.i_a, axis1.theta_e, axis2.duty_a: the twin's shaft has another electrical angle"
        )
        twin, residual = signals(burst)
        assert twin["tick"][0] > 3 << 32
        for name, limit in (("axis1.position", 0.02), ("axis2.position_ref", 1e-9)):
            assert np.abs(residual[name]).max() <= limit, name
        assert np.ptp(twin["axis2.position_ref"]) > 1.0
        assert np.isnan(residual["axis1.theta_e"]).all()


def test_a_burst_waits_for_a_lagging_twin(rig: TwinRig) -> None:
    begin(rig, FAST)
    rig.listening = False
    rig.run(0.1)
    points = end(rig, FAST)
    rig.twin.add_burst("", points)
    rig.twin.set_recorder(None)
    assert rig.twin.burst_answers() == []
    rig.listening = True
    rig.run(0.1)
    assert answer(rig).note == ""
    rig.run(2.2)
    rig.twin.add_burst("", points)
    assert answer(rig).note == "the twin was started after the set-up of the recorder", "sampled only when armed"


def test_variables_without_a_twin_value_are_omitted_and_reported(rig: TwinRig) -> None:
    begin(rig, replace(FAST, names=("tick", "cmd.position", "applied_tick", "axis2.i_q")))
    rig.run(0.1)
    points = end(rig, replace(FAST, names=("tick", "cmd.position[0]", "applied_tick", "axis2.i_q")))
    rig.run(0.1)
    rig.twin.add_burst("", points)
    burst = answer(rig)
    assert list(signals(burst)[0].columns) == ["tick", "axis2.i_q", topics.BURST_TIME, *topics.STAMP_COLUMNS]
    assert burst.note == "without cmd.position[0], applied_tick (written by the host or not available in the twin)"


@pytest.mark.parametrize(
    ("setup", "note"),
    [
        (replace(FAST, names=("tick", "foreign", "axis1.i_q[3]")), "the twin has none of tick, foreign, axis1.i_q[3]"),
        (replace(FAST, period_ns=0), "the recording contains no ticks or has an unknown sampling period"),
        (replace(FAST, period_ns=10_000 * PERIOD_NS), "312 s at full rate need 104 MB; the limit of the twin is 64 MB"),
    ],
)
def test_an_unsuitable_setup_is_refused_with_the_reason(rig: TwinRig, setup: RecorderSetup, note: str) -> None:
    begin(rig, FAST)
    rig.twin.set_recorder(setup)
    rig.run(0.1)
    rig.twin.add_burst("", end(rig, FAST))
    burst = answer(rig)
    assert (burst.twin, burst.residual) == (None, None)
    assert burst.note == note


def test_samples_before_a_resynchronisation_are_not_available(rig: TwinRig) -> None:
    begin(rig, FAST)
    rig.run(0.05)
    first = rig.real.tick
    rig.twin.resync("resynchronisation requested")
    rig.run(0.2)
    points = end(rig, FAST)
    rig.run(0.05)
    early = np.concatenate([[first], points["tick"][:-1]])
    rig.twin.add_burst("", points.changed(tick=early))
    note = answer(rig).note
    assert note.startswith(f"the burst starts at tick {first}; the twin has samples from tick ")
    assert note.endswith(" on (resynchronisation requested)")
    later = points.changed(tick=points["tick"] + 16_000.0)
    rig.twin.add_burst("", later)
    rig.twin.set_recorder(FAST)
    assert (
        answer(rig).note
        == "the twin lags: the recorder was set up again before the twin reached the end of the previous burst"
    )
    rig.twin.add_burst("", later)
    rig.twin.resync("asked again")
    assert answer(rig).note == "the twin does not follow the board: asked again"


def test_no_residual_while_the_boards_are_not_comparable() -> None:
    with TwinRig(real_seed=7, twin_seed=7) as rig:
        rig.enable_axes()
        begin(rig, replace(FAST, points=4000))
        rig.run(0.1)
        rig.board.inject(HotPowerStage(0, 200.0))
        rig.run(0.1)
        points = end(rig, FAST)
        rig.run(0.1)
        rig.twin.add_burst("", points)
        burst = answer(rig)
        twin, residual = signals(burst)
        apart = np.isnan(residual[FAST.names[1]])
        assert 0 < apart.sum() < len(apart)
        assert not apart[0]
        assert not residual.table(FAST.names[1:])[0].any()
        assert not np.isnan(twin.table()).any()
        assert burst.note == f"no residual at {apart.sum()} of {len(apart)} points: axis1 is FAULT, its twin RUN/SPIN"


def test_the_setup_of_a_recorder_is_converted_to_a_message_and_back() -> None:
    assert setup_from_message(setup_message(FAST)) == FAST
    assert setup_from_message(setup_message(replace(SLOW, period_ns=1_500_000))) == replace(SLOW, period_ns=1_500_000)
    assert setup_from_message(setup_message(None)) is None
    broken = setup_message(FAST)
    broken.data[2] = 0.0
    with pytest.raises(ValueError, match=r"0 points of .* are not a valid set-up"):
        setup_from_message(broken)


def test_sampling_ends_at_a_reset_of_the_board(rig: TwinRig) -> None:
    """The recorder was idle before the reset: the next board is not sampled."""
    begin(rig, FAST)
    rig.run(0.05)
    assert rig.twin._bursts.sampling
    rig.twin.set_recorder(None)
    rig.twin.resync("the board was reset")
    rig.run(0.2)
    assert not rig.twin._bursts.sampling
