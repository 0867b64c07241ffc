"""servo-sim identify: from an unknown motor to a plant file and a servo.toml, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.measurement.access import MeasurementError
from servo_msgs_py.measurement.log import MeasurementLog
from servo_msgs_py.measurement.motor_test import MotorTest
from servo_msgs_py.measurement.motor_values import Limits
from servo_msgs_py.tuning.reading import load
from servo_twin.board import Board
from servo_twin.board_access import VirtualBoardAccess
from servo_twin.cli import main
from servo_twin.firmware_build import servo_table
from servo_twin.identification.motors import random_motor
from servo_twin.identification.session import identified, measure_virtual
from servo_twin.identification.trials import AIMS, Trial, summary
from servo_twin.plant import PlantConfig

AXIS = 1
LIMITS = Limits(24.0, 4.0, r_on=0.03)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What one run on the packaged motor of axis 2 has written."""
    path = tmp_path_factory.mktemp("identify")
    assert main(["identify", "--axis", "2", "--level", "ideal", "--out", str(path)]) == 0
    return path


def test_the_plant_file_has_the_motor(folder: Path) -> None:
    found, true = PlantConfig.load(folder / "plant.toml").axes[AXIS], PlantConfig.load().axes[AXIS]
    assert found.pole_pairs == true.pole_pairs
    for name, aim in AIMS.items():
        assert getattr(found, name) == pytest.approx(getattr(true, name), rel=aim), name
    assert found.v_drop == pytest.approx(true.v_drop, rel=0.03)


def test_intervals_hold_the_truth(folder: Path) -> None:
    content = json.loads((folder / "estimates.json").read_text())
    true = PlantConfig.load().axes[AXIS]
    for name in AIMS:
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


def test_a_recording_with_missing_samples_is_enough(folder: Path, tmp_path: Path) -> None:
    log = MeasurementLog.load(folder / "measurement.npz")
    rng = np.random.default_rng(2)
    for recording in log.recordings:
        size = next(iter(recording.columns.values())).size
        gone = rng.random(size) < 0.05
        begin = int(rng.integers(0, size))
        gone[begin : begin + size // 20] = True
        for column in recording.columns.values():
            column[gone] = np.nan
    log.save(tmp_path / "gaps.npz")
    arguments = ["identify", "--recording", str(tmp_path / "gaps.npz"), "--model", "ideal", "--out", str(tmp_path)]
    assert main(arguments) == 0
    found, true = PlantConfig.load(tmp_path / "plant.toml").axes[AXIS], PlantConfig.load().axes[AXIS]
    for name, aim in AIMS.items():
        assert getattr(found, name) == pytest.approx(getattr(true, name), rel=aim), name


def test_a_locked_shaft_has_no_flux(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "plant.toml").write_text("# of a run before\n")
    assert main(["identify", "--locked", "--level", "ideal", "--out", str(tmp_path)]) == 1
    captured = capsys.readouterr()
    assert "held" in captured.err
    assert not (tmp_path / "plant.toml").exists()
    content = json.loads((tmp_path / "estimates.json").read_text())
    assert "r_s" in content["estimates"]
    assert not {"psi_m", "inertia", "friction", "l_d", "l_q"} & set(content["estimates"])


@pytest.mark.parametrize(
    ("reason", "voltage", "what"),
    [
        ("swap its lines", 24.0, "reverse"),
        ("encoder is dead", 24.0, "no encoder"),
        ("winding is open", 24.0, "no motor"),
        ("in one direction only", 24.0, "stops"),
        ("correct --voltage", 48.0, ""),
    ],
)
def test_what_cannot_be_measured_is_named(reason: str, voltage: float, what: str) -> None:
    def prepare(board: Board) -> None:
        if what == "reverse":
            board.reverse_encoder(0)
        elif what == "no encoder":
            board.connect_encoder(0, False)
        elif what == "no motor":
            board.connect_motor(0, False)
        elif what == "stops":
            board.obstruct_shaft(0, 3.0, 3.0)

    limits = Limits(voltage, 4.0)
    log, problem = measure_virtual(PlantConfig.load(), 0, limits, servo_table(), level="ideal", seed=1, prepare=prepare)
    assert reason in problem
    result = identified(log, PlantConfig.load(), problem, level="ideal")
    assert result.refinement is None
    assert result.problems[0] == problem
    assert "psi_m" not in result.estimates.values


def test_a_board_is_left_as_it_was_found() -> None:
    names = ["config.checksum", "param.features", "param.i_q_limit", "param.faults_enabled", "param.command_timeout"]
    with Board(PlantConfig.load(), seed=1, level="ideal") as board:
        board.lock_shaft(0)
        board.run(0.05)
        before = [board.read_raw(name) for name in names]
        with pytest.raises(MeasurementError, match="held"):
            MotorTest(VirtualBoardAccess(board), 0, LIMITS, servo_table()).run()
        board.run(0.05)
        assert [board.read_raw(name) for name in names] == before
        assert board.read("axis1.state") == board.catalogue.enums["state_t"]["STOP"]


def test_random_motors_are_the_same_for_a_seed() -> None:
    plant = PlantConfig.load()
    assert random_motor(plant, 0, 5) == random_motor(plant, 0, 5)
    assert random_motor(plant, 0, 5) != random_motor(plant, 0, 6)
    assert random_motor(plant, 0, 5).axes[1] == plant.axes[1]


def test_false_success_is_counted() -> None:
    good = Trial(dict.fromkeys(AIMS, 0.01), dict.fromkeys(AIMS, True), 20.0, (), "")
    far = Trial({**dict.fromkeys(AIMS, 0.01), "psi_m": 0.2}, dict.fromkeys(AIMS, False), 20.0, (), "")
    told = Trial({**dict.fromkeys(AIMS, 0.01), "psi_m": 0.2}, dict.fromkeys(AIMS, False), 20.0, ("psi_m",), "")
    assert [one.false_success for one in (good, far, told)] == [False, True, False]
    text = "\n".join(summary([(0, good), (1, far), (2, told)]))
    assert "3 motors: 2 identified, 1 not" in text
    assert "false success: 1 (motors 1)" in text
