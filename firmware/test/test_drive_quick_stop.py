"""Quick stop: ramp down at the limit, hold, and wait for a new enable."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from core_library import Core
from servo_bench import MODE, STATE, SUBSTATE, Bench, amps, rad_s, speed


def by_position(bench: Bench) -> None:
    bench.write(0, position=100_000)


def by_speed(bench: Bench) -> None:
    bench.write(0, mode=MODE.SPEED, speed=speed(100.0))


def by_torque(bench: Bench) -> None:
    bench.turn(0, 100.0)
    bench.write(0, mode=MODE.TORQUE, i_q=amps(1.0))


@pytest.mark.parametrize("move", [by_position, by_speed, by_torque])
def test_quick_stop_ramps_down_and_holds(bench: Bench, move: Callable[[Bench], None]) -> None:
    move(bench)
    for _ in range(150):
        if bench.servo.command.mode[0] != MODE.TORQUE:
            bench.turn(0, rad_s(bench.view(0).speed_ref))
        bench.slow()
    bench.write(0, quick_stop=1)
    bench.slow()
    before = rad_s(bench.view(0).speed_ref)
    assert before > 40.0
    log = bench.follow(int(before / 4000.0 / 0.5e-3) + 60)
    assert (bench.view(0).state, bench.view(0).substate) == (STATE.RUN, SUBSTATE.SPIN)
    assert bench.hal.axis[0].outputs_on
    assert rad_s(bench.view(0).speed_ref) == pytest.approx(0.0, abs=0.5)
    assert log[-1][0] == pytest.approx(log[-1][1], abs=1)


def test_after_a_quick_stop_set_points_wait_for_a_new_enable(bench: Bench) -> None:
    bench.write(0, quick_stop=1)
    bench.slow(5)
    bench.write(0, position=5000)
    bench.slow(5)
    bench.write(0, mode=MODE.SPEED, speed=speed(50.0))
    bench.slow(50)
    assert (bench.view(0).speed_ref, bench.view(0).i_q_ref) == (0, 0)
    bench.write(0, enable=1)
    bench.slow(50)
    assert (bench.view(0).speed_ref, bench.view(0).i_q_ref) == (0, 0), "earlier set-points are ignored"
    assert bench.servo.command.quick_stop[0] == 0
    bench.write(0, speed=speed(50.0))
    bench.slow(50)
    assert rad_s(bench.view(0).speed_ref) > 10.0


@pytest.mark.parametrize("order", [("enable", "quick_stop"), ("quick_stop", "enable")])
def test_quick_stop_has_precedence_over_an_enable_of_the_same_tick(bench: Bench, order: tuple[str, str]) -> None:
    bench.write(0, mode=MODE.SPEED, speed=speed(80.0))
    bench.follow(100)
    for name in order:
        bench.write(0, **{name: 1})
    bench.follow(200)
    assert rad_s(bench.view(0).speed_ref) == pytest.approx(0.0, abs=0.5)


def test_quick_stop_command_of_the_protocol_stops_both_axes(core: Core) -> None:
    bench = Bench(core)
    bench.to_spin(0, 1)
    for axis in range(2):
        bench.write(axis, mode=MODE.SPEED, speed=speed(60.0))
    for _ in range(80):
        for axis in range(2):
            bench.turn(axis, rad_s(bench.view(axis).speed_ref))
        bench.slow()
    app = bench.servo.freemaster.app
    result, size = core.ffi.new("uint8_t[16]"), core.ffi.new("uint16_t *")
    assert app.command(app.context, 1, core.ffi.NULL, 0, result, size) == 0
    for _ in range(120):
        for axis in range(2):
            bench.turn(axis, rad_s(bench.view(axis).speed_ref))
        bench.slow()
    assert [rad_s(bench.view(i).speed_ref) for i in range(2)] == pytest.approx([0.0, 0.0], abs=0.5)


def test_disable_during_a_quick_stop_leads_to_stop(bench: Bench) -> None:
    bench.write(0, quick_stop=1)
    bench.slow(20)
    bench.write(0, enable=0)
    bench.until(lambda: bench.view(0).state != STATE.RUN, 500)
    assert not bench.hal.axis[0].outputs_on
