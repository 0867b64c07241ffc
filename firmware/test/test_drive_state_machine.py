"""The main state machine of DRM 4.4 against a model: functions called, flags and state after any step."""

from __future__ import annotations

from typing import Any

from core_library import Core
from hypothesis import given, settings
from hypothesis import strategies as st

FAULT, FAULT_CLEAR, INIT_DONE, STOP, START, STOP_ACK, RUN_ACK = (1 << k for k in range(7))
STATES = ("fault", "init", "stop", "run")
TRANSITIONS = ("fault_init", "init_fault", "init_stop", "stop_fault", "stop_init", "stop_run", "run_fault", "run_stop")


class Machine:
    """The C machine with spies for its functions; each sets the flags in `sets` by its name."""

    def __init__(self, core: Core, state: int, ctrl: int, sets: dict[str, int]) -> None:
        self._core, self._sets = core, sets
        self.called: list[str] = []
        self.loops: list[int] = []
        self._spies: list[Any] = []  # kept alive
        states = core.ffi.new("sm_states_t *", {name: self._spy(name, "axis_loop_t") for name in STATES})
        transitions = core.ffi.new("sm_transitions_t *", {name: self._spy(name) for name in TRANSITIONS})
        self._keep = (states, transitions)
        self.sm: Any = core.ffi.new("sm_t *", {"states": states, "transitions": transitions})
        self.sm.state, self.sm.ctrl = state, ctrl

    def _spy(self, name: str, *more: str) -> Any:
        def called(_axis: Any, *loop: int) -> None:
            self.called.append(name)
            self.loops.extend(loop)
            self.sm.ctrl |= self._sets.get(name, 0)

        self._spies.append(self._core.ffi.callback(f"void({', '.join(('struct axis *', *more))})", called))
        return self._spies[-1]

    def step(self, loop: int = 0) -> tuple[list[str], int, int]:
        """One call from `loop`; the functions called, and the state and the flags after it."""
        self._core.lib.sm_step(self.sm, self._core.ffi.NULL, loop)
        return self.called, self.sm.state, self.sm.ctrl


class Model:
    """A step of the machine: a fault has precedence and discards every request; other transitions are acknowledged."""

    def __init__(self, state: int, ctrl: int, sets: dict[str, int]) -> None:
        self._name, self._ctrl, self._sets = STATES[state], ctrl, sets
        self._called: list[str] = []

    def _call(self, name: str) -> None:
        self._called.append(name)
        self._ctrl |= self._sets.get(name, 0)

    def _go(self, to: str, request: int, acknowledge: int) -> None:
        if self._ctrl & request:
            self._call(f"{self._name}_{to}")
            if self._ctrl & acknowledge:
                self._ctrl &= ~(request | acknowledge)
                self._name = to

    def step(self) -> tuple[list[str], int, int]:
        if self._name == "fault" or not self._ctrl & FAULT:
            self._call(self._name)  # not called with a pending fault, as it could switch the outputs on
        if self._name == "fault":
            self._ctrl &= ~FAULT
            if self._ctrl & FAULT_CLEAR:
                self._call("fault_init")
                self._name, self._ctrl = "init", 0
        elif self._ctrl & FAULT:
            self._call(f"{self._name}_fault")
            self._name, self._ctrl = "fault", 0
        elif self._name == "init":
            if self._ctrl & INIT_DONE:
                self._ctrl &= ~INIT_DONE
                self._call("init_stop")
                self._name = "stop"
        elif self._name == "stop":
            self._go("run", START, RUN_ACK)
        else:
            self._go("stop", STOP, STOP_ACK)
        return self._called, STATES.index(self._name), self._ctrl


WORDS = st.integers(0, 0x7F)


@settings(max_examples=150)
@given(
    state=st.integers(0, 3),
    ctrl=WORDS,
    sets=st.dictionaries(st.sampled_from([*STATES, *TRANSITIONS]), WORDS, max_size=4),
)
def test_step_agrees_with_the_model(core: Core, state: int, ctrl: int, sets: dict[str, int]) -> None:
    assert Machine(core, state, ctrl, sets).step() == Model(state, ctrl, sets).step()


def test_state_function_gets_the_calling_loop(core: Core) -> None:
    for state in range(4):
        for loop in range(6):
            machine = Machine(core, state, 0, {})
            machine.step(loop)
            assert machine.loops == [loop]


def test_numbers_are_those_of_the_reference_design(core: Core) -> None:
    names = ("CALIB", "READY", "ALIGN", "SPIN", "FREEWHEEL", "STARTUP", "TEST")
    assert core.ffi.typeof("state_t").relements == {f"STATE_{name.upper()}": k for k, name in enumerate(STATES)}
    assert core.ffi.typeof("substate_t").relements == {f"SUBSTATE_{name}": k for k, name in enumerate(names)}
