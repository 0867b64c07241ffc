"""Every remedy that names a value is accepted: it leads to another refusal or to a configuration that works."""

from __future__ import annotations

import math
import pickle
from collections.abc import Sequence
from typing import Any, Final

import pytest
from hypothesis import Phase, assume, example, given, settings
from hypothesis import strategies as st
from servo_tuning.assessment import assess
from servo_tuning.errors import RAISE, ConfigError, Problem, Remedy, Table, lower, problem
from servo_tuning.findings import findings
from servo_tuning.reading import parse
from servo_tuning.remedies import applied, explained, refusal_of, tried, value_in, with_value
from servo_tuning.tuned import tuned
from tuning_tool import CATALOGUE, entries, table

STEPS_MAX: Final = 12


ENTRIES: Final = {name: entry for name, entry in entries() if value_in(table(), name) is not None}


@st.composite
def changed(draw: st.DrawFn, names: Sequence[str] = sorted(ENTRIES), spread: float = 6.0) -> dict[str, Any]:
    """The committed configuration with up to three entries wrong by a factor, of this logarithm at most."""
    whole = table()
    for name in draw(st.lists(st.sampled_from(names), min_size=1, max_size=3, unique=True)):
        entry, value = ENTRIES[name], value_in(whole, name)
        assert isinstance(value, (int, float))
        new = value * math.exp(draw(st.floats(-spread, spread)))
        new = max(round(new), 1) if entry.whole else new
        whole = with_value(whole, name, min(new, entry.maximum))
    return whole


@settings(max_examples=40, derandomize=True, deadline=None, phases=[Phase.generate])
@given(changed(), st.integers(0, 3))
def test_remedies_lead_to_an_accepted_configuration(whole: dict[str, Any], choice: int) -> None:
    error, path = refusal_of(whole), []
    while error is not None:
        remedies = (found := tried(error, whole)).remedies
        path.append(str(found))
        assert len(path) < STEPS_MAX, path
        if not remedies:  # data of the motor or of the board that no other value can correct
            assert error.advice, path
            return
        remedy = remedies[choice % len(remedies)]
        assert remedy.value is not None
        assert f"{remedy.value:g}" in path[-1], "the message has the value"
        whole = dict(applied(whole, remedy))
        again = refusal_of(whole)
        assert again is None or again.entry != error.entry, (path, str(again))
        error = again


def warnings_of(whole: Table) -> list[Problem]:
    configuration = parse(whole, CATALOGUE)
    designs = [tuned(axis, configuration) for axis in configuration.axes]
    return [warning for design in designs for warning in findings(design, assess(design))]


WARNED: Final = [
    f"axis1.{path}"
    for path in (
        *("motor.psi_m", "motor.inertia", "motor.l_q", "rotor_search.turn_time", "observer.pll_size"),
        *("start_up.minimum_speed", "limits.speed", "limits.over_speed", "control.current_bandwidth"),
    )
]
"""Entries of which warnings with a value depend."""


@settings(max_examples=20, derandomize=True, deadline=None, phases=[Phase.explicit, Phase.generate])
@example(table(), 0.003)
@given(changed(WARNED, 1.5), st.sampled_from([0.0, 0.003, 0.006]))
def test_the_value_of_a_warning_removes_it_and_is_accepted(whole: dict[str, Any], flux: float) -> None:
    """Half of the axes are sensorless; a low flux requires a faster start-up."""
    if flux:
        whole = with_value(whole, "axis1.motor.psi_m", flux)
        whole["axis1"] |= {"feedback": "observer"}
    assume(refusal_of(whole) is None)
    for warning in warnings_of(whole):
        for remedy in warning.remedies:
            if remedy.value is not None:
                after = applied(whole, remedy)
                assert refusal_of(after) is None, (str(warning), str(refusal_of(after)))
                kept = [one for one in warnings_of(after) if one.entry == warning.entry]
                assert kept == [], (str(warning), list(map(str, kept)))


def test_a_refusal_keeps_its_values_in_another_process() -> None:
    with pytest.raises(ConfigError) as refusal:
        parse(with_value(table(), "axis1.stop.time_max", 0.5), CATALOGUE)
    other = pickle.loads(pickle.dumps(refusal.value))
    assert str(other) == str(refusal.value)
    assert Remedy("axis1.stop.time_max", (RAISE,), 0.579) in explained(other).problem.remedies


def test_entries_without_an_accepted_value_are_named() -> None:
    error = problem("axis1.limits.speed", 600.0, "too high", lower("axis1.friction.smooth"))
    assert (
        str(tried(error, with_value(table(), "axis1.limits.speed", 600.0)))
        == "axis1.limits.speed = 600: too high; no other value of axis1.friction.smooth alone is accepted"
    )


@pytest.mark.parametrize(("k_1", "remedy"), [(-100.0, "-1940 or less"), (-15000.0, "-8360 or more")])
def test_bound_of_a_negative_value_is_on_the_accepted_side(k_1: float, remedy: str) -> None:
    """A remedy changes the magnitude; `less` than a negative number has a larger one."""
    k_2 = 2000.0 if k_1 > -1000.0 else 5000.0
    whole = table(axis1__observer__k_1=k_1, axis1__observer__k_2=k_2, axis1__feedback="observer")
    error = refusal_of(whole)
    assert error is not None
    assert f"axis1.observer.k_1 = {remedy}" in str(tried(error, whole))


def test_entries_that_depend_on_each_other_are_changed_together() -> None:
    """A heavy shaft: the position gain has to remain below the bandwidth that is low enough for it."""
    whole = table(axis1__motor__inertia=5e-3, axis1__limits__acceleration=50.0, board__brake__energy=500.0)
    whole = with_value(whole, "axis1.stop.time_max", 30.0)
    error = refusal_of(whole)
    assert error is not None
    (remedy,) = tried(error, whole).remedies
    assert (remedy.entry, remedy.also and remedy.also.entry) == (
        "axis1.control.speed_bandwidth",
        "axis1.control.position_gain",
    )
    assert remedy.text().count(" = ") == 2
    assert refusal_of(applied(whole, remedy)) is None
