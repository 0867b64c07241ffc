"""The ideal chip: order of the calls, effect and time of a duty, over-current, serial line."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from native_library import HALF_NS, Native, c_config, ideal_plant
from servo_twin.plant import PlantConfig

PERIOD_NS = 2 * HALF_NS
M1, M2, EDGE, BREAK, BACKGROUND = range(5)


class Chip:
    """An ideal chip with a firmware that only records its calls."""

    def __init__(self, native: Native, plant: PlantConfig, baud: float = 115200.0) -> None:
        self.lib, self.ffi = native.lib, native.ffi
        self.servo = native.ffi.new("servo_t *")
        self.hal = native.ffi.new("hal_t *")
        self.servo.hal = self.hal
        native.lib.chip_init(self.hal, c_config(native, plant, baud=baud), self.servo, native.ffi.NULL)

    def run(self, until_ns: int) -> None:
        self.lib.chip_run(self.hal, until_ns, False)

    def calls(self, *kinds: int) -> list[Any]:
        return [c for c in self.servo.call[0 : self.servo.calls] if not kinds or c.kind in kinds]

    def switch_on(self, axis: int, *duty: int) -> None:
        """Duties (Q1.15) and outputs that the firmware writes at every interrupt of the axis from now on."""
        self.servo.duty[axis] = duty
        self.servo.on[axis] = True

    def motor(self, axis: int) -> Any:
        return self.hal.plant.axis[axis].motor


@pytest.fixture
def make(chip_c: Native) -> Callable[..., Chip]:
    def chip(plant: PlantConfig | None = None, **options: Any) -> Chip:
        return Chip(chip_c, plant or ideal_plant(), **options)

    return chip


def test_the_two_interrupts_alternate(make: Callable[..., Chip]) -> None:
    chip = make()
    chip.run(10 * PERIOD_NS)
    assert [(c.time_ns, c.kind) for c in chip.calls()] == [(k * HALF_NS, k % 2) for k in range(21)]


def test_time_is_run_up_to_and_including_its_end(make: Callable[..., Chip]) -> None:
    chip = make()
    chip.run(HALF_NS - 1)
    assert chip.servo.calls == 1
    chip.run(HALF_NS)
    assert chip.servo.calls == 2
    assert chip.hal.now_ns == HALF_NS
    chip.run(0)
    assert (chip.servo.calls, chip.hal.now_ns) == (2, HALF_NS)


def test_background_follows_every_interrupt(make: Callable[..., Chip]) -> None:
    chip = make()
    chip.servo.log_background = True
    chip.run(3 * HALF_NS)
    assert [c.kind for c in chip.calls()] == [M1, BACKGROUND, M2, BACKGROUND] * 2


@pytest.mark.parametrize("axis", [0, 1])
def test_duty_takes_effect_half_a_period_after_its_samples(make: Callable[..., Chip], axis: int) -> None:
    plant = ideal_plant()
    chip = make(plant)
    chip.lib.chip_run(chip.hal, PERIOD_NS - 1, False)  # at rest; the next M1 is due at one period
    chip.switch_on(axis, 16384 + 3277, 16384 - 1638, 16384 - 1638)
    sampled = PERIOD_NS if axis == 0 else PERIOD_NS + HALF_NS
    chip.run(sampled + HALF_NS)
    assert chip.motor(axis).i_d == pytest.approx(0.0, abs=1e-12)  # duty 0 on all phases until now
    chip.run(sampled + 2 * HALF_NS)
    motor = plant.axes[axis]
    decay = 1.0 - math.exp(-motor.r_s / motor.l_d * HALF_NS * 1e-9)
    assert chip.motor(axis).i_d == pytest.approx(0.15 * 24.0 * 2 / 3 / motor.r_s * decay, rel=0.01)
    assert chip.motor(1 - axis).i_d == 0.0


@pytest.mark.parametrize("axis", [0, 1])
def test_a_duty_holds_for_a_whole_period(make: Callable[..., Chip], axis: int) -> None:
    chip = make()
    chip.switch_on(axis, 16384, 16384, 16384)
    chip.run(4 * PERIOD_NS - 1)
    chip.switch_on(axis, 16384 + 3277, 16384 - 1638, 16384 - 1638)
    sampled = 4 * PERIOD_NS + axis * HALF_NS
    chip.run(sampled)
    chip.switch_on(axis, 16384, 16384, 16384)
    begin, end = sampled + HALF_NS, sampled + HALF_NS + PERIOD_NS
    currents = {}
    for time in (begin, begin + HALF_NS, end, end + HALF_NS):
        chip.run(time)
        currents[time] = chip.motor(axis).i_d
    assert currents[begin] == pytest.approx(0.0, abs=1e-12)
    assert currents[end] == pytest.approx(2 * currents[begin + HALF_NS], rel=0.03)
    assert currents[end + HALF_NS] < currents[end]


def test_each_axis_is_sampled_at_its_low_side_centre(make: Callable[..., Chip]) -> None:
    """Currents in the axis' own interrupt, offsets in the interrupt of the other axis, half a period later."""
    plant = ideal_plant().with_axis(0, i_offset=(0.4, 0.4, 0.4)).with_axis(1, i_offset=(-0.4, -0.4, -0.4))
    chip = make(plant)
    for axis in (0, 1):
        chip.lib.plant_motor_lock(chip.ffi.addressof(chip.motor(axis)), True)
        chip.switch_on(axis, 16384 + 1000, 16384 - 500, 16384 - 500)
    chip.run(200 * PERIOD_NS)
    per_amp = 2048 / 8.25
    m1, m2 = chip.calls(M1)[-1], chip.calls(M2)[-1]
    for call, axis, offset in [(m1, 0, 0.4), (m2, 1, -0.4)]:
        phase = chip.motor(axis).phase
        assert call.currents.first == pytest.approx(2048 + (phase[0] + offset) * per_amp, abs=1)
        assert call.currents.second == pytest.approx(2048 + (phase[1] + offset) * per_amp, abs=1)
        assert call.offsets.first == call.offsets.second == round(2048 - offset * per_amp)
    assert abs(chip.motor(0).phase[0]) > 0.5
    assert m1.bus == m2.bus == 2708 - 1


def test_outputs_off_means_no_current(make: Callable[..., Chip]) -> None:
    chip = make()
    chip.servo.duty[0] = (30000, 1000, 1000)
    chip.run(20 * PERIOD_NS)
    assert list(chip.motor(0).phase) == [0.0, 0.0, 0.0]


class TestOverCurrent:
    def trip(self, make: Callable[..., Chip]) -> Chip:
        chip = make(ideal_plant(i_break=5.0))
        chip.lib.plant_motor_lock(chip.ffi.addressof(chip.motor(0)), True)
        chip.switch_on(0, 32767, 0, 0)
        chip.switch_on(1, 16384, 16384, 16384)
        while not chip.calls(BREAK):
            chip.run(chip.hal.now_ns + HALF_NS)
            assert chip.hal.now_ns < 20 * PERIOD_NS
        return chip

    def test_comparator_opens_the_switches_without_software(self, make: Callable[..., Chip]) -> None:
        chip = self.trip(make)
        current = max(map(abs, chip.motor(0).phase))
        assert 5.0 < current < 5.0 + 16.0 / 0.403e-3 * HALF_NS * 1e-9
        assert [(c.axis, c.time_ns) for c in chip.calls(BREAK)] == [(0, chip.hal.now_ns)]
        chip.run(chip.hal.now_ns + 5 * PERIOD_NS)  # the firmware continues to request current
        assert list(chip.motor(0).phase) == [0.0, 0.0, 0.0]
        assert chip.lib.hal_over_current_active(chip.hal, 0)
        assert not chip.lib.hal_over_current_active(chip.hal, 1)
        assert chip.hal.plant.axis[1].inverter.on

    def test_latches_again_while_the_current_is_too_high(self, make: Callable[..., Chip]) -> None:
        chip = self.trip(make)
        chip.lib.hal_over_current_clear(chip.hal, 0)
        assert chip.lib.hal_over_current_active(chip.hal, 0)
        assert not chip.hal.plant.axis[0].inverter.on
        assert chip.hal.breaks == 2

    def test_clears_when_the_current_is_gone(self, make: Callable[..., Chip]) -> None:
        chip = self.trip(make)
        chip.switch_on(0, 16384, 16384, 16384)
        chip.run(chip.hal.now_ns + 5 * PERIOD_NS)
        chip.lib.hal_over_current_clear(chip.hal, 0)
        assert not chip.lib.hal_over_current_active(chip.hal, 0)
        chip.run(chip.hal.now_ns + 5 * PERIOD_NS)
        assert len(chip.calls(BREAK)) == 1


def test_edge_interrupt_follows_an_armed_capture_only(make: Callable[..., Chip]) -> None:
    chip = make()
    chip.motor(1).omega = 100.0
    chip.run(PERIOD_NS)
    assert not chip.calls(EDGE)
    chip.lib.hal_capture_arm(chip.hal, 1)
    chip.run(3 * PERIOD_NS)
    edges = chip.calls(EDGE)
    assert [c.axis for c in edges] == [1]
    # two counts per B edge at 100 rad/s are 31.4 us; the interrupt comes within half a period of its edge
    captured_ns = chip.servo.capture.time * 1280
    assert PERIOD_NS < captured_ns <= edges[0].time_ns < captured_ns + 1280 + HALF_NS
    age = chip.lib.hal_edge_age(chip.hal, 1)
    assert age == chip.hal.now_ns // 1280 - chip.servo.capture.time
    assert not chip.lib.hal_capture_take(chip.hal, 1, chip.ffi.new("edge_capture_t *"))


def test_preset_of_an_encoder_does_not_affect_the_other(make: Callable[..., Chip]) -> None:
    chip = make()
    chip.lib.hal_encoder_preset(chip.hal, 0, 777)
    assert chip.lib.hal_encoder_count(chip.hal, 0) == 777
    assert chip.lib.hal_encoder_count(chip.hal, 1) == 0


class TestSerialLine:
    BYTE_NS = 100_000  # at 100 kbaud

    def send(self, chip: Chip, data: bytes) -> int:
        return int(chip.lib.uart_host_write(chip.ffi.addressof(chip.hal.uart), data, len(data), chip.hal.now_ns))

    def fetch(self, chip: Chip) -> bytes:
        buffer = chip.ffi.new("uint8_t[]", 70000)
        size = chip.lib.uart_host_read(chip.ffi.addressof(chip.hal.uart), buffer, 70000)
        return bytes(chip.ffi.buffer(buffer, size))

    def test_bytes_have_the_delay_of_the_line_in_both_directions(self, make: Callable[..., Chip]) -> None:
        chip = make(baud=100_000.0)
        chip.servo.echo = True
        chip.run(7_777)
        self.send(chip, b"abc")
        arrivals = []
        for n in range(1, 6):
            assert chip.lib.uart_next_ns(chip.ffi.addressof(chip.hal.uart)) == 7_777 + n * self.BYTE_NS or n > 4
            chip.run(7_777 + n * self.BYTE_NS - 1)
            arrivals.append(self.fetch(chip))
            chip.run(7_777 + n * self.BYTE_NS)
            arrivals.append(self.fetch(chip))
        # each byte is returned when it has been received: one byte time later, at full rate
        assert arrivals == [b"", b"", b"", b"a", b"", b"b", b"", b"c", b"", b""]
        assert chip.lib.uart_next_ns(chip.ffi.addressof(chip.hal.uart)) == 2**64 - 1

    def test_byte_at_the_same_time_precedes_the_interrupt(self, make: Callable[..., Chip]) -> None:
        chip = make(baud=10 / HALF_NS * 1e9)
        chip.servo.log_background = True
        self.send(chip, b"x")
        chip.run(HALF_NS)
        at_half = [c.kind for c in chip.calls() if c.time_ns == HALF_NS]
        assert at_half == [BACKGROUND, M2, BACKGROUND]

    @pytest.mark.parametrize("baud", [9600.0, 115200.0, 1e6, 4e6])
    def test_full_speed_without_loss(self, make: Callable[..., Chip], baud: float) -> None:
        chip = make(baud=baud)
        chip.servo.echo = True
        data = bytes(k * 7 % 256 for k in range(300))
        assert self.send(chip, data) == 300
        byte_ns = round(1e10 / baud)
        chip.run(300 * byte_ns)
        assert len(self.fetch(chip)) == 299
        chip.run(301 * byte_ns)
        assert len(self.fetch(chip)) == 1
        assert chip.hal.uart.overruns == 0

    def test_bytes_not_fetched_are_lost_and_counted(self, make: Callable[..., Chip]) -> None:
        chip = make(baud=100_000.0)
        chip.servo.deaf = True
        self.send(chip, b"0123456789")
        chip.run(20 * self.BYTE_NS)
        assert chip.hal.uart.overruns == 6  # the FIFO holds four
        chip.servo.deaf, chip.servo.echo = False, True
        chip.run(40 * self.BYTE_NS)
        assert self.fetch(chip) == b"0123"

    def test_the_line_takes_a_bounded_number_of_bytes_ahead(self, make: Callable[..., Chip]) -> None:
        chip = make(baud=1e6)
        assert self.send(chip, bytes(5000)) == 4096
        chip.run(10_000_000)
        assert self.send(chip, bytes(5000)) == 1000

    def test_newest_bytes_are_lost_without_a_host(self, make: Callable[..., Chip]) -> None:
        chip = make(baud=10e6)
        chip.servo.echo = True
        for _ in range(20):
            self.send(chip, bytes(4096))
            chip.run(chip.hal.now_ns + 4200 * 1000)
        assert len(self.fetch(chip)) == 65536
        assert chip.hal.uart.tx_lost == 20 * 4096 - 65536
