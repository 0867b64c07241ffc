"""The includes and the links of the firmware: no circle, and the permitted dependencies of folders.

A unit is a source file with its header: `app/servo` stands for ``app/servo.c`` and ``app/servo.h``.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Mapping
from pathlib import Path

import pytest
from core_library import CORE_SOURCES
from firmware_compiler import FIRMWARE, compile_objects

INCLUDE = re.compile(r'^#include "([^"]+)"', re.MULTILINE)
Graph = Mapping[str, set[str]]


def include_graph(root: Path) -> dict[str, set[str]]:
    """Units that each unit includes, without those of the tests."""
    graph: dict[str, set[str]] = {}
    for path in sorted(root.rglob("*.[ch]")):
        name = path.relative_to(root).with_suffix("")
        if name.parts[0] == "test":
            continue
        units = graph.setdefault(name.as_posix(), set())
        for text in INCLUDE.findall(path.read_text(encoding="utf-8")):
            found = next((place / text for place in (root, path.parent) if (place / text).is_file()), None)
            assert found is not None, f"{path} includes {text}, which does not exist"
            units.add(found.relative_to(root).with_suffix("").as_posix())
        units.discard(name.as_posix())
    return graph


def link_graph(objects: Mapping[str, Path]) -> dict[str, set[str]]:
    """Units with the external functions and data that each unit uses."""
    owner: dict[str, str] = {}
    used: dict[str, set[str]] = {unit: set() for unit in objects}
    for unit, path in objects.items():
        symbols = subprocess.run(["nm", "--extern-only", path], check=True, capture_output=True, text=True).stdout
        for *_, kind, symbol in map(str.split, symbols.splitlines()):
            if kind == "U":
                used[unit].add(symbol)
            else:
                owner[symbol] = unit
    return {unit: {owner[name] for name in names if name in owner} for unit, names in used.items()}


def circle_of(graph: Graph) -> list[str]:
    """A circle of units, with the first unit repeated at the end; empty: none."""
    done: set[str] = set()

    def search(unit: str, path: list[str]) -> list[str]:
        if unit in path:
            return [*path[path.index(unit) :], unit]
        if unit in done:
            return []
        for other in sorted(graph.get(unit, ())):
            if circle := search(other, [*path, unit]):
                return circle
        done.add(unit)
        return []

    return next((circle for unit in sorted(graph) if (circle := search(unit, []))), [])


def reached_from(graph: Graph, folder: str) -> set[str]:
    """All units that a folder includes directly or indirectly."""
    reached: set[str] = set()
    open_ends = {unit for unit in graph if unit.startswith(f"{folder}/")}
    while open_ends:
        unit = open_ends.pop()
        reached.add(unit)
        open_ends |= graph.get(unit, set()) - reached
    return reached


@pytest.fixture(scope="module")
def graph() -> dict[str, set[str]]:
    return include_graph(FIRMWARE)


def test_no_unit_of_the_firmware_includes_itself_indirectly(graph: Graph) -> None:
    assert {"app/servo", "drive/axis", "diagnosis/fault_isolate", "port/mc56f84789/port"} <= set(graph)
    assert " -> ".join(circle_of(graph)) == ""


@pytest.mark.parametrize("above", ["drive", "app", "comm", "port"])
def test_the_diagnosis_includes_no_higher_layer(graph: Graph, above: str) -> None:
    assert not {unit for unit in reached_from(graph, "diagnosis") if unit.startswith(f"{above}/")}


def test_only_the_owner_of_a_board_selects_its_configuration(graph: Graph) -> None:
    default = "config/servo_config"
    users = {unit for unit, included in graph.items() if default in included}
    assert users == {"config/servo_config_gen", "port/mc56f84789/startup", "port/stm32f405/startup"}


def test_dependencies_of_the_drive_have_one_direction_from_axis_to_latch(graph: Graph) -> None:
    for lower, upper in (("axis_states", "axis"), ("run_states", "axis_states"), ("axis_faults", "run_states")):
        assert f"drive/{lower}" in graph[f"drive/{upper}"]
    assert "diagnosis/fault_latch" in reached_from(graph, "drive")


def test_no_object_file_needs_itself_indirectly(tmp_path: Path) -> None:
    objects = compile_objects(tmp_path / "objects", CORE_SOURCES, ["-O0"], "gcc")
    graph = link_graph(dict(zip((name.removesuffix(".c") for name in CORE_SOURCES), objects, strict=True)))
    assert "drive/run_step" in graph["drive/run_states"]
    assert " -> ".join(circle_of(graph)) == ""


def test_a_circle_of_includes_is_found(tmp_path: Path) -> None:
    for name, other in {"a.h": "b.h", "b.c": "c.h", "b.h": "b.h", "c.h": "a.h"}.items():
        (tmp_path / name).write_text(f'#include "{other}"\n', encoding="utf-8")
    assert circle_of(include_graph(tmp_path)) == ["a", "b", "c", "a"]
