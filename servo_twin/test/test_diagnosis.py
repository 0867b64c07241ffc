"""The diagnosis on virtual pairs, without ROS: what it names, what it does not, and what it learns from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pytest
from numpy.typing import NDArray
from servo_twin.diagnosis.channel import Channel, Finding, Kind
from servo_twin.diagnosis.hypotheses import Unknowns
from servo_twin.diagnosis.monitor import BURSTS, PLANT_VALUES, DiagnosisMonitor
from servo_twin.diagnosis.pair import BoardPair, Motion
from servo_twin.diagnosis.report import NOTHING_CHANGED, finding_text, located_text
from servo_twin.diagnosis.signal_watch import WATCHED, SignalWatch
from servo_twin.diagnosis.signals import CHANGES, NEEDED, BusSignal
from servo_twin.diagnosis.thresholds import Thresholds, ThresholdsError
from servo_twin.diagnosis.trials import NOTHING, Change, HealthyRuns, Trials
from servo_twin.diagnosis.window import BLOCK, Rows
from servo_twin.fault_injection import SlippedEncoder
from servo_twin.lockstep.twin import Pair
from servo_twin.plant import PlantConfig

from servo_twin import cli

PLANT = PlantConfig.load()
LEARNED = Thresholds.load(level="ideal")


def trials(*changes: Change, loss: float = 0.0, seconds: float = 10.0) -> Trials:
    return Trials(PLANT, LEARNED, changes, 5, seconds, loss, "ideal")


# ---- one change ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PLANT_VALUES)
@pytest.mark.parametrize("factor", [0.85, 1.15])
def test_each_change_gets_its_name_and_size(name: str, factor: float) -> None:
    size = 0.02 * (factor - 1.0) if name == "load" else factor
    answer = trials(Change(name, size)).run(0)
    assert (answer.said, answer.false_alarms) == (answer.truth, ())
    assert answer.covered
    assert answer.delay is not None
    assert answer.delay < 10.0


@pytest.mark.parametrize("name", ["friction", "resistance", "inertia", "load"])
def test_large_changes_are_single_ones_too(name: str) -> None:
    size = {"friction": 4.0, "resistance": 2.0, "inertia": 3.0, "load": 0.03}[name]
    answer = trials(Change(name, size)).run(1)
    assert answer.said == answer.truth
    assert answer.value == pytest.approx(size if name == "load" else size - 1.0, rel=0.15)


def test_missing_samples_cost_time_only() -> None:
    answer = trials(Change("inertia", 1.15), loss=0.3).run(2)
    assert (answer.said, answer.false_alarms) == (answer.truth, ())
    assert answer.covered


def test_nothing_is_said_of_a_healthy_pair() -> None:
    answer = trials(seconds=60.0).run(3)
    assert (answer.said, answer.false_alarms) == (NOTHING, ())


# ---- more than one, and none that is known --------------------------------------------------------------------------


def watched(*changes: tuple[str, float], slip: SlippedEncoder | None = None, seconds: float = 10.0) -> DiagnosisMonitor:
    """A monitor after changes in the middle of a motion."""
    monitor = DiagnosisMonitor(PLANT, LEARNED)
    with BoardPair(PLANT, PLANT, seed=11, level="ideal") as pair:
        pair.enable()
        motion = Motion(pair, 11)
        for one in motion.run(3.0):
            monitor.update(one)
        assert not monitor.findings()
        for name, value in changes:
            pair.board.set_plant(name, value)
        if slip is not None:
            pair.board.inject(slip)
        for one in motion.run(seconds):
            monitor.update(one)
    return monitor


def test_two_changes_of_one_axis_are_several() -> None:
    monitor = watched(("axis1.inertia", 1.2e-5), ("axis1.friction", 5e-3))
    (found,) = monitor.findings()
    assert (found.axis, found.finding.kind) == (0, Kind.SEVERAL)
    assert set(found.finding.changes) == {"friction", "inertia"}


def test_the_twin_takes_over_all_of_several_changes() -> None:
    plant = watched(("axis1.inertia", 1.2e-5), ("axis1.friction", 5e-3)).adapted(1 << 40)
    assert plant is not None
    assert plant.axes[0].inertia == pytest.approx(1.2e-5, rel=0.05)
    assert plant.axes[0].friction == pytest.approx(5e-3, rel=0.1)
    assert plant.axes[1] == PLANT.axes[1]


def test_a_slipped_encoder_is_an_angle() -> None:
    (found,) = watched(slip=SlippedEncoder(1, 100)).findings()
    assert (found.axis, found.finding.changes) == (1, ("encoder_angle",))
    assert abs(found.finding.value) == pytest.approx(np.deg2rad(18.0), rel=0.1)


def rows(samples: Sequence[tuple[float, NDArray[np.float64]]]) -> Rows:
    """One equation of weight 1 per sample."""
    y = np.array([[left] for left, _ in samples])
    return Rows(y, np.array([phi for _, phi in samples]), np.ones_like(y), np.ones_like(y))


def test_what_no_equation_has_is_unknown() -> None:
    """Noise three times as large as that of a healthy pair."""
    unknowns = Unknowns(("one", "two"), np.array([0.01, 0.01]), np.ones(2), (1, 1))
    channel = Channel(unknowns, 10.0, np.array([2.0]), np.empty(0), rows)
    draw = np.random.default_rng(1)
    said: list[Kind | None] = []
    for tick in range(0, 400_000, 136):
        phi = draw.normal(size=(1, 2))
        if channel.add(tick, 0.0085, (draw.normal() * 3.0, phi)):
            said.append(channel.finding.kind if channel.finding else None)
    assert set(said) == {None, Kind.UNKNOWN}
    assert said.count(Kind.UNKNOWN) > len(said) // 2


BLOCK_SAMPLES = 12
WHITE = np.random.default_rng(3).normal(size=100 * BLOCK_SAMPLES)


Simple = Channel[tuple[float, NDArray[np.float64]]]


def named(channel: Simple, left: NDArray[np.float64], change: int = 0) -> int | None:
    """Block in which a channel first names something, when one unknown alone moves, with these left sides."""
    phi = np.zeros((1, 2))
    phi[0, change] = 1.0
    for number, y in enumerate(left):
        channel.add(136 * number, 1.001 * BLOCK / BLOCK_SAMPLES, (float(y), phi))
        if channel.finding is not None:
            return number // BLOCK_SAMPLES
    return None


def two(*names: str) -> Simple:
    unknowns = Unknowns(names, np.array([0.01, 0.01]), np.ones(2), [BURSTS[CHANGES.index(name)] for name in names])
    return Channel(unknowns, 10.0, np.array([9.0]), np.empty(0), rows)


@pytest.mark.parametrize("name", CHANGES)
def test_a_transient_is_no_change_but_what_lasts_longer_is(name: str) -> None:
    """The blocks of a transient, `BURSTS`, are no evidence however strong they are."""
    blocks, begin = BURSTS[CHANGES.index(name)], 40 * BLOCK_SAMPLES
    names = ("flux", name) if name != "flux" else ("flux", "friction")
    change = names.index(name)
    short, longer = 0.1 * WHITE, 0.1 * WHITE
    short[begin : begin + blocks * BLOCK_SAMPLES] += 2.0
    longer[begin : begin + (blocks + 1) * BLOCK_SAMPLES] += 2.0
    assert named(two(*names), short, change) is None
    assert named(two(*names), longer, change) == 40 + blocks


@pytest.mark.parametrize("before", [0.0, 20.0])
def test_a_slip_and_an_unknown_cause_have_to_last(before: float) -> None:
    """Also after an outlier, which is a sign of a change for as long as the window holds it."""
    begin, second = 40 * BLOCK_SAMPLES, 10 * BLOCK_SAMPLES
    short, slip, noise = WHITE.copy(), WHITE.copy(), WHITE.copy()
    for left in (short, slip, noise):
        left[begin - second] += before
    short[begin : begin + second // 2] += 1.5
    slip[begin:] += 1.5
    noise[begin:] *= 6.0
    assert named(two("flux", "encoder_angle"), short, 1) is None
    assert named(two("flux", "friction"), short) is not None
    block = named(two("flux", "encoder_angle"), slip, 1)
    assert block is not None
    assert block >= 40 + 5
    channel = two("flux", "friction")
    block = named(channel, noise)
    assert block is not None
    assert block >= 40 + 19
    assert channel.finding is not None
    assert channel.finding.kind is Kind.UNKNOWN


class Buses:
    """Bus voltages of both boards, sample by sample."""

    STILL: Final = dict.fromkeys((f"axis{axis}.{name}" for axis in (1, 2) for name in NEEDED), 0.0)
    BRAKING: Final = STILL | {"axis1.i_q": -2.0, "axis1.u_q": 10.0}  # 30 W
    ACCELERATING: Final = STILL | {"axis1.i_q": 3.0, "axis1.u_q": 10.0}  # 45 W

    def __init__(self) -> None:
        self.signal = BusSignal(PLANT.bus)
        self.tick = 0

    def run(
        self, seconds: float, volts: tuple[float, float], real: dict[str, float], twin: dict[str, float]
    ) -> float | None:
        last = None
        for _ in range(round(seconds / 0.0085)):
            self.tick += 136
            last = self.signal.update(self.tick, real | {"u_dc": volts[0]}, twin | {"u_dc": volts[1]})
        return last


@pytest.mark.parametrize("braking", [(True, False), (False, True), (True, True)])
def test_a_bus_that_a_motor_has_lifted_does_not_show_its_supply(braking: tuple[bool, bool]) -> None:
    """0.5 J of either board, or of both: at standstill one board may use it faster than the other."""
    buses = Buses()
    assert buses.run(0.1, (24.0, 24.0), buses.STILL, buses.STILL) == 0.0
    assert buses.run(0.017, (24.0, 24.0), *(buses.BRAKING if one else buses.STILL for one in braking)) is None
    assert buses.run(2.0, (25.2, 24.0), buses.STILL, buses.STILL) is None
    assert buses.run(0.017, (25.2, 24.0), buses.ACCELERATING, buses.ACCELERATING) == pytest.approx(0.05)


def test_the_supply_is_judged_after_all_returned_energy_is_used() -> None:
    """A lift from 24 to 33 V is 1.21 J of 4.7 mF: 0.027 s at 45 W."""
    buses = Buses()
    buses.run(0.1, (24.0, 24.0), buses.STILL, buses.STILL)
    buses.run(1.2 / 30.0, (33.0, 33.0), buses.BRAKING, buses.BRAKING)
    assert buses.run(0.95 * 1.2 / 45.0, (26.0, 24.0), buses.ACCELERATING, buses.ACCELERATING) is None
    assert buses.run(0.3 * 1.2 / 45.0, (24.0, 24.0), buses.ACCELERATING, buses.ACCELERATING) == 0.0


def test_after_an_interruption_a_bus_above_its_supply_may_be_lifted() -> None:
    """As after another plant: what the motors have returned before is not known."""
    buses = Buses()
    for volts, shown in (((24.05, 24.0), 0.05 / 24.0), ((23.0, 24.0), -1.0 / 24.0), ((25.0, 24.0), None)):
        buses.signal.interrupt()
        found = buses.run(0.1, volts, buses.STILL, buses.STILL)
        assert found == (shown if shown is None else pytest.approx(shown))


def test_what_the_motion_does_not_tell_apart_is_said_to_be_one_of_two() -> None:
    """Friction and load are the same while the shaft turns one way only."""
    unknowns = Unknowns(("friction", "load"), np.array([0.01, 0.01]), np.ones(2), (1, 1))
    channel = Channel(unknowns, 10.0, np.array([5.0]), np.empty(0), rows)
    draw = np.random.default_rng(2)
    for tick in range(0, 1_000_000, 136):
        channel.add(tick, 0.0085, (draw.normal() + 1.0, np.ones((1, 2))))
    assert channel.finding is not None
    assert (channel.finding.kind, set(channel.finding.changes)) == (Kind.ONE_OF, {"friction", "load"})


# ---- afterwards ------------------------------------------------------------------------------------------------------


def test_what_has_gone_is_not_said_any_more_and_estimates_stay_at_rest() -> None:
    monitor = DiagnosisMonitor(PLANT, LEARNED)
    with BoardPair(PLANT, PLANT, seed=15, level="ideal") as pair:
        pair.enable()
        motion = Motion(pair, 15)
        for one in motion.run(2.0):
            monitor.update(one)
        pair.board.set_plant("axis2.friction", 2.0 * PLANT.axes[1].friction)
        for one in motion.run(6.0):
            monitor.update(one)
        assert [found.finding.changes for found in monitor.findings()] == [("friction",)]
        pair.write("cmd.mode", [1.0, 1.0])
        pair.write("cmd.speed", [0.0, 0.0])
        for _ in range(100):
            for one in pair.sample():
                monitor.update(one)
        before = monitor.estimates()
        for _ in range(600):
            for one in pair.sample():
                monitor.update(one)
        at_rest = monitor.estimates()
        del before["supply"], at_rest["supply"]
        assert at_rest == before
        pair.board.set_plant("axis2.friction", PLANT.axes[1].friction)
        for one in motion.run(15.0):
            monitor.update(one)
        assert not monitor.findings()


def residuals(pairs: list[Pair], name: str) -> float:
    return float(np.sqrt(np.mean([(one.real[name] - one.twin[name]) ** 2 for one in pairs])))


def test_the_residual_after_adapting_is_that_of_an_unchanged_pair() -> None:
    monitor = DiagnosisMonitor(PLANT, LEARNED)
    with BoardPair(PLANT, PLANT, seed=13, level="ideal") as pair:
        pair.enable()
        motion = Motion(pair, 13)
        unchanged = list(motion.run(10.0))
        pair.board.set_plant("axis1.inertia", 2.0 * PLANT.axes[0].inertia)
        for one in motion.run(10.0):
            monitor.update(one)
            plant = monitor.adapted(one.tick)
            if plant is not None:
                pair.twin.take_plant(plant)
                monitor.set_plant(plant)
        after = list(motion.run(10.0))
        assert pair.twin.synchronisations == 1
    for name in ("axis1.i_q", "axis1.speed", "axis1.u_q"):
        assert residuals(after, name) < 2.0 * residuals(unchanged, name)
    assert not monitor.findings()


# ---- means -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("loads", [(0.03, 0.0), (0.0, -0.03)])
def test_a_load_at_rest_shows_in_the_means(loads: tuple[float, float]) -> None:
    watch = SignalWatch([noise.means for noise in LEARNED.axes])
    with BoardPair(PLANT, PLANT, seed=14, level="ideal") as pair:
        pair.enable()
        for _ in range(200):
            for one in pair.sample():
                watch.update(one)
        before = watch.complaint
        for axis, load in enumerate(loads):
            pair.board.set_load(axis, load)
        for _ in range(200):
            for one in pair.sample():
                watch.update(one)
    assert before is None
    assert watch.complaint is not None
    assert watch.complaint[0] == (0 if loads[0] else 1)
    assert "i_q differs by" in watch.complaint[1]
    assert len(LEARNED.axes[0].means) == len(WATCHED)


# ---- what is learned -------------------------------------------------------------------------------------------------


def test_thresholds_are_learned_and_read_again(tmp_path: Path) -> None:
    runs = HealthyRuns(PLANT, 1, 120.0, "ideal")
    learner = runs.run(0)
    for number in range(1, 3):
        learner.join(runs.run(number))
    learned = learner.thresholds()
    path = tmp_path / "thresholds.toml"
    path.write_text(learned.text())
    read = Thresholds.load(path)
    assert read.detect == pytest.approx(learned.detect, rel=1e-5)
    assert read.axes[0].torque == pytest.approx(LEARNED.axes[0].torque, rel=0.1)
    assert read.run_hours == pytest.approx(0.1, rel=0.01)
    path.write_text(learned.text().replace("spread = [", "spread = [true, "))
    with pytest.raises(ThresholdsError, match=r"thresholds.toml: spread is not a list of 6 numbers"):
        Thresholds.load(path)


@pytest.mark.slow
def test_another_motor_is_learned_and_its_changes_are_named(tmp_path: Path) -> None:
    """Other motors on both axes and another supply, of board and twin, with the firmware for the usual ones."""
    plant, learned = tmp_path / "plant.toml", tmp_path / "thresholds.toml"
    plant.write_text(
        "[bus]\nu_source = 26.0\n"
        "[axis1]\nr_s = 0.8\npsi_m = 0.0125\ninertia = 1.4e-5\nfriction = 4e-3\n"
        "[axis2]\nr_s = 0.7\npsi_m = 0.011\ninertia = 2e-5\nfriction = 3e-3\n"
    )
    options = ["--plant", str(plant), "--workers", "1"]
    assert cli.main(["calibrate", *options, "--runs", "2", "--time", "120", "--out", str(learned)]) == 0
    assert Thresholds.load(learned).axes[0].voltage_q != LEARNED.axes[0].voltage_q
    changes = [word for name in ("friction", "inertia", "flux") for word in ("--change", f"{name}=1.15")]
    assert cli.main(["diagnose", *options, "--thresholds", str(learned), "--trials", "3", *changes]) == 0


def test_a_board_with_a_fault_teaches_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plant = tmp_path / "plant.toml"
    plant.write_text("[axis1]\npsi_m = 0.004\n")
    assert cli.main(["calibrate", "--plant", str(plant), "--runs", "1", "--workers", "1"]) == 1
    assert "axis1 of the board is in FAULT" in capsys.readouterr().err


def test_too_little_motion_teaches_nothing() -> None:
    with pytest.raises(ThresholdsError, match="s of motion are not enough"):
        HealthyRuns(PLANT, 1, 10.0, "ideal").run(0).thresholds()


# ---- in words --------------------------------------------------------------------------------------------------------


def test_a_finding_in_words() -> None:
    finding = Finding(Kind.SINGLE, ("friction",), 1.1, 0.9, 1.3, 16000, 38400)
    text = finding_text(finding, 48000, 1_700_000_003_000_000_000)
    assert text.startswith("friction 2.1 times (1.9..2.3) since ")
    assert text.endswith(":21, detected after 1.4 s")
    load = Finding(Kind.SINGLE, ("load",), 1e-3, 0.9e-3, 1.1e-3, 0, 16000)
    assert finding_text(load, 0, 0).startswith("load +1.0 mN m (+0.9..+1.1) since ")
    assert located_text([], ["axis1", "axis2"], 0, 0) == NOTHING_CHANGED


def test_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["diagnose", "--trials", "1", "--change", "flux=1.15", "--workers", "1"]) == 0
    shown = capsys.readouterr().out
    assert "flux              1      1" in shown
    assert "false alarms: 0 in 0.00 simulated hours" in shown
    assert cli.main(["diagnose", "--change", "colour=2"]) == 1
    assert "'colour=2' is not NAME=FACTOR" in capsys.readouterr().err
