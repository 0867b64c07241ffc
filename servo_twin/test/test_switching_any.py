"""The plant at switching level with extreme motors, buses, gates and external torques: its state stays valid."""

from __future__ import annotations

import math
import random

import pytest
from native_library import Native
from servo_twin.plant import PlantConfig
from switching_rig import Switching


def any_plant(rnd: random.Random) -> PlantConfig:
    plant = PlantConfig.load().with_bus(
        u_source=rnd.uniform(1.0, 60.0),
        r_source=10 ** rnd.uniform(-2.5, 1.0),
        capacitance=10 ** rnd.uniform(-4.5, -2.0),
        r_brake=rnd.choice([0.0, 5.0]),
    )
    for index in range(2):
        l_d = 10 ** rnd.uniform(-4.1, -2.2)
        plant = plant.with_axis(
            index,
            r_s=rnd.uniform(0.05, 5.0),
            l_d=l_d,
            l_q=l_d * rnd.uniform(0.8, 2.0),
            psi_m=rnd.uniform(0.0, 0.05),
            pole_pairs=rnd.randint(1, 5),
            inertia=10 ** rnd.uniform(-6.0, -4.0),
            friction=rnd.choice([0.0, 2e-3]),
            viscous=rnd.choice([0.0, 1e-5]),
            i_break=rnd.uniform(0.2, 20.0),
            v_drop=rnd.choice([0.0, 0.7, 1.5]),
            r_on=rnd.choice([0.0, 0.03]),
            i_settle=rnd.choice([0.0, 3e-7]),
            encoder_jitter=rnd.uniform(0.0, 0.3),
            theta_start=rnd.uniform(-3.0, 3.0),
        )
    return plant


# The last seeds once caused endless events: at end stops, without friction, without voltage drop, with a bus of 30 uF.
@pytest.mark.parametrize("seed", [*range(200), 235, 259, 260, 270, 278, 703])
def test_state_stays_valid_with_random_gates(switching_c: Native, seed: int) -> None:
    rnd = random.Random(seed)
    plant = any_plant(rnd)
    switching = Switching(switching_c, plant, seed)
    for axis in range(2):
        switching.spin(axis, rnd.uniform(-600.0, 600.0))
    lib, c = switching.lib, switching.c
    hands = [
        lambda axis: lib.switching_set_load(c, axis, rnd.uniform(-0.1, 0.1)),
        lambda axis: lib.switching_lock(c, axis, rnd.random() < 0.5),
        lambda axis: lib.switching_obstruct(c, axis, rnd.uniform(0.0, 0.01), rnd.choice([0.0, 0.005, math.inf])),
        lambda axis: lib.switching_plug(c, axis, rnd.random() < 0.8),
        lambda axis: lib.switching_brake_resistor(c, rnd.random() < 0.5),
        lambda axis: lib.switching_set_supply(c, rnd.uniform(0.0, 60.0)),
        lambda axis: lib.switching_cut(c, axis, rnd.randrange(2), rnd.random() < 0.5, False),
        lambda axis: lib.switching_current_code(c, axis, rnd.randrange(3)),
    ]
    clock = 0
    for _ in range(400):
        clock += rnd.randrange(60 if rnd.random() < 0.75 else 2500)
        switching.advance(clock)
        axis = rnd.randrange(2)
        if rnd.random() < 0.2:
            rnd.choice(hands)(axis)
        else:
            switching.edge(axis, rnd.randrange(3), 3 if rnd.random() < 0.02 else rnd.randrange(3))
        for index in range(2):
            truth = switching.truth(index)
            state = [*truth.phase, truth.omega, truth.theta, *truth.amplifier, truth.e_bus]
            assert all(map(math.isfinite, state))
            motor = plant.axes[index]
            volts = 60.0 + switching.bus.u_dc + motor.pole_pairs * motor.psi_m * abs(truth.omega)
            # bound of the current by the resistance alone
            assert max(map(abs, truth.phase)) < 1.0 + volts / (motor.r_s + motor.r_on)
            assert sum(truth.phase) == pytest.approx(0.0, abs=1e-9 * (1.0 + max(map(abs, truth.phase))))
            inverter = c.axis[index].inverter
            assert inverter.stop_min <= truth.theta <= inverter.stop_max
            for leg, current in enumerate(inverter.phase):
                lane = leg + (leg > 0)  # INVERTER_LANE
                if inverter.joined >> lane & 1 == 0:
                    sign = (inverter.positive >> lane & 1) - (inverter.negative >> lane & 1)
                    assert sign * current >= -2e-3  # no current flows against the sign that its leg conducts
                    assert sign != 0 or current == 0.0
        assert switching.bus.u_dc >= 0.0
    times = [event[0] for event in switching.events]
    assert times == sorted(times)
