"""The board ODrive v3.6: the ELF file of its firmware on the model of the STM32F405."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
import serial
from servo_msgs_py.board_description import VARIABLE, BoardDescription
from servo_msgs_py.board_port import choose, place
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.runtime.end_with_parent import with_parent_death_signal
from servo_msgs_py.text_file import read_toml
from servo_twin._build_native import generated_for
from servo_twin.board import Board, BoardError
from servo_twin.board_memory import BUSY
from servo_twin.cli import main as servo_sim
from servo_twin.fault_injection import HotPowerStage, ShortedPhase, StalledCore, StuckConverter
from servo_twin.level import ELF_VARIABLE, LEVEL_VARIABLE, LEVELS, Level
from servo_twin.plant import DEFAULT_FILE, PlantConfig, on_board
from servo_twin.simulation import keep_set_points
from servo_twin.validation.experiments.named_faults import has_fault
from targets.sources import ROOT
from targets.toolchain import run
from test_board_elf import planted, symbol

ODRIVE = BoardDescription.load("odrive36")
MS = 1_000_000
ADC2_JSQR, TIM2_CCR3, TIM5_CNT = 0x4001_2138, 0x4000_003C, 0x4000_0C24
INTERRUPTS = {18: "ADC", 23: "EXTI9_5", 40: "EXTI15_10", 58: "DMA2_STREAM2"}
GET_TABLE = bytes.fromhex("2B 29 01 00 6C")  # FreeMASTER v4 GETTSAINFO of table 0


class Sources:
    """A copy of the firmware in which errors can be planted, with its objects."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        shutil.copytree(ROOT / "firmware", folder / "firmware", ignore=shutil.ignore_patterns("build", "test"))
        generated = generated_for("odrive36", folder / "generated")
        settings = ["BOARD=odrive36", f"GENERATED={generated}", f"BUILD={folder / 'build'}"]
        self._make: list[str | Path] = ["make", "--silent", "-j2", "-C", folder / "firmware" / "port", *settings]

    def program(self, *changes: tuple[str, str, str]) -> bytes:
        """ELF file with changes: file of the port, text, other text."""
        before: dict[Path, str] = {}
        for name, old, new in changes:
            path = self._folder / "firmware" / "port" / "stm32f405" / name
            text = path.read_text()
            assert text.count(old) == 1
            before.setdefault(path, text)
            path.write_text(text.replace(old, new))
        try:
            run(self._make)
            return (self._folder / "build" / "servo.elf").read_bytes()
        finally:
            for path, text in before.items():
                path.write_text(text)


@pytest.fixture(scope="module")
def sources(cortex_m4_tools: None, tmp_path_factory: pytest.TempPathFactory) -> Sources:
    return Sources(tmp_path_factory.mktemp("odrive36"))


@pytest.fixture(scope="module")
def elf(sources: Sources) -> bytes:
    return sources.program()


def new_board(elf: bytes | None, flash: bytes | None = None, **changes: float) -> Board:
    """At level registers with an ELF file, else at level ideal."""
    plant = PlantConfig.parse(on_board(read_toml(DEFAULT_FILE), ODRIVE))
    for axis in (0, 1):
        plant = plant.with_axis(axis, **changes)
    level: Level = "registers" if elf else "ideal"
    return Board(plant, seed=3, level=level, catalogue=Catalogue.load(board=ODRIVE), elf=elf, flash=flash)


@pytest.fixture(params=LEVELS)
def software(request: pytest.FixtureRequest) -> bytes | None:
    """ELF file of level registers; None: level ideal."""
    return request.getfixturevalue("elf") if request.param == "registers" else None


@pytest.fixture
def board(elf: bytes) -> Iterator[Board]:
    with new_board(elf) as made:
        yield made


def enabled(board: Board) -> Board:
    """Both rotors found, each axis holding its position."""
    keep_set_points(board)
    board.run(0.02)
    board.write("cmd.enable", [1, 1])
    board.advance(560 * MS)
    return board


def test_serial_line_answers(board: Board) -> None:
    """Bytes through USART2 and both DMA streams: status, address and size of the table of variables."""
    board.run(0.02)
    board.serial_in(GET_TABLE)
    board.run(0.02)
    answer = board.serial_out()
    assert answer[:3] == b"+\x40\x07"
    assert len(answer[1:].replace(b"++", b"+")) == 10  # a start byte within the data is sent twice


def test_both_axes_move(software: bytes | None) -> None:
    """From the reset vector: gate drivers, rotor search, position; currents by two shunts; nothing is late."""
    with enabled(new_board(software)) as board:
        _move_both(board)


def _move_both(board: Board) -> None:
    before = [board.truth(axis).theta_m for axis in (0, 1)]
    board.write("cmd.position", [3.0, -2.0])
    board.advance(1000 * MS)
    moved = [board.truth(axis).theta_m - before[axis] for axis in (0, 1)]
    assert moved == pytest.approx([3.0, -2.0], abs=0.01)
    assert board.read("late_loops") == 0
    assert [board.read(f"axis{k}.faults") for k in (1, 2)] == [0, 0]
    assert board.read("u_dc") == pytest.approx(24.1, abs=0.15)  # braking has charged it


def faults(board: Board) -> list[list[str]]:
    read = (board.read_words(f"axis{k}.faults")[0] for k in (1, 2))
    return [[flag.name for flag in board.catalogue.active("faults", word)] for word in read]


def test_an_over_current_is_latched_in_the_gate_driver(software: bytes | None) -> None:
    """The driver of motor 1 opens its own gates; by the common line the other inverter opens, too."""
    with enabled(new_board(software)) as board:
        board.set_plant("axis1.i_break", 0.3)
        board.write("cmd.position", [3.0, 0.0])
        board.run(0.05)
        assert board.stats().breaks > 0
        assert faults(board) == [["OVER_CURRENT"]] * 2
        assert all(abs(board.truth(axis).i_q) < 1e-6 for axis in (0, 1))


def test_a_short_opens_both_inverters(software: bytes | None) -> None:
    with enabled(new_board(software)) as board:
        board.inject(ShortedPhase(0, "a"))
        board.write("cmd.position", [3.0, 0.0])
        board.run(0.01)
        assert faults(board) == [["OVER_CURRENT"]] * 2


def test_the_port_limits_the_current_beyond_the_gate_drivers(software: bytes | None) -> None:
    """A sample of more than 30 A: the switches of this axis open."""
    with enabled(new_board(software, i_break=1e3)) as board:
        board.inject(StuckConverter(0, "b", 2048 + 1520))
        board.run(0.002)
        assert faults(board) == [["OVER_CURRENT"], []]


def test_a_blocked_shaft_is_named(software: bytes | None) -> None:
    """By some hundredths of a volt, not as a dead encoder: the switches of the plant are those of the board."""
    with new_board(software) as board:
        board.lock_shaft(0)
        keep_set_points(board)
        board.run(0.02)
        board.write("cmd.enable", [1, 0])
        board.run(0.9)
        assert faults(board) == [["ROTOR_SEARCH"], []]


@pytest.mark.parametrize(("celsius", "expected"), [(84.0, []), (86.0, ["OVER_TEMPERATURE"])])
def test_the_thermistors(software: bytes | None, celsius: float, expected: list[str]) -> None:
    """The limit of the configuration is 85 deg C."""
    with new_board(software) as board:
        board.inject(HotPowerStage(0, celsius))
        board.run(0.1)
        assert faults(board) == [expected, []]


@pytest.mark.parametrize("function", ["hal_adc_currents", "hal_pwm_duty", "adc_take_m2"])
def test_a_planted_error_is_a_fault(elf: bytes, tmp_path: Path, function: str) -> None:
    """A driver that does nothing."""
    with enabled(new_board(planted(elf, tmp_path, function, b"\x70\x47"))) as wrong:
        wrong.write("cmd.position", [3.0, -2.0])
        wrong.advance(800 * MS)
        assert wrong.read("axis1.faults") or wrong.read("axis2.faults")


def test_an_exception_during_the_start_ends_in_a_reset(elf: bytes, tmp_path: Path) -> None:
    """A jump to the handler before the watchdog is set up: it runs with its reset values, 512 ms."""
    file = tmp_path / "servo.elf"
    file.write_bytes(elf)
    padding = b"\x00\xbf" if symbol(file, "gate_start") & 2 else b""  # nop: the address is aligned
    jump = b"\x00\x48\x00\x47" + (symbol(file, "unexpected") | 1).to_bytes(4, "little")  # ldr r0, [pc]; bx r0
    with new_board(planted(elf, tmp_path, "gate_start", padding + jump)) as board:
        board.run(0.1)
        assert board.peek(TIM2_CCR3) == 0
        before = board.peek(TIM5_CNT)  # since the start of the clocks
        board.run(0.5)
        assert 0 < board.peek(TIM5_CNT) < before


def _answers(board: Board) -> set[int]:
    """Statuses of what the host does with variables of the software: read, write, sample, set an estimate."""
    current = board.catalogue["axis1.i_q"]
    accesses: list[Callable[[], object]] = [
        lambda: board.read("axis1.faults"),
        lambda: board.write("cmd.enable", [0, 0]),
        lambda: board.sample(0, [(current, 0)], 10),
        lambda: board.set_winding(0, 25.0),
    ]
    statuses = set()
    for access in accesses:
        try:
            access()
            statuses.add(0)
        except BoardError as error:
            statuses.add(error.status)
    return statuses


def test_a_board_that_starts_again_is_busy(elf: bytes) -> None:
    """Reset by the watchdog: no function of the program is called before its start-up code has filled the memory."""
    with enabled(new_board(elf)) as board:
        board.inject(StalledCore(0.2))
        seen: list[set[int]] = []
        while board.time_ns < 700 * MS:
            board.run(0.0005)
            answers = _answers(board)
            board.end_sampling()
            assert has_fault(board, 0) == (answers == {0} and faults(board)[0] != [])
            if not seen or answers != seen[-1]:
                seen.append(answers)
                with board.copy() as other:
                    assert _answers(other) == answers
        assert seen == [{0}, {BUSY}, {0}]
        assert faults(board) == [["WATCHDOG"], ["WATCHDOG"]]


def test_a_record_has_the_ticks_of_the_software_that_runs(elf: bytes) -> None:
    """Not the memory of the software that a reset has ended, nor that of the next one before its first tick."""
    with enabled(new_board(elf)) as board:
        board.inject(StalledCore(0.2))
        ticks = board.record(700 * MS)["tick"]
    assert ticks.tolist() == list(range(8, 8 * len(ticks) + 8, 8))
    assert len(ticks) > 100


def test_a_brown_out_ends_in_a_board_at_rest(elf: bytes) -> None:
    """Nothing drives the motors from the first instant; the software starts as at power-on and waits for the host."""
    with enabled(new_board(elf)) as board:
        for axis in (0, 1):
            choose(board, "cmd.mode", axis, "SPEED")
        board.write("cmd.speed", [100.0, -100.0])
        board.run(0.2)
        services = board.stats().watchdog_services
        assert abs(board.truth(0).omega_m) > 90.0
        began = board.time_ns
        board.brown_out(0.05)
        board.run(0.045)
        assert [board.truth(axis).i_q for axis in (0, 1)] == pytest.approx([0.0, 0.0], abs=1e-6)
        assert board.stats().watchdog_services == services
        board.serial_in(GET_TABLE)
        while _answers(board) == {BUSY}:
            board.run(0.001)
            with board.copy() as other:
                assert _answers(other) == _answers(board)
        assert 70 * MS < board.time_ns - began < 90 * MS  # the gate drivers take 20 ms
        assert board.serial_out() == b""
        speed = board.truth(0).omega_m
        board.run(0.1)
        assert faults(board) == [[], []]
        assert [place(board, axis) for axis in (0, 1)] == ["STOP", "STOP"]
        assert 0.0 < board.truth(0).omega_m < speed
        board.serial_in(GET_TABLE)
        board.run(0.02)
        assert board.serial_out()[:3] == b"+\x40\x07"


def test_a_brown_out_in_a_save_leaves_the_stored_values(board: Board) -> None:
    board.run(0.05)
    board.write("storage.request", [1, 7])
    board.run(0.5)
    board.write("storage.request", [1, 8])
    board.run(0.1)
    assert board.read("storage.state") != 0
    board.brown_out(0.0)
    board.run(0.1)
    assert board.read("storage.source") == 1
    assert faults(board) == [[], []]


def test_a_brown_out_needs_the_executed_chip() -> None:
    with new_board(None) as board:
        with pytest.raises(BoardError, match="odrive36 that executes an ELF file"):
            board.brown_out(0.1)
        with pytest.raises(ValueError, match="at least 0"):
            board.brown_out(-1.0)


# ---- the fault matrix ----------------------------------------------------------------------------------------------

MATRIX = {
    ("open phase b", "100 rad/s"): ("PHASE_LOST", True),
    ("phase a to minus", "-250 rad/s"): ("OVER_CURRENT", False),  # the common line opens axis 2 as well
    ("converter b at 0", "torque"): ("OVER_CURRENT", True),  # beyond the 30 A of the port
    ("encoder line A", "FREEWHEEL"): ("ENCODER_LOST", True),
    ("supply gone", "torque"): ("UNDER_VOLTAGE", True),
    ("core hangs", "20 rad/s"): ("WATCHDOG", True),
    ("noise x 3", "-250 rad/s"): ("", True),
}
"""Each kind of fault in a state: reported fault, and whether the other axis is as expected."""

CASES = """
import json, sys
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments.fault_matrix import case, fault_cases

plant = PlantConfig.load()
named = {fault_case.name: fault_case for fault_case in fault_cases(plant)}
for name, state in json.load(sys.stdin):
    found = case(plant, 7, named[name], state)
    late = found.periods is None or found.periods > (named[name].periods_max or 10_000)
    print(json.dumps([found.name, found.other, found.gained <= found.gain_max, late]))
"""


@pytest.fixture(scope="module")
def matrix(elf: bytes, tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, str], list[object]]:
    """Cases of the experiment, executed from the file: fault, other axis, no motion afterwards, detected late."""
    command, environment = [sys.executable, "-c", CASES], environment_of(elf, tmp_path_factory.mktemp("matrix"))
    text = json.dumps(list(MATRIX))
    done = subprocess.run(command, input=text, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    return dict(zip(MATRIX, map(json.loads, done.stdout.splitlines()), strict=True))


@pytest.mark.parametrize("place", MATRIX, ids=", ".join)
def test_a_fault_of_the_matrix(matrix: dict[tuple[str, str], list[object]], place: tuple[str, str]) -> None:
    name, other = MATRIX[place]
    assert matrix[place] == [name, other, True, name == ""]


# ---- errors planted in the sources of the port ---------------------------------------------------------------------

SWAPPED = (
    ("settings.h", "#define PRIORITY_STAMP 1U", "#define PRIORITY_STAMP 2U"),
    ("settings.h", "#define PRIORITY_LOOPS 2U", "#define PRIORITY_LOOPS 1U"),
)
BEGIN = "    const uint32_t base = hal->axis[axis].pwm;\n"
LATE = ("pwm.c", BEGIN, f"    wait_clocks(hal, 3500U);\n{BEGIN}")
HIDDEN = ("pwm.c", "hal->axis[axis].behind = down != (axis == M1);", "(void)down;")


def priorities(program: bytes) -> dict[str, int]:
    """Priorities of the interrupts in a motion, as a trace shows them."""
    with enabled(new_board(program)) as board:
        board.write("cmd.position", [3.0, -2.0])
        board.run(0.03)
        log = board.trace(board.time_ns + 10 * MS)
    entered = log[log["kind"] == 8]
    return {INTERRUPTS[int(entry["a"])]: int(entry["b"]) >> 4 for entry in entered}


def test_a_trace_shows_the_priorities_of_the_interrupts(elf: bytes, sources: Sources) -> None:
    """The table in the document of the port; swapped, the loops interrupt the stamp of an edge."""
    expected = {"ADC": 2, "DMA2_STREAM2": 2, "EXTI9_5": 1, "EXTI15_10": 3}
    assert priorities(elf) == expected
    assert priorities(sources.program(*SWAPPED)) == expected | {"ADC": 1, "DMA2_STREAM2": 1, "EXTI9_5": 2}


def test_duties_that_are_written_late_are_named(sources: Sources) -> None:
    with enabled(new_board(sources.program(LATE))) as board:
        assert board.read_words("late_loops")[0] > 0
        assert faults(board) == [["LATE_LOOP"], ["LATE_LOOP"]]


@pytest.mark.parametrize("changes", [SWAPPED, (LATE, HIDDEN)], ids=["priorities", "late duties, not counted"])
def test_the_twin_shows_an_error_that_is_no_fault(
    elf: bytes, sources: Sources, tmp_path: Path, changes: Sequence[tuple[str, str, str]]
) -> None:
    """The residual of a twin with the right program is 0 otherwise (above)."""
    (wrong := tmp_path / "wrong.elf").write_bytes(sources.program(*changes))
    assert differences_of_the_twin(elf, tmp_path, "7", str(wrong)) > 100


def test_a_wrong_converter_input_is_a_fault(elf: bytes) -> None:
    """Phase b of motor 1 and the offset of motor 2 exchanged: inputs 10 and 13 of ADC2's injected sequence."""
    right, wrong = (
        (1 << 20 | first << 10 | second << 15).to_bytes(4, "little") for first, second in ((10, 13), (13, 10))
    )
    with enabled(new_board(elf.replace(right, wrong))) as board:
        assert board.peek(ADC2_JSQR) == int.from_bytes(wrong, "little")
        assert board.read("axis1.faults") or board.read("axis2.faults")


def test_variables_are_sampled_at_the_end_of_their_loops(board: Board) -> None:
    """Every slow tick and every PWM period, as by the recorder of the firmware, but without its time."""
    enabled(board)
    elements = [(board.catalogue[name], 0) for name in ("tick", "axis1.position", "axis1.i_q")]
    board.write("cmd.position", [3.0, -2.0])
    board.sample(1, elements, 1000)
    log = board.record(600 * MS)
    sampled = board.sampled()
    assert sampled["tick[0]"].tolist() == log["tick"].tolist()
    assert sampled["axis1.position[0]"].tolist() == log["axis1.position"].tolist()
    assert len(set(sampled["axis1.position[0]"].tolist())) > 50
    with pytest.raises(BoardError, match="end the sampling"):
        board.state()
    board.sample(0, elements, 200)  # the last ones are kept
    board.run(0.02)
    periods = board.sampled()["tick[0]"]
    assert len(periods) == 200
    assert set(np.diff(periods)) == {1}
    board.end_sampling()
    with pytest.raises(BoardError, match="not inside one variable"):
        board.sample(0, [(elements[0][0], 10_000)], 200)


TWIN = """
import os
from servo_twin.level import ELF_VARIABLE
from twin_rig import TwinRig

seed, *other = input().split()
with TwinRig(real_seed=7, twin_seed=7) as rig:
    if other:
        program = os.environ.get(ELF_VARIABLE, "")
        os.environ[ELF_VARIABLE] = other[0]
    rig.reset_board(int(seed))
    if other:
        os.environ[ELF_VARIABLE] = program
    rig.enable_axes()
    rig.move([3.0, -2.0])
    assert rig.board.catalogue.board.name == "odrive36" and rig.twin.synchronisations == 1
    assert max(pair.real["axis1.position"] for pair in rig.pairs) > 15.0
    differences = sum(value != pair.real[name] for pair in rig.pairs for name, value in pair.twin.items())
    print(rig.board.level, bool(rig.board.elf_sha256), len(rig.pairs) > 150, differences)
"""


def differences_of_the_twin(software: bytes | None, folder: Path, *board: str) -> int:
    """Numbers of the telemetry that differ in a move; `board`: its seed, and its ELF file if it has another."""
    environment = environment_of(software, folder) | {"PYTHONPATH": str(ROOT / "servo_twin" / "test")}
    command = [sys.executable, "-c", TWIN]
    done = subprocess.run(command, input=" ".join(board), capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    level, has_elf, compared, differences = done.stdout.split()
    assert (level, has_elf, compared) == ("registers" if software else "ideal", str(software is not None), "True")
    return int(differences)


@pytest.mark.parametrize("seed", [7, 8])
def test_the_twin_of_a_board_with_the_same_software_has_no_residual(
    software: bytes | None, tmp_path: Path, seed: int
) -> None:
    """The same ELF file, or the linked firmware: every bit of the telemetry; with other noise it is not."""
    assert (differences_of_the_twin(software, tmp_path, str(seed)) == 0) == (seed == 7)


def environment_of(software: bytes | None, folder: Path) -> dict[str, str]:
    """Environment of a process with this board."""
    if software is None:
        return {**os.environ, VARIABLE: "odrive36", LEVEL_VARIABLE: "ideal"}
    (program := folder / "servo.elf").write_bytes(software)
    kept = {name: value for name, value in os.environ.items() if name != LEVEL_VARIABLE}
    return {**kept, VARIABLE: "odrive36", ELF_VARIABLE: str(program)}


def test_servo_sim_executes_the_file(elf: bytes, tmp_path: Path) -> None:
    environment = environment_of(elf, tmp_path)
    file = environment.pop(ELF_VARIABLE)
    move = ["move", "--elf", file, "--turns", "0.5", "--time", "0.3", "--json"]
    command = [sys.executable, "-m", "servo_twin.cli", *move]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    assert [abs(one["target"] - one["reached"]) <= 2 for one in json.loads(done.stdout)["moves"]] == [True, True]


@pytest.mark.parametrize(
    ("options", "text"), [(["--level", "ideal"], "runs at level registers only"), ([], "No such file")]
)
def test_a_file_that_cannot_be_executed_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path, options: list[str], text: str
) -> None:
    monkeypatch.delenv(LEVEL_VARIABLE, raising=False)
    monkeypatch.setenv(ELF_VARIABLE, "")  # restored afterwards
    assert servo_sim(["move", "--elf", str(tmp_path / "none.elf"), *options]) == 2
    assert text in capsys.readouterr().err


def test_the_board_needs_its_program() -> None:
    with pytest.raises(BoardError, match=r"ELF file .* or level ideal"):
        Board(level="registers", catalogue=Catalogue.load(board=ODRIVE))


def test_the_program_simulates_the_board_of_the_environment(elf: bytes, tmp_path: Path) -> None:
    (program := tmp_path / "servo.elf").write_bytes(elf)
    command = with_parent_death_signal([sys.executable, "-m", "servo_twin.virtual_board", "--elf", str(program)])
    environment = {**os.environ, VARIABLE: "odrive36"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        try:
            assert process.stdout is not None
            port = re.search(r"/dev/pts/\d+", process.stdout.readline())
            assert port is not None
            with serial.Serial(port[0], 115200, timeout=20.0) as client:
                client.write(GET_TABLE)
                assert client.read(3) == b"+\x40\x07"
        finally:
            process.terminate()


CONTACTS = """
from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments.pins import fit, wired
with Board(wired(PlantConfig.load(), home_from=-9.0, home_to=9.0)) as board:
    board.run(0.02)
    fit(board, "home", "enable")
    for axis in ("axis1", "axis2"):
        print(*(flag.name for flag in board.catalogue.active("inputs", board.read_words(f"{axis}.inputs")[0])))
"""


@pytest.mark.parametrize("level", LEVELS)
def test_contacts_are_read_that_were_closed_before_the_start(elf: bytes, tmp_path: Path, level: Level) -> None:
    program = tmp_path / "servo.elf"
    program.write_bytes(elf)
    environment = {**os.environ, VARIABLE: "odrive36", LEVEL_VARIABLE: level}
    if level == "registers":
        environment[ELF_VARIABLE] = str(program)
    command = [sys.executable, "-c", CONTACTS]
    seen = subprocess.run(command, env=environment, check=True, capture_output=True, text=True, timeout=120.0)
    assert seen.stdout.splitlines() == ["HOME ENABLE"] * 2


def test_a_save_stalls_no_loop_and_loses_no_byte(elf: bytes, board: Board) -> None:
    """Nothing is fetched from the flash while it is erased (250 ms). Another board starts with the stored values."""
    board.run(0.05)
    assert board.read("tick") == 800
    services = board.stats().watchdog_services
    board.write("storage.request", [1, 7])
    board.run(0.1)
    assert board.read("storage.state") != 0  # the erase of the sector
    board.serial_in(GET_TABLE)
    board.run(0.32)
    assert board.serial_out()[:3] == b"+\x40\x07"  # behind the erase
    assert board.read("tick") == 800 + 6720
    assert board.stats().watchdog_services - services == 840
    assert board.read("late_loops") == 0
    assert (board.read("storage.answered"), board.read("storage.refusal"), board.read("storage.saves")) == (7, 0, 1)
    with new_board(elf, board.flash_image()) as other:
        other.run(0.01)
        assert board.read("storage.source") == 0
        assert other.read("storage.source") == 1
