"""The parts of a bridge: each one learns of a connection, of samples, of the loss and of the end."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace
from typing import Any
from unittest.mock import MagicMock

from board_context_rig import board_context
from bridge_rig import Rig
from servo_bridge.board_requests import BoardRequests
from servo_bridge.bursts.record_service import RecordService
from servo_bridge.part import Part
from servo_bridge.storage_service import StorageService
from servo_bridge.telemetry import Snapshot
from servo_bridge.tuning.service import TuningService


class _Recorder(Part):
    """Part that records its calls."""

    def __init__(self, name: str, calls: list[tuple[str, str]]) -> None:
        self._name, self._calls = name, calls

    def connected(self) -> None:
        self._calls.append((self._name, "connected"))

    def on_sample(self, snapshot: Snapshot) -> None:
        self._calls.append((self._name, "sample"))

    def lost(self, reason: str) -> None:
        self._calls.append((self._name, f"lost: {reason}"))

    def close(self) -> None:
        self._calls.append((self._name, "close"))


def test_every_part_is_in_the_order_once() -> None:
    with Rig() as rig:
        assert rig.bridge.supervisor is not None
        parts = rig.bridge.supervisor.parts
        assert len(parts.order) == len(set(parts.order))
        assert set(parts.order) == {part for part in vars(parts).values() if isinstance(part, Part)}


def test_all_parts_are_told_in_order_and_the_end_is_a_loss() -> None:
    calls: list[tuple[str, str]] = []
    with Rig() as rig:
        assert rig.bridge.supervisor is not None
        rig.bridge.supervisor.parts.order += (_Recorder("a", calls), _Recorder("b", calls))
        rig.connect()
        rig.link.disconnect(reason="gone")
        rig.until(lambda: "gone" in rig.state())
        rig.connect()
    told = ["connected", "sample", "lost: gone", "connected", "sample", "lost: the bridge was stopped", "close"]
    assert calls == [(name, call) for call in told for name in "ab"]


def test_calls_in_progress_are_answered_at_the_end() -> None:
    """Also those whose result would come from the link, which is closed."""
    context = replace(board_context(log=lambda _: None), call=lambda _: Future[Any]())
    requests = BoardRequests(context)
    storage = StorageService(context, MagicMock(), requests)
    records = RecordService(context, MagicMock(), MagicMock(), 8, MagicMock())
    tuning = TuningService(context, MagicMock(), "axes.toml", MagicMock(), MagicMock(), requests)
    answers = [storage._request("SAVE"), records._on_record(True), tuning._on_tune(False)]
    for part in (storage, records, tuning, requests):
        part.lost("unplugged")
        part.close()
    assert [answer.result(0)[0] for answer in answers] == [False] * 3
    assert "unplugged" in answers[0].result(0)[1]
    assert storage._request("SAVE") is not answers[0]  # the next one is not refused as a second one
