"""The main state machine of DRM 4.4: flags, acknowledges, and which transition functions are called."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest
from core_library import Core
from firmware_compiler import FIRMWARE
from hypothesis import given
from hypothesis import strategies as st
from servo_bench import STATE

FLAGS = {
    "NONE": 0x0,
    "FAULT": 0x1,
    "FAULT_CLEAR": 0x2,
    "INIT_DONE": 0x4,
    "STOP": 0x8,
    "START": 0x10,
    "STOP_ACK": 0x20,
    "RUN_ACK": 0x40,
}
STATES = ("fault", "init", "stop", "run")
TRANSITIONS = ("fault_init", "init_fault", "init_stop", "stop_fault", "stop_init", "stop_run", "run_fault", "run_stop")


class Machine:
    """The C machine with spies for functions; a spy may also set flags."""

    def __init__(self, core: Core, state: int, *flags: str) -> None:
        self._core = core
        self.called: list[str] = []
        self.loops: list[int] = []
        self.does: dict[str, Callable[[], None]] = {}
        self._spies: list[Any] = []
        states = core.ffi.new("sm_states_t *", {name: self._spy(name, state=True) for name in STATES})
        transitions = core.ffi.new("sm_transitions_t *", {name: self._spy(name) for name in TRANSITIONS})
        self._keep = (states, transitions)
        self.sm: Any = core.ffi.new("sm_t *", {"states": states, "transitions": transitions, "state": state})
        self.set(*flags)

    def _spy(self, name: str, *, state: bool = False) -> Any:
        def called(_axis: Any, *loop: int) -> None:
            self.called.append(name)
            self.loops.extend(loop)
            if name in self.does:
                self.does[name]()

        kind = "void(struct axis *, axis_loop_t)" if state else "void(struct axis *)"
        spy = self._core.ffi.callback(kind, called)
        self._spies.append(spy)
        return spy

    def set(self, *flags: str) -> None:
        for flag in flags:
            self.sm.ctrl |= FLAGS[flag]

    def step(self, loop: int = 0) -> tuple[list[str], int]:
        """One call from `loop`; returns the functions called and the state after it."""
        self.called.clear()
        self.loops.clear()
        self._core.lib.sm_step(self.sm, self._core.ffi.NULL, loop)
        return list(self.called), self.sm.state


def test_numbers_are_those_of_the_reference_design(core: Core) -> None:
    text = (FIRMWARE / "drive/state_machine.h").read_text(encoding="utf-8")
    found = {name: int(value, 16) for name, value in re.findall(r"#define SM_CTRL_(\w+) UINT16_C\((0x\w+)\)", text)}
    assert found == FLAGS
    assert core.ffi.typeof("state_t").relements == {
        f"STATE_{n}": k for k, n in enumerate(("FAULT", "INIT", "STOP", "RUN"))
    }
    names = ("CALIB", "READY", "ALIGN", "SPIN", "FREEWHEEL", "STARTUP", "TEST")
    assert core.ffi.typeof("substate_t").relements == {f"SUBSTATE_{n}": k for k, n in enumerate(names)}
    assert [f for f, _ in core.ffi.typeof("sm_transitions_t").fields] == list(TRANSITIONS)


@pytest.mark.parametrize("state", [STATE.FAULT, STATE.INIT, STATE.STOP, STATE.RUN])
def test_without_flags_only_the_state_function_runs(core: Core, state: int) -> None:
    machine = Machine(core, state)
    for _ in range(3):
        assert machine.step() == ([STATES[state]], state)


@pytest.mark.parametrize("state", [STATE.FAULT, STATE.INIT, STATE.STOP, STATE.RUN])
def test_the_state_function_gets_the_calling_loop(core: Core, state: int) -> None:
    machine = Machine(core, state)
    for loop in range(6):
        machine.step(loop)
        assert machine.loops == [loop]


def test_init_done_leads_to_stop(core: Core) -> None:
    machine = Machine(core, STATE.INIT)
    machine.does["init"] = lambda: machine.set("INIT_DONE")
    assert machine.step() == (["init", "init_stop"], STATE.STOP)
    assert machine.sm.ctrl == 0


def test_start_waits_for_its_acknowledge(core: Core) -> None:
    machine = Machine(core, STATE.STOP, "START")
    for _ in range(2):
        assert machine.step() == (["stop", "stop_run"], STATE.STOP)
    machine.does["stop_run"] = lambda: machine.set("RUN_ACK")
    assert machine.step() == (["stop", "stop_run"], STATE.RUN)
    assert machine.sm.ctrl == 0


def test_stop_waits_for_its_acknowledge(core: Core) -> None:
    machine = Machine(core, STATE.RUN, "STOP")
    for _ in range(2):
        assert machine.step() == (["run", "run_stop"], STATE.RUN)
    machine.does["run_stop"] = lambda: machine.set("STOP_ACK")
    assert machine.step() == (["run", "run_stop"], STATE.STOP)
    assert machine.sm.ctrl == 0


@pytest.mark.parametrize(
    ("state", "transition"), [(STATE.INIT, "init_fault"), (STATE.STOP, "stop_fault"), (STATE.RUN, "run_fault")]
)
def test_a_pending_fault_leads_every_state_to_fault(core: Core, state: int, transition: str) -> None:
    """A pending fault: the state function is not called, as it could switch the outputs on."""
    machine = Machine(core, state, "FAULT")
    assert machine.step() == ([transition], STATE.FAULT)
    assert machine.step() == (["fault"], STATE.FAULT)


@pytest.mark.parametrize(
    ("state", "transition"), [(STATE.INIT, "init_fault"), (STATE.STOP, "stop_fault"), (STATE.RUN, "run_fault")]
)
def test_fault_from_within_a_state_function(core: Core, state: int, transition: str) -> None:
    machine = Machine(core, state)
    machine.does[STATES[state]] = lambda: machine.set("FAULT")
    assert machine.step() == ([STATES[state], transition], STATE.FAULT)


@pytest.mark.parametrize("state", [STATE.INIT, STATE.STOP, STATE.RUN])
def test_fault_has_precedence_and_discards_requests(core: Core, state: int) -> None:
    machine = Machine(core, state, *(set(FLAGS) - {"NONE"}))
    assert machine.step()[1] == STATE.FAULT
    assert machine.sm.ctrl == 0
    assert machine.step() == (["fault"], STATE.FAULT)


def test_clear_leads_through_init(core: Core) -> None:
    machine = Machine(core, STATE.FAULT, "FAULT_CLEAR", "START", "INIT_DONE")
    assert machine.step() == (["fault", "fault_init"], STATE.INIT)
    assert machine.sm.ctrl == 0, "requests from before a fault are discarded"
    assert machine.step() == (["init"], STATE.INIT)


@given(state=st.integers(0, 3), ctrl=st.integers(0, 0x7F))
def test_any_flags_make_at_most_one_transition(core: Core, state: int, ctrl: int) -> None:
    machine = Machine(core, state)
    machine.sm.ctrl = ctrl
    called, after = machine.step()
    transitions = [name for name in called if name in TRANSITIONS]
    assert len(transitions) <= 1
    if after != state:
        assert transitions == [f"{STATES[state]}_{STATES[after]}"]
    if ctrl & 1:
        assert after == STATE.FAULT or (state == STATE.FAULT and ctrl & 2)
