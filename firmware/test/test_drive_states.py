"""States, sub-states and transitions of one axis of DRM 4.5 (F36, F37)."""

from __future__ import annotations

import pytest
from core_library import Core
from servo_bench import BRAKE, CODE_24V, MODE, PULL, REST, STATE, SUBSTATE, VERIFY, Bench

HALF = 16384


@pytest.fixture
def bench(core: Core) -> Bench:
    return Bench(core)


def at_rest(bench: Bench, axis: int) -> bool:
    """Currents and voltages are zero and every duty is 50 %."""
    a = bench.axis(axis)
    loop = a.current_loop
    zeros = (loop.current.d, loop.current.q, loop.voltage.d, loop.voltage.q, a.current_ref.d, a.current_ref.q)
    return not any(zeros) and list(bench.hal.axis[axis].duty) == [HALF] * 3


def test_reset_leads_through_init_to_stop_with_the_outputs_off(bench: Bench) -> None:
    assert bench.axis(0).sm.state == STATE.INIT
    bench.slow()
    assert bench.view(0).state == STATE.INIT
    bench.to_stop()
    bench.slow(200)
    assert [s[0] for s in bench.states()] == [STATE.STOP, STATE.STOP]
    for axis in range(2):
        assert bench.hal.axis[axis].times_on == 0
        assert at_rest(bench, axis)


def test_init_lasts_until_the_bus_filter_has_settled(bench: Bench) -> None:
    """Otherwise the rising filter would be an under-voltage fault."""
    ticks = bench.until(lambda: bench.view(0).state == STATE.STOP, 100)
    assert ticks == bench.core.lib.probe_config().axis[0].settle_ticks
    assert bench.axis(0).u_dc == pytest.approx(CODE_24V << 3, rel=1e-3)


@pytest.mark.parametrize("axis", [0, 1])
def test_enable_leads_one_axis_to_spin(bench: Bench, axis: int) -> None:
    bench.to_stop()
    bench.write(axis, enable=1)
    seen: list[tuple[int, int]] = []
    for _ in range(1500):
        bench.slow()
        now = (bench.view(axis).state, bench.view(axis).substate)
        if not seen or seen[-1] != now:
            seen.append(now)
        assert bench.view(1 - axis).state == STATE.STOP
        assert not bench.hal.axis[1 - axis].outputs_on
    assert seen == [
        (STATE.RUN, SUBSTATE.CALIB),
        (STATE.RUN, SUBSTATE.READY),
        (STATE.RUN, SUBSTATE.ALIGN),
        (STATE.RUN, SUBSTATE.SPIN),
    ]


def test_calib_measures_offsets_with_the_outputs_off(bench: Bench) -> None:
    bench.to_stop()
    hal = bench.hal.axis[0]
    hal.current_code[0], hal.current_code[1], hal.current_code[2] = 2040, 2051, 2060
    bench.write(0, enable=1)
    bench.slow()
    assert bench.view(0).substate == SUBSTATE.CALIB
    while bench.view(0).substate == SUBSTATE.CALIB:
        assert not hal.outputs_on
        assert at_rest(bench, 0)
        bench.slow()
    offsets = [o / 65536 for o in bench.axis(0).sense.offset]
    assert offsets == pytest.approx([2040, 2051, 2060], abs=0.5)


def test_calib_uses_only_samples_of_the_selected_pair(bench: Bench) -> None:
    """The first samples after Stop -> Run and after the change of the pair are valid."""
    bench.to_stop()
    for phase, code in enumerate((2000, 2050, 2100)):
        bench.hal.axis[1].current_code[phase] = code
    bench.write(1, enable=1)
    bench.to_substate(1, SUBSTATE.READY)
    assert [o / 65536 for o in bench.axis(1).sense.offset] == pytest.approx([2000, 2050, 2100], abs=0.02)


def test_ready_shorts_the_windings(bench: Bench) -> None:
    """50 % on every phase, outputs on; currents are sampled."""
    bench.to_stop()
    bench.write(0, enable=1)
    bench.to_substate(0, SUBSTATE.READY)
    assert bench.hal.axis[0].outputs_on
    assert list(bench.hal.axis[0].duty) == [HALF] * 3


def test_align_pulls_brakes_and_rests(bench: Bench) -> None:
    """A rising current vector, its reversal and decay, then 50 % until the shaft is at rest; finally a
    rotating vector that the shaft follows."""
    bench.to_stop()
    bench.write(0, enable=1)
    bench.to_substate(0, SUBSTATE.ALIGN)
    phases = set()
    for _ in range(600):
        bench.slow()
        axis = bench.axis(0)
        if axis.substate != SUBSTATE.ALIGN:
            break
        phases.add(axis.search.phase)
        assert bench.hal.axis[0].outputs_on
        if axis.search.phase == REST and axis.search.current_decaying == 0:
            assert list(bench.hal.axis[0].duty) == [HALF] * 3
        elif axis.search.phase != REST:
            assert axis.current_ref.d == pytest.approx(axis.search.current / 65536, abs=1)
            assert axis.current_ref.q == 0
            assert (axis.search.current < 0) == (axis.search.phase == BRAKE)
    assert phases == {PULL, BRAKE, REST, VERIFY}
    assert bench.axis(0).substate == SUBSTATE.SPIN


def test_align_presets_the_counter_to_the_found_angle(bench: Bench) -> None:
    bench.to_stop()
    bench.write(0, enable=1)
    bench.to_substate(0, SUBSTATE.SPIN)
    bench.slow()
    rotor = (bench._rotor[0] + bench.shaft[0].shaft * 2 / 4000) * 65536
    error = (bench.view(0).theta_e - rotor + 32768) % 65536 - 32768
    assert abs(error) / 65536 * 360 < 2.0
    assert bench.view(0).position == 0, "the position is zero at the angle of the first search (E41)"


def test_preset_of_the_counter_is_no_movement(bench: Bench) -> None:
    """The difference of captures before and after the preset is not a movement."""
    bench.to_stop()
    bench.write(0, enable=1)
    bench.to_substate(0, SUBSTATE.ALIGN)
    hal = bench.hal.axis[0]
    for _ in range(2000):
        if bench.view(0).substate == SUBSTATE.SPIN:
            break
        hal.edge.count, hal.edge.time, hal.edge_waits = hal.count, (hal.edge.time + 391) & 0xFFFF, True
        bench.slow()
    old = bench.shaft[0].raw
    assert hal.count != old, "the preset changes the counter"
    for count in (old, hal.count, hal.count):  # the first edge was captured just before the preset
        hal.edge.count, hal.edge.time, hal.edge_waits = count, (hal.edge.time + 391) & 0xFFFF, True
        bench.slow()
        assert bench.view(0).speed == 0


def test_spin_begins_by_holding_the_present_position(bench: Bench) -> None:
    bench.to_spin(0)
    bench.slow(20)
    view = bench.view(0)
    assert (view.speed_ref, view.i_q_ref, view.position, view.position_ref) == (0, 0, 0, 0)


@pytest.mark.parametrize("substate", [SUBSTATE.CALIB, SUBSTATE.READY, SUBSTATE.ALIGN])
def test_disable_before_spin_stops_at_once(bench: Bench, substate: int) -> None:
    bench.to_stop()
    bench.write(0, enable=1)
    bench.to_substate(0, substate)
    bench.write(0, enable=0)
    bench.slow(2)
    assert bench.view(0).state == STATE.STOP
    assert not bench.hal.axis[0].outputs_on
    assert at_rest(bench, 0)


def test_stop_from_spin_goes_through_freewheel_and_ready(bench: Bench) -> None:
    """Run -> Stop is never directly from SPIN; FREEWHEEL with open switches until the rotor is at rest."""
    bench.to_spin(0)
    bench.turn(0, 60.0)  # an external torque keeps the shaft moving
    bench.slow(10)
    bench.write(0, enable=0)
    bench.to_substate(0, SUBSTATE.FREEWHEEL)
    bench.slow(400)
    assert (bench.view(0).state, bench.view(0).substate) == (STATE.RUN, SUBSTATE.FREEWHEEL), "the rotor still turns"
    assert not bench.hal.axis[0].outputs_on
    assert at_rest(bench, 0)
    bench.turn(0, 0.0)
    ticks = bench.until(lambda: bench.view(0).state == STATE.STOP, 300)
    assert ticks * 0.5 >= 80  # ms without an edge
    assert bench.view(0).substate == SUBSTATE.READY
    assert not bench.hal.axis[0].outputs_on


def test_stop_of_a_shaft_that_does_not_slow_down_ends_after_its_time(bench: Bench) -> None:
    bench.to_spin(0)
    bench.turn_without_current(0, 100.0)
    bench.slow(50)
    bench.write(0, enable=0)
    bench.to_substate(0, SUBSTATE.FREEWHEEL, 1100)


def test_enable_during_freewheel_searches_the_rotor_again_at_rest(bench: Bench) -> None:
    bench.to_spin(0)
    bench.turn(0, 30.0)
    bench.write(0, enable=0)
    bench.to_substate(0, SUBSTATE.FREEWHEEL)
    bench.write(0, enable=1)
    bench.slow(50)
    assert bench.view(0).substate == SUBSTATE.FREEWHEEL
    bench.turn(0, 0.0)
    bench.to_substate(0, SUBSTATE.ALIGN)
    bench.to_substate(0, SUBSTATE.SPIN)
    bench.slow(100)
    assert bench.view(0).state == STATE.RUN


def test_enable_during_the_ramp_down_keeps_spinning(bench: Bench) -> None:
    bench.to_spin(0)
    bench.turn(0, 100.0)
    bench.slow(20)
    bench.write(0, enable=0)
    bench.slow(3)
    bench.write(0, enable=1)
    bench.turn(0, 0.0)
    bench.slow(400)
    assert (bench.view(0).state, bench.view(0).substate) == (STATE.RUN, SUBSTATE.SPIN)


def test_position_survives_a_new_alignment(bench: Bench) -> None:
    """Revolutions and zero are kept; only the counter is preset again."""
    bench.to_spin(0)
    bench.turn_without_current(0, 200.0)
    bench.slow(300)
    bench.turn(0, 0.0)
    bench.slow(5)
    travelled = bench.view(0).position
    assert travelled == pytest.approx(200 * 0.15 / 6.2832 * 4000, rel=0.02)
    bench.write(0, enable=0)
    bench.until(lambda: bench.view(0).state == STATE.STOP, 1500)
    before = bench.shaft[0].shaft
    bench.write(0, enable=1)
    bench.to_substate(0, SUBSTATE.SPIN)
    assert bench.view(0).position == travelled + bench.shaft[0].shaft - before
    assert bench.view(0).faults == 0


@pytest.mark.parametrize(
    ("substate", "sampled", "tracked"),
    [
        (SUBSTATE.CALIB, True, False),
        (SUBSTATE.READY, True, True),
        (SUBSTATE.ALIGN, True, True),
        (SUBSTATE.SPIN, True, True),
        (SUBSTATE.FREEWHEEL, True, True),
    ],
)
def test_samples_of_every_sub_state(bench: Bench, substate: int, sampled: bool, tracked: bool) -> None:
    """DRM 4.5: currents in all sub-states, the bus always, offsets in READY (before it ends) and later."""
    bench.to_stop()
    bench.write(0, enable=1)
    if substate == SUBSTATE.FREEWHEEL:
        bench.to_substate(0, SUBSTATE.SPIN)
        bench.turn(0, 20.0)
        bench.slow(5)
        bench.write(0, enable=0)
    if substate == SUBSTATE.READY:
        bench.to_substate(0, SUBSTATE.CALIB)
        bench.until(lambda: bool(bench.axis(0).calibrated), 100)
        bench.axis(0).substate = SUBSTATE.READY
    else:
        bench.to_substate(0, substate)
    offsets = list(bench.axis(0).sense.offset)
    bench.hal.axis[0].offset_code = [2068] * 3
    bench.log()
    bench.core.lib.probe_run(bench.servo, 8)
    calls = bench.calls()
    assert ("adc_currents", 0, 0) in calls or not sampled
    assert ("adc_offsets", 0, 0) in calls
    assert (list(bench.axis(0).sense.offset) != offsets) is tracked
    assert sum(name == "adc_bus" for name, _, _ in calls) >= 16


def test_offsets_are_followed_only_while_the_high_side_is_long_enough(bench: Bench) -> None:
    """At full modulation the phase with the shortest high side keeps its offset."""
    bench.to_spin(0)
    bench.write(0, mode=MODE.TORQUE, i_q=3000)
    bench.slow(30)  # no current flows on this bench: the loop commands the full voltage
    duty = list(bench.hal.axis[0].duty)
    sense = bench.axis(0).sense
    assert [sense.duty.a, sense.duty.b, sense.duty.c] == duty
    shortest = duty.index(min(duty))
    assert duty[shortest] < 3277
    for phase in range(3):
        bench.hal.axis[0].offset_code[phase] = 2090
    before = list(sense.offset)
    bench.slow(20)
    moved = [after != b for after, b in zip(sense.offset, before, strict=True)]
    assert not moved[shortest]
    assert any(moved)


def test_stop_and_fault_keep_filtering_the_bus(bench: Bench) -> None:
    bench.to_stop()
    bench.hal.bus_code = CODE_24V + 100
    bench.slow(20)
    assert bench.servo.snapshot.u_dc == pytest.approx((CODE_24V + 100) << 3, abs=2)
    bench.hal.axis[0].over_current = True
    bench.slow(1)
    bench.hal.bus_code = CODE_24V
    bench.slow(20)
    assert bench.axis(0).u_dc == pytest.approx(CODE_24V << 3, abs=2)
