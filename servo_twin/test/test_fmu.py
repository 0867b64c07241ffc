"""The exported FMU in FMPy: a valid file, the bits of the native board, states, refusals."""

from __future__ import annotations

import math
import random
import struct
import subprocess
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import pytest
from servo_twin.board import Board
from servo_twin.fault_injection import CurrentNoise, OpenPhase
from servo_twin.fmu import export_fmu
from servo_twin.plant import PlantConfig
from servo_twin.simulation import keep_set_points

pytest.importorskip("fmpy", reason="what FMPy needs has no wheels for Python 3.10")

from fmpy.fmi3 import FMU3Slave
from fmpy.model_description import ModelDescription, read_model_description
from fmpy.validation import validate_fmu
from fmuloader.fmi3 import Fmi3Slave

SEED: Final = 3
PERIOD_NS: Final = 62_500
NOISE: Final = CurrentNoise(0, 0.1)
PLANT: Final = PlantConfig.load().with_axis(0, theta_start=0.5, friction=3e-3, load_torque=1e-4, disc_phase=0.3)


def unpacked(path: Path) -> Path:
    """Folder with the contents of an FMU."""
    folder = path.with_suffix("")
    with zipfile.ZipFile(path) as file:
        file.extractall(folder)
    return folder


def packed(numbers: Sequence[float]) -> bytes:
    """Bits of numbers."""
    return struct.pack(f"<{len(numbers)}d", *numbers)


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The file, and a folder with its contents."""
    folder = tmp_path_factory.mktemp("fmu")
    export_fmu(folder / "board.fmu", PLANT, SEED)
    return folder / "board.fmu", unpacked(folder / "board.fmu")


@pytest.fixture(scope="module")
def description(exported: tuple[Path, Path]) -> ModelDescription:
    return read_model_description(str(exported[0]))


class Instance:
    """One FMU instance, with variables by name."""

    def __init__(self, contents: Path, description: ModelDescription) -> None:
        self.messages: list[str] = []
        self.slave = FMU3Slave(
            guid=description.guid,
            unzipDirectory=str(contents),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="board",
        )
        self.slave.instantiate(
            logMessage=lambda _environment, _status, _category, text: self.messages.append(str(text))
        )
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self.outputs = [v.valueReference for v in description.modelVariables if v.causality == "output"]
        self.time_ns = 0

    def start(self) -> None:
        self.slave.enterInitializationMode(startTime=0.0)
        self.slave.exitInitializationMode()

    def set(self, name: str, value: float) -> None:
        self.slave.setFloat64([self.references[name]], [value])

    def get(self, name: str) -> float:
        return float(self.slave.getFloat64([self.references[name]])[0])

    def step(self, periods: float) -> None:
        self.slave.doStep(self.time_ns * 1e-9, periods * PERIOD_NS * 1e-9)
        self.time_ns += round(periods * PERIOD_NS)

    def everything(self) -> bytes:
        """The bits of all outputs."""
        return packed(self.slave.getFloat64(self.outputs))


@pytest.fixture
def fmu(exported: tuple[Path, Path], description: ModelDescription) -> Iterator[Instance]:
    instance = Instance(exported[1], description)
    yield instance
    instance.slave.freeInstance()


def command(target: Any) -> list[tuple[int, Any]]:
    """Inputs of a board or an FMU by PWM period."""
    if isinstance(target, Instance):
        return [
            (320, lambda: target.set("axis1.cmd.enable", 1.0)),
            (320, lambda: target.set("axis2.cmd.enable", 1.0)),
            (9600, lambda: target.set("axis1.cmd.position", 6.0)),
            (9600, lambda: target.set("axis2.cmd.position", -3.0)),
            (10400, lambda: target.set("axis1.torque", -0.05)),
            (11200, lambda: target.set("supply.u_source", 20.0)),
            (12000, lambda: target.set("axis2.motor_unplugged", 1.0)),
            (12400, lambda: target.set("axis1.fault.current_noise", 0.1)),
            (12800, lambda: target.set("axis1.fault.current_noise", 0.0)),
            (13000, lambda: target.set("axis1.fault.open_phase_b", 1.0)),
        ]
    return [
        (320, lambda: target.write("cmd.enable", [1, 1])),
        (9600, lambda: target.write("cmd.position", [6.0, -3.0])),
        (10400, lambda: target.set_load(0, 0.05)),
        (11200, lambda: target.set_supply(20.0)),
        (12000, lambda: target.connect_motor(1, False)),
        (12400, lambda: target.inject(NOISE)),
        (12800, lambda: target.clear_fault(NOISE)),
        (13000, lambda: target.inject(OpenPhase(0, "b"))),
    ]


def expected(board: Board, description: ModelDescription) -> list[float]:
    """Outputs of the FMU from the native board."""
    truths = {axis: board.truth(axis)._asdict() for axis in (0, 1)}
    values = []
    for variable in description.modelVariables:
        if variable.causality == "output":
            part, _, rest = variable.name.partition(".")
            if part == "truth":
                values.append(truths[int(rest[4]) - 1][rest[6:]])
            else:
                entry = board.catalogue[variable.name]
                values.append(float(board.read_words(variable.name)[0] * float(entry.lsb)))
    return values


def test_file_is_valid(exported: tuple[Path, Path]) -> None:
    assert validate_fmu(str(exported[0])) == []


def test_every_bit_is_that_of_the_native_board(fmu: Instance, description: ModelDescription) -> None:
    draw = random.Random(1)
    with Board(PLANT, seed=SEED, level="ideal") as board:
        keep_set_points(board)
        fmu.start()
        inputs = [*command(board), *command(fmu)]
        while fmu.time_ns < 14_000 * PERIOD_NS:
            period = fmu.time_ns // PERIOD_NS
            for _, apply in (one for one in inputs if one[0] == period):
                apply()
            upcoming = [at - period for at, _ in inputs if at > period]
            fmu.step(min(draw.randrange(1, 40), *upcoming) if upcoming else draw.randrange(1, 40))
            board.advance(fmu.time_ns)
            assert fmu.everything() == packed(expected(board, description))
        assert board.read("axis1.position") != 0


def test_another_importer_gets_the_same_bits(
    fmu: Instance, exported: tuple[Path, Path], description: ModelDescription
) -> None:
    other = Fmi3Slave(exported[1], model_identifier=description.coSimulation.modelIdentifier)
    other.instantiate_co_simulation("other", instantiation_token=description.guid)
    fmu.start()
    other.enter_initialization_mode()
    other.exit_initialization_mode()
    for name in ("axis1.cmd.enable", "axis2.cmd.enable", "axis1.torque"):
        fmu.set(name, 1.0)
        other.set_float64([fmu.references[name]], [1.0])
    for _ in range(20):
        other.do_step(fmu.time_ns * 1e-9, 160 * PERIOD_NS * 1e-9)
        fmu.step(160)
        assert packed(other.get_float64(fmu.outputs)) == fmu.everything()
    other.free_instance()


def test_parameters_have_value_start_and_unit_of_the_plant(fmu: Instance, description: ModelDescription) -> None:
    variables = {v.name: v for v in description.modelVariables}
    parts = {"axis1": PLANT.axes[0].members(), "bus": vars(PLANT.bus)}
    numbers = {f"plant.{part}.{name}": value for part, values in parts.items() for name, value in values.items()}
    numbers |= {f"plant.axis1.i_offset_{k}": value for k, value in enumerate(numbers.pop("plant.axis1.i_offset"))}
    for name, value in numbers.items():
        assert (fmu.get(name), float(variables[name].start)) == (value, value), name
    assert (variables["plant.axis1.r_s"].unit, variables["truth.axis2.impulse_e"].unit) == ("ohm", "N m s")


def test_parameters_are_the_plant(fmu: Instance) -> None:
    assert fmu.get("axis2.param.i_q_limit") == pytest.approx(4.0, abs=1e-3)
    fmu.set("axis2.param.i_q_limit", 1.0)
    fmu.set("plant.axis2.theta_start", 1.25)
    for name, value in (
        ("axis1.r_s", 0.0),
        ("axis2.pole_pairs", 1.5),
        ("axis1.home_to", math.nan),
        ("bus.r_source", -1.0),
    ):
        with pytest.raises(Exception, match="fmi3"):
            fmu.set(f"plant.{name}", value)
        if value == value:
            assert f"{name.split('.')[-1]}: is outside of its range" in fmu.messages[-1]
    fmu.set("plant.axis1.home_to", math.inf)
    fmu.start()
    assert fmu.get("truth.axis2.theta_m") == 1.25
    fmu.set("axis2.cmd.enable", 1.0)
    fmu.set("axis2.cmd.mode", 1.0)
    fmu.step(9600)
    fmu.set("axis2.cmd.speed", 300.0)
    fmu.step(480)
    assert fmu.get("axis2.i_q_ref") == pytest.approx(1.0, abs=0.01)
    with pytest.raises(Exception, match="fmi3"):
        fmu.set("axis2.param.i_q_limit", 100.0)
    assert "axis2.param.i_q_limit: the firmware refuses the value" in fmu.messages[-1]


def test_parameter_of_the_plant_is_the_value_of_its_input(fmu: Instance) -> None:
    fmu.set("plant.bus.u_source", 28.0)
    fmu.set("plant.axis1.load_torque", 0.01)
    assert fmu.get("supply.u_source") == 28.0
    assert fmu.get("axis1.torque") == -0.01
    fmu.set("supply.u_source", 30.0)
    fmu.set("plant.bus.u_source", 29.0)  # the input is given
    fmu.start()
    fmu.step(1600)
    assert fmu.get("u_dc") == pytest.approx(30.0, abs=0.2)


def test_step_back_and_another_instance_continue_with_the_same_bits(
    fmu: Instance, exported: tuple[Path, Path], description: ModelDescription
) -> None:
    fmu.start()
    for name in ("axis1.cmd.enable", "axis2.cmd.enable"):
        fmu.set(name, 1.0)
    fmu.step(1603)
    state = fmu.slave.getFMUState()
    data = fmu.slave.serializeFMUState(state)
    fmu.step(2000)
    end, began = fmu.everything(), 1603 * PERIOD_NS
    fmu.slave.setFMUState(state)
    fmu.slave.freeFMUState(state)
    fmu.time_ns = began
    fmu.step(2000)
    assert fmu.everything() == end
    other = Instance(exported[1], description)
    other.slave.setFMUState(other.slave.deserializeFMUState(data))
    other.time_ns = began
    other.step(2000)
    assert other.everything() == end
    assert other.get("axis1.cmd.enable") == 1.0
    damaged = [data[:k] + bytes([data[k] ^ 1]) + data[k + 1 :] for k in range(0, 4000, 97)]
    for wrong in [data[:-1], *damaged]:
        with pytest.raises(Exception, match=r"fmi3(Deserialize|Set)FMUState"):
            other.slave.setFMUState(other.slave.deserializeFMUState(wrong))
    assert other.everything() == end
    other.slave.freeInstance()


def test_a_state_of_the_initialisation_is_restored_before_and_behind_its_end(fmu: Instance) -> None:
    fmu.slave.enterInitializationMode(startTime=0.0)
    state = fmu.slave.getFMUState()
    fmu.slave.setFMUState(state)
    fmu.slave.exitInitializationMode()
    fmu.step(1603)
    end = fmu.everything()
    fmu.slave.setFMUState(state)
    fmu.slave.exitInitializationMode()
    fmu.time_ns = 0
    fmu.step(1603)
    assert fmu.everything() == end
    with pytest.raises(Exception, match="fmi3ExitInitializationMode"):
        fmu.slave.exitInitializationMode()


@pytest.mark.parametrize("start", [0.123, 1e6])
def test_added_step_sizes_and_a_late_start_are_accepted(fmu: Instance, start: float) -> None:
    fmu.slave.enterInitializationMode(startTime=start)
    fmu.slave.exitInitializationMode()
    time = start
    for _ in range(3000):
        size = (time + 1e-3) - time  # as a master that knows points only
        fmu.slave.doStep(time, size)
        time += size
    assert fmu.get("tick") == 48000


def test_torque_beyond_any_motor_is_an_error_that_a_state_undoes(fmu: Instance) -> None:
    fmu.start()
    fmu.step(800)
    state = fmu.slave.getFMUState()
    fmu.set("axis1.torque", 1e6)
    with pytest.raises(Exception, match="fmi3DoStep"):
        fmu.step(1600)
    assert "faster than 20000 rad/s" in fmu.messages[-1]
    fmu.slave.setFMUState(state)
    fmu.step(1600)
    assert fmu.get("truth.axis1.omega_m") == 0.0


def test_calls_in_another_order_are_refused(fmu: Instance) -> None:
    with pytest.raises(Exception, match="fmi3ExitInitializationMode"):
        fmu.slave.exitInitializationMode()
    fmu.slave.enterInitializationMode(startTime=0.0)
    with pytest.raises(Exception, match="fmi3DoStep"):
        fmu.step(16)
    fmu.slave.exitInitializationMode()
    fmu.time_ns = 0
    fmu.step(16)
    fmu.slave.terminate()
    with pytest.raises(Exception, match="fmi3DoStep"):
        fmu.step(16)
    fmu.slave.reset()
    fmu.start()
    fmu.time_ns = 0
    fmu.step(16)


@pytest.mark.parametrize(
    ("mistake", "message"),
    [
        (lambda fmu: fmu.step(1.5), "communicationStepSize: is not a multiple of a PWM period"),
        (lambda fmu: fmu.slave.doStep(5e-3, 62.5e-6), "currentCommunicationPoint: is not the end of the last step"),
        (lambda fmu: fmu.set("axis1.torque", float("nan")), "axis1.torque: the value is not a number"),
        (lambda fmu: fmu.set("supply.u_source", float("inf")), "supply.u_source: the value is infinite"),
        (lambda fmu: fmu.slave.enterInitializationMode(), "fmi3EnterInitializationMode: comes after"),
        (lambda fmu: fmu.set("axis1.cmd.speed", 1e6), "axis1.cmd.speed: the firmware refuses"),
        (lambda fmu: fmu.set("axis1.fault.heat", -1.0), "axis1.fault.heat: is negative"),
        (lambda fmu: fmu.set("plant.axis1.r_s", 1.0), "plant.axis1.r_s: cannot be set now"),
        (lambda fmu: fmu.set("axis1.position", 1.0), "axis1.position: is no input"),
    ],
)
def test_mistake_is_refused_with_a_reason_and_changes_nothing(fmu: Instance, mistake: Any, message: str) -> None:
    fmu.start()
    fmu.step(100)
    before = fmu.everything()
    with pytest.raises(Exception, match="fmi3"):
        mistake(fmu)
    assert message in fmu.messages[-1]
    assert fmu.everything() == before
    fmu.step(1)


def test_binary_needs_no_python_and_the_sources_compile(exported: tuple[Path, Path]) -> None:
    contents = exported[1]
    (library,) = contents.glob("binaries/*/*.so")
    listed = subprocess.run(["ldd", library], capture_output=True, text=True, check=True).stdout
    assert "libc" in listed
    assert "python" not in listed
    sources = contents / "sources"
    include = [f"-I{sources / name}" for name in ("servo_twin/native", "firmware", "generated")]
    names = ("fmu/fmu.c", "exported/exported_board.c", "board_ideal_layout.c", "board_state.c")
    files = [sources / "servo_twin" / "native" / name for name in names]
    strict = ["-std=c99", "-fsyntax-only", "-Wall", "-Wextra", "-Wconversion", "-Werror"]
    subprocess.run(["cc", *strict, *include, *files], check=True)
