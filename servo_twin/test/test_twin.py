"""The twin with a virtual board in place of the real one: same commands at the same ticks in all situations."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.axis_config_transfer import read_block
from servo_msgs_py.board_parameters import parameters
from servo_msgs_py.catalogue import AXES
from servo_msgs_py.timed_points import TimedPoint
from servo_msgs_py.units import PERIOD_NS
from servo_twin.board import Board
from servo_twin.fault_injection import HotPowerStage, SlippedEncoder
from servo_twin.lockstep.replica import Replica
from servo_twin.lockstep.twin import Pair, Twin, TwinSettings
from servo_twin.plant import PlantConfig
from twin_rig import CATALOGUE, COLUMNS, EPOCH_NS, TwinRig, apart, worst, worst_counts

from servo_msgs_py import topics

COUNT = CATALOGUE["axis1.position"].lsb
STARVED = CATALOGUE.flag("limits", "STARVED").mask
CLOSE = 12.0  # differences by sensor noise in a move or a quick stop [counts]


@pytest.fixture
def rig() -> Iterator[TwinRig]:
    with TwinRig() as rig:
        yield rig


def follows(rig: TwinRig, pairs: list[Pair]) -> None:
    """Check that the twin followed the board in all of these pairs."""
    assert rig.twin.status == ""
    assert pairs
    assert apart(pairs) == []
    assert worst_counts(pairs) <= CLOSE
    assert worst(pairs, "axis1.speed") < 5.0
    assert worst(pairs, "axis2.speed") < 5.0


class TestExactness:
    def test_equal_boards_agree_bit_for_bit(self) -> None:
        with TwinRig(real_seed=7, twin_seed=7) as rig:
            rig.enable_axes()
            rig.move([3.0, -2.0])
            rig.write("cmd.mode", [1, 1])
            rig.write("cmd.speed", [100.0, -80.0])
            rig.run(0.3)
            rig.write("cmd.quick_stop", [1, 1])
            rig.run(0.3)
            rig.write("cmd.enable", [0, 0])
            rig.run(0.3)
            rig.write("cmd.enable", [1, 1])
            rig.until("RUN/SPIN")
            assert rig.twin.synchronisations == 1
            assert max(pair.real["axis1.position"] for pair in rig.pairs) > 15.0
            for pair in rig.pairs:
                for name, value in pair.twin.items():
                    assert value == pair.real[name], (pair.tick, name)

    def test_every_sample_gives_a_pair_at_its_tick(self, rig: TwinRig) -> None:
        pairs = rig.run(0.3)
        assert [pair.tick for pair in pairs] == [rig.every * k for k in range(1, len(pairs) + 1)]
        assert len(pairs) == 50
        for pair in pairs:
            assert pair.twin["tick"] == pair.real["tick"] == pair.tick
            assert pair.stamp_ns == EPOCH_NS + pair.tick * PERIOD_NS
        own = {"applied_tick", "applied_count", *topics.STAMP_COLUMNS}
        assert set(pairs[0].twin) == set(COLUMNS) - own

    def test_another_plant_causes_a_residual(self) -> None:
        heavy = PlantConfig.load().with_axis(0, friction=8e-3)
        with TwinRig(plant=heavy) as rig:
            rig.enable_axes()
            pairs = rig.move([5.0, -5.0], seconds=0.25)
            mean = {name: np.mean([p.real[name] - p.twin[name] for p in pairs]) for name in ("axis1.i_q", "axis2.i_q")}
            extra = 6e-3 / PlantConfig.load().axes[0].torque_constant
            assert mean["axis1.i_q"] == pytest.approx(extra, rel=0.3)
            assert abs(mean["axis2.i_q"]) < 0.2 * extra


def follow_sines(rig: TwinRig, count: int = 60) -> list[Pair]:
    """Let both axes of the real board follow a sine of 1 rad, 10 ms from point to point."""
    rig.write("cmd.mode", [3, 3])
    rig.run(0.1)
    before = len(rig.pairs)
    begin = rig.real.tick + 320
    start = [rig.real.raw[f"axis{axis + 1}.position_ref"] * COUNT for axis in range(AXES)]

    def point(axis: int, k: int) -> TimedPoint:
        t, rate = 0.01 * k, 2.0 * math.pi / 0.6
        distance, speed = 1.0 - math.cos(rate * t), rate * math.sin(rate * t)
        sign = 1 - 2 * axis
        return TimedPoint(axis, begin + 160 * k, start[axis] + sign * distance, sign * speed)

    for k in range(0, count, 2):
        rig.write_points([point(axis, m) for m in range(k, min(k + 2, count)) for axis in range(AXES)])
        rig.run(0.018)
    rig.run(0.3)
    return rig.pairs[before:]


class TestTrajectories:
    def test_timed_points_are_replayed_to_the_tick(self) -> None:
        with TwinRig(real_seed=7, twin_seed=7) as rig:
            rig.enable_axes()
            pairs = follow_sines(rig, 61)
            assert max(pair.real["axis1.position"] for pair in pairs) > 1.9
            assert rig.real.raw["axis1.points_taken"] == 61
            assert worst_counts(rig.pairs) == 0.0
            assert worst(rig.pairs, "axis2.i_q") == 0.0

    def test_both_stop_when_no_point_follows(self, rig: TwinRig) -> None:
        rig.enable_axes()
        follow_sines(rig, 20)
        pairs = rig.run(0.5)
        assert rig.real.raw["axis1.limits"] == rig.real.raw["axis2.limits"] == STARVED
        follows(rig, pairs)
        assert pairs[-1].real["axis1.speed_ref"] == 0.0


LITTLE = "param.following_error=0.02,0.02"
FEATURES = "SPEED_FORWARD+ACCELERATION_FORWARD+BUS_COMPENSATION+DEAD_TIME+ANTI_WINDUP+ENHANCED_MT"
OTHER_LIMITS = ("param.speed_limit=60,90", "param.i_q_limit=2.0,2.5", "param.acceleration_limit=500,600")


class TestParameters:
    def test_twin_takes_parameters_of_the_board(self, rig: TwinRig) -> None:
        rig.set_parameters(f"param.features={FEATURES},{FEATURES}", *OTHER_LIMITS)
        rig.enable_axes()
        assert rig.twin.parameters_known
        follows(rig, rig.move([5.0, -5.0]))
        assert max(pair.real["axis1.speed"] for pair in rig.pairs) < 70.0

    def test_default_parameters_cause_no_synchronisation(self, rig: TwinRig) -> None:
        rig.enable_axes()
        rig.set_parameters()
        assert rig.twin.status == ""
        follows(rig, rig.move([1.0, -1.0]))
        assert rig.twin.synchronisations == 1

    def test_a_reported_write_of_parameters_in_motion_keeps_the_boards_equal(self) -> None:
        with TwinRig(real_seed=7, twin_seed=7) as rig:
            rig.enable_axes()
            rig.move([20.0, -20.0], 0.2)
            rig.write_parameters("param.speed_limit=80,90", "param.i_q_limit=1.0,1.5", "param.host_timeout=2.0")
            rig.move([0.0, 5.0], 1.0)
            assert rig.twin.synchronisations == 1
            assert rig.twin.status == ""
            assert max(abs(pair.real["axis2.speed"]) for pair in rig.pairs[-60:]) < 100.0
            for pair in rig.pairs:
                for name, value in pair.twin.items():
                    assert value == pair.real[name], (pair.tick, name)

    def test_changed_parameters_resynchronise_at_rest(self, rig: TwinRig) -> None:
        rig.enable_axes()
        rig.move([20.0, -20.0], 0.2)
        rig.set_parameters("param.speed_limit[1]=50", f"param.features[0]={FEATURES}")
        changed = "changed parameters of the board: param.speed_limit, param.features"
        assert rig.twin.status == changed
        rig.run(0.05)
        assert rig.twin.status == f"waiting: axis1 is not at rest; {changed}"
        rig.run(3.0)
        assert rig.twin.synchronisations == 2
        rig.run(0.2)
        follows(rig, rig.move([15.0, -18.0], 0.5))

    def test_soft_limits_stop_both_at_the_same_position(self) -> None:
        """The rotor angle of the twin differs, so its positions have another zero."""
        with TwinRig(plant=PlantConfig.load().with_axis(0, theta_start=1.0)) as rig:
            rig.enable_axes()
            rig.move([2.0, 3.0], 0.8)
            rig.twin.resync("to be in the middle")
            rig.run(0.5)
            both = "POSITION_LIMITS+ANTI_WINDUP+ENHANCED_MT+BUS_COMPENSATION+DEAD_TIME"
            rig.set_parameters(
                f"param.features={both},{both}", "param.position_max=18.9,20", "param.position_min=-3,-4"
            )
            rig.run(0.5)
            follows(rig, rig.move([5.0, 5.0], 1.0))
            ends = [rig.pairs[-1].real[f"axis{n}.position"] for n in (1, 2)]
            assert ends == pytest.approx([18.9, 20.0], abs=3 * COUNT)
            follows(rig, rig.move([-5.0, -5.0], 1.5))
            ends = [rig.pairs[-1].real[f"axis{n}.position"] for n in (1, 2)]
            assert ends == pytest.approx([-3.0, -4.0], abs=3 * COUNT)


class TestConfiguration:
    @staticmethod
    def other_gains(rig: TwinRig, axis: int) -> dict[str, int]:
        """Changed gains of an axis."""
        block = read_block(rig.real, axis)
        scale = {
            "speed.kp": 0.8,
            "speed.ki": 0.7,
            "position_gain": 1.2,
            "current_loop.q.kp": 0.8,
            "path_omega_n_ts": 0.7,
        }
        return block | {path: round(block[path] * factor) for path, factor in scale.items()}

    def test_gains_that_change_in_motion_change_at_the_same_tick(self) -> None:
        with TwinRig(real_seed=7, twin_seed=7) as rig:
            rig.enable_axes()
            rig.move([40.0, -40.0], 0.2)
            rig.tune({axis: self.other_gains(rig, axis) for axis in range(2)})
            rig.run(0.1)
            rig.write("cmd.mode", [1, 1])
            rig.write("cmd.speed", [100.0, -80.0])
            rig.run(0.3)
            rig.tune({1: self.other_gains(rig, 1)})
            rig.run(0.3)
            assert rig.board.read_words("config.answers") == [2]
            assert rig.twin.synchronisations == 1
            for pair in rig.pairs:
                for name, value in pair.twin.items():
                    assert value == pair.real[name], (pair.tick, name)

    def test_motor_data_at_rest_and_a_twin_that_begins_later(self) -> None:
        with TwinRig(real_seed=7, twin_seed=7) as rig:
            rig.run(0.1)
            rig.tune({0: self.other_gains(rig, 0) | {"torque_constant": 1200, "stop_ticks_max": 900}})
            rig.enable_axes()
            assert rig.twin.torque_constants[0] == pytest.approx(1200 / 2**15)
            rig.twin.resync("for a test")
            rig.run(0.3)
            follows(rig, rig.move([5.0, -5.0]))
            assert rig.twin.torque_constants[0] == pytest.approx(1200 / 2**15)

    def test_configuration_reported_by_the_bridge_is_adopted(self) -> None:
        with TwinRig() as rig:
            rig.listening = False
            rig.run(0.1)
            block = self.other_gains(rig, 1)
            rig.tune({1: block})
            rig.run(0.1)
            rig.listening = True
            rig.run(0.3)
            rig.twin.set_blocks({0: tuple(AxisConfigTable.load().words(read_block(rig.real, 0)))})
            assert rig.twin.labels(), "the board of the twin already has this configuration"
            rig.twin.set_blocks({1: tuple(AxisConfigTable.load().words(block))})
            assert rig.twin.status == "changed configuration of the board"
            rig.enable_axes()
            began = rig.twin.synchronisations
            follows(rig, rig.move([5.0, -5.0]))
            rig.twin.set_blocks({1: tuple(AxisConfigTable.load().words(block))})
            assert rig.twin.synchronisations == began

    @pytest.mark.parametrize("told_after", [0.0, 0.4])
    def test_board_with_stored_values_is_followed(self, told_after: float) -> None:
        """The bridge reads blocks and parameters at every connection, some time after the first samples."""
        with TwinRig() as rig:
            rig.run(0.1)
            rig.tune({axis: self.other_gains(rig, axis) for axis in range(AXES)})
            rig.set_parameters("param.i_q_limit=1.0,1.5", "param.speed_limit=90,80")
            rig.run(0.1)
            blocks = {axis: tuple(AxisConfigTable.load().words(read_block(rig.real, axis))) for axis in range(AXES)}
            assert rig.real.write_words("storage.request", [CATALOGUE.bits["storage_request"]["SAVE"], 1])
            rig.run(0.2)
            assert rig.board.read("storage.saves") == 1
            rig.reset_board(seed=7)
            assert rig.board.read("storage.source") == 1
            assert rig.board.read("param.speed_limit") == pytest.approx([90.0, 80.0])
            rig.sample()
            rig.run(told_after)
            rig.twin.set_parameters({v.name: rig.board.read_words(v.name) for v in parameters(CATALOGUE)})
            rig.twin.set_blocks(blocks)
            rig.enable_axes()
            moving = rig.move([40.0, -40.0])
            follows(rig, moving)
            for pair in moving:
                for name in ("axis1.position_ref", "axis2.position_ref"):
                    assert pair.twin[name] == pair.real[name], "the same gains and limits shape the set-points"


class TestRotorSearch:
    @pytest.mark.parametrize("start", [0.0, 1.0, 2.0, 3.0])
    def test_rotor_search_of_another_length_is_compensated(self, start: float) -> None:
        with TwinRig(plant=PlantConfig.load().with_axis(0, theta_start=start)) as rig:
            rig.run(0.1)
            rig.write("cmd.enable", [1, 1])
            rig.until("RUN/SPIN")
            searching = apart(rig.pairs)
            assert any("axis1 is RUN/ALIGN" in text for text in searching)
            rig.run(0.02)  # the sample in which the last search ends precedes the compensation by the twin
            follows(rig, rig.run(0.1))
            follows(rig, rig.move([2.0, -2.0]))
            assert rig.twin.synchronisations == 1

    def test_one_axis_after_the_other(self, rig: TwinRig) -> None:
        rig.run(0.1)
        rig.write("cmd.enable", [1, 0], mask=1)
        rig.until("RUN/SPIN", axes=[0])
        follows(rig, rig.move([2.0, 0.0], mask=1))
        rig.write("cmd.enable", [0, 1], mask=2)
        rig.until("RUN/SPIN")
        rig.run(0.1)
        follows(rig, rig.move([0.0, 1.0]))

    def test_commands_before_the_twin_is_ready_are_repeated(self) -> None:
        # The real rotor is at an angle with a short search; axis 1 is never at rest, so the twin must not be run ahead.
        quick = PlantConfig.load().with_axis(1, theta_start=0.2)
        lengths = []
        with TwinRig(plant=quick) as rig:
            rig.run(0.1)
            rig.write("cmd.enable", [1, 0], mask=1)
            rig.until("RUN/SPIN", axes=[0])
            rig.write("cmd.mode", [1, 0], mask=1)
            rig.write("cmd.speed", [100.0, 0.0], mask=1)
            rig.run(0.3)
            rig.write("cmd.enable", [0, 1], mask=2)
            rig.until("RUN/SPIN")
            lengths.append(rig.twin.labels()[1])
            rig.move([0.0, 3.0], 0.02, mask=2)
            rig.run(1.0)
            assert lengths == ["RUN/ALIGN"]
            pairs = rig.run(0.2)
            follows(rig, pairs)
            assert pairs[-1].twin["axis2.position"] == pytest.approx(6 * math.pi, abs=CLOSE * COUNT)
            assert rig.twin.synchronisations == 1


class TestLateStart:
    def test_twin_started_later_with_a_board_at_rest_follows(self, rig: TwinRig) -> None:
        rig.listening = False
        rig.enable_axes()
        rig.move([5.0, -3.0])
        rig.listening = True
        rig.run(0.2)
        follows(rig, rig.run(0.1))
        follows(rig, rig.move([-2.0, 1.0]))

    def test_twin_started_long_after_the_reset_follows_a_disabled_board(self, rig: TwinRig) -> None:
        rig.listening = False
        rig.run(6.0)
        rig.listening = True
        rig.run(0.2)
        assert rig.twin.simulated_ticks < rig.real.tick
        rig.enable_axes()
        follows(rig, rig.move([2.0, 2.0]))

    def test_twin_waits_until_the_shafts_are_at_rest(self, rig: TwinRig) -> None:
        rig.listening = False
        rig.set_parameters("param.command_timeout=0")
        rig.enable_axes()
        rig.write("cmd.mode", [1, 1])
        rig.write("cmd.speed", [0.0, 50.0])
        rig.run(0.3)
        rig.listening = True
        assert rig.run(0.5) == []
        assert rig.twin.status == "waiting: axis2 is not at rest"
        rig.write("cmd.speed", [0.0, 0.0])
        rig.run(0.5)
        follows(rig, rig.run(0.1))

    @pytest.mark.parametrize(("variable", "value"), [("cmd.speed", 60.0), ("cmd.i_q", 0.3)])
    def test_a_mode_not_reported_is_taken_from_the_set_point(self, rig: TwinRig, variable: str, value: float) -> None:
        rig.listening = False
        rig.enable_axes()
        rig.write("cmd.mode", [1, 1] if variable == "cmd.speed" else [2, 2])
        rig.run(0.1)
        rig.listening = True
        rig.run(0.2)
        rig.write(variable, [value, -value])
        pairs = rig.run(0.15)
        assert pairs[-1].real["axis1.speed"] > 20.0
        assert pairs[-1].twin["axis1.speed"] == pytest.approx(pairs[-1].real["axis1.speed"], rel=0.1)

    def test_a_quick_stop_is_remembered(self, rig: TwinRig) -> None:
        rig.enable_axes()
        rig.write("cmd.quick_stop", [1, 1])
        rig.run(0.2)
        rig.twin.resync("asked")
        rig.run(0.2)
        pairs = rig.move([2.0, 2.0])  # ignored by a board that has been stopped
        assert abs(pairs[-1].real["axis1.position"]) < 5 * COUNT
        follows(rig, pairs)
        rig.write("cmd.enable", [1, 1])
        rig.run(0.02)
        follows(rig, rig.move([2.0, 2.0]))


class TestReports:
    def test_samples_wait_for_late_reports(self) -> None:
        with TwinRig(real_seed=5, twin_seed=5) as rig:
            rig.enable_axes()
            rig.held_reports = []
            rig.write("cmd.position", [6.0, -6.0])
            pairs = rig.run(0.04)
            assert pairs == []
            for command in rig.held_reports:
                rig.twin.add_command(command)
            rig.held_reports = None
            pairs = rig.run(0.3)
            assert len(pairs) > 50
            assert worst_counts(pairs) == 0.0
            assert rig.twin.synchronisations == 1

    def test_reordered_and_repeated_reports_are_accepted(self) -> None:
        with TwinRig(real_seed=5, twin_seed=5) as rig:
            rig.enable_axes()
            rig.held_reports = []
            rig.write("cmd.mode", [1, 1])
            rig.sample()
            rig.write("cmd.speed", [50.0, 50.0])
            rig.sample()
            rig.write("cmd.speed", [80.0, 20.0])
            rig.sample()
            assert [command.variable for command in rig.held_reports] == ["cmd.mode", "cmd.speed", "cmd.speed"]
            for command in [*reversed(rig.held_reports), rig.held_reports[0]]:
                rig.twin.add_command(command)
            rig.held_reports = None
            pairs = rig.run(0.3)
            assert worst_counts(pairs) == 0.0
            assert pairs[-1].twin["axis1.speed"] == pytest.approx(80.0, abs=2.0)
            assert rig.twin.synchronisations == 1

    def test_a_command_not_reported_causes_a_resynchronisation(self, rig: TwinRig) -> None:
        rig.enable_axes()
        rig.reporting = False
        rig.write("cmd.position", [6.0, -6.0])
        rig.run(0.2)
        assert rig.twin.status.startswith("waiting: axis1 is not at rest")
        rig.reporting = True
        rig.run(0.6)
        assert rig.twin.synchronisations == 2
        follows(rig, rig.move([0.0, 0.0]))

    def test_missing_columns_are_reported(self) -> None:
        with TwinRig(settings=TwinSettings(rest=10.0)) as rig:
            rig.enable_axes()
            rig.reporting = False
            rig.write("cmd.mode", [0, 0])
            reported = []
            for _ in range(20):
                rig.sample()
                reported.append(rig.twin.status)
            assert "" in reported
            assert rig.twin.synchronisations == 1
            assert reported[-1].startswith("waiting: ")

    def test_table_without_required_columns_is_refused(self, rig: TwinRig) -> None:
        columns = [name for name in COLUMNS if name not in ("applied_count", "axis2.i_q")]
        with pytest.raises(ValueError, match=r"no applied_count, axis2\.i_q"):
            rig.twin.add_samples(columns, np.zeros((1, len(columns))))


class TestTrouble:
    def test_a_reset_of_the_board(self, rig: TwinRig) -> None:
        rig.enable_axes()
        rig.move([1.0, 1.0])
        rig.reset_board(seed=9)
        rig.run(0.1)
        assert rig.twin.synchronisations == 2
        rig.enable_axes()
        follows(rig, rig.move([2.0, -1.0]))
        assert rig.twin.synchronisations == 2

    def test_a_gap_in_the_telemetry(self, rig: TwinRig) -> None:
        rig.enable_axes()
        rig.listening = False
        rig.move([1.0, 1.0], seconds=2.5)
        rig.listening = True
        rig.run(0.05)
        assert rig.twin.status.startswith("waiting: ")
        rig.run(0.2)
        assert rig.twin.synchronisations == 2
        follows(rig, rig.move([0.0, 0.0]))

    def test_short_gap_causes_no_synchronisation(self, rig: TwinRig) -> None:
        rig.enable_axes()
        rig.listening = False
        rig.run(1.0)
        rig.listening = True
        follows(rig, rig.move([1.0, 1.0]))
        assert rig.twin.synchronisations == 1

    def test_requested_synchronisation(self, rig: TwinRig) -> None:
        rig.enable_axes()
        rig.twin.resync("asked")
        assert rig.twin.status == "asked"
        assert rig.twin.labels() == []
        rig.run(0.3)
        assert rig.twin.synchronisations == 2
        follows(rig, rig.move([1.0, -1.0]))


KEEP_ALIVE = [bytes.fromhex("2B 30 01 04 E8"), bytes.fromhex("2B 31 00 EC")]
"""FreeMASTER: application command 4 (keep-alive), and the request of its result."""


def causes(pairs: list[Pair]) -> list[str]:
    """Fault texts of the pairs, each once, in order."""
    return list(dict.fromkeys(pair.fault for pair in pairs))


def cause(name: str) -> str:
    return f"{name}: {CATALOGUE.flag('faults', name).cause}"


def both(text: str) -> str:
    return f"axis1 of the board {text}; axis2 of the board {text}"


class TestFaults:
    """Faults of the real board, independent of the twin."""

    SPEED = 60.0

    def turning(self, rig: TwinRig) -> None:
        rig.set_parameters("param.command_timeout=0")
        rig.enable_axes()
        rig.write("cmd.mode", [1, 1])
        rig.write("cmd.speed", [self.SPEED, -self.SPEED])
        rig.run(0.2)

    def test_fault_of_the_board_alone_is_reported_until_it_is_cleared(self, rig: TwinRig) -> None:
        rig.set_parameters("param.features[0]=ANTI_WINDUP+ENHANCED_MT+BUS_COMPENSATION+DEAD_TIME+ANGLE_CHECK")
        self.turning(rig)
        rig.board.inject(SlippedEncoder(0, 667))
        rig.until("FAULT", axes=[0])
        named = f"axis1 of the board is in FAULT ({cause('ANGLE_MISMATCH')})"
        assert rig.twin.fault == named
        rig.write("cmd.quick_stop", [1, 1])
        before = len(rig.pairs)
        rig.run(4.0)
        assert causes(rig.pairs[before:]) == [named]
        assert rig.twin.synchronisations == 2
        assert rig.twin.labels() == ["STOP", "RUN/SPIN"]
        rig.write("cmd.clear_faults", [1, 0], 1)
        rig.sample()
        assert rig.pairs[-1].fault == ""
        rig.enable_axes()
        assert rig.twin.synchronisations == 2
        follows(rig, rig.move([1.0, 1.0]))

    def test_fault_of_both_is_reported_for_the_board(self, rig: TwinRig) -> None:
        rig.set_parameters("param.features=FOLLOWING_ERROR+ANTI_WINDUP,FOLLOWING_ERROR+ANTI_WINDUP", LITTLE)
        rig.enable_axes()
        rig.move([5.0, -5.0], 1.0)
        assert rig.label(0) == rig.label(1) == "FAULT"
        assert rig.twin.labels() == ["FAULT", "FAULT"]
        pairs = rig.run(1.0)
        assert causes(pairs) == [both(f"is in FAULT ({cause('FOLLOWING_ERROR')})")]
        assert apart(pairs) == []
        assert rig.twin.synchronisations == 1
        rig.write("cmd.clear_faults", [1, 1])
        rig.run(0.1)
        assert rig.twin.fault == ""
        assert rig.twin.labels() == ["STOP", "STOP"]
        assert rig.twin.synchronisations == 1

    def test_fault_from_before_the_start_of_the_twin(self, rig: TwinRig) -> None:
        rig.listening = False
        rig.enable_axes()
        rig.board.set_supply(5.0)
        rig.write("cmd.position", [30.0, -30.0])
        rig.until("FAULT")
        rig.run(6.0)
        rig.board.set_supply(24.0)
        rig.listening = True
        rig.sample()
        named = both(f"is in FAULT ({cause('UNDER_VOLTAGE')})")
        assert (rig.pairs, rig.twin.fault) == ([], named), "reported before the twin follows"
        pairs = rig.run(2.0)
        assert causes(pairs) == [named]
        assert rig.twin.synchronisations == 1

    def test_host_time_out_of_the_board(self, rig: TwinRig) -> None:
        """The board stops first, then enters FAULT; the board of the twin does not supervise a host."""
        self.turning(rig)
        for request in KEEP_ALIVE:
            rig.board.serial_in(request)
            rig.run(0.02)
        rig.until("FAULT")
        silent = cause("HOST_SILENT")
        reported = causes(rig.pairs)
        assert reported[0] == ""
        assert reported[1] == both(f"stops for a fault ({silent})")
        pairs = rig.run(3.0)
        assert causes(pairs) == [both(f"is in FAULT ({silent})")]
        assert rig.twin.synchronisations == 2
        rig.write("cmd.clear_faults", [1, 1])
        rig.run(0.1)
        assert (rig.twin.fault, rig.twin.status) == ("", "")

    def test_an_enable_refused_by_the_board_does_not_start_the_twin(self, rig: TwinRig) -> None:
        rig.enable_axes()
        rig.board.set_supply(5.0)
        rig.write("cmd.position", [30.0, -30.0])
        rig.until("FAULT")
        rig.board.set_supply(24.0)
        rig.run(2.0)
        assert rig.twin.synchronisations == 2
        for _ in range(10):
            rig.write("cmd.enable", [1, 1])
            assert apart(rig.run(0.5)) == []
        assert rig.twin.synchronisations == 2
        rig.write("cmd.clear_faults", [1, 1])
        rig.run(0.02)
        rig.enable_axes()
        follows(rig, rig.move([1.0, 1.0]))
        assert rig.twin.synchronisations == 2

    def test_fault_of_the_twin_alone_is_not_agreement(self, rig: TwinRig) -> None:
        boards: list[Board] = []

        def new_board() -> Board:
            boards.append(Board(seed=2))
            return boards[-1]

        rig.twin = Twin(new_board)
        rig.run(0.2)
        boards[0].inject(HotPowerStage(1, 200.0))
        pairs = rig.run(0.3)
        assert apart(pairs) == ["axis2 is STOP, its twin FAULT"]
        assert causes(pairs) == [""]
        rig.run(1.0)
        assert rig.twin.synchronisations == len(boards) == 2
        assert rig.twin.labels() == ["STOP", "STOP"]


class TestExpiry:
    """A board that stops because its set-point expired, simulated by the flag in its samples."""

    def test_expired_set_point_stops_the_twin_like_the_board(self, rig: TwinRig) -> None:
        bit = CATALOGUE.flag("limits", "EXPIRED").mask
        expired = False
        original = rig.twin.add_samples

        def with_flag(columns: list[str], table: NDArray[np.float64]) -> None:
            table[:, columns.index("axis2.limits")] = float(bit if expired else 0)
            original(columns, table)

        rig.twin.add_samples = with_flag  # type: ignore[method-assign, assignment]
        rig.enable_axes()
        rig.write("cmd.mode", [1, 1])
        rig.write("cmd.speed", [40.0, 40.0])
        assert {pair.stopping for pair in rig.run(0.2)} == {(False, False)}
        expired = True
        assert {pair.stopping for pair in rig.run(0.2)} == {(False, True)}
        rig.write("cmd.speed", [50.0, 50.0])
        assert {pair.stopping for pair in rig.run(0.1)} == {(False, False)}, "the bit is not new"
        expired = False
        rig.run(0.05)
        rig.write("cmd.speed", [0.0, 0.0])
        rig.run(0.02)
        expired = True
        assert rig.run(0.02)[-1].stopping == (False, True)
        assert rig.run(0.3)[-1].stopping == (False, False), "the rest position is adopted"


class TestLongUp:
    def test_ticks_beyond_32_bits(self) -> None:
        with TwinRig(tick_base=1 << 32) as rig:
            rig.run(0.3)
            rig.enable_axes()
            pairs = rig.move([3.0, -3.0])
            follows(rig, pairs)
            assert pairs[-1].tick > 1 << 32

    def test_positions_that_have_wrapped(self, rig: TwinRig) -> None:
        """Positions of the host exceed 32 bits, those of the board wrap; commands are positions of the board."""
        rig.listening = False
        rig.enable_axes()
        rig.listening = True
        frame = (1 << 32) * COUNT
        original = rig.twin.add_samples

        def shifted(columns: list[str], table: NDArray[np.float64]) -> None:
            for name in ("axis1.position", "axis1.position_ref"):
                table[:, columns.index(name)] += frame
            original(columns, table)

        rig.twin.add_samples = shifted  # type: ignore[method-assign, assignment]
        rig.run(0.2)
        pairs = rig.move([2.0, 2.0])
        assert apart(pairs) == []
        assert pairs[-1].twin["axis1.position"] == pytest.approx(frame + 4 * math.pi, abs=CLOSE * COUNT)


def test_torque_constants_are_kept_after_a_new_board(rig: TwinRig) -> None:
    assert rig.twin.torque_constants == []
    rig.run(0.1)
    expected = [axis.torque_constant for axis in PlantConfig.load().axes]
    assert rig.twin.torque_constants == pytest.approx(expected, rel=1e-3)
    rig.twin.resync("asked")
    assert len(rig.twin.torque_constants) == 2


def test_failed_rotor_search_of_the_twin_is_reported() -> None:
    stuck = PlantConfig.load()
    stuck = stuck.with_axis(0, friction=10.0)
    boards: list[Board] = []

    def new_board() -> Board:
        boards.append(Board(stuck, seed=2))
        return boards[-1]

    with TwinRig() as rig:
        rig.twin = Twin(new_board)
        rig.enable_axes()
        pairs = rig.run(1.0)
        assert apart(pairs) == ["axis1 is RUN/SPIN, its twin FAULT"]
        # The twin retries after each time-out of the agreement, not at every sample.
        assert 2 <= len(boards) <= 4
        assert rig.twin.simulated_ticks * PERIOD_NS * 1e-9 < 2.0


def test_commands_during_a_gap_are_unknown(rig: TwinRig) -> None:
    rig.enable_axes()
    rig.listening = False
    rig.write("cmd.mode", [1, 1])
    rig.run(2.5)
    rig.listening = True
    rig.run(0.3)
    assert rig.twin.synchronisations == 2
    rig.write("cmd.speed", [50.0, 50.0])
    pairs = rig.run(0.3)
    assert pairs[-1].twin["axis1.speed"] == pytest.approx(50.0, abs=2.0)


def test_discarded_commands_are_remembered(rig: TwinRig) -> None:
    rig.enable_axes()
    step = rig.twin.step
    rig.twin.step = lambda maximum=64: []  # type: ignore[method-assign]
    rig.write("cmd.mode", [1, 1])
    rig.run(0.3)
    rig.twin.step = step  # type: ignore[method-assign]
    rig.twin.discard("too much")
    rig.run(0.3)
    rig.write("cmd.speed", [50.0, 50.0])
    pairs = rig.run(0.3)
    assert pairs[-1].twin["axis1.speed"] == pytest.approx(50.0, abs=2.0)


def test_report_too_late_for_replay_is_remembered(rig: TwinRig) -> None:
    rig.listening = False
    rig.enable_axes()
    rig.held_reports = []
    rig.write("cmd.mode", [1, 1])
    rig.run(0.1)
    rig.listening = True
    rig.run(0.2)
    for command in rig.held_reports:
        rig.twin.add_command(command)
    rig.held_reports = None
    rig.write("cmd.i_q", [0.5, 0.5])  # would show the mode if it were unknown; ignored in speed mode
    pairs = rig.run(0.2)
    assert pairs
    assert abs(pairs[-1].real["axis1.speed"]) < 1.0
    assert abs(pairs[-1].twin["axis1.speed"]) < 1.0


@pytest.mark.parametrize("variable", ["cmd.quick_stop", "cmd.enable"])
def test_positions_agree_after_a_stop(variable: str) -> None:
    """Each ramps down from its measured speed; with the larger inertia the measured speeds differ."""
    plant = PlantConfig.load()
    for n, axis in enumerate(plant.axes):
        plant = plant.with_axis(n, inertia=1.4 * axis.inertia)
    with TwinRig(plant=plant) as rig:
        rig.enable_axes()
        rig.move([0.0, 0.0], 0.3)
        rig.move([10.0, -10.0], 0.2)
        rig.write(variable, [float(variable == "cmd.quick_stop")] * 2)
        pairs = rig.run(0.15)
        assert worst_counts(pairs) > 2 * CLOSE
        assert all(pair.stopping == (True, True) for pair in pairs)
        for _ in range(20):  # a stop takes longer if the shaft dithers
            pairs = rig.run(0.05)
            if pairs[-1].stopping == (False, False):
                break
        pairs = rig.run(0.2)
        assert all(pair.stopping == (False, False) for pair in pairs)
        follows(rig, pairs)
        rig.write("cmd.enable", [1, 1])
        rig.until("RUN/SPIN")
        rig.run(0.1)
        follows(rig, rig.move([0.0, 0.0], 1.0))
        assert rig.twin.synchronisations == 1


def test_enabling_forgets_a_quick_stop(rig: TwinRig) -> None:
    rig.enable_axes()
    rig.write("cmd.quick_stop", [1, 1])
    rig.run(0.1)
    rig.write("cmd.enable", [1, 1])
    rig.run(0.1)
    rig.twin.resync("asked")
    rig.run(0.3)
    follows(rig, rig.move([2.0, 2.0]))


def test_standstill_is_evaluated_again_after_a_reset() -> None:
    with TwinRig(settings=TwinSettings(from_reset=0.0)) as rig:
        rig.run(1.0)
        assert rig.twin.synchronisations == 1
        rig.reset_board()
        rig.run(0.06)
        assert rig.twin.status == "waiting: axis1 is not at rest"
        rig.run(0.2)
        assert rig.twin.synchronisations == 2
        follows(rig, rig.run(0.1))


def test_gap_does_not_count_as_standstill(rig: TwinRig) -> None:
    rig.enable_axes()
    rig.write("cmd.mode", [1, 1])
    rig.write("cmd.speed", [0.05, 0.05])  # so slow that two distant samples could have the same position
    rig.listening = False
    rig.run(2.5)
    rig.listening = True
    rig.run(0.03)
    assert rig.twin.status == "waiting: axis1 is not at rest"


# ---- temperature of the windings


def celsius(replica: Replica, axis: int) -> float:
    return replica.raw[f"axis{axis + 1}.winding_temperature"] * CATALOGUE["axis1.winding_temperature"].lsb


def test_twin_started_later_has_the_temperature_of_the_board(rig: TwinRig) -> None:
    """A twin with a cold winding would not derate its current where the board does."""
    rig.listening = False
    rig.set_parameters("param.features[0]=ANTI_WINDUP+ENHANCED_MT+DEAD_TIME+WINDING_MODEL", report=False)
    rig.enable_axes()
    rig.board.set_winding(0, 126.0)
    rig.board.set_winding(1, 70.0)
    rig.run(0.1)
    rig.listening = True
    rig.twin.set_windings([celsius(rig.real, axis) for axis in range(AXES)])
    rig.set_parameters()
    rig.run(1.5)
    assert rig.twin.status == ""
    replica = rig.twin._replica
    assert replica is not None
    for axis in range(AXES):
        assert celsius(replica, axis) == pytest.approx(celsius(rig.real, axis), abs=1.5), (
            "the rotor search heats the winding"
        )
    rig.write("cmd.mode", [2, 2])
    rig.write("cmd.i_q", [4.0, 1.0])
    pairs = rig.run(0.05)
    real, twin = (max(getattr(pair, side)["axis1.i_q_ref"] for pair in pairs) for side in ("real", "twin"))
    assert real == pytest.approx(2.3, abs=0.1)
    assert twin == pytest.approx(real, abs=0.1)


def test_twin_resets_with_the_board(rig: TwinRig) -> None:
    rig.run(0.2)
    rig.twin.set_windings([30.0, 30.0])
    rig.reset_board()
    rig.enable_axes()
    replica = rig.twin._replica
    assert replica is not None
    assert celsius(replica, 0) == pytest.approx(celsius(rig.real, 0), abs=1.0)
