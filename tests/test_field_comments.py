"""Every real-valued field of a data class has its meaning and unit on its line or in a docstring below it."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ["servo_msgs_py", "servo_bridge", "servo_twin"]
FOLDERS = [*(f"{package}/{folder}" for package in PACKAGES for folder in (package, "test")), "firmware", "tests"]

REAL = re.compile(r"\b(float|complex|NDArray|Matrix|_?Array|_Float|_Complex)\b")
ALIAS = re.compile(r"^(\w+) = Annotated\[float, ", re.MULTILINE)


def is_data_class(node: ast.ClassDef) -> bool:
    text = " ".join(map(ast.unparse, [*node.decorator_list, *node.bases]))
    return "dataclass" in text or "NamedTuple" in text


def unexplained(text: str) -> Iterator[str]:
    """Real-valued fields without a comment and without a docstring, with their lines."""
    lines, aliases = text.split("\n"), set(ALIAS.findall(text))
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.ClassDef) or not is_data_class(node):
            continue
        for field, below in zip(node.body, [*node.body[1:], None], strict=True):
            if not isinstance(field, ast.AnnAssign):
                continue
            annotation = ast.unparse(field.annotation)
            real = REAL.search(annotation) or aliases & set(re.findall(r"\w+", annotation))
            if not real or re.search("Callable|ClassVar|Final", annotation):
                continue
            docstring = isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant)
            if not docstring and not any("  # " in line for line in lines[field.lineno - 1 : field.end_lineno]):
                yield f"{field.lineno}: {node.name}.{ast.unparse(field.target)}"


@pytest.mark.parametrize("folder", FOLDERS)
def test_real_valued_fields_of_data_classes_have_a_comment_or_a_docstring(folder: str) -> None:
    paths = sorted((ROOT / folder).rglob("*.py"))
    assert paths
    found = [f"{path.name}:{field}" for path in paths for field in unexplained(path.read_text(encoding="utf-8"))]
    assert found == []


def test_field_without_comment_is_detected() -> None:
    text = (
        "Positive = Annotated[float, 'above 0']\n\n@dataclass\nclass A:\n    a: float  # [s]\n    b: float | None\n"
        "    c: tuple[float, ...]\n    '''b'''\n    d: int\n    f: Fixed[Positive]\n    e: Callable[[float], None]\n"
        "class B:\n    a: float\n"
    )
    assert list(unexplained(text)) == ["6: A.b", "10: A.f"]
