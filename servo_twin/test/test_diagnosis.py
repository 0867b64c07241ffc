"""The diagnosis with virtual pairs, without ROS: findings, false alarms and calibration."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pytest
from numpy.typing import NDArray
from servo_twin.diagnosis.board_pair import BoardPair, Motion
from servo_twin.diagnosis.change_detector import ChangeDetector, Estimate, Finding, Kind
from servo_twin.diagnosis.likelihood_ratio import Unknowns
from servo_twin.diagnosis.monitor import PLANT_VALUES, TRANSIENT_BLOCKS, DiagnosisMonitor
from servo_twin.diagnosis.report import NOTHING_CHANGED, estimate_numbers, finding_text, findings_text
from servo_twin.diagnosis.signal_monitor import MONITORED, SignalMonitor
from servo_twin.diagnosis.signals import CHANGES, NEEDED, BusSignal
from servo_twin.diagnosis.thresholds import Thresholds, ThresholdsError
from servo_twin.diagnosis.trials import NOTHING, Change, HealthyRuns, Trials, Verdict
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
def test_each_change_is_reported_with_its_size(name: str, factor: float) -> None:
    size = 0.02 * (factor - 1.0) if name == "load" else factor
    answer = trials(Change(name, size)).run(0)
    assert (answer.said, answer.false_alarms) == (answer.truth, ())
    assert answer.covered
    assert answer.delay is not None
    assert answer.delay < 10.0


@pytest.mark.parametrize("name", ["friction", "resistance", "inertia", "load"])
def test_a_large_change_is_reported_as_a_single_change(name: str) -> None:
    size = {"friction": 4.0, "resistance": 2.0, "inertia": 3.0, "load": 0.03}[name]
    answer = trials(Change(name, size)).run(1)
    assert answer.said == answer.truth
    assert answer.value == pytest.approx(size if name == "load" else size - 1.0, rel=0.15)


def test_a_change_is_found_with_30_percent_of_the_samples_missing() -> None:
    answer = trials(Change("inertia", 1.15), loss=0.3).run(2)
    assert (answer.said, answer.false_alarms) == (answer.truth, ())
    assert answer.covered


def test_a_healthy_pair_has_no_finding() -> None:
    answer = trials(seconds=60.0).run(3)
    assert (answer.said, answer.false_alarms) == (Verdict(NOTHING), ())


# ---- several changes, and unknown ones -------------------------------------------------------------------------------


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


def test_two_changes_of_one_axis_are_reported_as_several() -> None:
    monitor = watched(("axis1.inertia", 1.2e-5), ("axis1.friction", 5e-3))
    (found,) = monitor.findings()
    assert (found.axis, found.finding.kind) == (0, Kind.SEVERAL)
    assert set(found.finding.changes) == {"friction", "inertia"}


def test_the_twin_adopts_all_of_several_changes() -> None:
    plant = watched(("axis1.inertia", 1.2e-5), ("axis1.friction", 5e-3)).adapted(1 << 40)
    assert plant is not None
    assert plant.axes[0].inertia == pytest.approx(1.2e-5, rel=0.05)
    assert plant.axes[0].friction == pytest.approx(5e-3, rel=0.1)
    assert plant.axes[1] == PLANT.axes[1]


def test_a_slipped_encoder_is_reported_as_encoder_angle() -> None:
    (found,) = watched(slip=SlippedEncoder(1, 100)).findings()
    assert (found.axis, found.finding.changes) == (1, ("encoder_angle",))
    assert abs(found.finding.value) == pytest.approx(np.sin(np.deg2rad(18.0)), rel=0.1)


def rows(samples: Sequence[tuple[float, NDArray[np.float64]]]) -> Rows:
    """One equation of weight 1 per sample."""
    y = np.array([[left] for left, _ in samples])
    return Rows(y, np.array([phi for _, phi in samples]), np.ones_like(y), np.ones_like(y))


def test_a_residual_without_an_equation_is_reported_as_unknown() -> None:
    """Noise three times as large as that of a healthy pair."""
    unknowns = Unknowns(("one", "two"), np.array([0.01, 0.01]), np.ones(2), (1, 1))
    detector = ChangeDetector(unknowns, 10.0, np.array([2.0]), np.empty(0), rows)
    draw = np.random.default_rng(1)
    said: list[Kind | None] = []
    for tick in range(0, 400_000, 136):
        phi = draw.normal(size=(1, 2))
        if detector.add(tick, 0.0085, (draw.normal() * 3.0, phi)):
            said.append(detector.finding.kind if detector.finding else None)
    assert set(said) == {None, Kind.UNKNOWN}
    assert said.count(Kind.UNKNOWN) > len(said) // 2


BLOCK_SAMPLES = 12
WHITE = np.random.default_rng(3).normal(size=100 * BLOCK_SAMPLES)


Simple = ChangeDetector[tuple[float, NDArray[np.float64]]]


def detection_block(detector: Simple, left: NDArray[np.float64], change: int = 0) -> int | None:
    """Block of the first finding, if a single unknown changes, with these left sides; None without a finding."""
    phi = np.zeros((1, 2))
    phi[0, change] = 1.0
    for number, y in enumerate(left):
        detector.add(136 * number, 1.001 * BLOCK / BLOCK_SAMPLES, (float(y), phi))
        if detector.finding is not None:
            return number // BLOCK_SAMPLES
    return None


def two(*names: str) -> Simple:
    unknowns = Unknowns(
        names, np.array([0.01, 0.01]), np.ones(2), [TRANSIENT_BLOCKS[CHANGES.index(name)] for name in names]
    )
    return ChangeDetector(unknowns, 10.0, np.array([9.0]), np.empty(0), rows)


@pytest.mark.parametrize("name", CHANGES)
def test_a_transient_is_not_reported_but_a_longer_change_is(name: str) -> None:
    """The strongest `TRANSIENT_BLOCKS` are excluded from the decision, regardless of their strength."""
    blocks, begin = TRANSIENT_BLOCKS[CHANGES.index(name)], 40 * BLOCK_SAMPLES
    names = ("flux", name) if name != "flux" else ("flux", "friction")
    change = names.index(name)
    short, longer = 0.1 * WHITE, 0.1 * WHITE
    short[begin : begin + blocks * BLOCK_SAMPLES] += 2.0
    longer[begin : begin + (blocks + 1) * BLOCK_SAMPLES] += 2.0
    assert detection_block(two(*names), short, change) is None
    assert detection_block(two(*names), longer, change) == 40 + blocks


@pytest.mark.parametrize("before", [0.0, 20.0])
def test_a_slip_and_an_unknown_cause_are_reported_only_if_persistent(before: float) -> None:
    """Also after an outlier, which looks like a change while it is in the window."""
    begin, second = 40 * BLOCK_SAMPLES, 10 * BLOCK_SAMPLES
    short, slip, noise = WHITE.copy(), WHITE.copy(), WHITE.copy()
    for left in (short, slip, noise):
        left[begin - second] += before
    short[begin : begin + second // 2] += 1.5
    slip[begin:] += 1.5
    noise[begin:] *= 6.0
    assert detection_block(two("flux", "encoder_angle"), short, 1) is None
    assert detection_block(two("flux", "friction"), short) is not None
    block = detection_block(two("flux", "encoder_angle"), slip, 1)
    assert block is not None
    assert block >= 40 + 5
    detector = two("flux", "friction")
    block = detection_block(detector, noise)
    assert block is not None
    assert block >= 40 + 19
    assert detector.finding is not None
    assert detector.finding.kind is Kind.UNKNOWN


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
def test_a_bus_raised_by_braking_is_not_evaluated(braking: tuple[bool, bool]) -> None:
    """0.5 J of either board, or of both: at standstill one board may use it faster than the other."""
    buses = Buses()
    assert buses.run(0.1, (24.0, 24.0), buses.STILL, buses.STILL) == 0.0
    assert buses.run(0.017, (24.0, 24.0), *(buses.BRAKING if one else buses.STILL for one in braking)) is None
    assert buses.run(2.0, (25.2, 24.0), buses.STILL, buses.STILL) is None
    assert buses.run(0.017, (25.2, 24.0), buses.ACCELERATING, buses.ACCELERATING) == pytest.approx(0.05)


def test_the_supply_is_evaluated_after_all_returned_energy_is_used() -> None:
    """A lift from 24 to 33 V is 1.21 J of 4.7 mF: 0.027 s at 45 W."""
    buses = Buses()
    buses.run(0.1, (24.0, 24.0), buses.STILL, buses.STILL)
    buses.run(1.2 / 30.0, (33.0, 33.0), buses.BRAKING, buses.BRAKING)
    assert buses.run(0.95 * 1.2 / 45.0, (26.0, 24.0), buses.ACCELERATING, buses.ACCELERATING) is None
    assert buses.run(0.3 * 1.2 / 45.0, (24.0, 24.0), buses.ACCELERATING, buses.ACCELERATING) == 0.0


def test_a_bus_above_its_supply_is_not_evaluated_after_an_interruption() -> None:
    """As after a change of the plant: the energy returned before is unknown."""
    buses = Buses()
    for volts, shown in (((24.05, 24.0), 0.05 / 24.0), ((23.0, 24.0), -1.0 / 24.0), ((25.0, 24.0), None)):
        buses.signal.interrupt()
        found = buses.run(0.1, volts, buses.STILL, buses.STILL)
        assert found == (shown if shown is None else pytest.approx(shown))


def test_indistinguishable_changes_are_reported_as_one_of_two() -> None:
    """Friction and load are indistinguishable while the shaft rotates in one direction only."""
    unknowns = Unknowns(("friction", "load"), np.array([0.01, 0.01]), np.ones(2), (1, 1))
    detector = ChangeDetector(unknowns, 10.0, np.array([5.0]), np.empty(0), rows)
    draw = np.random.default_rng(2)
    for tick in range(0, 1_000_000, 136):
        detector.add(tick, 0.0085, (draw.normal() + 1.0, np.ones((1, 2))))
    assert detector.finding is not None
    assert (detector.finding.kind, set(detector.finding.changes)) == (Kind.ONE_OF, {"friction", "load"})


# ---- after a finding -------------------------------------------------------------------------------------------------


def test_a_finding_is_withdrawn_after_the_change_and_estimates_are_constant_at_rest() -> None:
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
        del before[(None, "supply")], at_rest[(None, "supply")]
        assert at_rest == before
        pair.board.set_plant("axis2.friction", PLANT.axes[1].friction)
        for one in motion.run(15.0):
            monitor.update(one)
        assert not monitor.findings()


def residuals(pairs: list[Pair], name: str) -> float:
    return float(np.sqrt(np.mean([(one.real[name] - one.twin[name]) ** 2 for one in pairs])))


def test_residual_after_adoption_is_as_of_an_unchanged_pair() -> None:
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
def test_a_load_at_rest_is_detected_by_the_means(loads: tuple[float, float]) -> None:
    watch = SignalMonitor([noise.means for noise in LEARNED.axes])
    with BoardPair(PLANT, PLANT, seed=14, level="ideal") as pair:
        pair.enable()
        for _ in range(200):
            for one in pair.sample():
                watch.update(one)
        before = watch.deviation
        for axis, load in enumerate(loads):
            pair.board.set_load(axis, load)
        for _ in range(200):
            for one in pair.sample():
                watch.update(one)
    assert before is None
    assert watch.deviation is not None
    assert watch.deviation[0] == (0 if loads[0] else 1)
    assert "i_q differs by" in watch.deviation[1]
    assert len(LEARNED.axes[0].means) == len(MONITORED)


# ---- calibration -----------------------------------------------------------------------------------------------------


def test_calibrated_thresholds_are_written_and_read_again(tmp_path: Path) -> None:
    runs = HealthyRuns(PLANT, 1, 90.0, "ideal")  # shorter runs have too little motion
    calibrator = runs.run(0)
    calibrator.merge(runs.run(1))
    calibrated = calibrator.thresholds()
    path = tmp_path / "thresholds.toml"
    path.write_text(calibrated.text())
    read = Thresholds.load(path)
    assert read.detect == pytest.approx(calibrated.detect, rel=1e-5)
    assert read.axes[0].torque == pytest.approx(LEARNED.axes[0].torque, rel=0.1)
    assert read.run_hours == pytest.approx(2 * 90.0 / 3600.0, rel=0.01)
    path.write_text(calibrated.text().replace("spread = [", "spread = [true, "))
    with pytest.raises(ThresholdsError, match=r"thresholds.toml: spread is not a list of 6 numbers"):
        Thresholds.load(path)


@pytest.mark.slow
def test_another_motor_is_calibrated_and_its_changes_are_found(tmp_path: Path) -> None:
    """Other motors on both axes and another supply, of board and twin, with the firmware for the usual ones."""
    plant, calibrated = tmp_path / "plant.toml", tmp_path / "thresholds.toml"
    plant.write_text(
        "[bus]\nu_source = 26.0\n"
        "[axis1]\nr_s = 0.8\npsi_m = 0.0125\ninertia = 1.4e-5\nfriction = 4e-3\n"
        "[axis2]\nr_s = 0.7\npsi_m = 0.011\ninertia = 2e-5\nfriction = 3e-3\n"
    )
    options = ["--plant", str(plant), "--workers", "1"]
    assert cli.main(["calibrate", *options, "--runs", "2", "--time", "90", "--out", str(calibrated)]) == 0
    assert Thresholds.load(calibrated).axes[0].voltage_q != LEARNED.axes[0].voltage_q
    changes = [word for name in ("friction", "inertia", "flux") for word in ("--change", f"{name}=1.15")]
    assert cli.main(["diagnose", *options, "--thresholds", str(calibrated), "--trials", "3", *changes]) == 0


def test_calibration_fails_with_a_board_in_fault(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plant = tmp_path / "plant.toml"
    plant.write_text("[axis1]\npsi_m = 0.004\n")
    assert cli.main(["calibrate", "--plant", str(plant), "--runs", "1", "--workers", "1"]) == 1
    assert "axis1 of the board is in FAULT" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("calibrate --time 0", "'0' is too small; write a number from 60 up to 100000 [s]"),
        ("calibrate --time 1e12", "'1e12' is too large"),
        ("calibrate --time nan", "'nan' is not a finite number"),
        ("diagnose --time -1", "'-1' is too small; write a number above 0"),
        ("diagnose --loss 1", "'1' is too large; write a number from 0 up to 0.9"),
    ],
)
def test_numbers_out_of_range_are_refused(words: str, why: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cli.main(words.split())
    assert why in capsys.readouterr().err


def test_calibration_fails_with_too_little_motion() -> None:
    with pytest.raises(ThresholdsError, match="s of motion are not enough"):
        HealthyRuns(PLANT, 1, 10.0, "ideal").run(0).thresholds()


# ---- as text ---------------------------------------------------------------------------------------------------------


def test_the_text_of_a_finding_has_its_value_and_times() -> None:
    finding = Finding(Kind.SINGLE, ("friction",), 1.1, 0.9, 1.3, 16000, 38400)
    text = finding_text(finding, 48000, 1_700_000_003_000_000_000)
    assert text.startswith("friction 2.1 times (1.9..2.3) since ")
    assert text.endswith(":21, detected after 1.4 s")
    load = Finding(Kind.SINGLE, ("load",), 1e-3, 0.9e-3, 1.1e-3, 0, 16000)
    assert finding_text(load, 0, 0).startswith("load +1.0 mN m (+0.9..+1.1) since ")
    assert findings_text([], ["axis1", "axis2"], 0, 0) == NOTHING_CHANGED


def test_the_encoder_angle_is_reported_as_an_angle() -> None:
    """The unknown of the equations is its sine."""
    value, low, high = (float(np.sin(np.deg2rad(angle))) for angle in (60.0, 55.0, 65.0))
    text = finding_text(Finding(Kind.SINGLE, ("encoder_angle",), value, low, high, 0, 16000), 0, 0)
    assert text.startswith("encoder angle +60 deg electrical (+55..+65) since ")
    text = finding_text(Finding(Kind.SINGLE, ("encoder_angle",), 1.1, 1.0, 1.2, 0, 16000), 0, 0)
    assert text.startswith("encoder angle +90 deg electrical (+90..+90) since "), "digits of the sine's interval"
    numbers = estimate_numbers(Estimate("encoder_angle", float(np.sin(np.deg2rad(80.0))), 0.1))
    assert numbers["value"] == pytest.approx(np.deg2rad(80.0))
    assert numbers["high"] == pytest.approx(np.pi / 2.0), "a sine above 1 is limited"


def test_the_command_prints_detections_and_errors(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["diagnose", "--trials", "1", "--change", "flux=1.15", "--workers", "1"]) == 0
    shown = capsys.readouterr().out
    assert ["flux", "1", "1"] in [line.split()[:3] for line in shown.splitlines()]
    assert "false alarms: 0 in 0.00 simulated hours" in shown
    assert cli.main(["diagnose", "--change", "colour=2"]) == 2
    assert "'colour=2': write NAME=FACTOR" in capsys.readouterr().err
