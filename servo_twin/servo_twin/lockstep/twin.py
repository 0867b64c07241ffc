"""Digital twin: a virtual board that executes the same commands at the same ticks as the real one.

Time is board ticks only. For each sample of the real board the twin's board is run to the corresponding tick,
``own = real + shift``; the samples of both boards at this tick form a `Pair`. Every command write is repeated with the
same raw integers, effective at the corresponding tick. Identical boards give identical numbers.

The shift is determined at the synchronisation: 0 if all commands since the reset of the board are known, otherwise at
standstill. A rotor search may take longer on one board than on the other. If the real axis has finished and the twin
has not, the twin is run ahead until it has, which changes the shift. After both rotor searches the positions differ by
a constant offset, which is added to the outputs of the twin and subtracted from its commands. After a stop the offset
is determined again, because both boards ramp down independently.

The parameters of the real board, which may have been changed at run time, are written to the twin's board at each
synchronisation. A reported write of a parameter is repeated at its tick; another change triggers a new synchronisation.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.board_parameters import RawParameters, parameter_names, parameters
from servo_msgs_py.board_port import reached
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.convert import AppliedCommand
from servo_msgs_py.recorder_setup import RecorderSetup
from servo_msgs_py.timed_points import shifted_points
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import PERIOD_NS, SLOW_PERIODS, TICK

from servo_twin.board import Board
from servo_twin.lockstep.applied_commands import AppliedCommands
from servo_twin.lockstep.axis_alignment import POINTS, AxisAlignment, ShaftPosition
from servo_twin.lockstep.blocks import (
    TAKE,
    Blocks,
    blocks_of,
    checksums_of,
    position_resolution,
    repeat_blocks,
    write_blocks,
)
from servo_twin.lockstep.bursts import Alignment, BurstAnswer, BurstSampler
from servo_twin.lockstep.replica import POLL, Replica, slow_tick
from servo_twin.lockstep.samples import PER_BOARD, Activity, Sample, SampleReader, StandstillDetector, activity
from servo_twin.plant import PlantConfig

Attach = Callable[[Board, Mapping[int, ShaftPosition]], object]
_POSITIONS: Final = ("param.position_min", "param.position_max")  # parameters with absolute positions
_FOREVER: Final = 1 << 63  # later than any tick
_SETTLE: Final = 2.0  # longest time from reset to STOP [s]


@dataclass(frozen=True)
class TwinSettings:
    """Times of the twin, all in board time [s]."""

    report_timeout: float = 0.05  # time that a sample waits for the report of a command that it counts as applied [s]
    from_reset: float = 5.0  # longest time since reset for a replay from the reset, if all commands are known [s]
    gap: float = 2.0  # gap of the telemetry that triggers a new synchronisation [s]
    rest: float = 0.1  # time of standstill before a synchronisation without a reset [s]
    search: float = 4.0  # largest difference of the durations of a rotor search [s]
    disagreement: float = 0.5  # longest time with different activities of the boards, except rotor searches [s]


class Pair(NamedTuple):
    """Both boards at the same tick."""

    tick: int  # tick of the real board
    stamp_ns: int  # ROS time of the real sample [ns]
    real: Mapping[str, float]  # the real sample, SI, by column name
    twin: Mapping[str, float]
    """Values of the twin, SI, in ticks and positions of the real board; the columns of `real` that the twin has."""
    difference: str  # reason why the boards are not comparable; empty: comparable
    stopping: tuple[bool, ...] = (False,) * AXES
    """Per axis, true during an autonomous stop: positions are not comparable; see `AxisAlignment.stopping`."""
    fault: str = ""  # axes of the real board and their faults; empty: none


class Twin:
    """Twin of one real board.

    Parameters
    ----------
    new_board : callable
        Creates a virtual board.
    settings : TwinSettings, optional
        Times.
    catalogue : Catalogue, optional
        Table of variables; the packaged one by default.
    attach : callable, optional
        Attaches a model of what the shafts move to the twin's board. Where the real shafts are, by axis; empty: both
        boards have just been reset.
    """

    def __init__(
        self,
        new_board: Callable[[], Board],
        settings: TwinSettings | None = None,
        catalogue: Catalogue | None = None,
        attach: Attach | None = None,
    ) -> None:
        self.settings = settings or TwinSettings()
        self.status = "no telemetry yet"  # reason why the twin is not synchronised; empty: synchronised
        self.fault = ""  # `Pair.fault` of the last sample, also without synchronisation
        self.synchronisations = 0  # number of synchronisations
        self.dropped = ""  # why the last synchronisation ended; empty: none has
        self.from_reset = False  # the twin's board has repeated everything since the reset of the real one
        self.torque_constants: list[float] = []  # per axis, from the firmware [N m/A]; empty: not synchronised yet
        self._catalogue = catalogue or Catalogue.load()
        self._new_board = new_board
        self._attach = attach
        self._detached = False  # the twin's present board has shafts of its own, although there is a model
        self._reader = SampleReader(self._catalogue)
        self._compared = {v.name: v.lsb for v in self._catalogue.snapshot_variables() if v.name not in PER_BOARD}
        self._commands = AppliedCommands()
        self._resolution = [1] * AXES  # position counts per count of the encoder
        self._rest = StandstillDetector(_ticks(self.settings.rest), self._resolution)
        self._own_rest = StandstillDetector(_ticks(self.settings.rest), self._resolution)
        self._queue: deque[Sample] = deque()
        self._last: Sample | None = None
        self._replica: Replica | None = None
        self._shift = 0
        self._axes = [AxisAlignment(axis, self._catalogue) for axis in range(AXES)]
        self._parameters: RawParameters | None = None
        self._cause = ""  # reason for a pending synchronisation
        self._in_force: RawParameters = {}  # parameters of the twin's board, in coordinates of the real board
        self._bursts = BurstSampler(self._catalogue, self._resolution)
        self._last_difference = ""  # `Pair.difference` of the last sample
        self._agreed_states: tuple[object, ...] | None = None  # `_states` with all aligned; None: it may not be
        self._blocks: dict[int, tuple[int, ...]] = {}  # known configuration blocks of the real board
        self._windings: Sequence[float] = ()  # winding temperatures of the real motors [deg C]; empty: unknown

    # ---- in
    @property
    def parameters_known(self) -> bool:
        """True if the parameters of the real board are known; until then the twin has the default parameters."""
        return self._parameters is not None

    def set_parameters(self, values: RawParameters) -> None:
        """Set the parameters of the real board; synchronises again if the twin's board has others."""
        self._parameters = values
        present = dict(self._in_force)
        for command in self._commands.until(_FOREVER):
            if command.variable in parameter_names():
                present[command.variable] = self._parameter(command)
        if self._replica is not None and values != present:
            changed = ", ".join(name for name in values if values[name] != present.get(name))
            self._cause = f"changed parameters of the board: {changed}"
            self.resync(self._cause)

    def set_blocks(self, blocks: Blocks) -> None:
        """Set the configuration blocks of the real board, as last read.

        Later block commands are executed at their tick. Synchronises again if the twin's board has other blocks.
        """
        self._blocks |= {axis: tuple(words) for axis, words in blocks.items()}
        for axis, words in blocks.items():
            self._resolution[axis] = position_resolution(words)
        if self._replica is not None and not self._has_blocks(self._replica):
            self._cause = "changed configuration of the board"
            self.resync(self._cause)

    def _has_blocks(self, replica: Replica) -> bool:
        """True if the twin's board has the blocks of the real one, or a waiting command sets them."""
        known = dict(enumerate(replica.read_words("config.checksum")))
        for command in self._commands.until(_FOREVER):
            if command.variable == TAKE:
                known |= checksums_of(blocks_of(command))
        return all(known[axis] == checksum for axis, checksum in checksums_of(self._blocks).items())

    def set_windings(self, temperatures: Sequence[float]) -> None:
        """Set the winding temperatures estimated by the real board, in the order of the axes [deg C].

        They replace the estimates of the twin's board at a synchronisation without reset, and whenever an axis enters
        closed-loop control: with a cold estimate the twin would not derate the current of a hot motor.
        """
        self._windings = tuple(temperatures)

    def add_command(self, command: AppliedCommand) -> None:
        """Add a command that took effect on the real board; in any order."""
        if not self._commands.add(command):
            self._remember(command)  # too late for a replay

    def set_recorder(self, setup: RecorderSetup | None) -> None:
        """Set the configuration of the recorder of the real board, before it starts; None: the recorder is idle."""
        if setup is None:
            self._bursts.idle(self.newest_tick)
            return
        self._bursts.set_up(setup)
        if self._replica is not None and self._last is not None:
            self._bursts.begin(self._replica, self._alignment(self._last))

    def add_burst(self, label: str, points: Trace) -> None:
        """Add a recording of the real board [SI].

        Raises
        ------
        ValueError
            If there are no ticks.
        """
        self._bursts.add_burst(label, points, self.tick)

    def add_samples(self, columns: Sequence[str], table: NDArray[np.float64]) -> None:
        """Add samples of the real board, a table (samples, columns), SI, in the order of their ticks.

        Raises
        ------
        ValueError
            If a required column is missing.
        """
        self._queue.extend(self._reader.rows(columns, table))

    def take_plant(self, plant: PlantConfig) -> None:
        """Change the plant of the twin's board without a new synchronisation."""
        if self._replica is not None:
            self._replica.board.take_plant(plant)

    def resync(self, reason: str) -> None:
        """Discard the twin's board and synchronise again at the next standstill of the real one."""
        self._drop(reason)
        if self._last is not None:
            self._settle(self._last)

    def discard(self, reason: str) -> None:
        """As `resync`, and discard the waiting samples."""
        if self._queue:
            self._last = self._queue[-1]
            self._queue.clear()
        self.resync(reason)

    def close(self) -> None:
        """Discard the twin's board."""
        self._drop("closed")

    # ---- out
    @property
    def newest_tick(self) -> int | None:
        """Tick of the newest received sample."""
        newest = self._queue[-1] if self._queue else self._last
        return None if newest is None else newest.tick

    @property
    def tick(self) -> int | None:
        """Tick of the last processed sample."""
        return None if self._last is None else self._last.tick

    def burst_answers(self) -> list[BurstAnswer]:
        """Recordings of the twin since the last call."""
        return self._bursts.take()

    @property
    def simulated_ticks(self) -> int:
        """Ticks of the twin's present board."""
        return 0 if self._replica is None else self._replica.tick

    def labels(self) -> list[str]:
        """State of every axis of the twin, such as ``RUN/SPIN``; empty without a synchronisation."""
        replica = self._replica
        return [] if replica is None else [replica.label(axis) for axis in range(AXES)]

    # ---- samples
    def step(self, maximum: int = 64) -> list[Pair]:
        """Process up to `maximum` waiting samples; stops at a sample that waits for its commands.

        Returns
        -------
        list of Pair
            One per sample while the twin is synchronised.
        """
        pairs: list[Pair] = []
        for _ in range(maximum):
            if not self._queue:
                break
            sample = self._queue[0]
            self._check_time(sample)
            if self._waits(sample):
                break
            self._queue.popleft()
            pair = self._take(sample)
            if pair is not None:
                pairs.append(pair)
        return pairs

    def _check_time(self, sample: Sample) -> None:
        """Detect resets of the board and gaps of the telemetry."""
        if self._last is None:
            return
        step = sample.tick - self._last.tick
        if step < 0:
            self._drop("the board was reset")
            self._commands.forget()
            self._last = None
            for axis in self._axes:
                axis.last_written.clear()
            self._blocks.clear()
            self._windings = ()
        elif step > _ticks(self.settings.gap) and self._replica is not None:
            self.resync(f"no telemetry for {step * PERIOD_NS * 1e-9:.1f} s of board time")

    def _waits(self, sample: Sample) -> bool:
        """True if the sample waits for reports of commands; after the timeout the twin synchronises again."""
        if self._replica is None:
            return False
        missing = self._missing(sample)
        if not missing:
            return False
        if self._queue[-1].tick - sample.tick <= _ticks(self.settings.report_timeout):
            return True
        self.resync(f"missing reports of {missing} applied command{'s' if missing > 1 else ''}")
        return False

    def _take(self, sample: Sample) -> Pair | None:
        if self._last is not None and sample.tick == self._last.tick:
            return None
        self._rest.add(sample.tick, sample.position)
        self.fault = self._fault(sample)
        homed = [axis_name(number) for number, axis in enumerate(self._axes) if axis.homed(self._last, sample)]
        if homed and self._replica is not None:
            self._drop(f"{' and '.join(homed)} of the board was homed")
        began = self._replica is None and self._begin(sample)
        replica = self._replica
        if replica is not None and not began:
            self._replay(replica, sample)
            replica = self._replica
        self._settle(sample)
        self._last = sample
        if replica is None:
            return None
        agreed = _states(replica, sample) == self._agreed_states
        if not agreed:
            self._align(replica, sample)
        self._own_rest.add(sample.tick, replica.position())
        if not agreed:
            self._align_at_standstill(replica, sample)
            self._last_difference = self._difference(replica, sample)
            if self._replica is None:
                return None
            if self._detached and not self._last_difference and all(map(self._rest.at_rest, range(AXES))):
                self._attach_model(replica, {axis.number: axis.shaft(sample) for axis in self._axes})
            self._note_agreement(replica, sample)
        if self._bursts.sampling:
            self._bursts.note(self._alignment(sample))
        stopping = tuple([axis.stopping for axis in self._axes])
        values = self._values(replica, sample)
        return Pair(sample.tick, sample.stamp_ns, sample.values, values, self._last_difference, stopping, self.fault)

    def _note_agreement(self, replica: Replica, sample: Sample) -> None:
        """Nothing has to be aligned before the next command or change of a state, if all is aligned now."""
        pending = self._detached or bool(self._last_difference) or any(axis.stopping for axis in self._axes)
        self._agreed_states = None if pending else _states(replica, sample)

    def _alignment(self, sample: Sample) -> Alignment:
        return Alignment(sample.tick, self._shift, tuple(axis.offset for axis in self._axes), self._last_difference)

    def _settle(self, sample: Sample) -> None:
        """Store the commands up to this sample and remove them from the queue."""
        if self._missing(sample):
            for axis in self._axes:
                axis.last_written.clear()
        for command in self._commands.until(sample.tick):
            self._remember(command)
        self._commands.settle(sample.tick, sample.applied_count)

    def _missing(self, sample: Sample) -> int:
        return self._commands.missing(sample.tick, sample.applied_tick, sample.applied_count)

    # ---- synchronisation
    def _begin(self, sample: Sample) -> bool:
        """Create and align the twin's board if this sample permits it; returns true if so."""
        if self._commands.from_reset and not self._missing(sample) and sample.tick <= _ticks(self.settings.from_reset):
            replica = self._switch_on(attached=True)
            if not self._has_blocks(replica):  # the real board has loaded its configuration from the data flash
                write_blocks(replica, self._blocks)
                self._note_torque(replica)
            for axis in self._axes:
                axis.begin_from_reset()
            self._set_parameters(replica)
            self._replay(replica, sample)
            self.from_reset = True
            return True
        for number, label in enumerate(sample.labels):
            if activity(label) is Activity.SEARCHING:
                self._wait(f"rotor search of {axis_name(number)}")
                return False
            if not self._rest.at_rest(number):
                self._wait(f"{axis_name(number)} is not at rest")
                return False
        replica = self._switch_on()
        reached(replica, lambda: set(self.labels()) == {"STOP"}, _SETTLE, POLL)
        write_blocks(replica, self._blocks)
        self._note_torque(replica)
        for number in range(AXES):
            self._set_winding_estimate(replica, number)
        active = sum(axis.begin_at(sample, replica) << number for number, axis in enumerate(self._axes))
        self._set_parameters(replica)
        for axis in self._axes:
            axis.set_home_state(replica, sample)
        replica.write("cmd.enable", [1] * AXES, active)
        self._shift = replica.tick - sample.tick
        return True

    def _switch_on(self, attached: bool = False) -> Replica:
        self._replica = replica = Replica(self._new_board())
        self._agreed_states = None
        self._detached = self._attach is not None
        if attached:
            self._attach_model(replica, {})
        self._note_torque(replica)
        self._in_force = self._parameters or {v.name: replica.read_words(v.name) for v in parameters(self._catalogue)}
        self._shift = 0
        self.synchronisations += 1
        self.status = self._cause = ""
        self._bursts.begin(replica)
        return replica

    def _attach_model(self, replica: Replica, shafts: Mapping[int, ShaftPosition]) -> None:
        """Attach the model of what the shafts move, if any; a rotor search needs a free shaft, or one at its start."""
        if self._attach is not None:
            self._detached = False
            self._attach(replica.board, shafts)

    def _note_torque(self, replica: Replica) -> None:
        constants = (replica.board.read(f"{axis_name(axis)}.torque_constant") for axis in range(AXES))
        self.torque_constants = [float(value) for value in constants if isinstance(value, (int, float))]

    def _wait(self, reason: str) -> None:
        self.status = f"waiting: {reason}" + (f"; {self._cause}" if self._cause else "")

    def _set_parameters(self, replica: Replica) -> None:
        """Write the parameters of the real board to the twin's board, with converted positions."""
        for name, raw in self._in_force.items():
            if name in _POSITIONS:
                low, high = self._catalogue[name].raw_range
                raw = [min(max(x - axis.offset, low), high) for x, axis in zip(raw, self._axes, strict=True)]
            replica.board.write_raw(name, raw)

    def _drop(self, reason: str) -> None:
        if self._replica is not None:
            self._replica.close()
            self._replica = None
            self.dropped = reason
        self.from_reset = False
        self._bursts.dropped(reason)
        self._rest.forget()
        self._own_rest.forget()
        self.status = reason

    # ---- replay
    def _replay(self, replica: Replica, sample: Sample) -> None:
        """Run to the sample and execute all commands up to it."""
        taken = False
        for command in self._commands.until(sample.tick):
            self._agreed_states = None
            replica.run_to(slow_tick(command.tick + self._shift - 1))
            if command.variable == TAKE:
                repeat_blocks(replica, command)
                taken = True
                continue
            if command.variable in parameter_names():
                self._in_force = {**self._in_force, command.variable: self._parameter(command)}
                self._set_parameters(replica)
                continue
            axes = sum(axis.repeat(replica, command) << number for number, axis in enumerate(self._axes))
            if axes:
                counts = [-axis.offset for axis in self._axes]
                replica.write_first(POINTS, shifted_points(command.raw, self._shift, counts, axes))
        replica.run_to(sample.tick + self._shift)
        if taken:
            self._note_torque(replica)
            self._check_blocks(replica)

    def _parameter(self, command: AppliedCommand) -> list[int]:
        return list(command.raw[: self._catalogue[command.variable].count])

    def _check_blocks(self, replica: Replica) -> None:
        """Synchronise again if the twin's board has refused the blocks, which it does during a motion."""
        if replica.read_words("config.refusal") != [0]:
            self._cause = "the twin's board refused the configuration because it was moving"
            self.resync(self._cause)

    def _remember(self, command: AppliedCommand) -> None:
        if command.variable == TAKE:
            self._blocks |= blocks_of(command)
            return
        if command.variable in parameter_names():
            return
        for axis in self._axes:
            axis.remember(command)

    def _align(self, replica: Replica, sample: Sample) -> None:
        """Align the axes that have entered closed-loop control on both boards."""
        for axis in self._axes:
            axis.observe(replica, sample)
        for number, axis in enumerate(self._axes):
            if axis.must_catch_up(replica, sample) and self._others_at_rest(number, sample):
                axis.catch_up(replica, self.settings.search)
                self._shift = replica.tick - sample.tick
            if axis.align(replica):
                self._set_winding_estimate(replica, number)
                self._set_parameters(replica)
                axis.restore(replica)

    def _set_winding_estimate(self, replica: Replica, number: int) -> None:
        if self._windings:
            replica.board.set_winding_estimate(number, self._windings[number])

    def _align_at_standstill(self, replica: Replica, sample: Sample) -> None:
        """Align the positions again after a stop."""
        changed = [
            axis.align_at_standstill(replica, sample)
            for number, axis in enumerate(self._axes)
            if axis.stopping and self._rest.at_rest(number) and self._own_rest.at_rest(number)
        ]
        if any(changed):
            self._set_parameters(replica)

    def _others_at_rest(self, number: int, sample: Sample) -> bool:
        return all(
            self._rest.at_rest(other)
            for other in range(AXES)
            if other != number and activity(sample.labels[other]) is Activity.ACTIVE
        )

    # ---- comparison
    def _fault(self, sample: Sample) -> str:
        """Axes of the real board in FAULT, or in a controlled stop before it, and the causes."""
        parts: list[str] = []
        for number, (label, raw) in enumerate(zip(sample.labels, sample.faults, strict=True)):
            if label == "FAULT" or raw:
                how = "is in FAULT" if label == "FAULT" else "stops for a fault"
                causes = [f"{flag.name}: {flag.cause}" for flag in self._catalogue.active("faults", raw)]
                parts.append(f"{axis_name(number)} of the board {how}" + (f" ({'; '.join(causes)})" if causes else ""))
        return "; ".join(parts)

    def _difference(self, replica: Replica, sample: Sample) -> str:
        """Reason why the boards are not comparable; after a timeout the twin synchronises again."""
        differences: list[str] = []
        for axis in self._axes:
            text, searching = axis.difference(replica, sample)
            if axis.different_since is None:
                continue
            differences.append(text)
            limit = self.settings.search if searching else self.settings.disagreement
            if sample.tick - axis.different_since > _ticks(limit):
                self.resync(text)
                break
        return "; ".join(differences)

    def _values(self, replica: Replica, sample: Sample) -> dict[str, float]:
        """Values of the twin for the columns of the sample."""
        raw, compared = replica.raw, self._compared
        found = {"tick": float(sample.tick)}
        found.update([(name, raw[name] * compared[name]) for name in sample.values if name in compared])
        for axis in self._axes:
            for name, counts in axis.in_real_coordinates(replica, sample).items():
                if name in found:
                    found[name] = counts * compared[name]
        return found


def _states(replica: Replica, sample: Sample) -> tuple[object, ...]:
    """All states of both boards on which their alignment depends."""
    return sample.labels, sample.expired, sample.home_states, replica.states()


def _ticks(seconds: float) -> int:
    """Convert board time [s] to PWM periods, rounded to slow ticks."""
    return round(seconds / TICK) * SLOW_PERIODS
