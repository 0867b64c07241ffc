"""The swept sine of test signals."""

from __future__ import annotations

import numpy as np
from core_library import Core
from hypothesis import given
from hypothesis import strategies as st

TURN = 2**32
SAMPLES = 320


@given(
    amplitude=st.integers(0, 16384),
    first=st.integers(0, 2**31 - 1),
    growth=st.integers(0, TURN // 10),
    calls=st.integers(0, SAMPLES),
)
def test_signal_is_the_sine_of_an_accelerating_phase(
    core: Core, amplitude: int, first: int, growth: int, calls: int
) -> None:
    sine = core.ffi.new("swept_sine_t *", {"amplitude": amplitude, "step": first, "growth": growth, "calls": calls})
    phase, step = 0, first
    for k in range(SAMPLES):
        expected = amplitude * np.sin(2.0 * np.pi * phase / TURN) if k < calls else 0.0
        # The table has an error of one LSB, and the phase is truncated to 16 bits.
        assert abs(core.lib.swept_sine_step(sine) - expected) <= 1.6 + amplitude * 2.0 * np.pi / 65536
        phase = (phase + step) % TURN
        step = min(step + (step * growth >> 32), 2**31 - 1)


def test_the_frequency_grows_exponentially(core: Core) -> None:
    """From 50 Hz to 4 kHz in 80 ms at 16 kHz."""
    calls = 1280
    growth = 80.0 ** (1.0 / calls) - 1.0
    sine = core.ffi.new(
        "swept_sine_t *", {"amplitude": 8192, "step": round(TURN / 320), "growth": round(TURN * growth), "calls": calls}
    )
    for _ in range(calls):
        core.lib.swept_sine_step(sine)
    assert sine.calls == 0
    assert abs(sine.step / TURN * 16000.0 - 4000.0) < 1.0
