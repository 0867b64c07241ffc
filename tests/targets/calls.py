"""Outputs of the core in one call of an entry point, as numbers and as text."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from servo_msgs_py.units import PERIOD_NS

KINDS: Final = ("init", "m1", "m2", "background", "edge", "over_current")
"""Names of ``call_t``."""

_OUTPUTS: Final = (
    ("pair", 1),
    ("duty", 3),
    ("enable", 1),
    ("over_current_clear", 0),
    ("preset", 1),
    ("capture_arm", 0),
    ("serial", 1),
    ("watchdog", 0),
    ("brake", 1),
    ("monitor", 1),
    ("done", 0),
    ("erase", 1),
    ("program", 3),
)
"""Names of ``out_t``, and number of words after the head."""

_AXIS_KINDS: Final = ("edge", "over_current")
_CALL: Final = re.compile(r"\?([0-9A-F]{8})((?: [0-9A-F]{4})+)")
_FIELD: Final = re.compile(r"!([0-9A-F]{4}) ([0-9A-F]{8})")
_CHECK: Final = re.compile(r"=([0-9A-F]{8})")
_END: Final = re.compile(r"end ([0-9A-F]{8})")


@dataclass(frozen=True)
class Call:
    """One call of an entry point."""

    period: int  # time of the call after reset [PWM periods]
    kind: int  # entry point, index of `KINDS`
    axis: int  # axis of the entry point, 0 or 1
    left: int  # number of recorded inputs that were not read
    missing: int  # number of inputs that were read but not recorded
    out: tuple[int, ...]  # output words, as in ``exchange.h``
    snapshot: tuple[tuple[int, int], ...] = ()  # index in the table of variables and value of each published scalar

    @property
    def place(self) -> str:
        """Time and entry point, as text."""
        kind = KINDS[self.kind] if self.kind < len(KINDS) else f"call {self.kind}"
        axis = f" of axis{self.axis + 1}" if kind in _AXIS_KINDS else ""
        return f"period {self.period} ({self.period * PERIOD_NS / 1e6:.2f} ms), {kind}{axis}"

    def outputs(self) -> list[str]:
        """Output words, one text per operation."""
        texts: list[str] = []
        words = list(self.out)
        while words:
            head = words.pop(0)
            operation, axis = head & 0xFF, head >> 8
            name, count = _OUTPUTS[operation] if operation < len(_OUTPUTS) else (f"operation {operation}", 0)
            operands = [str(_signed(word) if name in ("duty", "preset") else word) for word in words[:count]]
            del words[:count]
            texts.append(
                " ".join([name if name in ("serial", "watchdog", "brake") else f"axis{axis + 1} {name}", *operands])
            )
        return texts


@dataclass(frozen=True)
class Outcome:
    """Output of a replay program: final digest, check values, and calls of the requested periods."""

    digest: int
    checks: tuple[int, ...]
    calls: tuple[Call, ...]


def _signed(word: int) -> int:
    return word - 0x10000 if word & 0x8000 else word


def parse_console(text: str) -> Outcome:
    """Parse the output of a replay program.

    Raises
    ------
    ValueError
        If the program did not terminate normally.
    """
    checks: list[int] = []
    calls: list[Call] = []
    fields: list[tuple[int, int]] = []
    for line in text.splitlines():
        if match := _END.fullmatch(line):
            return Outcome(int(match[1], 16), tuple(checks), tuple(calls))
        if match := _CHECK.fullmatch(line):
            checks.append(int(match[1], 16))
        elif match := _CALL.fullmatch(line):
            kind, axis, left, missing, *out = (int(word, 16) for word in match[2].split())
            fields = []
            calls.append(Call(int(match[1], 16), kind, axis, left, missing, tuple(out)))
        elif (match := _FIELD.fullmatch(line)) and calls:
            fields.append((int(match[1], 16), int(match[2], 16)))
            calls[-1] = Call(**{**vars(calls[-1]), "snapshot": tuple(fields)})
    raise ValueError(f"the program did not terminate normally; end of its output: {text[-200:]!r}")


def parse_log(words: Sequence[int]) -> Iterator[Call]:
    """Calls in the log of the recorder (``recorder.h``)."""
    at = 0
    while at < len(words):
        begin, snapshot = at + 5, at + 5 + words[at + 4]
        low, high, kind, axis = words[at : begin - 1]
        end = snapshot + 1 + 3 * words[snapshot]
        fields = tuple((words[k], words[k + 1] | words[k + 2] << 16) for k in range(snapshot + 1, end, 3))
        yield Call(low | high << 16, kind, axis, 0, 0, tuple(words[begin:snapshot]), fields)
        at = end


def difference(call: Call, recorded: Call, fields: Mapping[int, str]) -> str | None:
    """First difference between a call on a target and the recorded call, as text; None if there is none.

    Parameters
    ----------
    fields : mapping
        Names of the entries in the table of variables.
    """
    if call == recorded:
        return None
    if call.missing or call.left:
        asked = f"read {call.missing} inputs more" if call.missing else f"left {call.left} inputs"
        return f"{call.place}: {asked} than were recorded"
    for here, there in zip(call.outputs(), recorded.outputs(), strict=False):
        if here != there:
            return f"{call.place}: {here}, recorded {there}"
    if len(call.out) != len(recorded.out):
        return f"{call.place}: outputs {call.outputs()}, recorded {recorded.outputs()}"
    for (index, value), (_, expected) in zip(call.snapshot, recorded.snapshot, strict=False):
        if value != expected:
            return f"{call.place}: {fields.get(index, f'entry {index}')} is {value:#x}, recorded {expected:#x}"
    return f"{call.place}: snapshot {'published' if call.snapshot else 'missing'}"
