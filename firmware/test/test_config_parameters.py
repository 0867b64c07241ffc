"""The table of variables is the only list of the parameters: the C code follows it."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from firmware_compiler import FIRMWARE, STRICT
from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.catalogue import Catalogue

from servo_msgs_py import catalogue, codegen

TABLE = Path(catalogue.__file__).with_name("variables.toml")

ADDED = """
[[variable]]
name = "param.hold_time"
path = "parameter.hold_time"
type = "uint16"
count = "axes"
scale = "slow_tick"
access = "rw"
maximum = 0.05
default = "axis.rest_ticks_max"
description = "added by a test"

[[variable]]
name = "param.monitor_gain"
path = "parameter.monitor_gain"
type = "int32"
count = "analog_outs"
access = "rw"
default = "-70000"
description = "added by a test"
"""

PROGRAM = """
#include "app/servo.h"

static servo_config_t config;
static parameter_block_t parameter;
static axis_parameters_t of_axis;
static board_parameters_t of_board;

int main(void)
{
    axis_config_t after = config.axis[1];
    after.rest_ticks_max = 9;
    config.axis[1].rest_ticks_max = 7;
    parameters_default_board(&parameter, &config);
    parameters_default_axis(&parameter, 1, &config.axis[1]);
    if (parameter.hold_time[0] != 0 || parameter.hold_time[1] != 7 || parameter.monitor_gain[1] != -70000) {
        return 1;
    }
    parameter.hold_time[1] = 8;
    parameters_renew(&parameter, 1, &config.axis[1], &config.axis[1]);
    parameters_of_axis(&of_axis, &parameter, 1);
    if (of_axis.hold_time != 8) {
        return 2;
    }
    parameters_renew(&parameter, 1, &config.axis[1], &after);
    parameters_of_axis(&of_axis, &parameter, 1);
    parameters_of_board(&of_board, &parameter);
    return of_axis.hold_time == 9 && of_board.monitor_gain[1] == -70000 ? 0 : 3;
}
"""


def changed(table: str, folder: Path) -> Catalogue:
    (folder / "variables.toml").write_text(table, encoding="utf-8")
    return Catalogue.load(folder / "variables.toml")


def test_a_parameter_added_to_the_table_is_in_every_list_of_the_firmware(tmp_path: Path) -> None:
    root = tmp_path / "firmware"
    shutil.copytree(FIRMWARE, root, ignore=shutil.ignore_patterns("test", "port", "__pycache__", ".*"))
    (tmp_path / "servo_msgs_py").mkdir()
    table = changed(TABLE.read_text("utf-8") + ADDED, tmp_path)
    codegen.update(codegen.outputs(root, table).items(), check=False)
    assert AxisConfigTable.load(table).members["rest_ticks_max"].raw_range == (0, 100)
    program = root / "main.c"
    program.write_text(PROGRAM, encoding="ascii")
    command = ["gcc", *STRICT, f"-I{root}"]
    sources = sorted(map(str, [*root.glob("app/*.c"), *root.glob("config/*.c")]))
    subprocess.run([*command, "-fsyntax-only", *sources], check=True)
    generated = root / "config" / "parameters_gen.c"
    subprocess.run([*command, str(program), str(generated), "-o", str(tmp_path / "program")], check=True)
    assert subprocess.run([tmp_path / "program"], check=False).returncode == 0


@pytest.mark.parametrize(
    ("given", "instead", "message"),
    [
        ('default = "all"', "", r"param\.faults_enabled: default: '' is not a number"),
        ('default = "NONE"', 'default = "SPEED"', r"param\.monitor: default: 'SPEED' is not a number"),
        ('default = "NONE"', 'default = "99"', r"param\.monitor: 99 is outside"),
        ('"board.command_timeout"', '"axis.speed_limit"', r"param\.command_timeout: .* of the axis has no default"),
        ('count = "analog_outs"', "count = 2", r"param\.monitor: the count of a parameter is one of axes, analog_outs"),
        ('count = "analog_outs"', 'count = "outs"', r"param\.monitor: unknown count 'outs'"),
        ('path = "parameter.monitor"', 'path = "parameter.shown"', r"param\.monitor: .* is parameter\.monitor"),
    ],
)
def test_a_table_without_a_valid_default_or_place_is_refused(
    given: str, instead: str, message: str, tmp_path: Path
) -> None:
    text = TABLE.read_text("utf-8")
    assert text.count(given) == 1
    with pytest.raises(catalogue.CatalogueError, match=message):
        codegen.outputs(FIRMWARE, changed(text.replace(given, instead), tmp_path))
