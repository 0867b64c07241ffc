"""Comments of C headers: a unit or format for every numeric member, and complete sentences on each line."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).resolve().parents[1] / "firmware"
NATIVE = Path(__file__).resolve().parents[1] / "servo_twin" / "native"
HEADERS = [
    path
    for path in sorted(FIRMWARE.rglob("*.h"))
    if not {"test", "port"} & set(path.relative_to(FIRMWARE).parts) and not path.name.endswith("_gen.h")
]
PLANT_HEADERS = [NATIVE / "board.h", *sorted((NATIVE / "plant").glob("*.h"))]
ALL_HEADERS = [
    path
    for path in (*sorted(FIRMWARE.rglob("*.h")), *sorted(NATIVE.rglob("*.h")))
    if "build" not in path.parts and not path.name.endswith("_gen.h")
]

STRUCTURE = re.compile(r"\bstruct\s*\w*\s*\{\n(.*?)\n\}", re.DOTALL)
MEMBER = re.compile(r"\s*(?:volatile )?(frac16_t|frac32_t|gain_t|path_position_t|pi_sum_t|u?int\d+_t) (\w[^;(]*);(.*)")
FRACTIONS = {"frac16_t", "frac32_t"}
REAL_MEMBER = re.compile(r"\s*(double) (\w[^;(]*);(.*)")
# After a member, a constant or a name of an enumeration: a comment that continues the previous line.
CONTINUATION = re.compile(r"[;,\w)}]\s*/\*\s*(\.\.|the same\b|of\b|that\b|and\b)|\.\.\s*\*/", re.IGNORECASE)
# A unit in brackets; [1]: no unit.
UNIT = re.compile(r"\[[^\]]+\]")
# Quantities with a full scale in firmware/doc/references.md, and number formats.
QUANTITY = re.compile(
    r"speed|accel|omega|\bi_|current|\bu_|voltage|emf|theta|angle|temperature|torque|\bpart\b|Q\d|bits|full.scale"
)


def members(text: str, member: re.Pattern[str] = MEMBER) -> Iterator[tuple[int, str, str, str]]:
    """Line, type, name and comment of every numeric member; the comment may stand on the line above it."""
    for structure in STRUCTURE.finditer(text):
        first, above = text.count("\n", 0, structure.start(1)) + 1, ""
        for number, line in enumerate(structure[1].split("\n"), first):
            if found := member.match(line):
                yield number, found[1], found[2], found[3].strip() or above
            above = line.strip() if line.strip().endswith("*/") and ";" not in line else ""


@pytest.mark.parametrize("path", HEADERS, ids=lambda path: str(path.relative_to(FIRMWARE)))
def test_numeric_members_have_a_comment_and_fractions_name_their_quantity(path: Path) -> None:
    unclear = []
    for line, kind, name, comment in members(path.read_text(encoding="utf-8")):
        quantity = kind not in FRACTIONS or QUANTITY.search(f"{name} {comment}")
        if not comment or not quantity:
            unclear.append(f"{line}: {kind} {name}; {comment}")
    assert unclear == []


@pytest.mark.parametrize("path", PLANT_HEADERS, ids=lambda path: str(path.relative_to(NATIVE)))
def test_members_of_the_plant_have_a_unit_in_brackets(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    found = members(text, REAL_MEMBER)
    assert [f"{line}: {name}" for line, _, name, comment in found if not UNIT.search(comment)] == []


@pytest.mark.parametrize("path", ALL_HEADERS, ids=lambda path: str(path.relative_to(FIRMWARE.parent)))
def test_a_comment_does_not_continue_the_previous_line(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").split("\n")
    assert [f"{number}: {line}" for number, line in enumerate(lines, 1) if CONTINUATION.search(line)] == []


@pytest.mark.parametrize("line", ["int a; /* the same */", "X, /* of y */", "int a; /* .. b */", "int a; /* b .. */"])
def test_a_comment_that_continues_another_one_is_detected(line: str) -> None:
    assert CONTINUATION.search(line)


def test_member_without_comment_is_detected() -> None:
    text = (
        "typedef struct {\n    frac16_t a; /* part of b */\n    /* Q1.31 */\n    frac32_t c;\n    uint16_t d;\n} x_t;\n"
    )
    assert [(line, comment) for line, _, _, comment in members(text)] == [
        (2, "/* part of b */"),
        (4, "/* Q1.31 */"),
        (5, ""),
    ]
