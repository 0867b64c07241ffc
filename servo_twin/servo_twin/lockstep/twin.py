"""The twin: a virtual board of its own that gets the same commands at the same ticks as the real one. Pure.

Nothing here looks at a clock. Samples of the real board come in with their ticks; the twin's board is run to the
corresponding tick of its own, ``own = real + shift``, and what both say at that tick makes a pair. On the way every
command write is repeated, with the same raw integers, so that it takes effect at the corresponding tick. Two boards
that differ in nothing give the same numbers, bit for bit.

The shift is chosen when the twin begins: 0 if everything since the reset of the board is known, otherwise when the
shafts are at rest. A rotor search may end some ticks earlier on one board than on the other. When the real axis
has found its rotor and the twin has not, the twin is run ahead until it has, which changes the shift; afterwards
positions differ by whole counts, which are added to what the twin says and taken off what it is told. They are chosen
anew after a stop, which ends on each board where its own ramp does.

The parameters of the real board, which may have been changed while it ran, are written to the twin's board whenever it
begins; when they change the twin begins anew.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.board_parameters import RawParameters, parameters
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.convert import AppliedCommand
from servo_msgs_py.recorder_setup import RecorderSetup
from servo_msgs_py.timed_points import shifted_points
from servo_msgs_py.units import PERIOD_NS, SLOW_PERIODS

from servo_twin.board import Board
from servo_twin.lockstep.axis_tie import POINTS, AxisTie
from servo_twin.lockstep.blocks import TAKE, Blocks, blocks_of, bring, checksums_of, repeat
from servo_twin.lockstep.bursts import Alignment, BurstAnswer, BurstFollower
from servo_twin.lockstep.ledger import CommandLedger
from servo_twin.lockstep.replica import Replica, slow_tick
from servo_twin.lockstep.samples import OWN, Activity, RestWatch, Sample, SampleReader, activity
from servo_twin.plant import PlantConfig

_POSITIONS: Final = ("param.position_min", "param.position_max")  # parameters that are positions of a shaft
_FOREVER: Final = 1 << 63  # later than any tick
_SETTLE: Final = 2.0  # longest time from reset to STOP [s]


@dataclass(frozen=True)
class TwinSettings:
    """Times of the twin, all in board time [s]."""

    report_timeout: float = 0.05  # longest wait for a command that a sample reports as applied, in telemetry time [s]
    from_reset: float = 5.0  # longest time since reset to follow from there on, if all commands since are known [s]
    gap: float = 2.0  # silence of the telemetry after which the twin synchronises anew [s]
    rest: float = 0.1  # time for which the shafts must be at rest before it synchronises without a reset [s]
    search: float = 4.0  # largest difference of the durations of a rotor search on the two boards [s]
    disagreement: float = 0.5  # largest time for which one board may be off and the other on otherwise [s]


@dataclass(frozen=True)
class Pair:
    """Both boards at the same tick."""

    tick: int  # of the real board
    stamp_ns: int  # ROS time of the real sample [ns]
    real: Mapping[str, float]  # the real sample, SI, by column name
    twin: Mapping[str, float]
    """Values of the twin, SI, in ticks and positions of the real board; every column of `real` that the twin has."""
    difference: str  # why the two cannot be compared, for people; empty: they can
    stopping: tuple[bool, ...] = (False,) * AXES
    """Per axis, whether it stops by itself, so that the positions are not comparable; see `AxisTie.stopping`."""
    fault: str = ""  # axes of the real board and their faults, for people; empty: none


class Twin:
    """Follows one real board.

    Parameters
    ----------
    new_board : callable
        Switches on another virtual board.
    settings : TwinSettings, optional
        Times.
    catalogue : Catalogue, optional
        Table of variables; the packaged one by default.
    """

    def __init__(
        self,
        new_board: Callable[[], Board],
        settings: TwinSettings | None = None,
        catalogue: Catalogue | None = None,
    ) -> None:
        self.settings = settings or TwinSettings()
        self.status = "no telemetry yet"  # why the twin does not follow; empty: it does
        self.fault = ""  # `Pair.fault` of the last sample, whether the twin followed or not
        self.synchronisations = 0  # how often it has begun
        self.torque_constants: list[float] = []  # of every axis in the firmware [N m/A]; empty before it has begun
        self._catalogue = catalogue or Catalogue.load()
        self._new_board = new_board
        self._reader = SampleReader(self._catalogue)
        self._ledger = CommandLedger()
        self._rest = RestWatch(_ticks(self.settings.rest))
        self._own_rest = RestWatch(_ticks(self.settings.rest))
        self._queue: deque[Sample] = deque()
        self._last: Sample | None = None
        self._replica: Replica | None = None
        self._shift = 0
        self._axes = [AxisTie(axis, self._catalogue) for axis in range(AXES)]
        self._parameters: RawParameters | None = None
        self._cause = ""  # why the twin has to begin anew, while it waits for that
        self._in_force: RawParameters = {}  # on the twin's board, as the real board has them
        self._bursts = BurstFollower(self._catalogue)
        self._apart = ""  # `Pair.difference` of the last sample
        self._blocks: dict[int, tuple[int, ...]] = {}  # configuration of the real board, as far as it is known
        self._windings: Sequence[float] = ()  # temperatures of the real motors [deg C]; empty: not known

    # ---- in
    @property
    def parameters_known(self) -> bool:
        """Whether those of the real board are known; until then the twin has those after reset."""
        return self._parameters is not None

    def parameters(self, values: RawParameters) -> None:
        """Take the parameters of the real board; begins anew when the twin's board has others."""
        self._parameters = values
        if self._replica is not None and values != self._in_force:
            changed = ", ".join(name for name in values if values[name] != self._in_force.get(name))
            self._cause = f"the board has another {changed}"
            self.resync(self._cause)

    def blocks(self, blocks: Blocks) -> None:
        """Take the configuration blocks of the real board, as they were last read.

        Those that come as a command afterwards are taken at their tick. Begins anew when the twin's board has others.
        """
        self._blocks |= {axis: tuple(words) for axis, words in blocks.items()}
        if self._replica is not None and not self._will_have_blocks(self._replica):
            self._cause = "the board has another configuration"
            self.resync(self._cause)

    def _will_have_blocks(self, replica: Replica) -> bool:
        """Whether the twin's board has the blocks of the real one, or gets them by a command that waits."""
        known = dict(enumerate(replica.read_words("config.checksum")))
        for command in self._ledger.until(_FOREVER):
            if command.variable == TAKE:
                known |= checksums_of(blocks_of(command))
        return all(known[axis] == checksum for axis, checksum in checksums_of(self._blocks).items())

    def windings(self, temperatures: Sequence[float]) -> None:
        """Take the temperatures of the windings that the real board estimates, in the order of the axes [deg C].

        The twin's board has its own estimates. It takes these over where it begins in the middle, and again with every
        axis that comes under control: a cold twin of a hot motor would not hold its current back.
        """
        self._windings = tuple(temperatures)

    def command(self, command: AppliedCommand) -> None:
        """Take a write that took effect on the real board; the order of arrival does not matter."""
        if not self._ledger.add(command):
            self._remember(command)  # too late to be replayed, but not to be known

    def recorder(self, setup: RecorderSetup | None) -> None:
        """Take what the recorder of the real board is about to record; None when it is idle."""
        if setup is None:
            self._bursts.idle(self.newest_tick)
            return
        self._bursts.set_up(setup)
        if self._replica is not None and self._last is not None:
            self._bursts.begin(self._replica, self._alignment(self._last))

    def burst(self, label: str, columns: Sequence[str], table: NDArray[np.float64]) -> None:
        """Take what the recorder of the real board has recorded, as it was published: a table (points, columns), SI.

        Raises
        ------
        ValueError
            If it has no ticks.
        """
        self._bursts.burst(label, columns, table, self.tick)

    def samples(self, columns: Sequence[str], table: NDArray[np.float64]) -> None:
        """Take samples of the real board, a table (samples, columns), SI, in the order of their ticks.

        Raises
        ------
        ValueError
            If a column is missing that the twin needs.
        """
        self._queue.extend(self._reader.rows(columns, table))

    def take_plant(self, plant: PlantConfig) -> None:
        """Have the present board be on another plant from here on, and go on following."""
        if self._replica is not None:
            self._replica.board.take_plant(plant)

    def resync(self, reason: str) -> None:
        """Throw the twin's board away and begin anew as soon as the real one is at rest."""
        self._drop(reason)
        if self._last is not None:
            self._settle(self._last)

    def discard(self, reason: str) -> None:
        """As `resync`, and do not look at the samples that wait."""
        if self._queue:
            self._last = self._queue[-1]
            self._queue.clear()
        self.resync(reason)

    def close(self) -> None:
        """Throw the twin's board away."""
        self._drop("closed")

    # ---- out
    @property
    def newest_tick(self) -> int | None:
        """Tick of the newest sample that has come."""
        newest = self._queue[-1] if self._queue else self._last
        return None if newest is None else newest.tick

    @property
    def tick(self) -> int | None:
        """Tick of the last sample that was dealt with."""
        return None if self._last is None else self._last.tick

    def burst_answers(self) -> list[BurstAnswer]:
        """What the twin has of the bursts since the call before."""
        return self._bursts.take()

    @property
    def simulated_ticks(self) -> int:
        """Ticks that the twin's present board has run."""
        return 0 if self._replica is None else self._replica.tick

    def labels(self) -> list[str]:
        """State of every axis of the twin, such as ``RUN/SPIN``; empty while there is none."""
        replica = self._replica
        return [] if replica is None else [replica.label(axis) for axis in range(AXES)]

    # ---- following
    def step(self, maximum: int = 64) -> list[Pair]:
        """Deal with waiting samples, at most so many; fewer when one waits for its commands.

        Returns
        -------
        list of Pair
            One per sample while the twin follows.
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
        """Notice resets of the board and gaps of its telemetry."""
        if self._last is None:
            return
        step = sample.tick - self._last.tick
        if step < 0:
            self._drop("the board was reset")
            self._ledger.forget()
            self._last = None
            for axis in self._axes:
                axis.memory.clear()
            self._blocks.clear()
            self._windings = ()
        elif step > _ticks(self.settings.gap) and self._replica is not None:
            self.resync(f"no telemetry for {step * PERIOD_NS * 1e-9:.1f} s of board time")

    def _waits(self, sample: Sample) -> bool:
        """Whether the sample has to wait for commands; gives up when they are too late."""
        if self._replica is None:
            return False
        missing = self._missing(sample)
        if not missing:
            return False
        if self._queue[-1].tick - sample.tick <= _ticks(self.settings.report_timeout):
            return True
        self.resync(f"{missing} command{'s' if missing > 1 else ''} took effect without a report")
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
        for axis in self._axes:
            axis.observe(replica, sample)
        self._align(replica, sample)
        self._take_over_rest(replica, sample)
        difference = self._difference(replica, sample)
        if self._replica is None:
            return None
        self._apart = difference
        if self._bursts.sampling:
            self._bursts.note(self._alignment(sample))
        stopping = tuple(axis.stopping for axis in self._axes)
        values = self._values(replica, sample)
        return Pair(sample.tick, sample.stamp_ns, sample.values, values, difference, stopping, self.fault)

    def _alignment(self, sample: Sample) -> Alignment:
        return Alignment(sample.tick, self._shift, tuple(axis.offset for axis in self._axes), self._apart)

    def _settle(self, sample: Sample) -> None:
        """Everything that took effect up to this sample is dealt with."""
        if self._missing(sample):
            for axis in self._axes:
                axis.memory.clear()
        for command in self._ledger.until(sample.tick):
            self._remember(command)
        self._ledger.settle(sample.tick, sample.applied_count)

    def _missing(self, sample: Sample) -> int:
        return self._ledger.missing(sample.tick, sample.applied_tick, sample.applied_count)

    # ---- beginning
    def _begin(self, sample: Sample) -> bool:
        """Switch the twin's board on if this sample allows it; returns whether it does."""
        if self._ledger.from_reset and not self._missing(sample) and sample.tick <= _ticks(self.settings.from_reset):
            replica = self._switch_on()
            if not self._will_have_blocks(replica):  # the real board has come up with what its data flash keeps
                bring(replica, self._blocks)
                self._note_torque(replica)
            for axis in self._axes:
                axis.begin()
            self._set_parameters(replica)
            self._replay(replica, sample)
            return True
        for number, label in enumerate(sample.labels):
            if activity(label) is Activity.SEARCHING:
                self._wait(f"{axis_name(number)} is searching its rotor")
                return False
            if not self._rest.at_rest(number):
                self._wait(f"{axis_name(number)} is not at rest")
                return False
        replica = self._switch_on()
        replica.run_until(lambda: set(self.labels()) == {"STOP"}, _ticks(_SETTLE))
        bring(replica, self._blocks)
        self._note_torque(replica)
        for number in range(AXES):
            self._warm(replica, number)
        active = sum(axis.begin(sample, replica) << number for number, axis in enumerate(self._axes))
        self._set_parameters(replica)
        for axis in self._axes:
            axis.take_over_home(replica, sample)
        replica.write("cmd.enable", [1] * AXES, active)
        self._shift = replica.tick - sample.tick
        return True

    def _switch_on(self) -> Replica:
        self._replica = replica = Replica(self._new_board())
        self._note_torque(replica)
        self._in_force = self._parameters or {v.name: replica.read_words(v.name) for v in parameters(self._catalogue)}
        self._shift = 0
        self.synchronisations += 1
        self.status = self._cause = ""
        self._bursts.begin(replica)
        return replica

    def _note_torque(self, replica: Replica) -> None:
        constants = (replica.board.read(f"{axis_name(axis)}.torque_constant") for axis in range(AXES))
        self.torque_constants = [float(value) for value in constants if isinstance(value, (int, float))]

    def _wait(self, reason: str) -> None:
        self.status = f"waiting: {reason}" + (f"; {self._cause}" if self._cause else "")

    def _set_parameters(self, replica: Replica) -> None:
        """Give the twin's board the parameters of the real one; its positions count from elsewhere."""
        for name, raw in self._in_force.items():
            if name in _POSITIONS:
                low, high = self._catalogue[name].raw_range
                raw = [min(max(x - axis.offset, low), high) for x, axis in zip(raw, self._axes, strict=True)]
            replica.board.write_raw(name, raw)

    def _drop(self, reason: str) -> None:
        if self._replica is not None:
            self._replica.close()
            self._replica = None
        self._bursts.dropped(reason)
        self._rest.forget()
        self._own_rest.forget()
        self.status = reason

    # ---- replaying
    def _replay(self, replica: Replica, sample: Sample) -> None:
        """Run to the sample, with every command on the way."""
        taken = False
        for command in self._ledger.until(sample.tick):
            replica.run_to(slow_tick(command.tick + self._shift - 1))
            if command.variable == TAKE:
                repeat(replica, command)
                taken = True
                continue
            axes = sum(axis.repeat(replica, command) << number for number, axis in enumerate(self._axes))
            if axes:
                counts = [-axis.offset for axis in self._axes]
                replica.write_first(POINTS, shifted_points(command.raw, self._shift, counts, axes))
        replica.run_to(sample.tick + self._shift)
        if taken:
            self._note_torque(replica)
            self._check_blocks(replica)

    def _check_blocks(self, replica: Replica) -> None:
        """Begin anew where the twin's board has not taken the blocks: it may move while the real one rests."""
        if replica.read_words("config.refusal") != [0]:
            self._cause = "the twin's board did not take another configuration while it moved"
            self.resync(self._cause)

    def _remember(self, command: AppliedCommand) -> None:
        if command.variable == TAKE:
            self._blocks |= blocks_of(command)
            return
        for axis in self._axes:
            axis.remember(command)

    def _align(self, replica: Replica, sample: Sample) -> None:
        """Tie the axes together that have come under control on both boards."""
        for number, axis in enumerate(self._axes):
            if axis.wants_to_catch_up(replica, sample) and self._others_rest(number, sample):
                axis.catch_up(replica, _ticks(self.settings.search))
                self._shift = replica.tick - sample.tick
            if axis.align(replica):
                self._warm(replica, number)
                self._set_parameters(replica)
                axis.restore(replica)

    def _warm(self, replica: Replica, number: int) -> None:
        if self._windings:
            replica.board.set_winding_estimate(number, self._windings[number])

    def _take_over_rest(self, replica: Replica, sample: Sample) -> None:
        """After a stop, let the twin's axes be where the real ones came to rest."""
        own = tuple(replica.raw[f"{axis_name(number)}.position"] for number in range(AXES))
        self._own_rest.add(sample.tick, own)
        changed = [
            axis.take_over_rest(replica, sample)
            for number, axis in enumerate(self._axes)
            if axis.stopping and self._rest.at_rest(number) and self._own_rest.at_rest(number)
        ]
        if any(changed):
            self._set_parameters(replica)

    def _others_rest(self, number: int, sample: Sample) -> bool:
        return all(
            self._rest.at_rest(other)
            for other in range(AXES)
            if other != number and activity(sample.labels[other]) is Activity.ACTIVE
        )

    # ---- comparing
    def _fault(self, sample: Sample) -> str:
        """Which axes of the real board are in FAULT, or on their way there by a controlled stop, and why."""
        parts: list[str] = []
        for number, (label, raw) in enumerate(zip(sample.labels, sample.faults, strict=True)):
            if label == "FAULT" or raw:
                how = "is in FAULT" if label == "FAULT" else "stops for a fault"
                causes = [f"{flag.name}: {flag.cause}" for flag in self._catalogue.active("faults", raw)]
                parts.append(f"{axis_name(number)} of the board {how}" + (f" ({'; '.join(causes)})" if causes else ""))
        return "; ".join(parts)

    def _difference(self, replica: Replica, sample: Sample) -> str:
        """What keeps the boards from being compared; begins anew when that lasts too long."""
        differences: list[str] = []
        for axis in self._axes:
            text, searching = axis.difference(replica, sample)
            if axis.apart_since is None:
                continue
            differences.append(text)
            limit = self.settings.search if searching else self.settings.disagreement
            if sample.tick - axis.apart_since > _ticks(limit):
                self.resync(text)
                break
        return "; ".join(differences)

    def _values(self, replica: Replica, sample: Sample) -> dict[str, float]:
        """The twin's values under the columns of the sample."""
        raw = dict(replica.raw)
        for axis in self._axes:
            raw.update(axis.in_real_frame(replica, sample))
        values = {"tick": float(sample.tick)}
        for name in sample.values:
            if name in raw and name not in OWN:
                values[name] = raw[name] * self._catalogue[name].lsb
        return values


def _ticks(seconds: float) -> int:
    """Board time [s] in PWM periods, a multiple of a slow tick."""
    return round(seconds * 1e9 / (PERIOD_NS * SLOW_PERIODS)) * SLOW_PERIODS
