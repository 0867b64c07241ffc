"""Hand-over between threads."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial

from servo_bridge.inbox import Inbox


def test_one_wake_up_for_all_pending_items_in_order() -> None:
    woken: list[Callable[[], None]] = []
    seen: list[int] = []
    inbox = Inbox(woken.append)
    for k in range(5):
        inbox.post(partial(seen.append, k))
    assert len(woken) == 1
    woken[0]()
    assert seen == [0, 1, 2, 3, 4]
    inbox.post(lambda: seen.append(9))
    assert len(woken) == 2


def test_items_posted_during_drain_are_handled_by_the_next_one() -> None:
    woken: list[Callable[[], None]] = []
    seen: list[str] = []
    inbox = Inbox(woken.append)
    inbox.post(lambda: inbox.post(lambda: seen.append("later")))
    woken[0]()
    assert seen == []
    woken[1]()
    assert seen == ["later"]


def test_no_item_is_lost_between_threads() -> None:
    ready = threading.Condition()
    woken: list[Callable[[], None]] = []

    def wake(function: Callable[[], None]) -> None:
        with ready:
            woken.append(function)
            ready.notify()

    inbox = Inbox(wake)
    seen: list[int] = []

    def produce() -> None:
        for k in range(2000):
            inbox.post(partial(seen.append, k))

    thread = threading.Thread(target=produce)
    thread.start()
    while len(seen) < 2000:
        with ready:
            assert ready.wait_for(lambda: woken, 5.0)
            function = woken.pop(0)
        function()
    thread.join()
    assert seen == list(range(2000))


def test_closed_inbox_discards_items() -> None:
    woken: list[Callable[[], None]] = []
    seen: list[int] = []
    inbox = Inbox(woken.append)
    inbox.post(lambda: seen.append(1))
    inbox.close()
    inbox.post(lambda: seen.append(2))
    woken[0]()
    assert seen == []
    assert len(woken) == 1
