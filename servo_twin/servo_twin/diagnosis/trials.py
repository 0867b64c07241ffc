"""Trials of the diagnosis: random motion of a virtual pair, and a change of the plant of the real board."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.quantity import ABOVE_0, Quantity
from servo_msgs_py.value_text import parse_assignment

from servo_twin.board import SimulationError
from servo_twin.diagnosis.board_pair import BoardPair, Motion
from servo_twin.diagnosis.calibration import Calibrator
from servo_twin.diagnosis.change_detector import Kind
from servo_twin.diagnosis.monitor import PLANT_VALUES, SUPPLY, DiagnosisMonitor, LocatedFinding
from servo_twin.diagnosis.thresholds import Thresholds
from servo_twin.level import Level
from servo_twin.plant import PlantConfig

NOTHING: Final = "nothing"
SEVERAL_PLACES: Final = "several places"

_BEFORE: Final = (3.0, 6.0)  # motion before the change, minimum and maximum [s]


@dataclass(frozen=True)
class Change:
    """A change of the real plant."""

    name: str  # key of `PLANT_VALUES`
    size: float  # factor; for a load the additional torque [N m]

    @classmethod
    def parse(cls, text: str) -> Change:
        """Parse ``NAME=FACTOR``, such as ``friction=1.15``; a load is a torque [N m].

        Raises
        ------
        ValueError
            If the text has another form.
        """
        form = f"NAME=FACTOR with one of {', '.join(PLANT_VALUES)}; load=TORQUE in N m"
        name, number = parse_assignment(text, form)
        if name not in PLANT_VALUES:
            raise ValueError(f"{text!r}: write {form}")
        valid = Quantity(unit="N m") if name == "load" else Quantity(minimum=ABOVE_0)
        return cls(name, valid.parse(number))

    def key(self, axis: int) -> str:
        """Name in the plant file."""
        return PLANT_VALUES[self.name] if self.name == SUPPLY else f"{axis_name(axis)}.{PLANT_VALUES[self.name]}"

    def verdict(self, axis: int) -> Verdict:
        """The right verdict about this change of an axis."""
        return Verdict(self.name, None if self.name == SUPPLY else axis)


@dataclass(frozen=True)
class Verdict:
    """What has changed, and where."""

    change: str  # key of `PLANT_VALUES`, value of another `Kind`, `NOTHING` or `SEVERAL_PLACES`
    axis: int | None = None  # index; None: the bus, nothing or several places

    def __str__(self) -> str:
        return self.change if self.axis is None else f"{axis_name(self.axis)} {self.change}"


@dataclass(frozen=True)
class Answer:
    """Result of a trial."""

    number: int
    truth: Verdict  # true change
    said: Verdict | None  # finding at the end of the trial; None: the trial was not run
    delay: float | None  # from the change to the first report of the final, right finding [s]; None: wrong
    value: float  # estimated change, relative or [N m]
    covered: bool  # true if the interval contains the true value
    false_alarms: tuple[str, ...]  # findings before the change
    seconds: float  # duration before the change [s]
    problem: str = ""  # error that ended the trial; empty: none


def _said(findings: Sequence[LocatedFinding]) -> Verdict:
    if not findings:
        return Verdict(NOTHING)
    if len(findings) > 1:
        return Verdict(SEVERAL_PLACES)
    axis, finding = findings[0].axis, findings[0].finding
    return Verdict(finding.changes[0], axis) if finding.kind is Kind.SINGLE else Verdict(finding.kind.value)


@dataclass(frozen=True)
class Trials:
    """All trials of a run; can be pickled."""

    plant: PlantConfig  # of the twin, and of the board before the change
    thresholds: Thresholds
    changes: tuple[Change, ...]  # one per trial, cyclic; empty: no change
    seed: int
    seconds: float  # duration after the change; without a change, of the trial [s]
    loss: float  # fraction of lost samples
    level: Level

    def run(self, number: int) -> Answer:
        """Run one trial."""
        seed = self.seed * 1_000_003 + number
        draw = random.Random(f"trial {seed}")
        change = self.changes[number % len(self.changes)] if self.changes else None
        axis = draw.randrange(AXES)
        truth = Verdict(NOTHING) if change is None else change.verdict(axis)
        monitor = DiagnosisMonitor(self.plant, self.thresholds)
        try:
            with BoardPair(self.plant, self.plant, seed=seed, level=self.level, loss=self.loss) as pair:
                pair.enable()
                motion = Motion(pair, seed)
                before = draw.uniform(*_BEFORE) if change is not None else self.seconds
                _, alarms, _ = _follow(monitor, motion, before, pair)
                if change is None:
                    return Answer(number, truth, _said(monitor.findings()), None, 0.0, False, alarms, before)
                key, old = change.key(axis), 0.0
                if change.name != "load":
                    part, _, entry = key.rpartition(".")
                    old = getattr(self.plant.bus if part == "bus" else self.plant.axes[axis], entry)
                pair.board.set_plant(key, old * change.size if old else change.size)
                begin = pair.clock()
                since, _, said = _follow(monitor, motion, self.seconds, pair)
                right = said == truth
                findings = monitor.findings()
                true_value = change.size if change.name == "load" else change.size - 1.0
                finding = findings[0].finding if right else None
                return Answer(
                    number,
                    truth,
                    said,
                    since - begin if right else None,
                    finding.value if finding else 0.0,
                    finding is not None and finding.low <= true_value <= finding.high,
                    alarms,
                    before,
                )
        except SimulationError as error:
            return Answer(number, truth, None, None, 0.0, False, (), 0.0, str(error))


def _follow(
    monitor: DiagnosisMonitor, motion: Motion, seconds: float, pair: BoardPair
) -> tuple[float, tuple[str, ...], Verdict]:
    """Time of the last new finding [s], all findings, and the last finding."""
    said, since, all_said = _said(monitor.findings()), pair.clock(), []
    for one in motion.run(seconds):
        if monitor.update(one):
            now = _said(monitor.findings())
            if now != said:
                said, since = now, pair.clock()
                if now != Verdict(NOTHING):
                    all_said.append(f"{pair.clock():.1f} s: {now}")
    return since, tuple(all_said), said


@dataclass(frozen=True)
class HealthyRuns:
    """Runs of virtual pairs without a change, for the calibration."""

    plant: PlantConfig  # of both boards
    seed: int
    seconds: float  # of each run [s]
    level: Level

    def run(self, number: int) -> Calibrator:
        """Run one pair."""
        seed = self.seed * 1_000_003 + number
        calibrator = Calibrator(self.plant)
        with BoardPair(self.plant, self.plant, seed=seed, level=self.level) as pair:
            pair.enable()
            for one in Motion(pair, seed).run(self.seconds):
                calibrator.add(one)
        calibrator.interrupt()
        return calibrator


def confusion(answers: Sequence[Answer]) -> dict[str, Counter[str]]:
    """Number of findings per true change; a right finding is counted without the number of the axis."""
    table: dict[str, Counter[str]] = {}
    for answer in answers:
        name = answer.truth.change
        said = name if answer.said == answer.truth else "not run" if answer.said is None else str(answer.said)
        table.setdefault(name, Counter())[said] += 1
    return table
