"""Parameters as text, merged, and checked against each other."""

from __future__ import annotations

import pytest
from servo_msgs_py.board_parameters import applied, contradiction, merged, parameters, parse, si
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.convert import parameters_from_message, parameters_message
from servo_msgs_py.value_text import parse_element

CATALOGUE = Catalogue.load()
DEFAULTS = {v.name: [v.to_raw(max(v.minimum, 0.0))] * v.count for v in parameters(CATALOGUE)}


def test_assignments_of_one_element_and_of_all_elements_are_parsed() -> None:
    one = parse("param.features[1] = anti_windup+POSITION_LIMITS", CATALOGUE)
    assert (one.variable.name, one.element, one.raw) == ("param.features", 1, (0x81,))
    assert one.text == "param.features[1]=anti_windup+POSITION_LIMITS"
    both = parse("param.i_q_limit=1.5,2", CATALOGUE)
    assert both.element is None
    assert si({"param.i_q_limit": both.raw}, CATALOGUE)["param.i_q_limit"] == pytest.approx([1.5, 2.0], abs=1e-3)
    assert parse("param.host_timeout=0.25", CATALOGUE).raw == (500,)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("param.i_q_limit", "write NAME=VALUE"),
        ("param.i_q_limit=", "write NAME=VALUE"),
        ("=1", "write NAME=VALUE"),
        ("param.i_q_limt[0]=1", "did you mean param.i_q_limit"),
        ("cmd.enable[0]=1", "is not a parameter"),
        ("param.i_q_limit[2]=1", "elements 0 .. 1"),
        ("param.i_q_limit=1", "1 value"),
        ("param.i_q_limit[0]=1,2", "2 value"),
        ("param.i_q_limit[0]=5", "outside 0.1 .. 4 A"),
        ("param.i_q_limit[0]=nan", "not a finite number"),
        ("param.features[0]=1.5", "1.5 is not a whole number"),
        ("param.features[0]=ANTI_WINDUP+FOO", "'FOO' is not a number or one of the names none, ANTI_WINDUP"),
    ],
)
def test_invalid_assignments_are_refused(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=r".") as caught:
        parse(text, CATALOGUE)
    assert reason in str(caught.value)


def test_a_later_assignment_replaces_an_earlier_one() -> None:
    first, second, both, other = (
        parse(f"param.i_q_limit{text}", CATALOGUE) for text in ("[0]=1", "[1]=1", "=2,3", "[0]=0.5")
    )
    assert merged([first, second], [other]) == [second, other]
    assert merged([first, second], [both]) == [both]
    assert merged([both], [other]) == [both, other]
    raw = applied([both, other], DEFAULTS)["param.i_q_limit"]
    assert raw == [other.raw[0], both.raw[1]]
    assert applied([first], {}) == {}  # the other element is unknown
    assert DEFAULTS["param.i_q_limit"] == [CATALOGUE["param.i_q_limit"].to_raw(0.1)] * 2


def test_reversed_limits_are_refused() -> None:
    assert contradiction(DEFAULTS, CATALOGUE) == ""
    reversed_limits = applied([parse("param.position_min[1]=3", CATALOGUE)], DEFAULTS)
    text = contradiction(reversed_limits, CATALOGUE)
    assert text.startswith("param.position_min[1] 3.00022 rad exceeds param.position_max[1] 0 rad")
    assert contradiction({"param.position_min": [1, 1]}, CATALOGUE) == ""


def test_message_conversion_is_exact() -> None:
    values = {
        v.name: [v.format.low + 12345 + k, v.format.high - 54321 % v.format.high - k][: v.count]
        for k, v in enumerate(parameters(CATALOGUE))
    }
    message = parameters_message(values, CATALOGUE)
    assert message.layout.dim[1].label.split(",")[0] == "param.speed_limit[0]"
    assert parameters_from_message(message, CATALOGUE) == values
    message.layout.dim[1].label = message.layout.dim[1].label.replace("speed_limit", "torque_limit")
    with pytest.raises(ValueError, match="another version"):
        parameters_from_message(message, CATALOGUE)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("cmd.position[1]", ("cmd.position", 1)),
        ("u_dc", ("u_dc", None)),
        ("a[0][12]", ("a[0]", 12)),
        ("a[]", ("a[]", None)),
        ("a[-1]", ("a[-1]", None)),
        ("[1]", ("[1]", None)),
    ],
)
def test_an_element_is_a_name_with_an_index(text: str, expected: tuple[str, int | None]) -> None:
    assert parse_element(text) == expected
