"""Pipes: bytes in both directions, complete and in order on a line that loses and damages frames."""

from __future__ import annotations

import pytest
from fake_target import FakeTarget
from fake_target_v3 import FakeTargetV3
from fake_transport import client_on
from lossy_line import LossyLine
from servo_bridge.freemaster.errors import CodecError, FreemasterError, StatusError


@pytest.mark.parametrize("kind", [FakeTarget, FakeTargetV3])
@pytest.mark.parametrize("odd", [False, True])
def test_both_streams_are_complete_on_a_bad_line(kind: type[FakeTarget], odd: bool) -> None:
    """For both toggle states that the target may have from a previous client."""
    target = kind(tables=[[]])
    line = LossyLine(target.feed, seed=5)
    client = client_on(line)
    client.identify()
    if odd:
        client.pipe().exchange()
    line.lose_request = line.lose_answer = line.damage = 0.1
    written = bytes(line.random.randrange(256) for _ in range(3000))
    sent = bytes(line.random.randrange(256) for _ in range(300))
    remaining, received, queued = sent, b"", 0
    pipe = client.pipe()
    for _ in range(5000):
        more = written[queued : queued + line.random.randrange(40)]
        queued += len(more)
        target.pipe += more
        try:
            data, accepted = pipe.exchange(remaining[:10])
        except FreemasterError:
            continue
        received += data
        remaining = remaining[accepted:]
        if len(received) == len(written) and not remaining:
            break
    assert received == written
    assert target.pipe_received == sent


def test_data_of_another_client_are_not_acknowledged_as_own() -> None:
    """The target remembers its last frame; the first frame of this client is lost."""
    target = FakeTarget(tables=[[]])
    line = LossyLine(target.feed)
    client = client_on(line)
    client.identify()
    other = client.pipe()
    other.exchange()
    other.exchange(b"1234")
    other.exchange(b"5678")
    pipe = client.pipe()
    line.lose_request = 1.0
    with pytest.raises(FreemasterError):
        pipe.exchange(b"abcd")
    line.lose_request = 0.0
    assert pipe.exchange(b"abcd") == (b"", 4)
    assert target.pipe_received == b"12345678abcd"


def test_missing_pipe_is_reported() -> None:
    target = FakeTarget(tables=[[]])
    client = client_on(LossyLine(target.feed))
    with pytest.raises(StatusError, match="pipe error"):
        client.pipe(2).exchange()
    with pytest.raises(CodecError, match=r"pipe 0 is not 1 \.\. 127"):
        client.pipe(0)
