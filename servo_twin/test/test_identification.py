"""servo-sim identify: from an unknown motor to a plant file and a servo.toml, and its refusals."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from servo_measurement import axis_under_test
from servo_measurement.access import Capture, MeasurementError
from servo_measurement.axis_under_test import AxisUnderTest
from servo_measurement.log import MeasurementLog
from servo_measurement.motor_test import MotorTest
from servo_measurement.motor_values import Estimate, Limits, MotorEstimates
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.trace import Trace
from servo_tuning.reading import load
from servo_twin.board import Board, BoardError
from servo_twin.board_access import VirtualBoardAccess
from servo_twin.cli import main
from servo_twin.identification import session
from servo_twin.identification.files import write_estimates
from servo_twin.identification.refine import covariance
from servo_twin.identification.session import identified, measure_virtual
from servo_twin.identification.trials import TARGETS, Trial, Trials, summary
from servo_twin.plant import PlantConfig
from servo_twin.servo_config import servo_table

AXIS = 1
LIMITS = Limits(24.0, 4.0, r_on=0.03)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files of one run on the packaged motor of axis 2."""
    path = tmp_path_factory.mktemp("identify")
    assert main(["identify", "--axis", "2", "--level", "ideal", "--out", str(path)]) == 0
    return path


def test_the_plant_file_has_the_motor(folder: Path) -> None:
    found, true = PlantConfig.load(folder / "plant.toml").axes[AXIS], PlantConfig.load().axes[AXIS]
    assert found.pole_pairs == true.pole_pairs
    for name, aim in TARGETS.items():
        assert getattr(found, name) == pytest.approx(getattr(true, name), rel=aim), name
    assert found.v_drop == pytest.approx(true.v_drop, rel=0.03)


def test_intervals_contain_the_true_values(folder: Path) -> None:
    content = json.loads((folder / "estimates.json").read_text())
    true = PlantConfig.load().axes[AXIS]
    for name in TARGETS:
        low, high = content["estimates"][name]["interval"]
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        assert abs(getattr(true, name) - middle) < 1.6 * half, name  # of one motor: 3 standard uncertainties
        assert half < 0.2 * middle, name
    assert content["board_seconds"] < 60.0
    assert content["difference"]["after"]["u_q"] < 0.02


def test_the_controller_is_tuned_for_it(folder: Path) -> None:
    configuration = load(folder / "servo.toml", Catalogue.load())
    axis, other = configuration.axes[AXIS], configuration.axes[0]
    assert axis("motor.l_q") == pytest.approx(PlantConfig.load().axes[AXIS].l_q, rel=0.03)
    assert other("motor.l_q") == servo_table()["axis1"]["motor"]["l_q"]
    assert (folder / "identify.png").stat().st_size > 10_000


def test_a_refusal_leaves_the_recording_of_an_earlier_run(tmp_path: Path) -> None:
    earlier = tmp_path / "measurement.npz"
    earlier.write_text("earlier")
    assert main(["identify", "--current", "99", "--out", str(tmp_path)]) == 1
    assert earlier.read_text() == "earlier"


def test_a_recording_with_missing_samples_is_enough(folder: Path, tmp_path: Path) -> None:
    log = MeasurementLog.load(folder / "measurement.npz")
    rng = np.random.default_rng(2)
    for k, recording in enumerate(log.recordings):
        size = len(recording)
        gone = rng.random(size) < 0.05
        begin = int(rng.integers(0, size))
        gone[begin : begin + size // 20] = True
        log.recordings[k] = recording.changed(
            **{name: np.where(gone, np.nan, values) for name, values in recording.columns.items()}
        )
    log.save(tmp_path / "gaps.npz")
    arguments = ["identify", "--recording", str(tmp_path / "gaps.npz"), "--model", "ideal", "--out", str(tmp_path)]
    assert main(arguments) == 0
    found, true = PlantConfig.load(tmp_path / "plant.toml").axes[AXIS], PlantConfig.load().axes[AXIS]
    for name, aim in TARGETS.items():
        assert getattr(found, name) == pytest.approx(getattr(true, name), rel=aim), name


def test_a_locked_shaft_has_no_flux(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "plant.toml").write_text("# of a run before\n")
    assert main(["identify", "--locked", "--level", "ideal", "--out", str(tmp_path)]) == 1
    captured = capsys.readouterr()
    assert "blocked" in captured.err
    assert not (tmp_path / "plant.toml").exists()
    content = json.loads((tmp_path / "estimates.json").read_text())
    assert "r_s" in content["estimates"]
    assert not {"psi_m", "inertia", "friction", "l_d", "l_q"} & set(content["estimates"])


@pytest.mark.parametrize(
    ("reason", "voltage", "what"),
    [
        ("swap its lines", 24.0, "reverse"),
        ("encoder is defective", 24.0, "no encoder"),
        ("winding is open", 24.0, "no motor"),
        ("in one direction only", 24.0, "stops"),
        ("correct --voltage", 48.0, ""),
    ],
)
def test_data_that_cannot_be_measured_are_reported(reason: str, voltage: float, what: str) -> None:
    def prepare(board: Board) -> None:
        if what == "reverse":
            board.reverse_encoder(0)
        elif what == "no encoder":
            board.connect_encoder(0, False)
        elif what == "no motor":
            board.connect_motor(0, False)
        elif what == "stops":
            board.obstruct_shaft(0, 2.0, 2.0)

    limits = Limits(voltage, 4.0)
    log, problem = measure_virtual(PlantConfig.load(), 0, limits, servo_table(), level="ideal", seed=1, prepare=prepare)
    assert reason in problem
    result = identified(log, PlantConfig.load(), problem, level="ideal")
    assert result.refinement is None
    assert str(result.problems[0]) == problem
    assert "psi_m" not in result.estimates.values


class _Watched(VirtualBoardAccess):
    """A board with a record of the largest motion of its shaft and a callback at each wait.

    Parameters
    ----------
    meanwhile : callable
        Called with this access before each wait.
    slow : float
        Duration of an exchange, as on a serial line [s].
    """

    def __init__(self, board: Board, meanwhile: Callable[[_Watched], None] = lambda _: None, slow: float = 0.0) -> None:
        super().__init__(board)
        self._meanwhile, self._slow = meanwhile, slow
        self._begin = board.truth(0).theta_m
        self.travel = self.speed = 0.0  # largest [rad], [rad/s]
        self.waits = 0

    def _advance(self, seconds: float) -> None:
        for _ in range(parts := max(math.ceil(seconds / 0.01), 1)):
            self.board.run(seconds / parts)
            truth = self.board.truth(0)
            self.travel = max(self.travel, abs(truth.theta_m - self._begin))
            self.speed = max(self.speed, abs(truth.omega_m))

    def read_words(self, name: str) -> list[int]:
        if self._slow:
            self._advance(self._slow)
        return super().read_words(name)

    def write_words(self, name: str, words: Sequence[int], first: int = 0) -> bool:
        if self._slow:
            self._advance(self._slow)
        return super().write_words(name, words, first)

    def wait(self, seconds: float) -> None:
        self.waits += 1
        self._meanwhile(self)
        self._advance(seconds)

    def record(self, capture: Capture) -> Trace:
        def pass_time(seconds: float, full: bool) -> None:
            for _ in range(round(seconds / 0.08) if self._slow else 0):
                self._advance(0.08)
                capture.meanwhile(full)

        pass_time(0.2 + (capture.seconds if capture.trigger else 0.0), False)
        recording = super().record(capture)
        pass_time(0.7, True)  # samples are read
        return recording


def _state(board: Board) -> dict[str, list[int]]:
    names = ["config.checksum", "cmd.mode", "cmd.i_q", "cmd.speed"]
    names += [name for name in board.catalogue.variables if name.startswith("param.")]
    return {name: board.read_words(name) for name in names}


def _set_protection(board: Board) -> None:
    """Set protective limits."""
    flags = {flag.name: flag.mask for flag in board.catalogue.flags["features"]}
    board.run(0.05)
    for name, value in (("speed_limit", 60.0), ("over_speed", 100.0), ("position_max", 24.0), ("position_min", -24.0)):
        board.write(f"param.{name}", [value] * 2)
    board.write_raw("param.features", [0xF | flags["POSITION_LIMITS"] | flags["OVER_SPEED"]] * 2)
    board.write_raw("cmd.mode", [board.catalogue.enums["control_mode_t"]["SPEED"]] * 2)
    board.run(0.05)


def test_protective_settings_apply_and_everything_is_restored() -> None:
    with Board(PlantConfig.load(), seed=1, level="ideal") as board:
        _set_protection(board)
        before = _state(board)
        access = _Watched(board)
        log = MotorTest(access, 0, LIMITS, servo_table()).run()
        board.run(0.05)
        assert _state(board) == before
        assert access.travel < 24.0
        assert 30.0 < access.speed < 60.0
        assert log.labelled("hold")
        assert board.read("axis1.state") == board.catalogue.enums["state_t"]["STOP"]


@pytest.mark.parametrize("turns", [3.0, 20.0])
def test_permitted_turns_are_kept_over_a_slow_line(turns: float) -> None:
    with Board(PlantConfig.load(), seed=1, level="ideal") as board:
        board.run(0.05)
        access = _Watched(board, slow=0.005)
        MotorTest(access, 0, dataclasses.replace(LIMITS, turns=turns), servo_table()).run()
        assert 0.5 * turns < access.travel / (2.0 * math.pi) < turns


def test_low_speed_limit_is_sufficient_and_kept() -> None:
    with Board(PlantConfig.load(), seed=1, level="ideal") as board:
        board.run(0.05)
        access = _Watched(board, slow=0.005)
        MotorTest(access, 0, dataclasses.replace(LIMITS, speed=30.0), servo_table()).run()
        assert access.speed < 31.0


@pytest.mark.parametrize("at", [(60,), (60, 62, 63), (160, 162)])
def test_ctrl_c_restores_the_board(at: tuple[int, ...]) -> None:
    def press(access: _Watched) -> None:
        if access.waits in at:
            raise KeyboardInterrupt

    with Board(PlantConfig.load(), seed=1, level="ideal") as board:
        _set_protection(board)
        before = _state(board)
        test = MotorTest(_Watched(board, press), 0, LIMITS, servo_table())
        with pytest.raises(KeyboardInterrupt):
            test.run()
        board.run(0.05)
        assert not test.unrestored
        assert _state(board) == before
        assert board.read("axis1.state") == board.catalogue.enums["state_t"]["STOP"]


def test_restoration_continues_after_a_line_failure() -> None:
    class Lost(_Watched):
        remaining = 3

        def write_words(self, name: str, words: Sequence[int], first: int = 0) -> bool:
            if self.waits > 100 and name in ("cmd.enable", "param.features", "cmd.speed") and self.remaining > 0:
                self.remaining -= 1
                raise OSError("no answer")
            return super().write_words(name, words, first)

    with Board(PlantConfig.load(), seed=1, level="ideal") as board:
        _set_protection(board)
        before = _state(board)
        with pytest.raises(OSError, match="no answer"):
            MotorTest(Lost(board), 0, LIMITS, servo_table()).run()
        board.run(0.05)
        assert _state(board) == before


@pytest.mark.parametrize("seconds", [10.0, math.inf])
def test_shaft_that_does_not_stop_is_reported_after_a_wait(seconds: float) -> None:
    """A load accelerates the shaft after the outputs are off."""

    class Loaded(_Watched):
        since = math.inf

        def write_words(self, name: str, words: Sequence[int], first: int = 0) -> bool:
            if name == "cmd.enable" and words == [0]:
                self.since = min(self.since, self.board.time_ns * 1e-9)
            return super().write_words(name, words, first)

        def wait(self, seconds_: float) -> None:
            lasts = self.since <= self.board.time_ns * 1e-9 < self.since + seconds
            self.board.set_load(0, 0.004 if lasts else 0.0)
            super().wait(seconds_)

    with Board(PlantConfig.load().with_axis(0, viscous=1e-4), seed=1, level="ideal") as board:
        _set_protection(board)
        before, messages = _state(board), list[str]()
        test = MotorTest(Loaded(board), 0, LIMITS, servo_table(), messages.append)
        with pytest.raises(MeasurementError):
            test.run()
        board.run(0.05)
        assert (_state(board) == before) == math.isfinite(seconds)
        assert any("NOT RESTORED: configuration" in text for text in messages) == math.isinf(seconds)
        assert ("The board restores" in test.restoring_text) == math.isinf(seconds)
        if math.isinf(seconds):
            with pytest.raises(BoardError):
                board.write_raw("cmd.enable", [1, 0])
            board.set_load(0, 0.0)
            board.run(10.0)
            assert _state(board) == before


def test_set_point_is_renewed_with_slow_exchanges() -> None:
    """As on a serial port that delays each answer by 16 ms."""
    written: list[float] = []

    class Timed(_Watched):
        def write_words(self, name: str, words: Sequence[int], first: int = 0) -> bool:
            if name == "cmd.i_q":
                written.append(self.clock())
            return super().write_words(name, words, first)

    with Board(PlantConfig.load(), seed=1, level="ideal") as board:
        it = AxisUnderTest(Timed(board, slow=0.016), 0)
        with it.session():
            it.command_timeout(1.0)
            it.command("cmd.i_q", 0.0)
            for _ in range(50):
                it.wait(0.002)
                it.value("speed"), it.value("position")
    assert len(written) > 4
    assert max(np.diff(written)) < 0.5


@pytest.mark.parametrize("mode", ["TEST", "SPEED"])
def test_host_pause_ends_the_motion(mode: str) -> None:
    """The board stops the shaft, and the set-point is not renewed."""
    speeds: list[float] = []

    def pause(access: _Watched) -> None:
        board = access.board
        turns = abs(board.truth(0).omega_m) > (3.0 if mode == "TEST" else 20.0)
        if turns and not speeds and board.read("axis1.mode") == board.catalogue.enums["control_mode_t"][mode]:
            board.run(1.5)
            speeds.append(board.truth(0).omega_m)

    with Board(PlantConfig.load(), seed=1, level="ideal") as board:
        board.run(0.05)
        before = _state(board)
        with pytest.raises(MeasurementError, match="EXPIRED"):
            MotorTest(_Watched(board, pause), 0, LIMITS, servo_table()).run()
        assert abs(speeds[0]) < 1.0
        assert _state(board) == before


def test_a_session_that_the_board_refuses_or_has_ended_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(axis_under_test, "_SESSION_MAX", 0.02)
    with Board(PlantConfig.load(), seed=1, level="ideal") as board:
        board.run(0.05)
        access = VirtualBoardAccess(board)
        first, second = (AxisUnderTest(access, axis) for axis in (0, 1))
        assert access.write_words("measurement.axis", [1])
        assert access.write_words("measurement.axis", [0])
        board.run(0.05)
        with pytest.raises(MeasurementError, match="another program has ended it"):
            first.command_timeout(1.0)
        assert access.write_words("measurement.axis", [1])
        first.mode("SPEED")
        first.enable("SPIN", 2.0)
        first.command("cmd.speed", 100.0)
        first.wait(0.5)
        assert access.write_words("measurement.axis", [0])
        with pytest.raises(MeasurementError, match="a shaft moves: bring the shafts to rest"), second.session():
            pass


@pytest.mark.parametrize("step", ["torque pulses", "running at several speeds"])
def test_nothing_is_changed_after_the_board_has_ended_the_session(step: str) -> None:
    """While the outputs are off no fault shows that the board has restored its values; later changes would remain."""
    with Board(PlantConfig.load(), seed=1, level="ideal") as board:
        board.run(0.05)
        before = _state(board)
        access = _Watched(board)

        def end_session(text: str) -> None:
            if text.startswith(step):
                assert not access.write_words("measurement.axis", [2])
                board.run(0.1)

        with pytest.raises(MeasurementError, match="another program has begun a session"):
            MotorTest(access, 0, LIMITS, servo_table(), end_session).run()
        board.run(0.05)
        assert _state(board) == before


@pytest.mark.parametrize(("axis", "reason"), [(0, "axis1 is enabled"), (1, "axis2 is enabled")])
def test_identification_is_refused_with_an_enabled_axis(axis: int, reason: str) -> None:
    class Silent(_Watched):
        def write_words(self, name: str, words: Sequence[int], first: int = 0) -> bool:
            raise AssertionError(f"{name} is written")

    with Board(PlantConfig.load(), seed=1, level="ideal") as board:
        board.run(0.05)
        board.write("cmd.enable", [int(axis == 0), int(axis == 1)])
        board.run(4.0)
        with pytest.raises(MeasurementError, match=reason):
            MotorTest(Silent(board), 0, LIMITS, servo_table()).run()
        assert board.read(f"axis{axis + 1}.state") == board.catalogue.enums["state_t"]["RUN"]


@pytest.mark.parametrize(
    ("limits", "reason"),
    [
        (dataclasses.replace(LIMITS, turns=2.0), "write --turns-max 3 or more"),
        (dataclasses.replace(LIMITS, speed=0.01), "write --speed-max 5 or more"),
    ],
)
def test_too_small_range_is_refused_before_any_motion(limits: Limits, reason: str) -> None:
    with Board(PlantConfig.load(), seed=1, level="ideal") as board:
        board.run(0.05)
        before, access = _state(board), _Watched(board)
        with pytest.raises(MeasurementError, match=reason):
            MotorTest(access, 0, limits, servo_table()).run()
        assert _state(board) == before
        assert access.travel < 0.01


def test_saturation_is_reported_as_failure(tmp_path: Path) -> None:
    plant = PlantConfig.load().with_axis(0, i_saturation_d=5.0, i_saturation_q=5.0)
    log, problem = measure_virtual(plant, 0, LIMITS, servo_table(), level="ideal", seed=1)
    result = identified(log, PlantConfig.load(), problem, refined=False)
    assert any("the iron saturates" in str(one) for one in result.problems)
    write_estimates(tmp_path / "estimates.json", result, [])
    content = json.loads((tmp_path / "estimates.json").read_text())
    assert content["bias"]["l_d"] == pytest.approx(2.8)


def test_a_value_of_zero_is_named_and_asks_for_no_current(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = MotorEstimates({"r_s": Estimate(0.0, 0.01), "l_d": Estimate(1e-3, 1e-4), "l_q": Estimate(1e-3, 1e-5)}, {})
    monkeypatch.setattr(session, "estimates_of", lambda log: found)
    log = MeasurementLog(0, notes={"limits": dataclasses.asdict(LIMITS), "current": 0.4})
    result = identified(log, PlantConfig.load(), refined=False)
    assert "r_s: 0 ohm is implausible: not determined by the data" in map(str, result.problems)
    assert any(str(one).endswith("is too wide; write --current 0.98 or more") for one in result.problems)
    write_estimates(tmp_path / "estimates.json", result, [])
    assert json.loads((tmp_path / "estimates.json").read_text())["remedies"] == [
        {"problem": "l_d", "alternatives": [{"--current": 0.98}]}
    ]


@pytest.mark.parametrize(
    ("values", "runs", "end"),
    [
        ({"friction": Estimate(1e-3, 1e-3)}, False, "is too wide"),  # of a version that did not note the runs
        ({"friction": Estimate(0.0, 1e-3)}, True, "is too wide"),
        ({"friction": Estimate(1e-3, 3.6e-4)}, True, "--speed-max 45 or more"),
        ({"l_q": Estimate(1e-3, 1e-4)}, True, "--current 0.98 or more"),  # inertia and flux are undetermined
    ],
)
def test_a_too_wide_interval_is_named_with_any_other_data(
    values: dict[str, Estimate], runs: bool, end: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = MotorEstimates({"r_s": Estimate(1.0, 1e-3), **values}, {})
    monkeypatch.setattr(session, "estimates_of", lambda log: found)
    log = MeasurementLog(
        0, notes={"limits": dataclasses.asdict(dataclasses.replace(LIMITS, speed=20.0)), "current": 0.4}
    )
    if runs:
        log.notes["runs"] = {"speed": 15.0, "speed_of_voltage": 300.0, "inertia": 1e-5, "travel": [1.0, 1e-3]}
    problems = [str(one) for one in identified(log, PlantConfig.load(), refined=False).problems]
    (name,) = values
    assert [one.endswith(end) for one in problems if one.startswith(f"{name}: the interval")] == [True], problems


@pytest.mark.parametrize("part", [0, 30, 5_000, 50_000, None])
def test_truncated_or_foreign_recording_is_reported(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], part: int | None
) -> None:
    content = (folder / "measurement.npz").read_bytes()
    (tmp_path / "part.npz").write_bytes(b"# no recording\n" if part is None else content[:part])
    assert main(["identify", "--recording", str(tmp_path / "part.npz"), "--out", str(tmp_path)]) == 2
    messages = capsys.readouterr().err
    assert "is not a complete measurement" in messages
    assert "pickle" not in messages


def places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Container and key of every field; of lists those of the first and the last element."""
    keys = list(value) if isinstance(value, dict) else {0, len(value) - 1} if isinstance(value, list) and value else ()
    for key in keys:
        yield value, key
        yield from places(value[key])


def test_recording_with_any_field_missing_or_wrong_is_reported(folder: Path, tmp_path: Path) -> None:
    with np.load(folder / "measurement.npz") as archive:
        arrays = dict(archive)
    text = json.loads(str(arrays.pop("log")))
    path, plant, refused = tmp_path / "m.npz", PlantConfig.load(), 0
    for container, key in places(text):
        kept = container[key]
        for wrong in (..., None, -1):
            container[key] = wrong
            if wrong is ...:
                del container[key]
            np.savez(path, log=np.array(json.dumps(text)), **arrays)
            try:
                identified(MeasurementLog.load(path), plant, refined=False)
            except MeasurementError:
                refused += 1
            if wrong is ... and isinstance(container, list):
                container.insert(key, kept)
            container[key] = kept
    assert refused > 80


def test_false_success_is_counted() -> None:
    good = Trial(dict.fromkeys(TARGETS, 0.01), dict.fromkeys(TARGETS, True), 20.0, (), "")
    far = Trial({**dict.fromkeys(TARGETS, 0.01), "psi_m": 0.2}, dict.fromkeys(TARGETS, False), 20.0, (), "")
    warned = Trial({**dict.fromkeys(TARGETS, 0.01), "psi_m": 0.2}, dict.fromkeys(TARGETS, False), 20.0, ("psi_m",), "")
    assert [one.false_success for one in (good, far, warned)] == [False, True, False]
    text = "\n".join(summary([(0, good), (1, far), (2, warned)]))
    assert "3 motors: 2 identified, 1 not" in text
    assert "false success: 1 (motors 1)" in text


def test_uncertainties_of_few_points_are_not_too_small() -> None:
    """A line through six points, each in its own batch: the leverage of the points is included."""
    x = np.linspace(0.2, 1.0, 6)
    jacobian = np.column_stack([x, np.ones_like(x)])
    true = np.linalg.inv(jacobian.T @ jacobian)
    rng = np.random.default_rng(1)
    found = np.zeros((2, 2))
    for _ in range(2000):
        noise = rng.standard_normal(x.size)
        left = noise - jacobian @ np.linalg.lstsq(jacobian, noise, rcond=None)[0]
        found += covariance(jacobian, left, np.arange(x.size)) / 2000
    assert np.all(np.diag(found) > np.diag(true))
    assert np.all(np.diag(found) < 2.0 * np.diag(true))


def test_interrupted_trials_keep_their_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(_: Trials, number: int) -> Trial:
        if number == 2:
            raise KeyboardInterrupt
        return Trial(dict.fromkeys(TARGETS, 0.01), dict.fromkeys(TARGETS, True), 20.0, (), "")

    monkeypatch.setattr(Trials, "run", run)
    arguments = ["identify", "--trials", "3", "--workers", "1", "--seed", "5", "--level", "ideal"]
    with contextlib.suppress(KeyboardInterrupt):
        main([*arguments, "--out", str(tmp_path)])
    assert [trial["motor"] for trial in json.loads((tmp_path / "trials.json").read_text())] == [0, 1]
