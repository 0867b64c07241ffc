"""Values of the plant that change while a board runs, at both levels."""

from __future__ import annotations

import numpy as np
import pytest
from servo_msgs_py.board_port import choose, write_axis
from servo_msgs_py.units import TICK
from servo_twin.board import Board
from servo_twin.fault_injection import BadContact, CurrentNoise, DryBearing, ShiftedDisc, WeakMagnet, WornShaft
from servo_twin.level import Level
from servo_twin.plant import PlantConfig, PlantError
from servo_twin.simulation import enable
from servo_twin.validation.sweep.variant import Base

LEVELS: list[Level] = ["ideal", "registers"]
LOAD = 0.02  # [N m]: enough current for a resistance to show
SPEED = 100.0  # [rad/s]
CHANGES = {
    "axis1.r_s": 1.2,
    "axis1.psi_m": 0.0123,
    "axis1.inertia": 2.0e-5,
    "axis1.friction": 8.0e-3,
    "axis1.load_torque": 0.01,
    "bus.u_source": 21.0,
}


def seen(board: Board) -> dict[str, float]:
    """Plant values from the signals of the firmware, each by its equation with the other values known."""
    plant = board.plant.axes[0]
    board.run(0.1)
    held = board.si(board.record(board.time_ns + 100_000_000))
    u_q, i_q = float(np.mean(held["axis1.u_q"])), float(np.mean(held["axis1.i_q"]))
    write_axis(board, "cmd.speed", 0, SPEED + 60.0)
    step = board.si(board.record(board.time_ns + 30_000_000))
    write_axis(board, "cmd.speed", 0, SPEED)
    torque = plant.torque_constant * (step["axis1.i_q"] - i_q)
    speed = step["axis1.speed"]
    emf = plant.pole_pairs * SPEED * plant.psi_m
    return {
        "axis1.r_s": (u_q - emf) / i_q,
        "axis1.psi_m": (u_q - plant.r_s * i_q) / (plant.pole_pairs * SPEED),
        "axis1.inertia": float(np.trapezoid(torque, dx=TICK) / (speed[-1] - speed[0])),
        "axis1.friction": plant.torque_constant * i_q - board.plant.axes[0].load_torque,
        "axis1.load_torque": plant.torque_constant * i_q - board.plant.axes[0].friction,
        "bus.u_source": float(np.mean(held["u_dc"])),
    }


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("name", CHANGES)
def test_change_of_the_plant_is_measured_by_the_drive(name: str, level: Level) -> None:
    plant = PlantConfig.load().with_value("axis1.load_torque", LOAD)
    with Board(level=level, seed=3) as board:
        enable(board)
        choose(board, "cmd.mode", 0, "SPEED")
        write_axis(board, "cmd.speed", 0, SPEED)
        board.set_plant("axis1.load_torque", LOAD)
        before = seen(board)
        board.set_plant(name, CHANGES[name])
        assert board.plant == plant.with_value(name, CHANGES[name])
        after = seen(board)
    table = {"axis1": plant.axes[0], "bus": plant.bus}
    part, _, value = name.partition(".")
    change = CHANGES[name] - getattr(table[part], value)
    # dead time and voltage drops of the inverter cancel in the difference
    assert after[name] - before[name] == pytest.approx(change, rel=0.1)


@pytest.mark.parametrize("level", LEVELS)
def test_other_settings_are_kept_after_a_change(level: Level) -> None:
    with Board(level=level) as board:
        board.set_load(0, 0.011)
        board.set_supply(25.0)
        board.set_plant("axis2.r_s", 0.5)
        assert board.plant.axes[0].load_torque == 0.011
        assert board.plant.bus.u_source == 25.0
        board.lock_shaft(0)
        board.run(0.3)
        assert board.truth(0).u_dc == pytest.approx(25.0, abs=0.1)


@pytest.mark.parametrize("level", LEVELS)
def test_empty_change_keeps_runs_bit_identical(level: Level) -> None:
    logs = []
    for again in (False, True):
        with Board(level=level, seed=5) as board:
            enable(board)
            choose(board, "cmd.mode", 0, "SPEED")
            write_axis(board, "cmd.speed", 0, 60.0)
            board.run(0.05)
            if again:
                board.set_plant("axis1.r_s", board.plant.axes[0].r_s)
            logs.append(board.record(board.time_ns + 50_000_000).tobytes())
    assert logs[0] == logs[1]


@pytest.mark.parametrize("level", LEVELS)
def test_noise_fault_is_kept_after_a_change_and_removed_to_the_present_value(level: Level) -> None:
    fault = CurrentNoise(0, 0.04)
    spread = []
    with Board(level=level) as board:
        enable(board)
        for step in ("whole", "broken", "changed", "repaired"):
            if step == "broken":
                board.inject(fault)
            elif step == "changed":
                board.set_plant("axis1.i_noise", 0.0)
            elif step == "repaired":
                board.clear_fault(fault)
            spread.append(float(np.std(board.si(board.record(board.time_ns + 30_000_000))["axis1.i_d"])))
    whole, broken, changed, repaired = spread
    assert broken > 1.5 * whole
    assert changed > 1.5 * whole
    assert repaired < 0.7 * whole


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("axis1.r_q", 1.0, "axis1.r_q: no such number of the plant; similar names: r_s"),
        ("axis3.r_s", 1.0, "axis3.r_s: no such number"),
        ("axis1.r_s", 0.0, "axis1.r_s: r_s: 0.0 is too small"),
        ("axis1.i_offset", 0.0, "axis1.i_offset: no such number"),
        ("axis1.pins", 0.0, "axis1.pins: no such number"),
        ("axis1.pole_pairs", 3.0, "axis1.pole_pairs: cannot be changed on a running board"),
        ("pwm_frequency", 8000.0, "pwm_frequency: cannot be changed on a running board"),
    ],
)
def test_invalid_changes_are_refused(name: str, value: float, text: str) -> None:
    with Board(level="ideal") as board, pytest.raises(PlantError, match=text):
        board.set_plant(name, value)


@pytest.mark.parametrize("level", LEVELS)
def test_faults_that_change_plant_values(level: Level) -> None:
    """Each fault changes the truth; faults of the same value add up; their removal restores the value."""
    plant = PlantConfig.load().with_axis(0, load_inertia=1e-5, shaft_stiffness=50.0, backlash=1e-3)
    axis = plant.axes[0]
    with Board(plant, level=level) as board:
        board.run(0.001)
        whole = board.truth(0)
        board.inject(WeakMagnet(0, 0.8))
        board.inject(BadContact(0, 0.3))
        board.inject(BadContact(0, 0.2))
        assert board.truth(0).psi_m == pytest.approx(0.8 * axis.psi_m)
        assert board.truth(0).r_s == pytest.approx(axis.r_s + 0.5)
        board.set_plant("axis1.r_s", 0.7)  # the fault is added to the present value
        assert board.truth(0).r_s == pytest.approx(0.7 + 0.5)
        assert board.plant == plant.with_value("axis1.r_s", 0.7)
        board.clear_fault(BadContact(0, 0.3))
        assert board.truth(0).r_s == pytest.approx(0.7 + 0.2)
        board.set_plant("axis1.r_s", axis.r_s)
        board.clear_fault()
        assert (board.truth(0).r_s, board.truth(0).psi_m) == (whole.r_s, whole.psi_m)


@pytest.mark.parametrize("level", LEVELS)
def test_worn_shaft_has_more_backlash(level: Level) -> None:
    plant = PlantConfig.load().with_axis(0, load_inertia=1e-5, shaft_stiffness=5.0, shaft_damping=0.01, backlash=0.01)
    rest = []
    with Board(plant, level=level) as board:
        board.lock_shaft(0)
        board.inject(WornShaft(0, 0.02))
        for torque in (0.01, -0.01):
            board.set_load(0, torque)
            board.run(0.3)
            rest.append(board.truth(0).theta_load)
    assert rest[1] - rest[0] == pytest.approx(0.03 + 2.0 * 0.01 / 5.0, rel=1e-6)


@pytest.mark.parametrize("level", LEVELS)
def test_a_dry_bearing_takes_more_current(level: Level) -> None:
    with Board(level=level, seed=1) as board:
        enable(board)
        choose(board, "cmd.mode", 0, "SPEED")
        write_axis(board, "cmd.speed", 0, SPEED)
        before = seen(board)["axis1.friction"]
        board.inject(DryBearing(0, 4.0))
        after = seen(board)["axis1.friction"]
        axis = board.plant.axes[0]
    assert after - before == pytest.approx(3.0 * (axis.friction + axis.viscous * SPEED), rel=0.1)


@pytest.mark.parametrize("level", LEVELS)
def test_a_disc_that_shifts_moves_the_position(level: Level) -> None:
    """The position error of a running shaft stays within the new bound, and no count is lost."""
    with Board(PlantConfig.load().with_axis(0, theta_start=0.0), level=level) as board:
        enable(board)
        choose(board, "cmd.mode", 0, "SPEED")
        write_axis(board, "cmd.speed", 0, 20.0)
        board.run(0.2)

        def error() -> float:
            board.run(0.001)
            return board.read_words("axis1.position")[0] * 2.0 * np.pi / 4000.0 - board.truth(0).theta_m

        before = np.array([error() for _ in range(400)])
        fault = ShiftedDisc(0, 0.02, 1.0)
        board.inject(fault)
        during = np.array([error() for _ in range(400)])
        board.clear_fault(fault)
        after = np.array([error() for _ in range(400)])
    assert np.ptp(during) == pytest.approx(0.04, rel=0.2)
    assert np.mean(after) == pytest.approx(np.mean(before), abs=2.0 * np.pi / 4000.0)


def test_invalid_wear_is_refused() -> None:
    with Board(level="ideal") as board:
        for fault, text in (
            (WornShaft(0, 0.01), "axis 0 has no second mass"),
            (WeakMagnet(0, 1.5), "part 1.5 is not within 0 .. 1"),
            (BadContact(0, -0.1), "resistance -0.1 is not"),
            (ShiftedDisc(0, 0.5), "disc_eccentricity: 0.5 is too large"),
            (DryBearing(2, 1.0), "axis 2: a board has the axes 0 .. 1"),
        ):
            with pytest.raises((ValueError, IndexError), match=text):
                board.inject(fault)


def test_a_sweep_varies_every_part_of_a_real_shaft() -> None:
    values = {
        "load_inertia": 1e-5, "shaft_stiffness": 30.0, "shaft_damping": 1e-4, "backlash": 0.01, "load_friction": 1e-3,
        "cogging_torque": 1e-3, "cogging_periods": 24.0, "cogging_phase": 0.1, "i_saturation_d": 4.0,
        "i_saturation_q": 3.0, "winding_warms": 1.0, "magnet_coefficient": -0.002, "magnet_time": 10.0,
        "disc_eccentricity": 0.01, "disc_phase": 0.2, "load_torque": 0.01,
    }  # fmt: skip
    base = Base(PlantConfig.load(), {})
    point = {f"plant.axis2.{name}": value for name, value in values.items()}
    plant = base.variant({"plant.axis2.shaft_stiffness": 30.0, **point}).plant
    assert {name: getattr(plant.axes[1], name) for name in values} == values
    assert base.variant({"plant.axis1.pins.brake_torque": 0.1}).plant.axes[0].pins.brake_torque == 0.1
