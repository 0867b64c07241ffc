"""Invariants under random commands, voltages, currents and shaft movements."""

from __future__ import annotations

import random

import pytest
from core_library import Core
from servo_bench import CODE_24V, STATE, SUBSTATE, Bench, bus_code

LEGAL = {
    (STATE.FAULT, STATE.INIT),
    (STATE.INIT, STATE.FAULT),
    (STATE.INIT, STATE.STOP),
    (STATE.STOP, STATE.FAULT),
    (STATE.STOP, STATE.RUN),
    (STATE.RUN, STATE.FAULT),
    (STATE.RUN, STATE.STOP),
}
AT_ONCE = {(STATE.STOP, STATE.INIT), (STATE.RUN, STATE.INIT)}
"""Transitions via FAULT: raised by the monitors within a tick, cleared at its end."""


class Monkey:
    """Random commands, voltages, currents and shaft movements on one board."""

    def __init__(self, core: Core, seed: int) -> None:
        self.random = random.Random(seed)
        self.bench = Bench(core)
        self.seen: set[tuple[int, int]] = set()
        self.enabled = [False, False]  # written since the last time the axis was not enabled

    def any_of(self, name: str) -> int:
        """A random raw number within the range of a variable."""
        low, high = self.bench.catalogue[name].raw_range
        return self.random.randrange(low, high + 1)

    def act(self) -> None:
        r, b = self.random, self.bench
        axis = r.randrange(2)
        kind = r.randrange(16)
        if kind < 5:
            b.write(axis, enable=1)
            self.enabled[axis] = True
        elif kind == 5:
            b.write(axis, enable=0)
        elif kind == 6:
            b.write(axis, mode=r.randrange(3))
        elif kind == 7:
            b.write(axis, position=r.choice([0, 4000, -(2**29), 2**29, r.randrange(-9999, 9999)]))
        elif kind == 8:
            b.write(axis, speed=self.any_of("cmd.speed"), i_q=self.any_of("cmd.i_q"))
        elif kind == 9:
            b.write(axis, quick_stop=r.randrange(2))
        elif kind == 10:
            b.turn(axis, r.choice([0.0, 0.0, r.uniform(-520.0, 520.0)]))
        elif kind == 11:
            b.hal.bus_code = r.choice([CODE_24V] * 8 + [bus_code(14.0), bus_code(35.0), 0, 4095])
        elif kind == 12:
            b.hal.axis[axis].over_current = r.random() < 0.2
        elif kind == 13:
            for phase in range(3):
                b.hal.axis[axis].current_code[phase] = r.choice([2048, 2048, r.randrange(4096)])
        elif kind == 14:
            for name in ("param.i_q_limit", "param.speed_limit", "param.host_timeout"):
                b.write_raw(name, [self.any_of(name) for _ in range(b.catalogue[name].count)])
        elif r.random() < 0.3:
            b.hal.bus_code, b.hal.axis[axis].over_current = CODE_24V, False
            for phase in range(3):
                b.hal.axis[axis].current_code[phase] = 2048
            b.turn(axis, 0.0)
        b.write(axis, clear_faults=1)

    def check(self, axis: int, before: tuple[int, int]) -> None:
        view, hal = self.bench.view(axis), self.bench.hal.axis[axis]
        now = (view.state, view.substate)
        self.seen.add(now)
        assert view.state in range(4)
        assert view.substate in range(5)
        if hal.outputs_on:
            assert view.state == STATE.RUN
            assert view.substate in (SUBSTATE.READY, SUBSTATE.ALIGN, SUBSTATE.SPIN)
            assert view.faults == 0
        assert (view.state == STATE.FAULT) == (view.faults != 0)
        assert all(0 <= duty <= 32767 for duty in hal.duty)
        assert abs(view.i_q_ref) <= 15888  # 4 A
        assert hal.pair == self.bench.axis(axis).sense.pair
        assert now[0] == before[0] or (before[0], now[0]) in LEGAL | AT_ONCE
        if before[0] == STATE.STOP and now[0] == STATE.RUN:
            assert self.enabled[axis], "no command since the last stop"
        if now[0] in (STATE.FAULT, STATE.INIT, STATE.STOP) and before[0] == STATE.RUN:
            self.enabled[axis] = False


@pytest.mark.parametrize("seed", range(4))
def test_outputs_are_on_only_in_run_without_a_fault(core: Core, seed: int) -> None:
    monkey = Monkey(core, seed)
    for _ in range(700):
        for _ in range(monkey.random.choice([0, 1, 1, 2])):
            monkey.act()
        if monkey.random.random() < 0.1:
            monkey.bench.keep_alive()
        ticks = monkey.random.choice([1, 1, 2, 5, 30, 120])
        for _ in range(ticks):
            before = [(monkey.bench.view(i).state, monkey.bench.view(i).substate) for i in range(2)]
            monkey.bench.slow()
            for axis in range(2):
                monkey.check(axis, before[axis])
    print(sorted(monkey.seen))
    assert {state for state, _ in monkey.seen} == {STATE.FAULT, STATE.INIT, STATE.STOP, STATE.RUN}
    assert {substate for state, substate in monkey.seen if state == STATE.RUN} >= {
        SUBSTATE.CALIB,
        SUBSTATE.ALIGN,
        SUBSTATE.SPIN,
        SUBSTATE.FREEWHEEL,
    }
