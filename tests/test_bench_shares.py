"""Counts of the bench: instructions are assigned to the part of their source file, those of a call only once."""

from __future__ import annotations

from bench.shares import by_part, part_of

PROFILE = """\
events: Ir
fl=(1) /x/servo_twin/native/board_registers.c
fn=(1) board_trace
10 5
+2 3
cfi=(2) /x/servo_twin/native/plant/switching.c
cfn=(2) switching_advance
calls=4 20
* 700
fi=(3) /x/firmware/math/trig.c
12 40
fl=(2)
fn=(2)
20 650
-3 50
"""


def test_source_files_are_assigned_to_parts() -> None:
    assert part_of("/x/servo_twin/native/plant/switched_inverter.c") == "plant"
    assert part_of("/x/servo_twin/native/chip/pwm.c") == "chip"
    assert part_of("/x/firmware/port/mc56f84789/pwm.c") == "drivers"
    assert part_of("/x/firmware/control/svm.c") == "firmware"
    assert part_of("/usr/lib/libm.so") == "other"


def test_cost_of_a_call_is_counted_in_the_callee() -> None:
    assert by_part(PROFILE.splitlines()) == {"chip": 8, "firmware": 40, "plant": 700}
