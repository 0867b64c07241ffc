"""The generated C files: up to date, and correct for a compiler with 16-bit int."""

from __future__ import annotations

import re
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
from servo_msgs_py.catalogue import Catalogue, CatalogueError
from servo_msgs_py.fault_rules import FaultRules, fault_list, raised_in

from servo_msgs_py import codegen

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
CATALOGUE = Catalogue.load()
RULES = FaultRules.load()


@pytest.mark.skipif(not FIRMWARE.is_dir(), reason="no firmware next to this package")
def test_committed_files_are_up_to_date() -> None:
    for path, text in codegen.outputs(FIRMWARE, CATALOGUE).items():
        assert path.read_text(encoding="utf-8") == text, f"{path.name} is out of date: run `make generate`"


def test_generator_writes_compares_and_detects_a_change(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for folder in ("firmware/config", "firmware/app", "firmware/doc", "firmware/diagnosis", "servo_msgs_py"):
        (tmp_path / folder).mkdir(parents=True)
    raises = "".join(f"raise(FINDING_{finding});\n" for finding in RULES.rules)
    (tmp_path / "firmware" / "diagnosis" / "monitor.c").write_text(raises, encoding="utf-8")
    arguments = ["--firmware", str(tmp_path / "firmware")]
    assert codegen.main([*arguments, "--check"]) == 1
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["monitor.c"]
    assert codegen.main(arguments) == 0
    assert codegen.main([*arguments, "--check"]) == 0
    header = tmp_path / "firmware" / "config" / "contract_gen.h"
    header.write_text(header.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    capsys.readouterr()
    assert codegen.main([*arguments, "--check"]) == 1
    assert re.findall(r"(\S+) is out of date", capsys.readouterr().err) == [str(header)]


def _lines_of_faults(rules: FaultRules) -> list[str]:
    return fault_list(CATALOGUE, rules, {finding: [] for finding in rules.rules}).splitlines()


def test_list_of_faults_follows_the_rules() -> None:
    blocked = replace(RULES.rules["SHAFT_BLOCKED"], instead=("CURRENT_SENSE",))
    later = replace(RULES.revisions[0], within=0.1)
    other = replace(RULES, rules={**RULES.rules, "SHAFT_BLOCKED": blocked}, revisions=(later, *RULES.revisions[1:]))
    lines = [line for line in _lines_of_faults(other) if line not in _lines_of_faults(RULES)]
    assert [("`CURRENT_SENSE`" in line, "`STALLED`" in line, "| 100 ms |" in line) for line in lines] == [
        (True, True, False),
        (True, False, True),
    ]


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"fault": "OVER_TEMPERATURE"}, "HEAT_SINK_HOT.*'when'"),
        ({"fault": "OVER_TEMPERATURE", "when": "", "insted": ["PHASE"]}, "HEAT_SINK_HOT.*'insted'"),
        ({"fault": "OVER_TEMPERATURE", "when": "", "instead": ["PHASES"]}, "HEAT_SINK_HOT: no cause has PHASES"),
        ({"fault": "STALLED", "when": ""}, "OVER_TEMPERATURE"),
    ],
)
def test_a_wrong_rule_of_a_fault_is_refused(entry: dict[str, Any], message: str) -> None:
    table = {"findings": {"HEAT_SINK_HOT": entry}, "causes": [asdict(cause) for cause in RULES.causes], "revisions": []}

    def listed() -> list[str]:
        rules = FaultRules.parse(table)
        return _lines_of_faults(replace(RULES, rules={**RULES.rules, **rules.rules}))

    with pytest.raises(CatalogueError, match=message):
        listed()


def test_list_for_people_names_every_variable_with_its_unit() -> None:
    text = codegen.variable_list(CATALOGUE)
    for variable in CATALOGUE.variables.values():
        lines = [line for line in text.splitlines() if f"`{variable.name}`" in line]
        assert len(lines) == 1, variable.name
        assert variable.unit in lines[0]
        assert variable.text in lines[0]


def test_a_missing_folder_is_a_clear_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        codegen.main(["--firmware", str(tmp_path / "nowhere")])
    assert "no firmware folder" in capsys.readouterr().err


def test_header_has_hash_enums_and_flags() -> None:
    header = codegen.contract_header(CATALOGUE)
    assert f"#define CATALOGUE_HASH UINT32_C(0x{CATALOGUE.hash:08X})" in header
    assert "    STATE_RUN = 3,\n} state_t;" in header
    assert "#define FAULT_UNDER_VOLTAGE UINT32_C(0x00000002)" in header
    assert "#define LIMIT_VOLTAGE UINT16_C(0x0002)" in header
    assert f"#define PARAM_FEATURES_MAX INT32_C({CATALOGUE['param.features'].raw_range[1]})" in header


def _with(name: str, **changes: Any) -> Catalogue:
    """The catalogue with one variable changed."""
    return replace(CATALOGUE, variables={**CATALOGUE.variables, name: replace(CATALOGUE[name], **changes)})


_KINDS = {
    (2, False): "0U",
    (2, True): "NUMBER_SIGNED",
    (4, False): "NUMBER_WIDE",
    (4, True): "NUMBER_WIDE | NUMBER_SIGNED",
}


def test_table_has_the_range_of_every_writable_variable() -> None:
    rows = codegen.variable_table(CATALOGUE).split("servo_ranges[] = {\n")[1].split("};")[0].splitlines()
    found = [re.sub(r"U?INT32_C\((.*?)\)", r"\1", row).replace("INT32_MIN", str(-(2**31))) for row in rows]
    assert found == [
        f"    {{OFFSET({v.path}), {v.count}, {{{kind}, {low}, {high}}}}}, /* {v.name} */"
        for v in CATALOGUE.variables.values()
        if v.writable
        for low, high in [v.raw_range]
        for kind in [_KINDS[v.format.size, v.format.signed]]
    ]


@pytest.mark.parametrize(
    ("name", "changes", "text"),
    [
        (
            "param.faults_enabled",
            {"maximum": 2.0**32 - 1},
            "param.faults_enabled: limit 4294967295 does not fit int32_t",
        ),
        ("param.features", {"maximum": 4000.0}, "param.features: 0 .. 4000 is not the complete range of a flag word"),
        ("cmd.mode", {"maximum": 1.0}, "cmd.mode: the values of control_mode_t are not all integers from 0 to 1"),
    ],
)
def test_range_that_the_table_cannot_represent_is_refused(name: str, changes: dict[str, object], text: str) -> None:
    with pytest.raises(CatalogueError, match=re.escape(text)):
        codegen.variable_table(_with(name, **changes))


def test_table_names_every_variable_once_and_strings_are_shared() -> None:
    table = codegen.variable_table(CATALOGUE)
    for variable in CATALOGUE.variables.values():
        kind = "TSA_KIND_RW" if variable.writable else "TSA_KIND_RO"
        place = f"AT({variable.path}), SIZE({variable.path})" if variable.path else f"), {variable.size}"
        assert f"{place}, {kind}}}, /* {variable.name} */" in table
        assert table.count(f'"{variable.name}\\0"') == 1
    assert table.count('"state_t\\0"') == 1
    checked = sum(bool(v.path and v.size) + bool(v.source) for v in CATALOGUE.variables.values())
    checked += sum(1 + len(members) for members in CATALOGUE.structs.values())
    assert table.count("CHECK(") == 1 + checked


def test_table_has_the_source_of_every_number_in_a_loop() -> None:
    table = codegen.variable_table(CATALOGUE)
    rows = table.split("sources[] TABLE_MEMORY = {\n")[1].split("};")[0].splitlines()
    assert [row.split("/* ")[1].removesuffix(" */") for row in rows] == [
        v.name for v in CATALOGUE.variables.values() if v.source
    ]
    assert "AT(snapshot.axis[1].i_q), OFFSET(axis[1].current_loop.current.q), 2}" in table
    assert "OFFSET(axis[0].current_loop.d.integral) + 4, 4}" in table
    assert "CHECK(" in table
    assert ", SIZE(axis[0].current_loop.d.integral) >= 8);" in table
    numbers = [int(number) for number in re.findall(r"^    \{\d+, \d+, LIVE\((\d+)\)", table, re.MULTILINE)]
    assert numbers == list(range(len(numbers)))
    assert len(numbers) == sum(1 for v in CATALOGUE.variables.values() if not v.path)


def test_string_offsets_point_at_the_strings() -> None:
    table = codegen.variable_table(CATALOGUE)
    block = table.split("static const char strings[] TABLE_MEMORY =\n")[1].split(";")[0]
    blob = b"".join(
        line.strip()[1:-1].encode().decode("unicode_escape").encode("latin-1") for line in block.splitlines()
    )
    for line in table.split("tsa_source_t sources[]")[0].splitlines():
        if line.startswith("    {") and "/* " in line:
            name = line.split("/* ")[1].removesuffix(" */")
            offsets = [int(x) for x in line.strip(" {").split(",")[:2]]
            assert blob[offsets[0] :].split(b"\0")[0].decode() == name
            assert blob[offsets[1] :].split(b"\0")[0] != b""


@pytest.mark.skipif(not FIRMWARE.is_dir(), reason="no firmware next to this package")
def test_list_of_faults_names_the_sources_that_raise_a_finding_and_refuses_a_finding_that_none_raises() -> None:
    sources = raised_in(FIRMWARE)
    assert sources["OVER_CURRENT_TRIP"] == ["diagnosis/bus_monitor.c"]
    assert sources["SHAFT_BLOCKED"] == ["diagnosis/shaft_monitor.h", "diagnosis/stall_test.c"]  # run_states.c compares
    assert sources["LOOPS_LATE"] == ["app/servo.c"]
    del sources["LOOPS_LATE"]
    with pytest.raises(CatalogueError, match="LOOPS_LATE"):
        fault_list(CATALOGUE, RULES, sources)
