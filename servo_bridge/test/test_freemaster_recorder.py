"""Recorders of fake targets of both protocol versions."""

from __future__ import annotations

import struct
from itertools import pairwise

import pytest
from fake_recorder import RECORD_BYTES, SLOT_BYTES
from fake_target import RO, FakeEntry, FakeTarget
from fake_target_v3 import FakeTargetV3
from fake_transport import FakeTransport, client_on
from servo_bridge.freemaster.client import BoardInfo, Client
from servo_bridge.freemaster.commands import ScopeSlot
from servo_bridge.freemaster.errors import FreemasterError, RecorderError, StatusError
from servo_bridge.freemaster.frames import V4
from servo_bridge.freemaster.recorder import (
    Compare,
    SampleMemory,
    Setup,
    State,
    Trigger,
    in_order,
    memory_checked,
)
from servo_bridge.freemaster.recorder_v4 import set_up

COUNT, WAVE, LIMIT, REAL = (ScopeSlot(0x1000, 4), ScopeSlot(0x1004, 2), ScopeSlot(0x1006, 2), ScopeSlot(0x1008, 4))


def signals(target: FakeTarget, tick: int) -> None:
    """A counter, a triangle -100 .. 100 with a period of 400 ticks from 0, and the triangle as float."""
    phase = (tick + 100) % 400
    wave = phase - 100 if phase <= 200 else 300 - phase
    target.set_int(COUNT.address, tick, 4)
    target.set_int(WAVE.address, wave, 2)
    target.poke(REAL.address, struct.pack(">f" if target.big_endian else "<f", wave))


def a_target(kind: type[FakeTarget] = FakeTarget, **options: object) -> tuple[FakeTarget, Client]:
    rows = [FakeEntry(f"v{s.address:x}", b"\xf1", s.address, s.size, RO) for s in (COUNT, WAVE, LIMIT, REAL)]
    target = kind(tables=[rows], recorder_memory=2048, ticks_per_request=7, **options)  # type: ignore[arg-type]
    target.on_tick = lambda tick: signals(target, tick)
    target.set_int(LIMIT.address, 40, 2)
    client = client_on(FakeTransport(target.feed))
    client.identify()
    return target, client


def points_of(client: Client, memory: SampleMemory, piece: int) -> bytes:
    """All points, oldest first."""
    parts = range(memory.address, memory.address + memory.size, piece)
    return in_order(
        memory, b"".join(client.read_memory(at, min(piece, memory.address + memory.size - at)) for at in parts)
    )


def burst(target: FakeTarget, client: Client, setup: Setup) -> list[tuple[int, int]]:
    """Record, and return counter and triangle of all samples."""
    recorder = client.recorder()
    points = recorder.configure(setup)
    recorder.start()
    for _ in range(10_000):
        if recorder.state() is not State.RUNNING:
            break
    else:
        pytest.fail("no trigger")
    data = points_of(client, memory_checked(recorder.memory()), client.read_limit)
    assert len(data) == points * setup.point_size
    order = target.order
    return [
        (int.from_bytes(data[k : k + 4], order), int.from_bytes(data[k + 4 : k + 6], order, signed=True))
        for k in range(0, len(data), 6)
    ]


@pytest.mark.parametrize("big_endian", [False, True])
@pytest.mark.parametrize(("kind", "mtu"), [(FakeTarget, 240), (FakeTarget, 32), (FakeTargetV3, 60)])
@pytest.mark.parametrize("above", [True, False])
@pytest.mark.parametrize("divider", [1, 3])
def test_trigger_is_at_the_requested_position(
    kind: type[FakeTarget], mtu: int, big_endian: bool, above: bool, divider: int
) -> None:
    target, client = a_target(kind, mtu=mtu, big_endian=big_endian)
    trigger = Trigger(WAVE, Compare.SIGNED, above, not above, -50)
    rows = burst(target, client, Setup((COUNT, WAVE), 100, 30, divider, trigger))
    counts, waves = zip(*rows, strict=True)
    assert len(rows) == 100
    assert [b - a for a, b in pairwise(counts)] == [divider] * 99
    assert (waves[30] >= -50) is above
    assert (waves[29] >= -50) is not above


def test_threshold_can_be_a_variable_and_an_unselected_trigger_is_not_stored() -> None:
    _, client = a_target()
    trigger = Trigger(WAVE, Compare.SIGNED, True, False, threshold_address=LIMIT.address)
    recorder = client.recorder()
    assert recorder.configure(Setup((COUNT,), 50, 10, 1, trigger)) == 50
    recorder.start()
    while recorder.state() is State.RUNNING:
        pass
    memory = recorder.memory()
    assert memory.point_size == 4
    data = points_of(client, memory, 16)
    tick = int.from_bytes(data[40:44], "little")
    assert (tick + 100) % 400 - 100 == 40


def test_a_level_trigger_fires_at_once_and_an_edge_trigger_does_not() -> None:
    target, client = a_target()
    rows = burst(
        target, client, Setup((COUNT, WAVE), 20, 10, 1, Trigger(WAVE, Compare.SIGNED, True, False, -1000, level=True))
    )
    assert rows[-1][0] < target.ticks_done
    bits = int.from_bytes(struct.pack("<f", 60.0), "little")
    rows = burst(target, client, Setup((COUNT, WAVE), 20, 0, 1, Trigger(REAL, Compare.FLOAT, True, False, bits)))
    assert rows[0][1] == 60


def test_a_recording_may_be_stopped_early() -> None:
    _, client = a_target()
    recorder = client.recorder()
    with pytest.raises(StatusError, match="not initialised"):
        recorder.stop()
    recorder.configure(Setup((COUNT,), 400))
    assert recorder.state() is State.EMPTY
    recorder.start()
    recorder.stop()
    assert recorder.state() is State.CUT_SHORT
    memory = recorder.memory()
    assert 0 < memory.count < 400
    counts = struct.unpack(f"<{memory.count}I", points_of(client, memory, 240))
    assert list(counts) == list(range(counts[0], counts[0] + memory.count))


@pytest.mark.parametrize("kind", [FakeTarget, FakeTargetV3])
def test_recording_fills_the_memory(kind: type[FakeTarget]) -> None:
    _, client = a_target(kind)
    recorder = client.recorder()
    fits = (2048 - RECORD_BYTES - 2 * SLOT_BYTES) // 6 if kind is FakeTarget else 2048 // 6
    assert recorder.configure(Setup((COUNT, WAVE))) == fits
    assert recorder.configure(Setup((COUNT, WAVE), fits)) == fits
    with pytest.raises(RecorderError, match=f"{fits} points fit"):
        recorder.configure(Setup((COUNT, WAVE), fits + 1))
    with pytest.raises(RecorderError, match=r"too many|record fewer"):
        recorder.configure(Setup((COUNT,) * 80))


def test_capacity_reported_by_the_target_is_used() -> None:
    """The number of samples that the target reports after the set-up is used."""
    target, client = a_target()
    real = target.recorders[0].capacity
    target.recorders[0].capacity = lambda *_: real() - 3  # type: ignore[method-assign]
    fits = (2048 - RECORD_BYTES - SLOT_BYTES) // 4
    with pytest.raises(RecorderError, match=f"{fits - 3} points fit"):
        client.recorder().configure(Setup((COUNT,), fits))


def test_invalid_recordings_are_refused() -> None:
    _, client = a_target(FakeTargetV3)
    level = Trigger(WAVE, Compare.SIGNED, True, False, 0, level=True)
    with pytest.raises(RecorderError, match="one edge through a fixed threshold"):
        client.recorder().configure(Setup((COUNT,), 10, 0, 1, level))
    with pytest.raises(RecorderError, match="divide its rate"):
        client.recorder().configure(Setup((COUNT,), 10, 0, 70_000))
    with pytest.raises(RecorderError, match="not less than all 10"):
        Setup((COUNT,), 10, 10)
    with pytest.raises(RecorderError, match="1, 2, 4 or 8"):
        Setup((ScopeSlot(0, 3),))
    with pytest.raises(RecorderError, match="nothing to record"):
        Setup(())
    _, client = a_target()
    with pytest.raises(FreemasterError, match=r"no recorder 1; recorders: 0 \.\. 0"):
        client.recorder(1)
    with pytest.raises(StatusError, match="access denied"):
        client.recorder().configure(Setup((ScopeSlot(0x9999, 2),)))


def test_invalid_memory_is_refused() -> None:
    with pytest.raises(RecorderError, match="not plausible"):
        memory_checked(SampleMemory(0, 4, 10, 10))
    with pytest.raises(RecorderError, match="not plausible"):
        memory_checked(SampleMemory(0, 1 << 20, 1 << 20, 0))


def test_set_up_matches_the_wire() -> None:
    """Frames of a vendor target, with all operations in one frame."""
    head = V4.encode(0x24, b"\x00")[:2]
    setup = Setup(
        (ScopeSlot(0x20000038, 4), ScopeSlot(0x2000003C, 2)), 20, 5, 1,
        Trigger(ScopeSlot(0x2000003C, 2), Compare.SIGNED, True, False, -100),
    )  # fmt: skip
    (request,) = set_up(0, setup, 252)
    assert request.frame.startswith(head)
    assert request.payload == bytes.fromhex(
        "00 01 04 02 14 05 00 02 09 00 B8 80 80 80 02 04 00 00 02 0A 01 BC 80 80 80 02 02 12 9C 7F"
    )
    bits = int.from_bytes(struct.pack("<f", 100.25), "little")
    (request,) = set_up(
        0,
        Setup(
            (ScopeSlot(0x20000038, 4),), 8, 3, 1, Trigger(ScopeSlot(0x2000006C, 4), Compare.FLOAT, True, False, bits)
        ),
        252,
    )
    assert V4.encode(0x24, request.payload + b"\x03\x00") == bytes.fromhex(
        "2B 24 23 00 01 04 02 08 03 00 02 09 00 B8 80 80 80 02 04 00 00"
        "02 0D 01 EC 80 80 80 02 04 17 80 80 A2 96 04 03 00 F6"
    )
    below = Trigger(ScopeSlot(0x2000003C, 2), Compare.SIGNED, False, True, threshold_address=0x20000066)
    (request,) = set_up(0, Setup((ScopeSlot(0x2000003C, 2),), 8, 3, 1, below), 252)
    assert V4.encode(0x24, request.payload + b"\x03\x00") == bytes.fromhex(
        "2B 24 18 00 01 04 01 08 03 00 02 0D 00 BC 80 80 80 02 02 A2 E6 80 80 80 02 03 00 9C"
    )


def test_limits_of_the_reference_target_are_read() -> None:
    answers = {
        "2B 25 02 00 81 D8": "2B 95 E2",
        "2B 25 02 00 82 D1": "2B 40 07 80 08 C0 84 3D 40 20 5B",
        "2B 25 02 00 83 D6": "2B 40 0A 04 02 80 C1 80 80 02 06 14 0E 1A",
        "2B 25 02 00 84 C3": "2B 40 01 02 9D",
        "2B 24 03 00 03 00 EE": "2B 00 00",
    }
    client = client_on(FakeTransport(lambda request: bytes.fromhex(answers[request.hex(" ").upper()])))
    client.info = BoardInfo(recorders=1)
    recorder = client.recorder()
    limits = recorder.limits()
    assert (limits.memory, limits.period_ns, limits.overhead, limits.slot_overhead) == (1024, 1_000_000, 64, 32)
    recorder.start()
    assert recorder.memory() == SampleMemory(0x20002080, 6, 20, 14)
    assert recorder.state() is State.RUNNING
