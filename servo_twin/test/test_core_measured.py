"""Cycles per instruction from the pulse widths measured at the scope pins."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from servo_twin.cli import main
from servo_twin.core_speed import DEFAULT_FILE, CoreSpeed
from servo_twin.plant import PlantConfig
from servo_twin.validation.timing.core_measured import compare, instructions, with_cycles

COUNTS = {"off": {"m1": 400.0, "m2": 380.0}, "hold": {"m1": 700.0, "m2": 650.0}}
US = 1e-6


def test_single_number_is_recovered_from_its_widths() -> None:
    widths = {state: {h: 2.3 * n * 10e-9 for h, n in handlers.items()} for state, handlers in COUNTS.items()}
    rows, cycles = compare(widths, COUNTS)
    assert cycles == pytest.approx(2.3)
    assert [row.cycles for row in rows] == pytest.approx([2.3] * 4)
    assert [row.measured for row in rows] == pytest.approx([920.0, 874.0, 1610.0, 1495.0])


def test_long_handlers_have_more_weight_if_one_number_does_not_fit() -> None:
    _, cycles = compare({"off": {"m1": 4.0 * US}, "hold": {"m1": 14.0 * US}}, COUNTS)  # 1.0 and 2.0
    assert cycles == pytest.approx((400.0 * 400.0 + 1400.0 * 700.0) / (400.0**2 + 700.0**2))


@pytest.mark.parametrize(
    ("measured", "why"),
    [
        ({}, "no measured widths"),
        ({"off": {}}, "no measured widths"),
        ({"asleep": {"m1": US}}, "unknown state 'asleep'; states: off, hold"),
        ({"off": {"F6": US}}, "off: unknown handler 'F6'; handlers: m1, m2"),
        ({"off": {"m1": 0.0}}, "off: m1 = 0 us is not within 0 .. 62.5 us"),
        ({"hold": {"m2": 63.0 * US}}, "hold: m2 = 63 us"),
    ],
)
def test_invalid_measurements_are_refused(measured: dict[str, dict[str, float]], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        compare(measured, COUNTS)


def test_only_the_one_number_of_the_file_changes(tmp_path: Path) -> None:
    text = "# why\ncycles_per_instruction = 1.5\nentry_cycles = 30  # more\n"
    core = tmp_path / "core.toml"
    core.write_text(text)
    assert with_cycles(core, 2.0649) == text.replace("1.5", "2.06")
    core.write_text(text.replace("cycles_per_instruction", '"cycles_per_instruction"'))
    with pytest.raises(ValueError, match=r"core\.toml: write cycles_per_instruction = NUMBER once"):
        with_cycles(core, 2.0)


@pytest.mark.parametrize(
    ("option", "text", "why"),
    [
        ("core", "a = b", "correct the TOML"),
        ("core", "a = 1", "expected the values"),
        ("core", 'cycles_per_instruction = "x"\nentry_cycles = 30', "cycles_per_instruction = 'x' is not a number"),
        ("core", "cycles_per_instruction = 1.5\nentry_cycles = -1", "entry_cycles = -1 is too small; write a whole"),
        ("measured", "a = b", "correct the TOML"),
        ("measured", "off = 1", "off is no table of widths in us"),
        ("measured", 'off.m1 = "x"', "off is no table of widths in us"),
        ("measured", "off.m1 = 0", "off: m1 = 0 us is not within"),
    ],
)
def test_an_invalid_file_is_refused_with_its_name(
    option: str, text: str, why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / f"{option}.toml"
    file.write_text(text)
    assert main(["core-speed", f"--{option}", str(file)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"servo-sim: {file}: ")
    assert why in error


def test_measured_widths_are_written_to_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Widths 25 % above those of the virtual board; with the new number it reports the measured widths."""
    core, measured = tmp_path / "core.toml", tmp_path / "measured.toml"
    shutil.copy(DEFAULT_FILE, core)
    counts = instructions(CoreSpeed.load(core), PlantConfig.load(), seed=1)
    lines = [f"[{s}]\n" + "\n".join(f"{h} = {0.025 * n}" for h, n in rows.items()) for s, rows in counts.items()]
    measured.write_text("\n".join(lines), encoding="utf-8")
    assert main(["core-speed", "--measured", str(measured), "--core", str(core)]) == 0
    assert "cycles_per_instruction = 2.50" in capsys.readouterr().out
    assert "cycles_per_instruction = 2.50" in core.read_text(encoding="utf-8")
    assert main(["core-speed", "--core", str(core)]) == 0
    printed = [line.split() for line in capsys.readouterr().out.splitlines()[1:]]
    assert {(row[0], row[1]) for row in printed} == {(s, h) for s, rows in counts.items() for h in rows}
    for state, handler, _, width, *_ in printed:
        assert float(width) == pytest.approx(0.025 * counts[state][handler], rel=0.02)


def test_a_poor_fit_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    core, measured = tmp_path / "core.toml", tmp_path / "measured.toml"
    shutil.copy(DEFAULT_FILE, core)
    measured.write_text("[off]\nm1 = 5.0\nm2 = 30.0\n", encoding="utf-8")
    assert main(["core-speed", "--measured", str(measured), "--core", str(core)]) == 1
    assert "poor fit" in capsys.readouterr().out
