"""Every row of the table of failures has a test, and every test of these files has a row."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TABLE = ROOT / "servo_bridge" / "doc" / "failures.md"
TESTS = [ROOT / "tests" / name for name in ("test_failures_board.py", "test_failures_bridge.py")]
OTHER_FILES = {"parameter-written": ROOT / "tests" / "test_parameters_move_nothing.py"}
NAME = re.compile(r"`?([a-z]+(?:-[a-z]+)*)`?")


def table_rows(text: str) -> list[str]:
    """Names in the first column of the tables of a text, without the headings."""
    rows, inside = [], False
    for line in text.splitlines():
        if not line.startswith("|"):
            inside = False
        elif re.fullmatch(r"\|[\s:|-]+\|", line.strip()):
            inside = True
        elif inside and (name := NAME.fullmatch(line.split("|")[1].strip())):
            rows.append(name[1])
    return rows


def rows_with_tests(path: Path) -> list[str]:
    """Names of rows from the test functions of a file, including those in classes."""
    functions = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.FunctionDef)]
    names = [f.name for f in functions if f.name.startswith("test_")]
    return [name.removeprefix("test_").replace("_", "-") for name in names]


def test_every_row_has_a_test_and_every_test_a_row() -> None:
    rows = table_rows(TABLE.read_text().partition("## How a program ends")[0])  # its table: test_program_ends.py
    assert rows, "no table found"
    assert len(rows) == len(set(rows)), "a row occurs twice"
    tested = {row for path in TESTS for row in rows_with_tests(path)}
    tested |= {row for row, path in OTHER_FILES.items() if row in rows_with_tests(path)}
    assert sorted(set(rows) - tested) == [], "rows without a test"
    assert sorted(tested - set(rows)) == [], "tests without a row"
