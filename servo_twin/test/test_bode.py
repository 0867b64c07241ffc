"""Loops measured on a running virtual board in simulated time, against the prediction of the tuning code."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import pytest
from servo_measurement.access import Capture, MeasurementError
from servo_measurement.bode import Bode, measure
from servo_measurement.bode_plan import LOOPS, BodeRequest, complete_settings, refuse_settings
from servo_measurement.bode_report import as_dict, draw, text
from servo_measurement.test_signal import end_test_signal
from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.axis_config_transfer import read_block, send_configuration
from servo_msgs_py.figure import PictureError
from servo_msgs_py.trace import Trace
from servo_tuning.reading import loads
from servo_twin.board import Board
from servo_twin.board_access import VirtualBoardAccess
from servo_twin.level import Level
from servo_twin.plant import PlantConfig
from servo_twin.servo_config import blocks_of_configuration
from servo_twin.simulation import enable
from servo_twin.validation.experiments.pins import fit

CONFIG: Final = Path(__file__).resolve().parents[2] / "firmware" / "config" / "servo.toml"

GAIN: Final = 0.02
"""Permitted relative deviation of the crossover from its prediction; the aim is 0.05."""

PHASE: Final = 1.5
"""Permitted deviation of the phase margin [degrees]; the aim is 3."""


@pytest.fixture(params=["ideal", "registers"])
def level(request: pytest.FixtureRequest) -> Level:
    return "ideal" if request.param == "ideal" else "registers"


@pytest.fixture
def access() -> Iterator[VirtualBoardAccess]:
    """A board with its outputs off."""
    with Board(level="ideal", seed=3) as board:
        board.run(0.1)
        yield VirtualBoardAccess(board)


def refuse_difference(bode: Bode) -> None:
    """Fail if prediction and measurement differ."""
    found, expected = bode.figures, bode.prediction.margins
    assert found.crossover is not None
    assert found.phase_margin is not None
    assert found.crossover.value == pytest.approx(expected.crossover, rel=GAIN)
    assert found.phase_margin.value == pytest.approx(expected.phase, abs=PHASE)
    assert found.crossover.sigma < 0.01 * found.crossover.value
    if found.gain_margin is not None:
        assert found.gain_margin.value == pytest.approx(expected.gain, rel=0.06)


def restored_values(access: VirtualBoardAccess) -> tuple[object, ...]:
    """Values that a measurement has to restore."""
    names = ("param.command_timeout", "param.i_q_limit", "param.speed_limit", "cmd.enable", "axis1.mode", "axis2.mode")
    return tuple(tuple(access.read(name)) for name in names)


@pytest.mark.parametrize("loop", LOOPS)
@pytest.mark.parametrize("axis", [0, 1])
def test_measured_loop_agrees_with_the_prediction(loop: str, axis: int, level: Level) -> None:
    with Board(level=level, seed=3) as board:
        board.run(0.1)
        access = VirtualBoardAccess(board)
        before = restored_values(access)
        bode = measure(access, BodeRequest(axis, loop), enable=True)
        refuse_difference(bode)
        assert bode.notes == ()
        assert restored_values(access) == before
        assert access.read(f"axis{axis + 1}.faults") == [0.0]
        assert access.read(f"axis{axis + 1}.test_point") == [0.0]
        assert access.read("late_loops") == [0.0]


def test_prediction_for_other_gains_and_the_speed_observer(access: VirtualBoardAccess) -> None:
    source = CONFIG.read_text(encoding="utf-8").replace("speed_bandwidth   = 75.0", "speed_bandwidth   = 40.0")
    blocks = blocks_of_configuration(loads(source, access.catalogue))
    block = read_block(access, 0)
    send_configuration(access, {0: AxisConfigTable.load().block(blocks[0])})
    half = measure(access, BodeRequest(0, "speed"), enable=True)
    refuse_difference(half)
    assert half.figures.crossover is not None
    assert half.figures.crossover.value < 50.0
    send_configuration(access, {0: block})
    observer = access.catalogue.flag("features", "SPEED_OBSERVER").mask
    words = access.read("param.features")
    access.write("param.features", [words[0] + observer, words[1]])
    observed = measure(access, BodeRequest(0, "position"), enable=True)
    assert observed.prediction.observed
    refuse_difference(observed)


def test_mode_of_an_enabled_axis_is_restored_at_rest() -> None:
    with Board(level="ideal", seed=3) as board:
        enable(board)
        access = VirtualBoardAccess(board)
        board.write("param.command_timeout", 0.25)
        access.write("cmd.mode", [access.catalogue.enums["control_mode_t"]["SPEED"]], 0)
        access.wait(0.2)
        before = restored_values(access)
        place = access.read("axis2.position")
        refuse_difference(measure(access, BodeRequest(0, "speed", speed=60.0, repeats=3)))
        access.wait(0.2)
        assert restored_values(access) == before
        assert abs(access.read("axis1.speed")[0]) < 1.0
        assert access.read("axis2.position") == pytest.approx(place, abs=0.01)


def test_interruption_stops_the_shaft() -> None:
    with Board(level="ideal", seed=3) as board:
        enable(board)
        access = VirtualBoardAccess(board)
        before = restored_values(access)

        def progress(_: str, done: int, __: int) -> None:
            if done:
                access.write("cmd.mode", [1.0], 0)
                access.write("cmd.speed", [100.0], 0)
                access.wait(0.2)
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            measure(access, BodeRequest(0, "position"), progress=progress)
        assert abs(access.read("axis1.speed")[0]) < 1.0
        assert restored_values(access) == before


def mode_of(access: VirtualBoardAccess, axis: int) -> str:
    return access.catalogue.label("control_mode_t", int(access.read(f"axis{axis + 1}.mode")[0]))


def set_mode(access: VirtualBoardAccess, axis: int, mode: str) -> None:
    access.write("cmd.mode", [access.catalogue.enums["control_mode_t"][mode]], axis)


def test_load_on_an_axis_in_torque_mode_is_held(access: VirtualBoardAccess) -> None:
    """Its set-point has expired: it holds its position; the old mode would start without current and drop the load."""
    enable(access.board)
    access.write("param.command_timeout", [0.5])
    set_mode(access, 0, "TORQUE")
    access.write("cmd.i_q", [0.0], 0)
    access.wait(1.0)
    access.board.set_load(0, 0.02)
    access.wait(1.0)
    messages: list[str] = []
    measure(access, BodeRequest(0, "speed", repeats=2), report=messages.append)
    start = access.board.truth(0).theta_m
    access.wait(0.5)
    assert access.board.truth(0).theta_m == pytest.approx(start, abs=0.05)
    assert mode_of(access, 0) == "POSITION"
    assert "axis1 holds its position in mode POSITION" in messages[-1]


def test_other_axis_still_stops_when_its_set_points_expire(access: VirtualBoardAccess) -> None:
    """The time-out of 0.5 s of the other axis also applies while the first axis is measured."""
    enable(access.board)
    access.write("param.command_timeout", [0.5])
    set_mode(access, 1, "SPEED")
    places: list[float] = []

    def progress(_: str, done: int, __: int) -> None:
        if done == 0:
            access.write("cmd.speed", [20.0], 1)
        places.append(access.board.truth(1).theta_m)

    measure(access, BodeRequest(0, "speed", repeats=2), progress=progress)
    assert 5.0 < places[1] - places[0] < 20.0 * 0.6
    assert places[-1] == pytest.approx(places[1], abs=0.1)


@pytest.mark.parametrize(
    "refused",
    [
        BodeRequest(0, "speed", speed=1000.0),
        BodeRequest(0, "speed", speed=-310.0),
        BodeRequest(0, "speed", speed=300.0, amplitude=1.9),
        BodeRequest(0, "speed", amplitude=3.0),
        BodeRequest(1, "current", amplitude=2.0),
        BodeRequest(0, "position", amplitude=400.0),
        BodeRequest(0, "position", amplitude=300.0, speed=100.0),
        BodeRequest(0, "position", amplitude=400.0, speed=400.0),
        BodeRequest(0, "position", f_min=0.05),
        BodeRequest(0, "speed", gain=0.01),
    ],
    ids=str,
)
def test_values_that_a_refusal_names_are_accepted(access: VirtualBoardAccess, refused: BodeRequest) -> None:
    with pytest.raises(MeasurementError) as caught:
        plan(access, refused)
    names = {"speed": "speed", "amplitude": "amplitude", "lowest frequency": "f_min"}
    found = re.findall(r"(speed|amplitude|lowest frequency) of at (?:most|least) ([\d.]+)", str(caught.value))
    assert found, caught.value
    changes: dict[str, Any] = {names[name]: float(value) for name, value in found}
    if refused.speed is not None and "speed" in changes:
        changes["speed"] = math.copysign(changes["speed"], refused.speed)
    plan(access, replace(refused, **changes))


@pytest.mark.parametrize("loop", ["speed", "position"])
def test_an_amplitude_is_named_for_a_measurement_at_standstill(access: VirtualBoardAccess, loop: str) -> None:
    """There is no lower speed than 0."""
    access.write("param.speed_limit", [8.0], 0)
    request = BodeRequest(0, loop, speed=0.0)
    with pytest.raises(MeasurementError, match="use an amplitude of at most") as caught:
        plan(access, request)
    amplitude = re.findall(r"at most ([\d.]+)", str(caught.value))[0]
    plan(access, replace(request, amplitude=float(amplitude)))


def plan(access: VirtualBoardAccess, request: BodeRequest) -> None:
    """Raise a `MeasurementError` if a measurement is not possible."""
    settings, _, bands = complete_settings(access, request)
    refuse_settings(access, request, settings, bands)


def test_measurement_beyond_the_limits_is_refused_without_motion(access: VirtualBoardAccess) -> None:
    place = access.read("axis1.position")
    for request, why in (
        (BodeRequest(0, "speed", speed=1000.0), "exceeds the limit of axis1"),
        (BodeRequest(0, "position", amplitude=400.0), "exceeds the limit of axis1"),
        (BodeRequest(0, "speed", amplitude=3.0), "too large for the limit of axis1"),
        (BodeRequest(0, "current", amplitude=2.0), "too large for the limit of axis1"),
        (BodeRequest(0, "current", speed=10.0), "omit the speed"),
        (BodeRequest(0, "speed", speed=50.0, travel_max=5.0), "use a lower speed"),
        (BodeRequest(0, "position", f_min=0.05), "use a lowest frequency of at least 0"),
        (BodeRequest(0, "speed", f_min=300.0, f_max=200.0), "300 Hz of the band must be below"),
        (BodeRequest(0, "position", amplitude=280.0, f_min=300.0, f_max=700.0), "cmd.test_amplitude: 0.53"),
    ):
        with pytest.raises(MeasurementError, match=why):
            measure(access, request, enable=True)
    access.write("param.feedback", [1.0], 0)
    with pytest.raises(MeasurementError, match="without its encoder"):
        measure(access, BodeRequest(0, "speed"), enable=True)
    access.write("param.feedback", [0.0], 0)
    with pytest.raises(MeasurementError, match="axis1 is not enabled"):
        measure(access, BodeRequest(0, "speed"))
    assert access.read("axis1.position") == place
    assert access.read("cmd.enable") == [0.0, 0.0]


def test_a_current_loop_of_an_axis_with_a_holding_brake_is_refused(access: VirtualBoardAccess) -> None:
    fit(access.board, "brake")
    with pytest.raises(MeasurementError, match="axis1 has a holding brake"):
        measure(access, BodeRequest(0, "current"), enable=True)
    assert access.read("cmd.enable") == [0.0, 0.0]


@pytest.mark.parametrize("loop", ["current", "current_d"])
def test_a_voltage_at_its_limit_is_refused(access: VirtualBoardAccess, loop: str) -> None:
    access.board.set_plant("axis1.r_s", 8.0)
    with pytest.raises(MeasurementError, match="the voltage of axis1 reaches 1"):
        measure(access, BodeRequest(0, loop, repeats=2), enable=True)
    assert access.read("cmd.enable") == [0.0, 0.0]


class SlowHost(VirtualBoardAccess):
    """A host whose waits take longer than they should."""

    factor = 1.0

    def wait(self, seconds: float) -> None:
        super().wait(self.factor * seconds)


def test_varying_speed_of_the_shaft_is_an_error(access: VirtualBoardAccess) -> None:
    enable(access.board)
    slow = SlowHost(access.board)
    slow.factor = 4.0  # the trajectory ends before the sweep does
    with pytest.raises(MeasurementError, match=r"axis1 ran at .* instead of 31"):
        measure(slow, BodeRequest(0, "position", repeats=2))
    access.write("param.command_timeout", [0.2])
    slow.factor = 10.0
    with pytest.raises(MeasurementError, match=r"axis1 is limited\. EXPIRED: "):
        measure(slow, BodeRequest(0, "speed", repeats=2))
    access.wait(0.2)
    assert abs(access.read("axis1.speed")[0]) < 1.0


class Computing(VirtualBoardAccess):
    """A host that computes for longer than the time-out of the set-points after each recording."""

    def record(self, capture: Capture) -> Trace:
        recording = super().record(capture)
        self.board.run(0.8)
        return recording


def test_a_current_that_expires_between_two_recordings_still_holds_the_rotor(access: VirtualBoardAccess) -> None:
    found = measure(Computing(access.board), BodeRequest(0, "current", repeats=2), enable=True)
    assert found.bands


class EndedSignal(VirtualBoardAccess):
    """A board that ends a test signal half-way."""

    def record(self, capture: Capture) -> Trace:
        calls = 0

        def ending(full: bool) -> None:
            nonlocal calls
            calls += 1
            if calls == 5:
                end_test_signal(self, 0)
            capture.meanwhile(full)

        return super().record(replace(capture, meanwhile=ending))


def test_a_test_signal_that_ends_early_is_refused(access: VirtualBoardAccess) -> None:
    with pytest.raises(MeasurementError, match="ended the test signal of axis1 too early"):
        measure(EndedSignal(access.board), BodeRequest(0, "speed", repeats=2), enable=True)
    assert access.read("cmd.enable") == [0.0, 0.0]


def test_figures_need_confirmation_at_half_the_amplitude() -> None:
    """At 0.10 A the quantisation of the M/T method shifts the crossover by a fifth."""
    with Board(level="registers", seed=3) as board:
        board.run(0.1)
        access = VirtualBoardAccess(board)
        small = measure(access, BodeRequest(0, "speed", amplitude=0.10, speed=60.0), enable=True)
        assert small.figures.crossover is not None
        assert not small.confirmed
        assert "+-" not in text(small)
        assert "not confirmed" in text(small)
        assert as_dict(small)["measured"]["crossover"]["sigma"] is None
        assert not as_dict(small)["confirmed"]
        larger = measure(access, BodeRequest(0, "speed", amplitude=0.5, speed=60.0), enable=True)
        assert larger.confirmed
        assert "+-" in text(larger)
        refuse_difference(larger)


def test_range_of_motion_is_kept(access: VirtualBoardAccess) -> None:
    access.write("cmd.enable", [1.0], 0)
    access.wait(4.0)
    theta = [access.board.truth(0).theta_m]
    bode = measure(
        access,
        BodeRequest(0, "speed", travel_max=40.0, repeats=4),
        progress=lambda *_: theta.append(access.board.truth(0).theta_m),
    )
    assert 5.0 < bode.settings.speed < 40.0
    assert max(abs(angle - theta[0]) for angle in theta) < 40.0
    assert bode.figures.crossover is not None


def test_fault_or_wrong_state_of_an_axis_is_reported(access: VirtualBoardAccess) -> None:
    access.write("cmd.enable", [1.0], 0)
    access.wait(4.0)
    with pytest.raises(MeasurementError, match="disable the axis first"):
        measure(access, BodeRequest(0, "current"), enable=True)
    access.write("cmd.mode", [1.0], 0)
    access.write("param.command_timeout", [0.0])
    access.write("cmd.speed", [50.0], 0)
    access.wait(0.3)
    with pytest.raises(MeasurementError, match="axis1 is in motion"):
        measure(access, BodeRequest(0, "speed"))
    access.board.connect_encoder(0, False)
    access.wait(0.5)
    with pytest.raises(MeasurementError, match="axis1 has a fault"):
        measure(access, BodeRequest(0, "speed"))


def test_too_small_signal_gives_a_note_or_no_figures(access: VirtualBoardAccess, tmp_path: Path) -> None:
    bode = measure(access, BodeRequest(0, "speed", amplitude=0.02, speed=100.0, repeats=2), enable=True)
    assert "resolution of the M/T method" in bode.notes[0]
    assert "note: " in text(bode)
    tiny = measure(access, BodeRequest(0, "speed", amplitude=0.0005, speed=100.0, repeats=2), enable=True)
    assert tiny.figures.crossover is None
    assert "not determined" in text(tiny)
    assert as_dict(tiny)["measured"]["crossover"] is None
    with pytest.raises(PictureError, match="not_a_format"):
        draw(bode, tmp_path / "bode.not_a_format")


def test_resonance_of_an_elastic_shaft_is_found(level: Level) -> None:
    """Two masses: antiresonance at 150 Hz, resonance at 190 Hz."""
    rotor, load, frequency, damping = 5e-6, 3e-6, 150.0, 0.05
    stiffness = (2.0 * math.pi * frequency) ** 2 * load
    both = frequency * math.sqrt(1.0 + load / rotor)
    plant = PlantConfig.load().with_axis(
        0,
        inertia=rotor,
        load_inertia=load,
        shaft_stiffness=stiffness,
        shaft_damping=2.0 * damping * math.sqrt(stiffness * load),
    )
    with Board(plant, level=level, seed=3) as board:
        board.run(0.1)
        bode = measure(VirtualBoardAccess(board), BodeRequest(0, "speed", amplitude=0.5), enable=True)
    low, high = bode.figures.resonances
    assert low.frequency == pytest.approx(frequency, rel=0.05)
    assert high.frequency == pytest.approx(both, rel=0.05)
    assert low.height < -6.0
    assert high.height > 6.0
    assert "antiresonance" in text(bode)
