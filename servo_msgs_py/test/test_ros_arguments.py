"""Every text, number and list arrives in the node as it was given."""

from __future__ import annotations

import ast
from itertools import pairwise
from pathlib import Path

import rclpy
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.node import Node
from servo_msgs_py.runtime.ros_arguments import parameter_arguments

NAMES = ["run #1.rrd", "a: b", "[new] 1.rrd", "{x}", "- y", "&a", "*a", "!t", "o'neil", 'say "so"', "%", "@", "`", "|"]
LIKE_VALUES = ["", "true", "null", "~", "12", "1e3", "1_0", ".inf", "0x1F", "yes"]
PRINTABLE = st.text(
    st.characters(exclude_categories=["C", "Zl", "Zp"], include_characters="\t\n\U0001f600"), max_size=9
)


def received(**parameters: object) -> dict[str, object]:
    """Parameters of a node with these arguments."""
    context = rclpy.Context()
    rclpy.init(args=parameter_arguments(**parameters), context=context)
    try:
        node = Node(
            "one",
            context=context,
            automatically_declare_parameters_from_overrides=True,
            start_parameter_services=False,
            enable_rosout=False,
        )
        values = {name: node.get_parameter(name).value for name in parameters}
        node.destroy_node()
        return values
    finally:
        rclpy.shutdown(context=context)


def test_names_that_yaml_reads_otherwise() -> None:
    given = {f"p{k}": name for k, name in enumerate([*NAMES, *LIKE_VALUES])}
    assert received(**given, path=Path("plants #1/my.toml"), texts=[*NAMES, *LIKE_VALUES]) == {
        **given,
        "path": "plants #1/my.toml",
        "texts": [*NAMES, *LIKE_VALUES],
    }


@settings(max_examples=15, deadline=None, derandomize=True)
@given(st.lists(PRINTABLE, min_size=30, max_size=60))
def test_any_text(texts: list[str]) -> None:
    parameters = {f"p{k}": text for k, text in enumerate(texts)}
    assert received(**parameters) == parameters


def test_numbers_keep_their_type() -> None:
    parameters = {"count": 3, "rate": 1e-7, "whole": 2.0, "on": True, "gains": [1.0, 2.5], "signs": [1, -1]}
    got = received(**parameters)
    assert {name: list(value) if name in ("gains", "signs") else value for name, value in got.items()} == parameters  # type: ignore[call-overload]
    assert isinstance(got["whole"], float)


def test_nothing_else_writes_a_parameter() -> None:
    """Text put beside ``NAME:=`` in any other place would not be quoted."""
    root = Path(__file__).resolve().parents[2]
    elsewhere = []
    for path in root.glob("servo_*/servo_*/**/*.py"):
        strings = (node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.JoinedStr))
        for parts in (string.values for string in strings):
            for text, value in pairwise(parts):
                marked = isinstance(text, ast.Constant) and str(text.value).endswith((":=", ":='", ':="'))
                if marked and isinstance(value, ast.FormattedValue) and path.name != "ros_arguments.py":
                    elsewhere.append(f"{path.relative_to(root)}:{text.lineno}")
    assert elsewhere == []


def test_no_parameters_give_no_arguments() -> None:
    assert parameter_arguments() == []
