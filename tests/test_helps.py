"""The help of every program and of its commands fits into a terminal of 80 columns."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from importlib import import_module
from typing import Any, Final

import pytest

WIDTH: Final = 80
PROGRAMS: Final = (
    "servo_bridge.command",
    "servo_bridge.demo",
    "servo_bridge.tool",
    "servo_twin.cli",
    "servo_twin.runs.command",
    "servo_twin.up",
    "servo_twin.virtual_board",
)
NODES: Final = ("servo_bridge.node", "servo_twin.node", "servo_twin.viewer_node")


class _Found(BaseException):
    def __init__(self, parser: argparse.ArgumentParser) -> None:
        self.parser = parser


def parsers(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """A parser and those of its commands."""
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in dict.fromkeys(action.choices.values()):
                yield from parsers(command)


def main_parser(module: str, monkeypatch: pytest.MonkeyPatch) -> argparse.ArgumentParser:
    """Parser that the ``main`` of a module uses."""

    def found(self: argparse.ArgumentParser, *_: Any, **__: Any) -> Any:
        raise _Found(self)

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", found)
    monkeypatch.setattr(argparse.ArgumentParser, "parse_known_args", found)
    with pytest.raises(_Found) as caught:
        import_module(module).main(["--help"])
    return caught.value.parser


@pytest.mark.parametrize("module", PROGRAMS)
def test_help_fits_into_80_columns(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    found = parsers(main_parser(module, monkeypatch))
    wide = [line for parser in found for line in parser.format_help().splitlines()]
    assert [line for line in wide if len(line) > WIDTH] == []


@pytest.mark.parametrize("module", NODES)
def test_help_of_nodes_fits_into_80_columns(module: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert import_module(module).main(["--help"]) == 0
    assert [line for line in capsys.readouterr().out.splitlines() if len(line) > WIDTH] == []
