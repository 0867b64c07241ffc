"""Triggers as text, compared with the action of a target with the resulting threshold."""

from __future__ import annotations

import math
import struct
from operator import ge, gt, le, lt

import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_bridge.bursts.trigger_text import Expression, parse_expression, trigger_of
from servo_bridge.freemaster.recorder import Compare
from servo_bridge.freemaster.tsa import TargetVariable, TypeKind, ValueType, parse_type
from servo_bridge.tool_values import UnknownVariableError, UsageError
from servo_bridge.wire.session import BoardVariable
from servo_msgs_py.catalogue import Catalogue

CATALOGUE = Catalogue.load()


def plain(name: str, type_text: bytes, size: int, address: int = 0x1000) -> BoardVariable:
    type_ = parse_type(type_text, size)
    assert type_ is not None
    return BoardVariable(TargetVariable(name, address, size, type_, False), None)


def known(name: str) -> BoardVariable:
    contract = CATALOGUE[name]
    type_ = parse_type(bytes((contract.format.tsa,)), contract.size)
    assert type_ is not None
    return BoardVariable(TargetVariable(name, 0x2000, contract.size, type_, contract.writable), contract)


BOARD = {
    variable.name: variable
    for variable in (
        plain("i8", b"\xf0", 1),
        plain("u16", b"\xe1", 2),
        plain("q", b"\xf4:3.4", 1),
        plain("real", b"\xfa", 4),
        plain("array", b"\xf1", 6),
        plain("other", b"\xf0", 1, 0x1234),
        BoardVariable(TargetVariable("memory", 0, 20, ValueType(TypeKind.RAW, 20, "bytes"), False), None),
        *map(known, ("axis1.i_q", "axis1.state", "axis1.speed", "u_dc")),
    )
}

OPERATORS = st.sampled_from([">", ">=", "<", "<="])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("axis1.i_q > 1.0", ("axis1.i_q", ">", "1.0")),
        ("axis1.i_q>=-1e-3", ("axis1.i_q", ">=", "-1e-3")),
        ("  array[1]<=3 ", ("array[1]", "<=", "3")),
        ("axis1.state rising FAULT", ("axis1.state", "rising", "FAULT")),
        ("rising falling 3", ("rising", "falling", "3")),
    ],
)
def test_every_form_of_a_trigger_is_parsed(text: str, expected: tuple[str, str, str]) -> None:
    assert parse_expression(text) == Expression(*expected)


@given(st.text(max_size=30))
def test_any_text_is_a_trigger_or_a_usage_error(text: str) -> None:
    try:
        trigger_of(parse_expression(text), BOARD, CATALOGUE)
    except (UsageError, UnknownVariableError):
        return


@given(st.sampled_from(sorted(BOARD)), st.sampled_from([">", " rising "]), st.text(max_size=12))
def test_any_value_is_accepted_or_refused_with_a_reason(name: str, operator: str, value: str) -> None:
    try:
        trigger_of(parse_expression(name + operator + value), BOARD, CATALOGUE)
    except (UsageError, UnknownVariableError):
        return


@pytest.mark.parametrize("name", ["i8", "q"])
@given(  # a value very close to an integer number of units is taken as that integer
    operator=OPERATORS, value=st.one_of(st.integers(-200, 200), st.floats(-10, 10).map(lambda value: round(value, 6)))
)
def test_comparison_of_integers_agrees_with_the_text(name: str, operator: str, value: float) -> None:
    variable = BOARD[name]
    scale = 2.0**-variable.target.type.fraction_bits
    compare = {">": gt, ">=": ge, "<": lt, "<=": le}[operator]
    expected = [compare(raw * scale, value) for raw in range(-128, 128)]
    try:
        trigger = trigger_of(Expression(name, operator, repr(value)), BOARD, CATALOGUE)
    except UsageError:
        assert len(set(expected)) == 1
        return
    assert [(raw >= trigger.threshold) is trigger.above for raw in range(-128, 128)] == expected


@given(operator=OPERATORS, value=st.floats(-1e6, 1e6, width=32))
def test_comparison_of_floats_agrees_with_the_text(operator: str, value: float) -> None:
    trigger = trigger_of(Expression("real", operator, repr(value)), BOARD, CATALOGUE)
    assert trigger.compare is Compare.FLOAT
    (threshold,) = struct.unpack("<f", trigger.threshold.to_bytes(4, "little"))
    assert (value >= threshold) is (operator in (">=", "<"))
    assert math.isclose(threshold, value, rel_tol=1e-6, abs_tol=1e-30)


def test_values_of_catalogue_variables_are_si() -> None:
    trigger = trigger_of(parse_expression("axis1.i_q > 1.0"), BOARD, CATALOGUE)
    lsb = CATALOGUE["axis1.i_q"].lsb
    assert (trigger.threshold - 1) * lsb <= 1.0 < trigger.threshold * lsb
    assert (trigger.compare, trigger.above, trigger.below, trigger.level) == (Compare.SIGNED, True, False, False)
    code = CATALOGUE.enums["axis_state"]["FAULT"] if "axis_state" in CATALOGUE.enums else None
    state = trigger_of(parse_expression("axis1.state rising FAULT"), BOARD, CATALOGUE, level=True)
    assert state.level
    assert code is None or state.threshold == code


def test_the_threshold_can_be_another_variable() -> None:
    trigger = trigger_of(parse_expression("i8 < other"), BOARD, CATALOGUE)
    assert (trigger.threshold_address, trigger.below) == (0x1234, True)
    assert trigger_of(parse_expression("array[1] > array[2]"), BOARD, CATALOGUE).threshold_address == 0x1004
    for text in ("i8 > u16", "axis1.i_q > axis1.speed", "axis1.i_q > u_dc"):
        with pytest.raises(UsageError, match="cannot be the threshold"):
            trigger_of(parse_expression(text), BOARD, CATALOGUE)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("i8 > 128", r"outside the range of i8: -128 \.\. 127"),
        ("axis1.i_q > 100", r"outside the range of axis1.i_q: -8.25 .* A"),
        ("real > 1e39", "outside the range of real"),
        ("real > nan", "not one finite number"),
        ("i8 > fast", "'fast' is not a number"),
        ("i8 > 1,2", "not one finite number"),
        ("array > 1", r"write one element, such as array\[0\]"),
        ("memory > 1", "block of bytes"),
        ("i8 == 1", "is not a trigger"),
        ("i8", "is not a trigger"),
        ("> 1", "is not a trigger"),
    ],
)
def test_invalid_triggers_are_usage_errors(text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        trigger_of(parse_expression(text), BOARD, CATALOGUE)


def test_an_unknown_variable_is_reported() -> None:
    with pytest.raises(UnknownVariableError, match=r"did you mean axis1\.i_q"):
        trigger_of(parse_expression("axis1.iq > 1"), BOARD, CATALOGUE)
