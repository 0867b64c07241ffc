"""Feed-forward against torque ripple against its formula in floating point."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
from core_library import Core
from exact import I32, clip32
from hypothesis import given
from hypothesis import strategies as st

FULL = 2**31
TURN = 2**32
LEAD = round(0.0525 * FULL)  # turns at full-scale speed during 0.63 ms


class Harmonic(NamedTuple):
    order: int
    amplitude: int  # Q1.15
    phase: int  # 2^16 is one turn


HARMONICS = st.lists(st.builds(Harmonic, st.integers(1, 255), st.integers(0, 32767), st.integers(0, 65535)), max_size=8)


def current(core: Core, harmonics: list[Harmonic], angle: int, speed: int, lead: int = LEAD) -> int:
    config = core.ffi.new("torque_ripple_config_t *")
    config.lead = lead
    for k, harmonic in enumerate(harmonics):
        config.order[k], config.amplitude[k], config.phase[k] = harmonic
    return int(core.lib.torque_ripple_current(config, angle % TURN, speed))


def formula(harmonics: list[Harmonic], angle: int, speed: int, lead: int = LEAD) -> float:
    """Sum of the harmonics [2^31 is full scale]."""
    if not harmonics:
        return 0.0
    order, amplitude, phase = np.array(harmonics, float).T
    ahead = speed * lead / FULL / FULL  # turns
    part = np.clip(2.0 - order * abs(ahead) / 0.125, 0.0, 1.0)
    waves = amplitude * part * np.sin(2.0 * np.pi * (order * (angle / TURN + ahead) + phase / 65536.0))
    return float(waves.sum()) * 65536.0


@given(harmonics=HARMONICS, angle=st.integers(0, TURN - 1), speed=I32)
def test_agrees_with_the_formula(core: Core, harmonics: list[Harmonic], angle: int, speed: int) -> None:
    """Within the 16 bits of each phase and amplitude, and the 16 bits with which the fading knows the speed."""
    exact = max(-float(FULL), min(FULL - 1.0, formula(harmonics, angle, speed)))
    steps = sum(h.amplitude * (2.0 * math.pi / 65536.0 + (4.0 * h.order + 3.0) / 32768.0) + 2.0 for h in harmonics)
    assert abs(current(core, harmonics, angle, speed) - exact) <= 65536.0 * steps


@given(harmonics=HARMONICS, angle=st.integers(0, TURN - 1), speed=I32)
def test_harmonics_behind_the_end_of_the_list_have_no_effect(
    core: Core, harmonics: list[Harmonic], angle: int, speed: int
) -> None:
    ended = [*harmonics[:4], Harmonic(0, 32767, 16384), *harmonics[4:7]]
    assert current(core, ended, angle, speed) == current(core, harmonics[:4], angle, speed)


def test_sine_is_that_of_the_pair(core: Core) -> None:
    for angle in range(-32768, 32768):
        assert core.lib.f16_sin(angle) == core.lib.sin_cos_of(angle).sin


@pytest.mark.parametrize("sign", [1, -1])
def test_extrapolation_advances_the_angle_in_both_directions(core: Core, sign: int) -> None:
    """A shaft at this speed has turned by the lead when the current acts."""
    wave = [Harmonic(12, 8000, 1000)]
    speed = sign * FULL // 10  # 52 rad/s: 12 periods per turn advance by 0.063 turns
    later = 12345678 + sign * round(LEAD / 10 * 2)
    assert current(core, wave, 12345678, speed) == pytest.approx(current(core, wave, later, 0), abs=2**31 / 8000)


def test_harmonics_fade_out_with_the_frequency(core: Core) -> None:
    """In force up to an eighth of a turn of the lead, half at 3/16, without effect from a quarter on."""

    def size(turns: float) -> float:
        """Largest current with a lead of this phase, of the amplitude."""
        speed = clip32(round(turns / 84 * FULL / LEAD * FULL))
        wave = [Harmonic(84, 16384, 0)]
        return max(current(core, wave, angle, speed) for angle in range(0, TURN // 84, TURN // 84 // 64)) / 2.0**30

    sizes = [size(turns) for turns in (0.0, 0.12, 0.1875, 0.25, 0.4)]
    assert sizes == pytest.approx([1.0, 1.0, 0.5, 0.0, 0.0], abs=0.01)
