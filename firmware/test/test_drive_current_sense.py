"""Current reconstruction, offsets and bus voltage (DRM 2.3.2, 4.2)."""

from __future__ import annotations

from typing import Any

import pytest
from core_library import Core
from exact import I16, MAX16, U16, clip16, edges, narrow, nearest
from hypothesis import given, settings
from hypothesis import strategies as st
from servo_bench import Bench, bus_code

AB, BC, CA = range(3)
U12 = edges(0, 4095)
PHASES = {AB: (0, 1), BC: (1, 2), CA: (2, 0)}
MID = 2048 << 16


@pytest.fixture
def sense(core: Core) -> Any:
    s = core.ffi.new("current_sense_t *")
    core.lib.current_sense_reset(s)
    return s


def read(core: Core, sense: Any, pair: int, first: int, second: int) -> list[int]:
    sense.pair = pair
    i = core.lib.current_sense_read(sense, (first, second))
    return [i.a, i.b, i.c]


@pytest.mark.parametrize("sector", range(1, 7))
def test_longest_low_sides_are_sampled(core: Core, sector: int) -> None:
    """The phase with the longest high side in this sector is not sampled."""
    import math

    angle = math.radians(60 * sector - 30)
    vector = {"alpha": round(25000 * math.cos(angle)), "beta": round(25000 * math.sin(angle))}
    duty = core.lib.svm(vector).duty
    high_sides = [duty.a, duty.b, duty.c]
    left_out = high_sides.index(max(high_sides))
    assert left_out not in PHASES[core.lib.current_sense_pair(sector)]


@pytest.mark.parametrize("pair", [AB, BC, CA])
def test_third_current_is_the_negative_sum(core: Core, sense: Any, pair: int) -> None:
    first, second = PHASES[pair]
    i = read(core, sense, pair, 2048 + 500, 2048 - 200)
    assert i[first] == 500 * 16
    assert i[second] == -200 * 16
    assert sum(i) == 0


@given(first=st.integers(0, 4095), second=st.integers(0, 4095), pair=st.integers(0, 2))
def test_full_range_saturates_and_never_wraps(core: Core, first: int, second: int, pair: int) -> None:
    sense = core.ffi.new("current_sense_t *")
    core.lib.current_sense_reset(sense)
    i = read(core, sense, pair, first, second)
    a, b = PHASES[pair]
    assert i[a] == (first - 2048) * 16
    assert i[b] == (second - 2048) * 16
    assert i[3 - a - b] == min(max(-(i[a] + i[b]), -32768), 32767)


@given(codes=st.tuples(U12, U12), pair=st.integers(0, 2), offsets=st.tuples(*[edges(0, 0xFFFFFFF)] * 3))
@settings(max_examples=300)
def test_every_bit_of_a_reading(core: Core, codes: tuple[int, int], pair: int, offsets: tuple[int, int, int]) -> None:
    """Any 12-bit code, any 12-bit offset with its fraction rounded to 1/16, halves upwards."""
    sense = core.ffi.new("current_sense_t *", {"offset": offsets})
    i = read(core, sense, pair, *codes)
    phases = PHASES[pair]
    sampled = [clip16(code * 16 - nearest(offsets[x], 2**12)) for code, x in zip(codes, phases, strict=True)]
    assert [i[x] for x in phases] == sampled
    assert i[3 - sum(phases)] == clip16(-sum(sampled))


def test_offset_is_subtracted_with_its_fraction(core: Core, sense: Any) -> None:
    sense.offset[0] = MID + (10 << 16) + 0x8000  # 10.5 codes
    assert read(core, sense, AB, 2058, 2048)[0] == -8
    assert read(core, sense, AB, 2059, 2048)[0] == 8
    sense.offset[0] = MID + 0x900  # 9/256 codes: rounded to 1/16
    assert read(core, sense, AB, 2048, 2048)[0] == -1


def test_a_reset_restores_the_middle_as_offset(core: Core) -> None:
    sense = core.ffi.new("current_sense_t *", ([1, 2, 3], [4, 5, 6], 7, 2, (8, 9, 10)))
    core.lib.current_sense_reset(sense)
    assert list(sense.offset) == [MID] * 3
    assert list(sense.sum) == [0] * 3
    assert (sense.samples, sense.pair) == (0, AB)
    assert (sense.duty.a, sense.duty.b, sense.duty.c) == (0, 0, 0)


def calibrate(core: Core, sense: Any, offsets: list[int]) -> int:
    samples = 0
    done = False
    while not done:
        first, second = PHASES[sense.pair]
        done = core.lib.current_sense_calibrate(sense, (offsets[first], offsets[second]))
        samples += 1
        assert samples <= 2000
    return samples


def test_calibration_measures_all_three_amplifiers(core: Core, sense: Any) -> None:
    calibrate(core, sense, [2010, 2100, 2048])
    assert [o / 65536 for o in sense.offset] == [2010.0, 2100.0, 2048.0]
    assert read(core, sense, BC, 2100, 2048) == [0, 0, 0]


def test_calibration_averages_noise(core: Core, sense: Any) -> None:
    done, k = False, 0
    while not done:
        done = core.lib.current_sense_calibrate(sense, (2040 + k % 16, 2050 - k % 16))
        k += 1
    assert sense.offset[0] / 65536 == pytest.approx(2047.5, abs=0.01)
    assert sense.offset[1] / 65536 == pytest.approx(2042.5, abs=0.01)


@pytest.mark.parametrize(
    ("codes", "plausible"),
    [([1948, 2148, 2048], True), ([1947, 2048, 2048], False), ([2048, 2048, 2149], False), ([0, 4095, 2048], False)],
)
def test_offsets_far_from_the_middle_are_not_plausible(
    core: Core, sense: Any, codes: list[int], plausible: bool
) -> None:
    calibrate(core, sense, codes)
    assert bool(core.lib.current_sense_offsets_plausible(sense, 100)) is plausible


def test_drift_of_the_offset_is_followed_slowly(core: Core, sense: Any) -> None:
    sense.duty = (16384, 16384, 16384)
    for _ in range(256):
        core.lib.current_sense_track(sense, (2058, 2048), 3277)
    assert sense.offset[0] / 65536 == pytest.approx(2048 + 10 * 0.632, abs=0.1)
    for _ in range(4000):
        core.lib.current_sense_track(sense, (2058, 2048), 3277)
    assert sense.offset[0] / 65536 == pytest.approx(2058, abs=0.01)
    assert sense.offset[1] == sense.offset[2] == MID


@given(
    offsets=st.tuples(*[edges(0, 0xFFFFFFF)] * 3),
    codes=st.tuples(edges(0, 4095), edges(0, 4095)),
    pair=st.integers(0, 2),
    duty=st.tuples(I16, I16, I16),
    minimum=edges(0, MAX16),
)
@settings(max_examples=300)
def test_every_bit_of_the_offset_tracking(
    core: Core,
    offsets: tuple[int, int, int],
    codes: tuple[int, int],
    pair: int,
    duty: tuple[int, int, int],
    minimum: int,
) -> None:
    """A 256th of the error, towards minus infinity, and only for the phases of this pair with a long high side."""
    sense = core.ffi.new("current_sense_t *", {"offset": offsets, "pair": pair, "duty": duty})
    core.lib.current_sense_track(sense, codes, minimum)
    expected = list(offsets)
    for code, phase in zip(codes, PHASES[pair], strict=True):
        if duty[phase] >= minimum:
            expected[phase] += ((code << 16) - offsets[phase]) >> 8
    assert list(sense.offset) == expected


@given(codes=st.lists(st.tuples(U16, U16), min_size=2, max_size=6), shift=st.integers(0, 511))
@settings(max_examples=40)
def test_every_bit_of_the_calibration(core: Core, codes: list[tuple[int, int]], shift: int) -> None:
    """256 samples of pair AB, 256 of pair CA with c first; exact means with 16 fraction bits, 12-bit codes."""
    sense = core.ffi.new("current_sense_t *")
    core.lib.current_sense_reset(sense)
    sums = [0, 0, 0]
    for k in range(512):
        first, second = (code & 0xFFF for code in codes[(k + shift) % len(codes)])
        assert sense.pair == (AB if k < 256 else CA)
        if k < 256:
            sums[0], sums[1] = sums[0] + first, sums[1] + second
        else:
            sums[2] += first
        assert core.lib.current_sense_calibrate(sense, (first, second)) == (k == 511)
    assert [offset * 256 for offset in sense.offset] == [total * 65536 for total in sums]


@given(offsets=st.tuples(*[edges(0, 0xFFFFFFF)] * 3), tolerance=edges(0, 4095))
def test_plausible_means_within_the_tolerance(core: Core, offsets: tuple[int, int, int], tolerance: int) -> None:
    """In whole codes, with the fraction truncated; the bounds are plausible."""
    for at in (offsets, tuple(clip_offset(o, tolerance) for o in offsets)):
        sense = core.ffi.new("current_sense_t *", {"offset": at})
        plausible = all(abs((o >> 16) - 2048) <= tolerance for o in at)
        assert bool(core.lib.current_sense_offsets_plausible(sense, tolerance)) is plausible


def clip_offset(offset: int, tolerance: int) -> int:
    """Offset moved close to the bounds."""
    return min(max(offset, max(2047 - tolerance, 0) << 16), min(2049 + tolerance, 4095) << 16)


@pytest.mark.parametrize("pair", [AB, BC, CA])
def test_short_high_sides_give_no_offset(core: Core, sense: Any, pair: int) -> None:
    """The shunt is without current only if the high side conducts long enough."""
    first, second = PHASES[pair]
    duty = [3276, 3276, 3276]
    duty[first] = 3277
    sense.pair, sense.duty = pair, tuple(duty)
    core.lib.current_sense_track(sense, (2100, 2100), 3277)
    assert sense.offset[first] > MID
    assert sense.offset[second] == MID


# ---- the bus (E46, E47) -------------------------------------------------------------------------------------------


def test_24_volts_is_21665_of_which_a_12_bit_converter_delivers_21664(core: Core) -> None:
    assert round(24.0 / 36.3, 6) == 0.661157
    assert round(24.0 / 36.3 * 2**15) == 21665
    bench = Bench(core)
    assert bench.catalogue.variables["u_dc"].to_raw(24.0) == 21665
    assert bus_code(24.0) == bench.hal.bus_code == 2708
    bench.to_stop()
    bench.slow(20)
    assert bench.servo.snapshot.u_dc == 21664


@given(codes=st.lists(edges(0, 4095), min_size=1, max_size=40))
@settings(max_examples=60)
def test_every_bit_of_the_bus_filter(core: Core, codes: list[int]) -> None:
    """Q1.31 of the full scale; a 16th of the difference, towards minus infinity; the first code goes in as it is."""
    bench = Bench(core)
    axis = core.ffi.addressof(bench.servo.axis[0])
    filtered = 0
    for code in codes:
        bench.hal.bus_code = code
        core.lib.axis_fast(axis)
        sample = code << 19
        filtered = filtered or sample
        filtered += (sample - filtered) >> 4
        assert axis.u_dc_filter == filtered
        assert axis.u_dc == narrow(filtered)


def test_the_bus_voltage_is_filtered_with_first_order(core: Core) -> None:
    """First order, 16 PWM periods; the full scale does not wrap."""
    bench = Bench(core)
    bench.to_stop()
    bench.slow(20)
    bench.hal.bus_code = bus_code(28.0)
    bench.slow(2)  # 16 periods
    rise = (bench.axis(0).u_dc - 21664) / ((bus_code(28.0) << 3) - 21664)
    assert rise == pytest.approx(1.0 - (15 / 16) ** 16, abs=0.01)
    bench.hal.bus_code = 4095
    bench.slow(50)
    assert bench.axis(0).u_dc == 4095 << 3
