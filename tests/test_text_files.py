"""Every text file of a user is read in the same manner: UTF-8, also as editors of Windows write it."""

from __future__ import annotations

import ast
import contextlib
import re
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeGuard

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from servo_bridge.description import description_from_file
from servo_bridge.trajectory.files import read_waypoints
from servo_measurement.access import MeasurementError
from servo_measurement.log import MeasurementLog
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.text_file import TextFileError, decoded, parse_json, parse_toml, read_toml, toml_text
from servo_tuning.reading import SERVO_TOML, load
from servo_twin.core_speed import CoreSpeed
from servo_twin.diagnosis.thresholds import Thresholds
from servo_twin.plant import PlantConfig
from servo_twin.servo_config import servo_table

from servo_bridge import parameter_file

ROOT = Path(__file__).resolve().parents[1]
TWIN = ROOT / "servo_twin" / "servo_twin"
PATH_JSON = '{"joint_names": ["axis1"],\n "points": [{"time_from_start": 0, "positions": [0]}]}\n'


def parameters(path: Path) -> object:
    return parameter_file.load(path, None)


def positions(path: Path) -> object:
    return read_waypoints(path).positions.tolist()


FILES: dict[str, tuple[Callable[[Path], object], str]] = {
    "servo.toml": (lambda path: load(path, Catalogue.load()), SERVO_TOML.read_text(encoding="utf-8")),
    "base.toml": (servo_table, SERVO_TOML.read_text(encoding="utf-8")),
    "plant.toml": (PlantConfig.load, "[axis1]\nr_s = 0.6\n"),
    "core.toml": (CoreSpeed.load, (TWIN / "core.toml").read_text(encoding="utf-8")),
    "thresholds.toml": (Thresholds.load, (TWIN / "diagnosis" / "thresholds.toml").read_text(encoding="utf-8")),
    "parameters.toml": (parameters, '[parameters]\n"param.host_timeout" = 0.5\n'),
    "parameters.json": (parameters, '{"parameters":\n {"param.host_timeout": 0.5}}\n'),
    "path.csv": (positions, "time,axis1\n0,0\n1,2\n"),
    "path.json": (positions, PATH_JSON),
    "bridge.yaml": (
        lambda path: description_from_file(str(path)),
        "/**:\n  ros__parameters:\n    joints: [a, b]\n",
    ),
}
OWN_FILES = {
    "servo_bridge/servo_bridge/tuning/process.py",  # pipe of the parent
    "servo_bridge/servo_bridge/wire/serial_port.py",  # sysfs
    "servo_msgs_py/servo_msgs_py/codegen.py",
    "servo_msgs_py/servo_msgs_py/fault_rules.py",  # sources of the firmware, as in the build
    "servo_twin/servo_twin/_board_pointers.py",
    "servo_twin/servo_twin/_build_native.py",
    "servo_twin/servo_twin/_core_time.py",
    "servo_twin/servo_twin/board.py",  # compiled module
    "servo_twin/servo_twin/identification/command.py",  # just written
    "servo_twin/servo_twin/processes.py",  # whole log of a child, for tests
    "servo_twin/servo_twin/validation/experiments/command.py",  # just written
    "servo_twin/servo_twin/robot/plugin.py",  # just compiled
    "servo_twin/servo_twin/validation/sweep/command.py",  # modules of the package
}
"""Modules that read files of the project, the build or their own work."""

OPENED = re.compile(r"\bopen\(")
WRITTEN = re.compile(r"'[wxa]b?'|O_WRONLY|os\.open")

BAD = {
    "utf-16": ("utf-16", "UTF-16 .*save it as UTF-8"),
    "utf-16 without mark": ("utf-16-le", "UTF-16 .*save it as UTF-8"),
    "latin-1": ("latin-1", r"line 1: the byte 0xfc is not UTF-8; save the file as UTF-8"),
}


@pytest.mark.parametrize("name", FILES)
def test_byte_order_mark_and_line_ends_of_windows_are_accepted(name: str, tmp_path: Path) -> None:
    reader, text = FILES[name]
    plain, marked = tmp_path / "plain" / name, tmp_path / "marked" / name
    plain.parent.mkdir()
    marked.parent.mkdir()
    plain.write_bytes(text.encode())
    marked.write_bytes(text.replace("\n", "\r\n").encode("utf-8-sig"))
    assert reader(marked) == reader(plain)


@pytest.mark.parametrize("encoding", BAD)
@pytest.mark.parametrize("name", FILES)
def test_other_encodings_are_refused_with_a_remedy(name: str, encoding: str, tmp_path: Path) -> None:
    reader, text = FILES[name]
    codec, reason = BAD[encoding]
    path = tmp_path / name
    path.write_bytes(("# \u00fc\n" + text).encode(codec))
    with pytest.raises(Exception, match=reason):
        reader(path)


@pytest.mark.parametrize("name", [*FILES, "measurement.npz"])
def test_file_of_any_size_is_refused_with_the_bound(name: str, tmp_path: Path) -> None:
    reader = FILES[name][0] if name in FILES else MeasurementLog.load
    path = tmp_path / name
    with path.open("wb") as file:
        file.truncate(10**12)  # without the memory for it
    with pytest.raises(Exception, match=r"it has more than [0-9]+ bytes, the largest size"):
        reader(path)


def test_measurement_of_any_unpacked_size_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "m.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("log.npy", bytes(200_000_001))
    with pytest.raises(MeasurementError, match=r"m\.npz has more than 200000000 bytes unpacked"):
        MeasurementLog.load(tmp_path / "m.npz")


@pytest.mark.parametrize("folder", ["servo_bridge/servo_bridge", "servo_twin/servo_twin", "servo_msgs_py"])
def test_every_read_of_a_file_has_a_bound(folder: str) -> None:
    """A file of a user may be a device, a pipe or a file of any size."""
    found = {
        path.relative_to(ROOT).as_posix(): reads
        for path in sorted((ROOT / folder).rglob("*.py"))
        if "test" not in path.parts and (reads := unbounded_reads(path.read_text(encoding="utf-8")))
    }
    assert set(found) <= OWN_FILES, {name: reads for name, reads in found.items() if name not in OWN_FILES}


def unbounded_reads(text: str) -> list[str]:
    """Expressions that read a whole file or a line of any length, with their line numbers."""
    tree = ast.parse(text)
    calls = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and _is_unbounded(node, node.func)
    ]
    found = {node.lineno: ast.unparse(node) for node in [*calls, *_used_files(tree)]}
    return [f"{line}: {expression}" for line, expression in sorted(found.items())]


def _used_files(tree: ast.Module) -> Iterator[ast.expr]:
    """Uses of open files other than methods with arguments: iterations, ``read()``, arguments of other readers."""
    for block in ast.walk(tree):
        if not isinstance(block, ast.With):
            continue
        for item in block.items:
            file, opened = item.optional_vars, ast.unparse(item.context_expr)
            if not isinstance(file, ast.Name) or not OPENED.search(opened) or WRITTEN.search(opened):
                continue
            bounded = {
                id(node.func.value)
                for node in ast.walk(block)
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and (node.args or node.keywords)
            }
            for node in ast.walk(block):
                if _has_bound(node):
                    bounded |= {id(argument) for argument in node.args}
                elif isinstance(node, ast.Call) and len(node.args) > 1:  # partial(file.readline, BYTES)
                    bounded |= {id(method.value) for method in node.args if isinstance(method, ast.Attribute)}
            for node in ast.walk(ast.Module(block.body, [])):
                if isinstance(node, ast.Name) and node.id == file.id and id(node) not in bounded:
                    yield node


def _has_bound(node: ast.AST) -> TypeGuard[ast.Call]:
    return isinstance(node, ast.Call) and any("max" in ast.unparse(keyword.value).lower() for keyword in node.keywords)


def _is_unbounded(call: ast.Call, function: ast.Attribute) -> bool:
    name = ast.unparse(function)
    if name in ("np.load", "json.load", "tomllib.load", "yaml.safe_load", "np.fromfile", "np.genfromtxt"):
        return not any(bounded in ast.unparse(call) for bounded in ("read_bytes(path,", "read_text("))
    if function.attr in ("readline", "readlines"):
        return not call.args
    return function.attr in ("read_text", "read_bytes")


def test_unbounded_reads_are_found() -> None:
    text = "p.read_text()\nnp.load(p)\nf.readline()\nf.readline(9)\nread_text(p)\nyaml.safe_load(read_text(p))\n"
    assert [read.split(":")[0] for read in unbounded_reads(text)] == ["1", "2", "3"]
    uses = ("f.read()", "for line in f: pass", "list(f)", "csv.reader(f)", "[x for x in f]")
    assert all(unbounded_reads(f"with p.open('rb') as f:\n    {use}") for use in uses)
    for use in ("f.read(9)", "partial(f.readline, 9)", "f.seek(0)", "Reader(f, limit=_BYTES_MAX)"):
        assert not unbounded_reads(f"with open(p) as f:\n    {use}")
    assert not unbounded_reads("with p.open('w') as f:\n    csv.writer(f)")


@given(st.text(st.characters(codec="utf-8", exclude_characters="\r\0")), st.sampled_from(["\n", "\r\n", "\r"]))
def test_text_is_independent_of_mark_and_line_ends(text: str, end: str) -> None:
    plain = text.removeprefix("\ufeff")
    for codec in ("utf-8", "utf-8-sig"):
        assert decoded(plain.replace("\n", end).encode(codec)) == plain


@given(st.binary())
def test_any_bytes_are_text_or_refused(data: bytes) -> None:
    for parse in (parse_toml, parse_json):
        with contextlib.suppress(TextFileError):
            parse(decoded(data))


@pytest.mark.parametrize("parse", [parse_toml, parse_json])
def test_deep_nesting_is_refused(parse: Callable[[str], object]) -> None:
    with pytest.raises(TextFileError, match="too many nested brackets"):
        parse(f"{'a = ' if parse is parse_toml else ''}{'[' * 100_000}")


TEXT = st.text(st.characters(exclude_categories=["Cs"]))
NUMBER_OR_TEXT = st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | TEXT
SCALAR = st.booleans() | NUMBER_OR_TEXT
TABLES = st.recursive(
    st.dictionaries(TEXT, SCALAR | st.lists(SCALAR | st.lists(SCALAR))), lambda inner: st.dictionaries(TEXT, inner)
)


@given(TABLES)
@example({'"': "\"\\'\n\r\t\0\x7f\u0085😀", "a.b": {"": {"ü": ["'''", '"""']}}})
def test_written_toml_is_read_as_the_same_table(table: dict[str, object]) -> None:
    assert parse_toml(toml_text(table)) == table


def test_written_configuration_is_read_as_the_same() -> None:
    table = read_toml(SERVO_TOML)
    assert parse_toml(toml_text(table)) == table


@given(st.dictionaries(TEXT, st.lists(NUMBER_OR_TEXT, min_size=1), min_size=1))
def test_written_parameters_are_read_as_the_same(values: dict[str, list[parameter_file.Entry]]) -> None:
    table = parse_toml(parameter_file.dump(Path("p.toml"), values, {}, 7))
    assert table["parameters"] == {name: value if len(value) > 1 else value[0] for name, value in values.items()}
