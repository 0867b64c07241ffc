"""A write with a value out of range is refused completely, by every access path."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from core_library import Core
from freemaster_model import Answer, parse_answer, request, uleb
from hypothesis import given
from hypothesis import strategies as st
from servo_bench import Bench
from servo_msgs_py.catalogue import Catalogue, Variable
from servo_msgs_py.value_text import parse_values

WRITEMEM = 0x23
OUT_OF_RANGE = 0x97
REACH = 2**30
CATALOGUE = Catalogue.load()
WRITABLE = {
    v.name: v
    for v in CATALOGUE.variables.values()
    if v.writable and v.name.startswith(("cmd.", "param.")) and v.name != "cmd.points"
}
RANGED = [name for name in WRITABLE if name != "cmd.position"]
BOUNDED = [name for name in RANGED if WRITABLE[name].raw_range[1] + 1 < 1 << 8 * WRITABLE[name].element_size]
"""Variables with a range smaller than that of their type."""


def stopped(core: Core, *, shaft: int = 0) -> Bench:
    """A board at rest with both shafts at the position `shaft` [counts]."""
    bench = Bench(core)
    bench.to_stop()
    for axis in range(2):
        bench.view(axis).position = shaft
    return bench


@pytest.fixture
def bench(core: Core) -> Bench:
    return stopped(core)


def memory(bench: Bench) -> bytes:
    """Command and parameter blocks, their marks, and the counters of the supervision."""
    servo, buffer = bench.servo, bench.core.ffi.buffer
    parts = (servo.command, servo.parameter, servo.marks)
    counts = bytes([servo.host_commands & 0xFF, servo.locked])
    return b"".join(bytes(buffer(bench.core.ffi.addressof(part))) for part in parts) + counts


def over_frame(bench: Bench, address: int, data: bytes, mask: bytes | None = None) -> int:
    """Status of a WRITEMEM over the serial line."""
    flags = b"\x00" if mask is None else b"\x01"
    wire = request(WRITEMEM, flags + uleb(address) + uleb(len(data)) + data + (mask or b""))
    hal = bench.hal
    bench.core.ffi.memmove(hal.serial_in, wire, len(wire))
    hal.serial_in_taken, hal.serial_in_size, hal.serial_out_size = 0, len(wire), 0
    bench.core.lib.servo_background(bench.servo)
    answer = parse_answer(bytes(bench.core.ffi.buffer(hal.serial_out, hal.serial_out_size)))
    assert answer == Answer(answer.status)
    return answer.status


def by_direct_access(bench: Bench, address: int, data: bytes, mask: bytes | None = None) -> int:
    """Status of a write without a serial line."""
    lib, servo = bench.core.lib, bench.servo
    if mask is None:
        return int(lib.servo_write(servo, address, data, len(data)))
    return int(lib.freemaster_write(bench.core.ffi.addressof(servo, "freemaster"), address, data, mask, len(data)))


WriteFunction = Callable[..., int]
ACCESS_PATHS = pytest.mark.parametrize("write", [over_frame, by_direct_access])


def encoded(variable: Variable, number: int) -> bytes:
    """Bytes of one element, in range or not."""
    return (number % (1 << 8 * variable.element_size)).to_bytes(variable.element_size, "little")


def stored(bench: Bench, variable: Variable) -> list[int]:
    data = bench.core.ffi.new("uint8_t[]", variable.size)
    assert bench.core.lib.servo_read(bench.servo, bench.address(variable.name), data, variable.size) == 0
    return variable.decode_raw(bytes(bench.core.ffi.buffer(data)))


def test_values_after_a_reset_are_within_their_ranges(bench: Bench) -> None:
    for variable in WRITABLE.values():
        low, high = variable.raw_range
        assert all(low <= number <= high for number in stored(bench, variable)), variable.name


@ACCESS_PATHS
@pytest.mark.parametrize("name", RANGED)
def test_both_ends_of_a_range_are_accepted(bench: Bench, name: str, write: WriteFunction) -> None:
    variable = WRITABLE[name]
    for number in variable.raw_range:
        assert write(bench, bench.address(name), encoded(variable, number) * variable.count) == 0
        assert stored(bench, variable) == [number] * variable.count
        bench.core.lib.servo_init(bench.servo, bench.hal, bench.core.lib.probe_config())
        for element in range(variable.count):
            assert write(bench, bench.address(name, element), encoded(variable, number)) == 0
            assert stored(bench, variable)[element] == number


@ACCESS_PATHS
@pytest.mark.parametrize("name", BOUNDED)
def test_a_value_one_beyond_either_end_is_refused_and_changes_nothing(
    bench: Bench, name: str, write: WriteFunction
) -> None:
    variable = WRITABLE[name]
    low, high = variable.raw_range
    before = memory(bench)
    for number in (low - 1, high + 1):
        bad, good = encoded(variable, number), encoded(variable, high)
        for element in range(variable.count):
            assert write(bench, bench.address(name, element), bad) == OUT_OF_RANGE
            whole = good * element + bad + good * (variable.count - element - 1)
            assert write(bench, bench.address(name), whole) == OUT_OF_RANGE, "the good element is not written either"
            assert write(bench, bench.address(name), whole, b"\xff" * len(whole)) == OUT_OF_RANGE
        assert memory(bench) == before


@given(data=st.data())
def test_after_any_writes_every_element_is_inside_its_range(core: Core, data: st.DataObject) -> None:
    """Writes of parts of elements, of several elements and with masks: every stored element stays in its range."""
    bench = stopped(core)
    taken = 0
    for _ in range(20):
        variable = data.draw(st.sampled_from(list(WRITABLE.values())))
        begin = data.draw(st.integers(0, variable.size - 1))
        size = data.draw(st.integers(1, variable.size - begin))
        written = data.draw(st.binary(min_size=size, max_size=size))
        some = st.sampled_from([0, 0xFF]) | st.integers(0, 0xFF)
        mask = data.draw(st.none() | st.lists(some, min_size=size, max_size=size).map(bytes))
        before = stored(bench, variable)
        old = b"".join(encoded(variable, number) for number in before)
        selected = mask or b"\xff" * size
        new = bytearray(old)
        for k in range(size):
            new[begin + k] = old[begin + k] & ~selected[k] & 0xFF | written[k] & selected[k]
        low, high = variable.raw_range
        expected = variable.decode_raw(bytes(new))
        fits = all(low <= number <= high for number in expected)
        status = by_direct_access(bench, bench.address(variable.name) + begin, written, mask)
        if variable.name == "cmd.position":
            fits = status == 0  # the distance is limited too, see below
        assert status == (0 if fits else OUT_OF_RANGE)
        assert stored(bench, variable) == (expected if fits else before)
        taken += fits


@ACCESS_PATHS
@pytest.mark.parametrize(
    ("group", "member", "variable", "value"),
    [
        ("observer", "drive", "param.features", "ANGLE_CHECK"),
        ("observer", "drive", "param.feedback", "OBSERVER"),
        ("speed_observer", "l_position", "param.features", "SPEED_OBSERVER"),
    ],
)
def test_what_the_configuration_has_no_constants_for_is_refused(
    bench: Bench, group: str, member: str, variable: str, value: str, write: WriteFunction
) -> None:
    servo, entry = bench.servo, WRITABLE[variable]
    config = bench.core.ffi.new("axis_config_t *", servo.axis[1].config[0])
    setattr(getattr(config, group), member, 0)
    servo.axis[1].config = config
    (number,) = parse_values(entry, value, CATALOGUE)
    data = encoded(entry, entry.to_raw(number))
    assert write(bench, bench.address(variable, 1), data) == OUT_OF_RANGE
    assert write(bench, bench.address(variable, 0), data) == 0, "the other axis has them"
    others = encoded(entry, 1 << 3 if variable == "param.features" else 0)
    assert write(bench, bench.address(variable, 1), others) == 0


# ---- position set-points --------------------------------------------------------------------------------------------


@ACCESS_PATHS
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("shaft", [0, 12345, -(2**30) - 7, 2**31 - 1, -(2**31)])
def test_a_position_out_of_reach_is_refused(core: Core, shaft: int, axis: int, write: WriteFunction) -> None:
    """Distance above a quarter of the 32-bit range; the distance is the shorter one across the wrap."""
    bench, variable = stopped(core), WRITABLE["cmd.position"]
    bench.view(axis).position = shaft
    address = bench.address("cmd.position", axis)
    for distance in (0, 1, -1, REACH, -REACH):
        assert write(bench, address, encoded(variable, shaft + distance)) == 0, distance
    before = memory(bench)
    for distance in (REACH + 1, -REACH - 1, 2**31 - 1, -(2**31)):
        assert write(bench, address, encoded(variable, shaft + distance)) == OUT_OF_RANGE, distance
    assert memory(bench) == before


def test_only_the_commanded_axis_is_checked_for_its_distance(core: Core) -> None:
    """The other shaft may have moved away from its last set-point."""
    bench, variable = stopped(core), WRITABLE["cmd.position"]
    bench.view(1).position = 2**31 - 1
    address, both = bench.address("cmd.position"), encoded(variable, 7) * 2
    assert over_frame(bench, address, encoded(variable, 7)) == 0
    assert over_frame(bench, address, both, b"\xff" * 4 + bytes(4)) == 0
    assert over_frame(bench, address, both) == OUT_OF_RANGE
    assert over_frame(bench, address, both, bytes(7) + b"\x01") == OUT_OF_RANGE


# ---- effects of a refused write ------------------------------------------------------------------------------------


def test_a_refused_command_takes_no_effect(bench: Bench) -> None:
    snapshot = bench.servo.snapshot
    count, commands = snapshot.applied_count, bench.servo.host_commands
    assert over_frame(bench, bench.address("cmd.enable"), b"\x01\x00\x02\x00") == OUT_OF_RANGE
    assert bench.servo.freemaster.statistics.refused == 1
    bench.slow(3)
    assert (snapshot.applied_count, bench.servo.host_commands) == (count, commands), (
        "it does not reset the host time-out"
    )
    assert not bench.axis(0).enable_requested


# ---- boot token ------------------------------------------------------------------------------------------------------


@ACCESS_PATHS
def test_the_boot_token_is_written_once_after_each_reset(bench: Bench, write: WriteFunction) -> None:
    variable = CATALOGUE["boot_token"]
    address = bench.address(variable.name)
    for token in (0x12345678, 5):
        assert stored(bench, variable) == [0]
        assert write(bench, address, encoded(variable, token)) == 0
        for number in (0, token + 1):
            assert write(bench, address, encoded(variable, number)) == OUT_OF_RANGE
        for part in range(4):
            assert write(bench, address + part, bytes(4 - part)) == OUT_OF_RANGE
        bench.slow(3)
        assert stored(bench, variable) == [token]
        bench.core.lib.servo_init(bench.servo, bench.hal, bench.core.lib.probe_config())
