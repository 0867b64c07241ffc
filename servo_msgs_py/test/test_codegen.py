"""The generated C files: in step with the table, and right for a compiler with 16-bit int."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from servo_msgs_py.catalogue import Catalogue

from servo_msgs_py import codegen

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
CATALOGUE = Catalogue.load()


@pytest.mark.skipif(not FIRMWARE.is_dir(), reason="no firmware beside this package")
def test_committed_files_are_up_to_date() -> None:
    for path, text in codegen.outputs(FIRMWARE, CATALOGUE).items():
        assert path.read_text(encoding="utf-8") == text, f"{path.name} is out of date: run `make generate`"


def test_generation_writes_then_agrees_then_sees_a_change(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for folder in ("firmware/config", "firmware/app", "servo_msgs_py"):
        (tmp_path / folder).mkdir(parents=True)
    arguments = ["--firmware", str(tmp_path / "firmware")]
    assert codegen.main([*arguments, "--check"]) == 1
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
    assert codegen.main(arguments) == 0
    assert codegen.main([*arguments, "--check"]) == 0
    header = tmp_path / "firmware" / "config" / "contract_gen.h"
    header.write_text(header.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    capsys.readouterr()
    assert codegen.main([*arguments, "--check"]) == 1
    assert re.findall(r"(\S+) is out of date", capsys.readouterr().err) == [str(header)]


def test_list_for_people_names_every_variable_with_its_unit() -> None:
    text = codegen.variable_list(CATALOGUE)
    for variable in CATALOGUE.variables.values():
        lines = [line for line in text.splitlines() if f"`{variable.name}`" in line]
        assert len(lines) == 1, variable.name
        assert variable.unit in lines[0]
        assert variable.description in lines[0]


def test_a_missing_folder_is_a_clear_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        codegen.main(["--firmware", str(tmp_path / "nowhere")])
    assert "no firmware folder" in capsys.readouterr().err


def test_header_has_hash_enums_flags_and_limits() -> None:
    header = codegen.contract_header(CATALOGUE)
    assert f"#define CATALOGUE_HASH UINT32_C(0x{CATALOGUE.hash:08X})" in header
    assert "    STATE_RUN = 3,\n} state_t;" in header
    assert "#define FAULT_UNDER_VOLTAGE UINT32_C(0x00000002)" in header
    assert "#define LIMIT_VOLTAGE UINT16_C(0x0002)" in header
    position = CATALOGUE["cmd.position"]
    assert f"#define CMD_POSITION_MAX INT32_C({position.to_raw(position.maximum)})" in header


def test_header_is_c99_and_its_numbers_are_those_of_the_table(tmp_path: Path) -> None:
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    (tmp_path / "contract_gen.h").write_text(codegen.contract_header(CATALOGUE), encoding="utf-8")
    names = [v.name for v in CATALOGUE.variables.values() if v.writable and v.type != "enum"]
    stems = [name.replace(".", "_").upper() for name in names]
    prints = "".join(f'    printf("%ld %ld\\n", (long){s}_MIN, (long){s}_MAX);\n' for s in stems)
    source = f'#include "contract_gen.h"\n#include <stdio.h>\nint main(void)\n{{\n{prints}    return 0;\n}}\n'
    (tmp_path / "limits.c").write_text(source, encoding="utf-8")
    program = tmp_path / "limits"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror"]
    subprocess.run([compiler, *flags, "-o", str(program), "limits.c"], cwd=tmp_path, check=True)
    lines = subprocess.run([str(program)], check=True, capture_output=True, text=True).stdout.splitlines()
    for name, line in zip(names, lines, strict=True):
        variable = CATALOGUE[name]
        assert line == f"{variable.to_raw(variable.minimum)} {variable.to_raw(variable.maximum)}", name


def test_table_names_every_variable_once_and_strings_are_shared() -> None:
    table = codegen.variable_table(CATALOGUE)
    for variable in CATALOGUE.variables.values():
        kind = "TSA_KIND_RW" if variable.writable else "TSA_KIND_RO"
        assert f"AT({variable.path}), SIZE({variable.path}), {kind}}}, /* {variable.name} */" in table
        assert table.count(f'"{variable.name}\\0"') == 1
    assert table.count('"state_t\\0"') == 1
    assert table.count("CHECK(") == 1 + sum(1 for v in CATALOGUE.variables.values() if v.size)


def test_string_offsets_point_at_the_strings() -> None:
    table = codegen.variable_table(CATALOGUE)
    block = table.split("static const char strings[] =\n")[1].split(";")[0]
    blob = b"".join(
        line.strip()[1:-1].encode().decode("unicode_escape").encode("latin-1") for line in block.splitlines()
    )
    for line in table.splitlines():
        if line.startswith("    {") and "/* " in line:
            name = line.split("/* ")[1].removesuffix(" */")
            offsets = [int(x) for x in line.strip(" {").split(",")[:2]]
            assert blob[offsets[0] :].split(b"\0")[0].decode() == name
            assert blob[offsets[1] :].split(b"\0")[0] != b""
