"""States, transitions, faults and limits of the axes in recorded runs, from the snapshots."""

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
        ("READY", "SPIN"),  # with a holding brake, if the angle is known
        ("ALIGN", "READY"),
        ("ALIGN", "SPIN"),
        ("SPIN", "FREEWHEEL"),
        ("SPIN", "ALIGN"),  # stall test: blocked shaft or dead encoder
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
class AxisSample:
    """One axis at the end of a slow tick."""

    state: str
    substate: str
    faults: frozenset[str]
    limits: frozenset[str]


@dataclass
class History:
    """States, transitions, faults and limits of one axis."""

    states: set[str] = field(default_factory=set)  # states of the main state machine
    substates: set[str] = field(default_factory=set)  # sub-states of RUN
    transitions: set[Transition] = field(default_factory=set)  # (from, to) of the main state machine
    run_transitions: set[Transition] = field(default_factory=set)  # (from, to) of the sub-states, except to CALIB
    faults: set[str] = field(default_factory=set)  # reported faults
    limits: set[str] = field(default_factory=set)  # reported limits
    faulted_from: set[str] = field(default_factory=set)  # states and sub-states that were ended by a fault

    def add(self, samples: Sequence[AxisSample]) -> None:
        """Add one run, which starts with a reset."""
        for sample in samples:
            self.states.add(sample.state)
            if sample.state == "RUN":
                self.substates.add(sample.substate)
            self.faults |= sample.faults
            self.limits |= sample.limits
        for before, after in itertools.pairwise(samples):
            if before.state != after.state:
                self.transitions.add((before.state, after.state))
            if before.substate != after.substate and after.substate != "CALIB":
                self.run_transitions.add((before.substate, after.substate))
            if after.state == "FAULT" and before.state != "FAULT":
                self.faulted_from.add(before.substate if before.state == "RUN" else before.state)


def histories(recordings: Iterable[Recording], catalogue: Catalogue) -> dict[int, History]:
    """History of each axis (1, 2) over all runs."""
    found = {axis: History() for axis in AXES}
    for recording in recordings:
        views = recording.snapshots()
        for axis in AXES:
            found[axis].add(list(_axis_samples(recording, catalogue, axis, views)))
    return found


def _axis_samples(
    recording: Recording, catalogue: Catalogue, axis: int, views: Iterable[dict[int, int]]
) -> Iterator[AxisSample]:
    index = {name: i for i, name in recording.fields.items()}
    state, substate, faults, limits = (
        index[f"axis{axis}.{name}"] for name in ("state", "substate", "faults", "limits")
    )
    for view in views:
        yield AxisSample(
            state=catalogue.label("state_t", view[state]),
            substate=catalogue.label("substate_t", view[substate]),
            faults=frozenset(flag.name for flag in catalogue.active("faults", view[faults])),
            limits=frozenset(flag.name for flag in catalogue.active("limits", view[limits])),
        )
