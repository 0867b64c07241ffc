"""The counts of the bench: instructions go to the part whose source they come from, those of a call only once."""

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


def test_parts_by_source() -> None:
    assert part_of("/x/servo_twin/native/plant/switched_inverter.c") == "plant"
    assert part_of("/x/servo_twin/native/chip/pwm.c") == "chip"
    assert part_of("/x/firmware/port/mc56f84789/pwm.c") == "drivers"
    assert part_of("/x/firmware/control/svm.c") == "firmware"
    assert part_of("/usr/lib/libm.so") == "other"


def test_a_call_counts_where_it_arises() -> None:
    assert by_part(PROFILE.splitlines()) == {"chip": 8, "firmware": 40, "plant": 700}
