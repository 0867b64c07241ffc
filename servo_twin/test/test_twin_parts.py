"""Parts of the twin: applied commands, standstill, replica, health."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.board_port import reached
from servo_msgs_py.convert import AppliedCommand
from servo_msgs_py.joints import Joint
from servo_msgs_py.units import PERIOD_NS
from servo_twin.board import Board
from servo_twin.lockstep.applied_commands import AppliedCommands
from servo_twin.lockstep.axis_alignment import AxisAlignment
from servo_twin.lockstep.blocks import position_resolution
from servo_twin.lockstep.replica import POLL, Replica, slow_tick
from servo_twin.lockstep.residual import COMPARED, HealthMonitor, Residual, Thresholds, residual
from servo_twin.lockstep.samples import Activity, SampleReader, StandstillDetector, activity
from servo_twin.validation.experiments.plant_limits import built_in_block
from twin_rig import CATALOGUE, COLUMNS

from servo_msgs_py import topics

SECOND = round(1e9 / PERIOD_NS)
EXPIRED = sum(flag.mask for flag in CATALOGUE.flags["limits"] if flag.name in ("EXPIRED", "STARVED"))


def command(tick: int, variable: str = "cmd.position", raw: tuple[int, int] = (1, 2)) -> AppliedCommand:
    return AppliedCommand(variable, tick, raw, 3)


class TestAppliedCommands:
    def test_missing_commands_are_counted(self) -> None:
        applied_commands = AppliedCommands()
        assert applied_commands.from_reset
        assert applied_commands.missing(800, 0, 0) == 0
        assert applied_commands.missing(800, 792, 2) == 2
        applied_commands.add(command(792))
        assert applied_commands.missing(800, 792, 2) == 1
        applied_commands.add(command(400))
        assert applied_commands.missing(800, 792, 2) == 0
        assert [c.tick for c in applied_commands.until(800)] == [400, 792]
        assert [c.tick for c in applied_commands.until(791)] == [400]

    def test_writes_of_one_tick_count_once(self) -> None:
        applied_commands = AppliedCommands()
        applied_commands.add(command(80, "cmd.mode"))
        applied_commands.add(command(80, "cmd.speed"))
        assert applied_commands.missing(96, 80, 1) == 0
        assert applied_commands.missing(96, 80, 2) == 1
        assert [c.variable for c in applied_commands.until(96)] == ["cmd.mode", "cmd.speed"]

    def test_a_later_command_does_not_replace_an_earlier_one(self) -> None:
        applied_commands = AppliedCommands()
        applied_commands.add(command(160))
        assert applied_commands.missing(96, 80, 1) == 1

    def test_settling_removes_and_refuses_old_commands(self) -> None:
        applied_commands = AppliedCommands()
        assert applied_commands.add(command(80))
        assert not applied_commands.add(command(80))
        applied_commands.settle(96, 1)
        assert (applied_commands.from_reset, applied_commands.until(96)) == (False, [])
        assert not applied_commands.add(command(96))
        assert applied_commands.missing(800, 80, 1) == 0
        assert applied_commands.add(command(104))
        assert applied_commands.missing(800, 104, 2) == 0
        applied_commands.forget()
        assert applied_commands.from_reset
        assert applied_commands.add(command(8))

    def test_missing_commands_are_counted_across_the_wrap_of_the_counters(self) -> None:
        applied_commands = AppliedCommands()
        late = (1 << 32) + 80
        applied_commands.settle((1 << 32) - 160, 0xFFFF)
        applied_commands.add(command((1 << 32) - 80))
        applied_commands.add(command(late))
        assert applied_commands.missing(late + 16, 80, 1) == 0
        assert applied_commands.missing(late + 16, 80, 2) == 1

    @given(st.permutations(range(1, 8)))
    def test_the_order_of_arrival_does_not_matter(self, order: list[int]) -> None:
        applied_commands = AppliedCommands()
        for k in order:
            applied_commands.add(command(8 * k))
        assert [c.tick for c in applied_commands.until(56)] == [8, 16, 24, 32, 40, 48, 56]


class FarReplica:
    """A board whose counters have just wrapped."""

    raw: ClassVar = {"axis1.position": -(2**31) + 2, "axis1.position_ref": 2**31 - 1}


@pytest.mark.parametrize("turns_of_the_counter", [-2, 0, 1, 5])
def test_positions_of_the_twin_are_unwrapped_like_those_of_the_board(turns_of_the_counter: int) -> None:
    far = turns_of_the_counter << 32
    sample = SimpleNamespace(position=(far + 2**31 + 5, 0), labels=("STOP", "STOP"))
    alignment = AxisAlignment(0, CATALOGUE)
    alignment.begin_at(sample, FarReplica())  # type: ignore[arg-type]
    assert alignment.offset == 3
    assert alignment.in_real_coordinates(FarReplica(), sample) == {  # type: ignore[arg-type]
        "axis1.position": far + 2**31 + 5,
        "axis1.position_ref": far + 2**31 + 2,
    }


class TestSamples:
    @pytest.mark.parametrize(
        ("label", "kind"),
        [
            ("STOP", Activity.IDLE), ("FAULT", Activity.IDLE), ("INIT", Activity.IDLE),
            ("RUN/FREEWHEEL", Activity.IDLE), ("RUN/CALIB", Activity.SEARCHING), ("RUN/READY", Activity.SEARCHING),
            ("RUN/ALIGN", Activity.SEARCHING), ("RUN/SPIN", Activity.ACTIVE),
        ],
    )  # fmt: skip
    def test_activity_of_a_state_label(self, label: str, kind: Activity) -> None:
        assert activity(label) is kind

    @staticmethod
    def row(**values: float) -> NDArray[np.float64]:
        return np.array([[values.get(name.replace(".", "_"), 0.0) for name in COLUMNS]])

    def test_counts_states_and_stamps_are_read(self) -> None:
        lsb = CATALOGUE["axis1.position"].lsb
        (sample,) = SampleReader(CATALOGUE).rows(
            COLUMNS,
            self.row(
                tick=2.0**33, axis1_position=(2**40 + 3) * lsb, axis1_position_ref=5 * lsb, axis2_state=3,
                axis2_substate=2, applied_count=7, applied_tick=9, stamp_sec=1.7e9, stamp_nanosec=999_999_999,
            ),
        )  # fmt: skip
        assert sample.tick == 2**33
        assert sample.position == (2**40 + 3, 0)
        assert sample.position_ref == (5, 0)
        assert sample.labels == ("FAULT", "RUN/ALIGN")
        assert (sample.applied_tick, sample.applied_count) == (9, 7)
        assert sample.stamp_ns == 1_700_000_000_999_999_999
        assert (sample.faults, sample.expired) == ((0, 0), (False, False))

    def test_faults_and_expired_set_points_are_read(self) -> None:
        others = sum(flag.mask for flag in CATALOGUE.flags["limits"]) & ~EXPIRED
        row = self.row(axis1_faults=2.0**20, axis2_faults=5.0, axis1_limits=others, axis2_limits=EXPIRED | 1)
        (sample,) = SampleReader(CATALOGUE).rows(COLUMNS, row)
        assert sample.faults == (1 << 20, 5)
        assert sample.expired == (False, True)

    def test_missing_faults_and_limits_read_as_none(self) -> None:
        columns = [name for name in COLUMNS if not name.endswith(("faults", "limits"))]
        (sample,) = SampleReader(CATALOGUE).rows(columns, np.zeros((1, len(columns))))
        assert (sample.faults, sample.expired) == ((0, 0), (False, False))

    def test_the_position_replaces_a_missing_shaped_set_point(self) -> None:
        columns = [name for name in COLUMNS if not name.endswith("position_ref")]
        table = np.array([[float(name == "axis2.position") for name in columns]])
        (sample,) = SampleReader(CATALOGUE).rows(columns, table)
        assert sample.position_ref == sample.position == (0, 637)

    def test_standstill_requires_the_full_time(self) -> None:
        detector = StandstillDetector(100)

        def add(tick: int, counts: int) -> bool:
            detector.add(tick, (counts, 0))
            return detector.at_rest(0)

        assert [add(tick, 0) for tick in (0, 40, 80, 120)] == [False, False, False, True]
        assert add(160, 2)
        assert not add(200, 3)
        assert not add(240, 3)
        assert add(280, 3)
        assert detector.at_rest(1)
        detector.forget()
        assert not detector.at_rest(1)
        assert [add(tick, 0) for tick in (400, 450, 500)] == [False, False, True]

    def test_an_encoder_with_few_lines_rests_within_its_own_counts(self) -> None:
        resolution = [1, 1]
        detector = StandstillDetector(100, resolution)
        for tick, counts in ((0, 0), (50, 20), (100, 0)):
            detector.add(tick, (counts, counts))
        assert not detector.at_rest(0)
        table, block = AxisConfigTable.load(), built_in_block(0)
        for lines, expected in ((100, 10), (1000, 1), (16384, 1)):
            words = table.words({**block, "encoder.angle_per_count": round(2**32 / (4 * lines))})
            assert position_resolution(words) == expected
        resolution[0] = 10
        assert detector.at_rest(0)
        assert not detector.at_rest(1)

    @pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
    @pytest.mark.parametrize(
        "column", ["tick", "axis1.position", "axis2.state", "axis1.speed", "u_dc", topics.STAMP_COLUMNS[0]]
    )
    def test_a_number_that_no_board_sends_is_refused(self, column: str, value: float) -> None:
        row = self.row()
        row[0, COLUMNS.index(column)] = value
        with pytest.raises(ValueError, match="which no board sends"):
            SampleReader(CATALOGUE).rows(COLUMNS, row)

    def test_the_limits_of_every_variable_are_accepted(self) -> None:
        names = [name for name in COLUMNS if name in CATALOGUE.variables]
        for end in (min, max):
            row = np.array([[CATALOGUE[name].scale(end(CATALOGUE[name].raw_range)) for name in names]])
            assert SampleReader(CATALOGUE).rows([*names, *topics.STAMP_COLUMNS], np.hstack([row, [[1.0, 2.0]]]))


class TestReplica:
    @pytest.fixture
    def replica(self) -> Iterator[Replica]:
        replica = Replica(Board(seed=1))
        yield replica
        replica.close()

    def test_replica_runs_to_slow_ticks(self, replica: Replica) -> None:
        assert replica.raw == {}
        replica.run_to(160)
        assert (replica.tick, replica.raw["tick"]) == (160, 160)
        replica.run_to(80)
        assert replica.tick == 160
        with pytest.raises(ValueError, match="multiple of 8"):
            replica.run_to(165)
        assert [slow_tick(t) for t in (7, 8, 15, 16)] == [0, 8, 8, 16]

    def test_a_write_takes_effect_with_the_next_slow_tick(self, replica: Replica) -> None:
        replica.run_to(1600)
        replica.write("cmd.position", [5, 6], 3)
        replica.run_to(1608)
        assert (replica.raw["applied_tick"], replica.raw["applied_count"]) == (1608, 1)

    def test_unmasked_axes_are_not_written(self, replica: Replica) -> None:
        replica.write("cmd.position", [5, 6], 3)
        replica.write("cmd.position", [7, 8], 2)
        assert replica.board.read("cmd.position") == pytest.approx([5 * 0.0015707963, 8 * 0.0015707963])

    def test_an_expired_set_point_is_detected(self, replica: Replica) -> None:
        assert not replica.expired(0)
        replica.raw = {"axis1.limits": EXPIRED | 1, "axis2.limits": 1}
        assert [replica.expired(axis) for axis in range(2)] == [True, False]

    def test_an_expired_set_point_of_the_twin_alone_is_a_stop(self, replica: Replica) -> None:
        """Only the rising edge counts: a set bit does not stop the axis again after a new set-point."""
        alignment = AxisAlignment(1, CATALOGUE)
        (sample,) = SampleReader(CATALOGUE).rows(COLUMNS, TestSamples.row())
        reported = []
        for limits in (0, EXPIRED, EXPIRED, 0, EXPIRED):
            replica.raw = {"axis2.limits": limits, "axis1.limits": EXPIRED}
            alignment.observe(replica, sample)
            reported.append(alignment.stopping)
            alignment.stopping = False
        assert reported == [False, True, False, False, True]

    def test_replica_waits_in_whole_slow_ticks(self, replica: Replica) -> None:
        assert reached(replica, lambda: replica.raw.get("axis1.state") == 2, 1.0, POLL)
        assert replica.tick % 128 == 0
        tick = replica.tick
        assert not reached(replica, lambda: False, 0.08, POLL)
        assert replica.tick == tick + 1280


class TestHealth:
    @staticmethod
    def update(monitor: HealthMonitor, seconds: float, **differences: float) -> bool:
        real = dict.fromkeys(COMPARED, 1.0)
        twin = {name: 1.0 - differences.get(name.replace(".", "_"), 0.0) for name in COMPARED}
        return monitor.update(residual(round(seconds * SECOND), real, twin, [0.5, 2.0]))

    def test_residual_is_real_minus_twin(self) -> None:
        real = {name: float(k) for k, name in enumerate(COMPARED)}
        twin = dict.fromkeys(COMPARED, 0.5)
        result = residual(80, real, twin, [0.5, 2.0])
        assert result.tick == 80
        assert result.position == (-0.5, 2.5)
        assert result.velocity == (0.5, 3.5)
        assert result.effort == (0.5 * 1.5, 2.0 * 4.5)
        assert result.values["axis2.i_q"] == 4.5

    def test_twin_becomes_healthy_after_the_hold_time(self) -> None:
        monitor = HealthMonitor(Thresholds(hold=0.5))
        assert not monitor.healthy
        assert not self.update(monitor, 10.0)
        assert not self.update(monitor, 10.49)
        assert monitor.reason == "residual small for less than 0.5 s"
        assert self.update(monitor, 10.5)
        assert monitor.reason == ""

    def test_a_short_excursion_is_tolerated(self) -> None:
        monitor = HealthMonitor(Thresholds(position=0.05, hold=0.5, grace=0.1))
        for t in (0.0, 0.5):
            self.update(monitor, t)
        assert self.update(monitor, 0.6, axis1_position=-0.06)
        assert self.update(monitor, 0.69, axis1_position=-0.06)
        assert self.update(monitor, 0.695)
        assert self.update(monitor, 0.7, axis1_position=-0.06)
        assert not self.update(monitor, 0.8, axis1_position=-0.06)
        assert monitor.reason == "axis1: position differs by -0.06 rad, limit 0.05"
        assert not self.update(monitor, 0.9)
        assert self.update(monitor, 1.4)

    @pytest.mark.parametrize(
        ("difference", "reported"),
        [
            ({"axis2_position": 0.06}, "axis2: position differs by +0.06 rad"),
            ({"axis1_speed": -11.0}, "axis1: velocity differs by -11 rad/s"),
            ({"axis2_i_q": 0.04}, "axis2: effort differs by +0.08 N m"),
        ],
    )
    def test_every_quantity_can_make_the_twin_unhealthy(self, difference: dict[str, float], reported: str) -> None:
        monitor = HealthMonitor(Thresholds(0.05, 10.0, 0.05, hold=0.0, grace=0.0))
        assert self.update(monitor, 0.0)
        assert not self.update(monitor, 0.1, **difference)
        assert monitor.reason.startswith(reported)

    def test_a_geared_joint_is_compared_in_joint_units(self) -> None:
        zero = dict.fromkeys(COMPARED, 0.0)
        real = zero | {"axis1.position": 0.4, "axis1.speed": -20.0, "axis1.i_q": 0.01}
        arm = Joint("arm", 10.0, -1, 0.5)
        result = residual(80, real, zero, [0.5, 2.0], [arm, Joint("wheel")])
        assert result.position[0] == result.values["axis1.position"] == pytest.approx(-0.04)
        assert result.velocity[0] == result.values["axis1.speed"] == 2.0
        assert result.effort[0] == pytest.approx(-0.05)
        assert result.values["axis1.i_q"] == 0.01
        monitor = HealthMonitor(Thresholds(0.05, 1.0, 0.06, hold=0.0, grace=0.0))
        assert not monitor.update(result)
        assert monitor.reason == "arm: velocity differs by +2 rad/s, limit 1"

    def test_the_position_of_a_stopping_axis_is_ignored(self) -> None:
        monitor = HealthMonitor(Thresholds(0.05, 10.0, 0.05, hold=0.0, grace=0.0))
        far = dict.fromkeys(COMPARED, 0.0) | {"axis2.position": 0.1}
        difference = Residual(0, ["axis1", "axis2"], far, (0.0, 0.1), (0.0, 0.0), (0.0, 0.0))
        assert monitor.update(difference, (False, True))
        assert not monitor.update(difference, (True, False))
        assert monitor.differs
        fast = Residual(0, ["axis1", "axis2"], far, (0.0, 0.1), (0.0, 11.0), (0.0, 0.0))
        assert not monitor.update(fast, (False, True))
        assert monitor.reason.startswith("axis2: velocity")

    def test_an_interruption_restarts_the_hold_time(self) -> None:
        monitor = HealthMonitor(Thresholds(hold=0.5))
        self.update(monitor, 0.0)
        assert self.update(monitor, 0.5)
        monitor.interrupt("nothing to compare")
        assert (monitor.healthy, monitor.reason) == (False, "nothing to compare")
        assert not self.update(monitor, 0.6)
        assert not self.update(monitor, 1.0)
        assert self.update(monitor, 1.1)
