"""Every output and number of a program is checked before the work begins: before ports, nodes and motion."""

from __future__ import annotations

import argparse
from importlib import import_module
from pathlib import Path
from typing import Final

import pytest
from test_helps import PROGRAMS, main_parser, parsers

from servo_msgs_py import argument

CHECKED: Final = (argument.output_file, argument.output_folder, argument.picture)
INPUTS: Final = {
    "config",
    "file",
    "core",
    "elf",
    "firmware",
    "flash",
    "link",
    "measured",
    "plant",
    "recording",
    "run",
    "runs",
    "thresholds",
    "twin_plant",
}
"""Options with paths that are read, or have a check of their own."""


@pytest.mark.parametrize("module", PROGRAMS)
def test_every_option_with_a_path_is_checked_or_an_input(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    found = [action for parser in parsers(main_parser(module, monkeypatch)) for action in parser._actions]
    assert {action.dest for action in found if action.type is Path} <= INPUTS
    for action in found:
        if action.dest in ("out", "output", "json", "plot", "record", "rrd", "save") and action.nargs != 0:
            assert action.type in CHECKED, action
            assert not action.default or isinstance(action.default, str), "argparse checks defaults of type str"


@pytest.mark.parametrize("module", PROGRAMS)
def test_every_number_has_a_range(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """``nan`` is a float."""
    found = [action for parser in parsers(main_parser(module, monkeypatch)) for action in parser._actions]
    assert [action.option_strings for action in found if action.type is float] == []


@pytest.mark.parametrize("module", PROGRAMS)
def test_every_parser_takes_negative_numbers_and_checks_namespaces(
    module: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = list(parsers(main_parser(module, monkeypatch)))
    assert [parser.prog for parser in found if not isinstance(parser, argument.Parser)] == []
    names = [action for parser in found for action in parser._actions if "--namespace" in action.option_strings]
    assert [action.type for action in names] == [argument.namespace] * len(names)


@pytest.mark.parametrize("text", ["-1e-3", "-1.", "-.5E+2", "-inf", "-3,4", "-0x1f", "-1_000", "-0b101", "-infinity"])
def test_negative_numbers_are_values(text: str) -> None:
    parser = argument.Parser()
    parser.add_argument("--position")
    parser.add_argument("value")
    parsed = parser.parse_args(["--position", text, text])
    assert (parsed.position, parsed.value) == (text, text)


@pytest.mark.parametrize("text", ["-v", "-3.csv", "-1x", "--5"])
def test_other_words_with_a_dash_are_no_values(text: str) -> None:
    parser = argument.Parser()
    parser.add_argument("--position")
    with pytest.raises(SystemExit):
        parser.parse_args(["--position", text])


@pytest.mark.parametrize("text", ["", "/", "servo", "/a/b_2", "robot/", "_x"])
def test_namespace_is_taken_as_it_is(text: str) -> None:
    assert argument.namespace(text) == text


@pytest.mark.parametrize("text", ["a b", "1x", "/a//b", "\u00fc", "a-b", "~", "a\n"])
def test_wrong_namespace_is_refused(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="is no ROS namespace; write names"):
        argument.namespace(text)


@pytest.mark.parametrize(
    ("module", "words"),
    [
        ("servo_bridge.tool", "--port /dev/null record tick -o {}"),
        ("servo_bridge.tool", "--port /dev/null bode axis1 speed --out {}"),
        ("servo_bridge.tool", "--port /dev/null identify --current 1 --voltage 24 --out {}"),
        ("servo_bridge.demo", "--json {}"),
        ("servo_twin.cli", "experiment all --out {}"),
        ("servo_twin.up", "--no-web --out {}"),
    ],
)
def test_output_below_a_file_is_refused_by_its_option(
    module: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    obstacle = tmp_path / "file"
    obstacle.touch()
    path = obstacle / "out"
    with pytest.raises(SystemExit) as stop:
        import_module(module).main(words.format(path).split())
    assert stop.value.code == 2
    assert f"'{path}' cannot be written: Not a directory ({obstacle})" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "reason"),
    [("folder", "Is a directory"), ("x" * 300, "File name too long"), ("closed/file", "Permission denied")],
)
def test_file_that_cannot_be_written_is_refused(
    name: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "closed").mkdir(mode=0o500)
    monkeypatch.setattr("os.access", lambda path, _: Path(path).name != "closed")  # root may write anywhere
    with pytest.raises(argparse.ArgumentTypeError, match=f"cannot be written: {reason}"):
        argument.output_file(str(tmp_path / name))


def test_new_and_existing_outputs_and_devices_are_accepted_without_a_change(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "kept").write_text("kept")
    for name in ("new/file.png", "kept", "/dev/full", "/dev/stdout"):
        argument.output_file(str(tmp_path / name))
    argument.output_folder(str(tmp_path / "new" / "folder"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["kept", "loop"]
    assert (tmp_path / "kept").read_text() == "kept"


def test_unknown_format_of_a_picture_is_refused() -> None:
    with pytest.raises(argparse.ArgumentTypeError, match=r"\.bmpp is no format of a picture; formats: .*\.png"):
        argument.picture("a.bmpp")
    assert argument.picture("a.svg") == Path("a.svg")
