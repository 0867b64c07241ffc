"""Where the axes have been in recorded runs: states, transitions, faults and limits, out of the snapshots."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

from servo_msgs_py.catalogue import Catalogue

from targets.recording import Recording

AXES: Final = (1, 2)

MAIN_TRANSITIONS: Final = frozenset(
    {
        ("FAULT", "INIT"),
        ("INIT", "FAULT"),
        ("INIT", "STOP"),
        ("STOP", "FAULT"),
        ("STOP", "RUN"),
        ("RUN", "FAULT"),
        ("RUN", "STOP"),
    }
)
"""Transitions of the main state machine (DRM F36). No flag leads from STOP to INIT, though F36 lists its function."""

RUN_TRANSITIONS: Final = frozenset(
    {
        ("CALIB", "READY"),
        ("READY", "ALIGN"),
        ("READY", "SPIN"),  # behind a holding brake, where the angle is known
        ("ALIGN", "READY"),
        ("ALIGN", "SPIN"),
        ("SPIN", "FREEWHEEL"),
        ("SPIN", "ALIGN"),  # is a shaft that does not move held fast, or unseen?
        ("FREEWHEEL", "ALIGN"),
        ("FREEWHEEL", "READY"),
        ("READY", "STARTUP"),
        ("STARTUP", "SPIN"),
        ("STARTUP", "FREEWHEEL"),
        ("READY", "TEST"),
        ("TEST", "READY"),
        ("TEST", "FREEWHEEL"),
    }
)
"""Transitions between the sub-states of RUN (DRM F37, STARTUP, TEST); each entry into RUN starts with CALIB."""

Transition = tuple[str, str]


@dataclass(frozen=True)
class Moment:
    """One axis at the end of a slow tick."""

    state: str
    substate: str
    faults: frozenset[str]
    limits: frozenset[str]


@dataclass
class History:
    """What one axis has gone through.

    Attributes
    ----------
    states, substates : set of str
        Where it was; sub-states only while in RUN.
    transitions, run_transitions : set of (str, str)
        From state to state, and from sub-state to sub-state except to CALIB.
    faults, limits : set of str
        What was raised and reported.
    faulted_from : set of str
        States and sub-states that a fault has ended.
    """

    states: set[str] = field(default_factory=set)
    substates: set[str] = field(default_factory=set)
    transitions: set[Transition] = field(default_factory=set)
    run_transitions: set[Transition] = field(default_factory=set)
    faults: set[str] = field(default_factory=set)
    limits: set[str] = field(default_factory=set)
    faulted_from: set[str] = field(default_factory=set)

    def add(self, moments: Sequence[Moment]) -> None:
        """Take in one run, which begins with a reset."""
        for moment in moments:
            self.states.add(moment.state)
            if moment.state == "RUN":
                self.substates.add(moment.substate)
            self.faults |= moment.faults
            self.limits |= moment.limits
        for before, after in itertools.pairwise(moments):
            if before.state != after.state:
                self.transitions.add((before.state, after.state))
            if before.substate != after.substate and after.substate != "CALIB":
                self.run_transitions.add((before.substate, after.substate))
            if after.state == "FAULT" and before.state != "FAULT":
                self.faulted_from.add(before.substate if before.state == "RUN" else before.state)


def histories(recordings: Iterable[Recording], catalogue: Catalogue) -> dict[int, History]:
    """What each axis (1, 2) has gone through in all of the runs."""
    found = {axis: History() for axis in AXES}
    for recording in recordings:
        views = [dict(call.snapshot) for call in recording.calls() if call.snapshot]
        for axis in AXES:
            found[axis].add(list(_moments(recording, catalogue, axis, views)))
    return found


def _moments(
    recording: Recording, catalogue: Catalogue, axis: int, views: Iterable[dict[int, int]]
) -> Iterator[Moment]:
    index = {name: i for i, name in recording.fields.items()}
    state, substate, faults, limits = (
        index[f"axis{axis}.{name}"] for name in ("state", "substate", "faults", "limits")
    )
    for view in views:
        yield Moment(
            state=catalogue.label("state_t", view[state]),
            substate=catalogue.label("substate_t", view[substate]),
            faults=frozenset(flag.name for flag in catalogue.active("faults", view[faults])),
            limits=frozenset(flag.name for flag in catalogue.active("limits", view[limits])),
        )
