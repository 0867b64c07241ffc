"""Numbers of the board are stated once, in its description."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from servo_msgs_py.board_description import DEFAULT_BOARD, BoardDescription
from servo_msgs_py.catalogue import Catalogue

ROOT: Final = Path(__file__).resolve().parents[1]
FOLDERS: Final = (
    *("firmware", "servo_msgs_py/servo_msgs_py", "servo_msgs_py/servo_tuning", "servo_msgs_py/servo_measurement"),
    *("servo_bridge/servo_bridge", "servo_twin/servo_twin", "servo_twin/native"),
)
STATED: Final = {
    f"servo_msgs_py/servo_msgs_py/boards/{DEFAULT_BOARD}.toml",
    "firmware/config/servo.toml",  # stop.short_current, a choice that happens to be the range of the shunts
}
COMMENT: Final = re.compile(r'/\*.*?\*/|#[^\n]*|"""[\s\S]*?"""', re.DOTALL)


def sources() -> Iterator[Path]:
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*")):
            if (
                path.suffix in (".py", ".c", ".h", ".toml")
                and not {"test", "build"} & set(path.parts)
                and "_gen" not in path.stem
            ):
                yield path


def test_no_source_repeats_a_number_of_the_board() -> None:
    board = BoardDescription.load()
    numbers = [*board.ranges.values(), Catalogue.load().full_scale("stator_voltage"), board.timer_clock]
    numbers += [board.period_ns, board.period_ns / 1000.0]
    texts = {text for one in numbers for text in (f"{one:.10g}", f"{one:_.10g}")}
    number = re.compile("|".join(rf"(?<![\d.]){re.escape(text)}(?![\d])" for text in sorted(texts)))
    found = {
        path.relative_to(ROOT).as_posix()
        for path in sources()
        if number.search(COMMENT.sub("", path.read_text(encoding="utf-8")))
    }
    assert found == STATED
