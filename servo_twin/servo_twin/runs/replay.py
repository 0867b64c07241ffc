"""Replay of a recorded run through the twin: the same commands at the same ticks, many times faster than real time."""

from __future__ import annotations

import hashlib
from array import array
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from servo_msgs_py.axis_config import Member
from servo_msgs_py.board_description import DEFAULT_BOARD, OtherBoardError, check_board
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.convert import AppliedCommand
from servo_msgs_py.run_file.reader import Record
from servo_msgs_py.run_file.run_info import VirtualBoard
from servo_msgs_py.text_file import TextFileError, parse_toml
from servo_msgs_py.units import PERIOD_NS

from servo_msgs_py import topics
from servo_twin.board import ELF_MARK, Board, Firmware, SimulationError, build_of
from servo_twin.diagnosis.monitor import LocatedFinding
from servo_twin.diagnosis.thresholds import Thresholds as DiagnosisThresholds
from servo_twin.level import FAST_LEVEL, LEVELS, Level, chosen_elf
from servo_twin.lockstep.blocks import TAKE, Blocks, checksums_of
from servo_twin.lockstep.board_topics import BOARD_TOPICS
from servo_twin.lockstep.twin import Pair, Twin, TwinSettings
from servo_twin.plant import PlantConfig, PlantError
from servo_twin.robot.command import load_on_line
from servo_twin.runs.divergence import Departure, Divergence, Estimates
from servo_twin.runs.recorded import Contents, RecordedRun, RunError, messages_in_order
from servo_twin.servo_config import ServoConfig, servo_table

if TYPE_CHECKING:
    from servo_twin.robot.robot_model import RobotModel

_BURSTS: Final = (topics.RECORDER, topics.RECORDING)
REPLAYED: Final = {topic.name: topic for topic in BOARD_TOPICS if topic.name not in _BURSTS}
SETTINGS: Final = TwinSettings(report_timeout=1.0, from_reset=600.0)  # no live display is delayed
_GAP: Final = 0.1  # gap of the telemetry that is reported [s]
_ESTIMATION: Final = 2.0  # time after a change within which the diagnosis may not have found it [s]
_JUMP: Final = 1.0  # jump of the clock of the recording against the ticks of the board that is reported [s]


@dataclass(frozen=True)
class WhatIf:
    """Answers *what if*: replaces what the recording says of the board."""

    plant: PlantConfig | None = None
    servo: ServoConfig | None = None  # configuration, instead of the recorded blocks
    level: Level | None = None
    seed: int | None = None
    firmware: Firmware | None = None  # another build of firmware and model, at level ideal
    robot: RobotModel | None = None  # MuJoCo model of what the shafts move


@dataclass(frozen=True)
class Model:
    """The twin's board."""

    plant: PlantConfig
    seed: int
    level: Level
    servo: ServoConfig | None  # None: compiled in
    exact: bool  # equal boards give equal numbers: the run is compared bit for bit
    keeps_configuration: bool  # recorded configuration blocks are repeated
    firmware: Firmware | None = None  # another build; None: that of this checkout
    other_build: str | None = None  # how it differs from the recorded build, for people; empty: equal; None: not known
    notes: tuple[str, ...] = ()  # why it may differ from the recorded board; for people
    robot: RobotModel | None = None  # what the shafts move; None: the load of the plant

    def board(self) -> Board:
        """A new board."""
        new = Board if self.robot is None else self.robot.board
        return new(self.plant, seed=self.seed, level=self.level, servo=self.servo, firmware=self.firmware)

    def twin(self, catalogue: Catalogue) -> Twin:
        """A twin with such a board."""
        kind = Twin if self.keeps_configuration else WithOwnConfiguration
        return kind(self.board, SETTINGS, catalogue, None if self.robot is None else self.robot.attach)


def model_of(contents: Contents, what_if: WhatIf) -> Model:
    """Model of the recorded board.

    Raises
    ------
    RunError
        If it is another board than that of the twin, or the recorded plant is damaged.
    """
    notes: list[str] = []
    info = contents.info
    virtual = None if info is None else info.virtual_board
    catalogue = Catalogue.load()
    if info is not None and info.board:
        try:
            check_board(info.board.get("hardware", DEFAULT_BOARD), catalogue.board)
        except OtherBoardError as error:
            raise RunError(f"the recorded board: {error}") from None
    if info is not None and info.catalogue and info.catalogue != f"{catalogue.hash:08X}":
        notes.append(
            f"recorded with another table of variables ({info.catalogue} instead of {catalogue.hash:08X}): "
            "another version of the firmware"
        )
    if info is not None and info.tick_ns not in (0, PERIOD_NS):
        notes.append(f"recorded with ticks of {info.tick_ns} ns instead of {PERIOD_NS} ns: another firmware")
    plant = what_if.plant or PlantConfig.load()
    if virtual is not None:
        if virtual.plant and what_if.plant is None:
            plant = _recorded_plant(virtual)
        if virtual.level != FAST_LEVEL:
            notes.append(f"recorded at level {virtual.level}: equal boards differ within noise")
        notes += [f"a fault was injected: {fault}" for fault in virtual.faults]
    exact = virtual is not None and virtual.level == FAST_LEVEL == (what_if.level or FAST_LEVEL)
    robot = what_if.robot
    if robot is None and virtual is not None and virtual.robot:
        robot, problem = _recorded_robot(virtual)
        if problem:
            notes.append(problem)
            exact = False
    seed = what_if.seed if what_if.seed is not None else virtual.seed if virtual is not None else 1
    return Model(
        plant,
        seed,
        what_if.level or FAST_LEVEL,
        what_if.servo or _recorded_configuration(contents),
        exact,
        what_if.servo is None,
        what_if.firmware,
        None if virtual is None else _other_build(virtual, what_if.firmware),
        tuple(notes),
        robot,
    )


def _recorded_plant(recorded: VirtualBoard) -> PlantConfig:
    try:
        return PlantConfig.parse(parse_toml(recorded.plant))
    except (PlantError, TextFileError) as error:
        raise RunError(f"the plant in the recording is damaged ({error}); --plant gives another") from None


def _recorded_robot(recorded: VirtualBoard) -> tuple[RobotModel | None, str]:
    """Model of what the shafts of a virtual board moved, and what is wrong with it; for people."""
    try:
        robot = load_on_line(recorded.robot)
    except (SimulationError, ValueError) as error:
        return None, f"without the robot that the shafts moved: {error}; --robot gives its model"
    if robot.sha256 != recorded.robot_sha256:
        return robot, f"the model {recorded.robot} is not the recorded one; --robot gives another"
    return robot, ""


def _other_build(recorded: VirtualBoard, firmware: Firmware | None) -> str | None:
    """How a build differs from the recorded one; empty: it does not; None: not known."""
    if not recorded.build or (firmware is not None and recorded.level != FAST_LEVEL):
        return None
    own = firmware
    for level in LEVELS:
        if firmware is None and level == recorded.level:
            own = build_of(Catalogue.load().board.name, level)
    if own is None:
        return None
    module, _, program = recorded.build.partition(ELF_MARK)
    if module != (build := own.build):
        return (
            f"recorded with another build of firmware and model ({module[:8]}, here {build[:8]}); "
            "--firmware takes the checkout of the recorded one"
        )
    elf = chosen_elf()
    if program != (here := hashlib.sha256(elf).hexdigest() if elf else ""):
        return (
            f"recorded with another program ({program[:8] or 'the compiled firmware'}, here "
            f"{here[:8] or 'the compiled firmware'}); --elf takes the ELF file of the recorded one"
        )
    return ""


def _recorded_configuration(contents: Contents) -> ServoConfig | None:
    """Configuration of the firmware with the recorded blocks; None if they are those compiled in."""
    if not contents.blocks:
        return None
    with Board(level=FAST_LEVEL) as board:
        compiled = board.read_words("config.checksum")
    if all(compiled[axis] == checksum for axis, checksum in checksums_of(contents.blocks).items()):
        return None
    compiled_in = ServoConfig.of_table(servo_table())
    blocks = tuple(tuple(contents.blocks.get(axis, block)) for axis, block in enumerate(compiled_in.blocks))
    return replace(compiled_in, blocks=blocks)


@dataclass
class Stretch:
    """Consecutive samples that were replayed."""

    first: int  # tick
    last: int  # tick
    samples: int
    exact: bool  # compared bit for bit
    end: str = ""  # why it ended; empty: at the end of the recording


@dataclass(frozen=True)
class MemberChange:
    """A member of the configuration that repeats the run with another value than the recorded one."""

    axis: int  # index
    member: Member
    recorded: int  # raw number of the replay
    found: int  # raw number that repeats the run

    def __str__(self) -> str:
        factor = f"{self.found / self.recorded:.3g} times: " if self.recorded else ""
        values = f"{self.member.shown(self.found)} instead of {self.member.shown(self.recorded)}"
        return f"{axis_name(self.axis)} {self.member.name} {factor}{values}"


@dataclass(frozen=True)
class Explained:
    """Result of the search for the cause of a difference of the controller, see `member_search`."""

    change: MemberChange | None  # None: no member of the configuration explains the difference


@dataclass
class Replayed:
    """Result of a replay."""

    stretches: list[Stretch] = field(default_factory=list)
    samples: int = 0  # in the recording, without repeated ones
    departures: list[Departure] = field(default_factory=list)  # in order
    first: int | None = None  # first tick of a difference; None: the runs are equal
    first_exact: bool = False  # the difference was found bit for bit
    before: Estimates = field(default_factory=dict)  # of the plant before `first`
    after: Estimates = field(default_factory=dict)  # and at the end
    findings: list[LocatedFinding] = field(default_factory=list)  # changes of the plant at the end
    explained: Explained | None = None  # of the controller; None: it does not differ, or this cannot be told
    other_build: str | None = None  # as `Model.other_build`
    notes: list[str] = field(default_factory=list)  # what could not be replayed, and why

    @property
    def first_axis(self) -> str:
        """Axis with the most variables that differ in the first sample; the other one follows by the bus voltage."""
        names = (one.variable.partition(".") for one in self.departures if one.tick == self.first)
        axes = Counter(axis for axis, dot, _ in names if dot)
        return axes.most_common(1)[0][0] if axes else ""

    @property
    def early_fault(self) -> Departure | None:
        """Fault of the axis that differs first, so soon that the plant could not be estimated; None: there is none."""
        name = f"{self.first_axis}.faults"
        found = next((one for one in self.departures if one.variable == name), None)
        soon = found is not None and self.first is not None and found.tick - self.first < _ESTIMATION * 1e9 / PERIOD_NS
        return found if soon and not self.findings else None

    @property
    def controller(self) -> str:
        """Axis that differs first, if the runs differ bit for bit and it is not the plant; empty: not known."""
        return "" if self.findings or not self.first_exact or self.early_fault else self.first_axis

    @property
    def compared(self) -> int:
        """Samples that were compared."""
        return sum(stretch.samples for stretch in self.stretches)

    @property
    def seconds(self) -> float:
        """Compared board time [s]."""
        return sum(stretch.last - stretch.first for stretch in self.stretches) * PERIOD_NS * 1e-9


class WithOwnConfiguration(Twin):
    """A twin that does not take the configuration of the board."""

    def set_blocks(self, blocks: Blocks) -> None:
        pass

    def add_command(self, command: AppliedCommand) -> None:
        if command.variable == TAKE:  # counts, but writes nothing
            command = AppliedCommand("cmd.enable", command.tick, (0,) * AXES, 0)
        super().add_command(command)


class Replay:
    """Replays one run.

    Parameters
    ----------
    run : RecordedRun
    model : Model
        Of the twin's board.
    calibrated : DiagnosisThresholds, optional
        Noise of a healthy pair; by default the packaged one of the level.
    watch : callable, optional
        Gets every pair, and the torque constants of the motors [N m/A].
    """

    def __init__(
        self,
        run: RecordedRun,
        model: Model,
        calibrated: DiagnosisThresholds | None = None,
        watch: Callable[[Pair, Sequence[float]], None] | None = None,
    ) -> None:
        self._run, self._model = run, model
        self._catalogue = Catalogue.load()
        self._twin = model.twin(self._catalogue)
        self._divergence = Divergence(
            model.plant,
            calibrated or DiagnosisThresholds.load(None, model.level),
            self._catalogue,
        )
        self._watch = watch
        self._result = Replayed()
        self._troubles: Counter[str] = Counter()
        self._synchronisation = 0
        self._open: Stretch | None = None
        self._ticks = array("q")  # of the newest sample of each message
        self._times = array("q")

    def run(self) -> Replayed:
        """Replay everything.

        Raises
        ------
        RunFileError, OSError
            If the recording cannot be read.
        """
        try:
            for each in messages_in_order(self._run, REPLAYED, self._troubles):
                self._take(*each)
            return self._finished()
        finally:
            self._twin.close()

    def _take(self, name: str, record: Record, message: Any) -> None:
        if name == topics.WINDING_TEMPERATURES and self._twin.from_reset:
            return  # those of the twin are exact, the recorded ones are rounded
        if name == topics.SNAPSHOT:
            self._result.samples += message.layout.dim[0].size
        try:
            REPLAYED[name].take(self._twin, message, self._catalogue)
        except ValueError as error:
            self._troubles[f"{record.topic}: {error}"] += 1
            return
        if name != topics.SNAPSHOT:
            return
        if (newest := self._twin.newest_tick) is not None:
            self._ticks.append(newest)
            self._times.append(record.time_ns)
        self._step()

    def _step(self) -> None:
        while True:
            before = self._twin.tick
            pairs = self._twin.step(1)
            if self._twin.synchronisations != self._synchronisation:
                self._synchronisation = self._twin.synchronisations
                self._end(self._twin.dropped)
                self._divergence.interrupt()
            for pair in pairs:
                self._compare(pair)
            if not pairs and self._twin.status:
                self._end(self._twin.dropped)
            if not pairs and self._twin.tick == before:
                return

    def _compare(self, pair: Pair) -> None:
        exact = self._model.exact and self._twin.from_reset
        if self._open is None:
            self._open = Stretch(pair.tick, pair.tick, 0, exact)
            self._result.stretches.append(self._open)
        self._open.last = pair.tick
        self._open.samples += 1
        if self._divergence.first is None:
            self._result.first_exact = exact
        self._divergence.add(pair, exact=exact)
        if self._watch is not None:
            self._watch(pair, self._twin.torque_constants)

    def _end(self, reason: str) -> None:
        if self._open is not None:
            self._open.end = reason
            self._open = None

    def _finished(self) -> Replayed:
        result, divergence = self._result, self._divergence
        divergence.interrupt()
        result.departures = divergence.ordered()
        result.findings = divergence.findings()
        result.first = divergence.first
        if result.first is None and result.findings:  # seen by the equations only, such as a small change of the supply
            result.first = min(one.finding.since for one in result.findings)
        result.before, result.after = divergence.before, divergence.monitor.estimates()
        result.other_build = self._model.other_build
        result.notes = [*filter(None, [self._model.other_build]), *self._run.contents.missing, *self._model.notes]
        result.notes += [
            f"{text}{f' ({count} messages)' if count > 1 else ''}" for text, count in self._troubles.items()
        ]
        result.notes += self._gaps()
        for stretch in result.stretches:
            if stretch.end:
                result.notes.append(f"{at(stretch.last)}: {stretch.end}")
        if not result.stretches and self._twin.status:
            result.notes.append(f"nothing could be replayed: {self._twin.status}")
        result.notes = list(dict.fromkeys(result.notes))  # reading and replay find the same damage
        return result

    def _gaps(self) -> list[str]:
        """Gaps of the telemetry, resets of the board, and jumps of the clock of the recording."""
        ticks, times = np.array(self._ticks, np.int64), np.array(self._times, np.int64)
        steps, clock = np.diff(ticks) * PERIOD_NS, np.diff(times)
        texts = [f"{at(int(ticks[k + 1]))}: the board was reset" for k in np.flatnonzero(steps < 0)]
        gaps = np.flatnonzero(steps > _GAP * 1e9)
        if len(gaps):
            longest = int(gaps[np.argmax(steps[gaps])])
            count = f"{len(gaps)} gaps" if len(gaps) > 1 else "a gap"
            texts.append(
                f"{count} of the telemetry above {_GAP:g} s, the longest {steps[longest] * 1e-9:.2f} s from "
                f"{at(int(ticks[longest]))}"
            )
        jumps = np.flatnonzero((np.abs(clock - steps) > _JUMP * 1e9) & (steps >= 0))
        texts += [
            f"{at(int(ticks[k + 1]))}: the clock of the recording jumps by {(clock[k] - steps[k]) * 1e-9:+.1f} s; "
            "the ticks of the board count"
            for k in jumps[:5]
        ]
        return texts


def at(tick: int) -> str:
    """A tick with its time since the reset."""
    return f"tick {tick}, {tick * PERIOD_NS * 1e-9:.3f} s"
