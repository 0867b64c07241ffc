"""Both axes in one step of the plant, compared with two separate axes."""

from __future__ import annotations

import pytest
from native_library import Native, c_axis, c_config
from servo_twin.plant import PlantConfig


@pytest.mark.parametrize("speeds", [(80.0, -40.0), (0.0, 60.0), (-3.0, 0.2)])
def test_a_pair_agrees_with_two_single_axes(plant_c: Native, speeds: tuple[float, float]) -> None:
    """Rotating shafts, a shaft at rest, shafts that stop within a step: equal states and counts."""
    ffi, lib = plant_c
    plant = PlantConfig.load().with_axis(0, theta_start=0.4).with_axis(1, theta_start=-2.0)
    both = ffi.new("plant_t *")
    lib.plant_init(both, c_config(plant_c, plant))
    duties = [(0.62, 0.48, 0.40), (0.45, 0.52, 0.53)]
    motors = [ffi.new("plant_motor_t *") for _ in range(2)]
    inverters = [ffi.new("averaged_inverter_t *") for _ in range(2)]
    step = both.step_ns * 1e-9
    charge = ffi.new("double *")
    for index in range(2):
        config = c_axis(plant_c, plant.axes[index])
        lib.plant_motor_init(motors[index], config)
        lib.averaged_inverter_init(inverters[index], config, 16000.0, step)
        inverters[index].on = both.axis[index].inverter.on = True
        motors[index].omega = both.axis[index].motor.omega = speeds[index]
    for n in range(600):
        bus = both.bus.u
        if n % 2 == 0:
            for index in range(2):
                lib.averaged_inverter_load(inverters[index], duties[index], bus)
                lib.averaged_inverter_load(ffi.addressof(both.axis[index].inverter), duties[index], bus)
        lib.plant_step(both, n * both.step_ns)
        for index, motor in enumerate(motors):
            remaining = step
            while remaining > 1e-15:
                remaining -= lib.averaged_inverter_step(inverters[index], motor, bus, remaining, charge)
            paired = both.axis[index].motor
            assert paired.omega == pytest.approx(motor.omega, rel=1e-11, abs=1e-12)
            assert paired.theta == pytest.approx(motor.theta, rel=1e-12, abs=1e-14)
            assert list(paired.phase) == pytest.approx(list(motor.phase), abs=1e-11)
            assert list(both.axis[index].inverter.share) == pytest.approx(list(inverters[index].share), abs=1e-11)
    assert abs(both.axis[1].motor.theta + 2.0) > 0.001
