"""Converter codes and noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from native_library import Native, c_config, ideal_plant
from servo_twin.plant import PlantConfig


def test_24_volts_are_code_2708(plant_c: Native) -> None:
    """DRM E46 on a 12-bit converter; shifted to Q1.15 it is 21664."""
    assert plant_c.lib.plant_code_unipolar(24.0, 36.3) == 2708


@pytest.mark.parametrize(
    ("value", "code"),
    [
        (2048.0, 2048),
        (2048.49, 2048),
        (2047.51, 2048),
        (0.49, 0),
        (0.51, 1),
        (4094.51, 4095),
        (4096.0, 4095),
        (-9.0, 0),
    ],
)
def test_codes_are_the_nearest(plant_c: Native, value: float, code: int) -> None:
    assert plant_c.lib.plant_code(value) == code


@pytest.mark.parametrize(("volts", "code"), [(1e6, 4095), (-1e6, 0), (36.3, 4095), (0.0, 0)])
def test_codes_saturate_at_the_ends_of_the_converter(plant_c: Native, volts: float, code: int) -> None:
    assert plant_c.lib.plant_code_unipolar(volts, 36.3) == code


def gauss(plant_c: Native, size: int, seed: int = 1, stream: int = 0) -> list[float]:
    random = plant_c.ffi.new("plant_random_t *")
    plant_c.lib.plant_random_init(random, seed, stream)
    return [plant_c.lib.plant_random_gauss(random) for _ in range(size)]


def test_noise_is_gaussian_enough(plant_c: Native) -> None:
    x = np.array(gauss(plant_c, 100_000))
    assert abs(x.mean()) < 0.01
    assert x.std() == pytest.approx(1.0, abs=0.01)
    assert abs((x**3).mean()) < 0.04
    assert (x**4).mean() == pytest.approx(2.9, abs=0.1)  # 3 - 1.2 / 12
    assert abs(np.corrcoef(x[:-1], x[1:])[0, 1]) < 0.01
    assert np.abs(x).max() < 6.0


def test_noise_repeats_with_its_seed_and_differs_between_streams(plant_c: Native) -> None:
    assert gauss(plant_c, 50, seed=3, stream=1) == gauss(plant_c, 50, seed=3, stream=1)
    assert gauss(plant_c, 50, seed=3, stream=1) != gauss(plant_c, 50, seed=4, stream=1)
    first, second = np.array(gauss(plant_c, 20000, 3, 1)), np.array(gauss(plant_c, 20000, 3, 2))
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.03


class Converters:
    """Two converters of axis 1, one phase each."""

    def __init__(self, plant_c: Native, plant: PlantConfig, *phases: int) -> None:
        self.native = plant_c
        self.plant = plant_c.ffi.new("plant_t *")
        self._phases = plant_c.ffi.new("int[2]", phases)
        plant_c.lib.plant_init(self.plant, c_config(plant_c, plant))
        self.plant.axis[0].inverter.on = True

    def sample(self) -> Any:
        samples = self.native.ffi.new("plant_samples_t *")
        self.native.lib.plant_sample(self.plant, 0, self._phases, True, samples)
        return samples

    def read(self, samples: Any) -> list[int]:
        code = self.native.ffi.new("uint16_t[2]")
        self.native.lib.plant_sample_codes(self.plant, 0, samples, code)
        return list(code)


def test_current_codes_carry_offset_and_noise_of_their_phase(plant_c: Native) -> None:
    plant = ideal_plant(i_offset=(0.2, -0.1, 0.05), i_noise=0.02)
    for phases, offsets in (((0, 1), (0.2, -0.1)), ((1, 2), (-0.1, 0.05)), ((2, 0), (0.05, 0.2))):
        converters = Converters(plant_c, plant, *phases)
        codes = np.array([converters.read(converters.sample()) for _ in range(4000)])
        assert codes.mean(axis=0) == pytest.approx(2048 + np.array(offsets) / 8.25 * 2048, abs=0.5)
        assert codes.std(axis=0) == pytest.approx(0.02 / 8.25 * 2048, rel=0.1)
        assert abs(np.corrcoef(codes.T)[0, 1]) < 0.05


def test_bus_code_carries_its_noise(plant_c: Native) -> None:
    state = plant_c.ffi.new("plant_t *")
    plant_c.lib.plant_init(state, c_config(plant_c, PlantConfig.load().with_bus(u_noise=0.05)))
    codes = np.array([plant_c.lib.plant_bus_code(state) for _ in range(4000)])
    assert codes.mean() == pytest.approx(2708.1, abs=0.5)
    assert codes.std() == pytest.approx(0.05 / 36.3 * 4096, rel=0.1)
