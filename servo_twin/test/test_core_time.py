"""The instrumented C files follow their sources and headers, and nothing else."""

from __future__ import annotations

from pathlib import Path

from servo_twin._core_time import write_charged


def test_files_are_instrumented_again_only_after_a_change_of_their_text(tmp_path: Path) -> None:
    firmware = tmp_path / "firmware"
    (firmware / "math").mkdir(parents=True)
    header, used, alone = (firmware / "math" / name for name in ("gain.h", "used.c", "alone.c"))
    header.write_text("#define GAIN 3\n", encoding="ascii")
    used.write_text('#include "math/gain.h"\nint used(int x)\n{\n    return GAIN * x;\n}\n', encoding="ascii")
    alone.write_text("int alone(int x)\n{\n    return x + 1;\n}\n", encoding="ascii")

    def written() -> list[int]:
        return [path.stat().st_ino for path in write_charged([used, alone], firmware, [], tmp_path / "charged")]

    first = written()
    assert written() == first
    header.write_text("/* the same */\n#define GAIN 3\n", encoding="ascii")
    assert written() == first
    header.write_text("#define GAIN 4\n", encoding="ascii")
    changed = written()
    assert changed[0] != first[0]
    assert changed[1] == first[1]
    assert "4 * x" in (tmp_path / "charged" / "math" / "used.c").read_text(encoding="utf-8")
    (tmp_path / "charged" / "math" / "alone.c").unlink()
    written()
    assert "core_spend" in (tmp_path / "charged" / "math" / "alone.c").read_text(encoding="utf-8")
