"""The table of variables: its contract, and error messages for invalid tables."""

from __future__ import annotations

import copy
import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_msgs_py.catalogue import AXES, Catalogue, CatalogueError, axis_name, numbers

CATALOGUE = Catalogue.load()

SMALL: dict[str, Any] = {
    "scales": {"volt": {"full_scale": 36.3, "unit": "V"}, "turn": {"lsb": 0.5, "unit": "rad"}},
    "enums": {"mode_t": {"A": 0, "B": 1}},
    "flags": {"faults": {"HOT": {"bit": 3, "cause": "too hot", "remedy": "wait"}}},
    "variable": [
        {"name": "u", "path": "snapshot.u", "type": "frac16", "scale": "volt", "description": "bus"},
        {
            "name": "cmd.x", "path": "command.x", "type": "int32", "count": 2, "scale": "turn", "access": "rw",
            "minimum": -10.0, "maximum": 10.0, "description": "set-points",
        },
    ],
    "axis_variable": [
        {"name": "mode", "path": "a[{i}].mode", "type": "enum", "enum": "mode_t", "description": "mode"},
        {"name": "faults", "path": "a[{i}].faults", "type": "flags", "flags": "faults", "description": "faults"},
    ],
}  # fmt: skip


def small(**changes: Any) -> Catalogue:
    """`SMALL` with changes to the entry of ``u``; None removes a key."""
    table = copy.deepcopy(SMALL)
    entry = table["variable"][0]
    entry.update(changes)
    table["variable"][0] = {key: value for key, value in entry.items() if value is not None}
    return Catalogue.parse(table)


# ---- the packaged table
def test_every_variable_is_described_and_finite() -> None:
    for variable in CATALOGUE.variables.values():
        assert variable.text
        assert variable.lsb > 0.0
        assert -math.inf < variable.minimum <= variable.maximum < math.inf
        assert variable.name == variable.name.lower()


def test_variables_that_the_project_uses_exist() -> None:
    per_axis = ["position", "position_ref", "speed", "speed_ref", "i_q", "i_d", "i_q_ref", "u_d", "u_q", "theta_e"]
    per_axis += ["state", "substate", "faults", "limits", "torque_constant"]
    required = {f"{axis_name(axis)}.{name}" for axis in range(AXES) for name in per_axis}
    required |= {"tick", "applied_tick", "applied_count", "u_dc", "catalogue_hash", "snapshot"}
    assert required <= set(CATALOGUE.variables)


def test_only_commands_blocks_and_parameters_can_be_written() -> None:
    writable = {name.split(".")[0] for name, v in CATALOGUE.variables.items() if v.writable}
    assert writable == {"boot_token", "cmd", "config", "measurement", "param", "storage"}


def test_numbers_of_states_are_those_of_the_reference_design() -> None:
    assert CATALOGUE.enums["state_t"] == {"FAULT": 0, "INIT": 1, "STOP": 2, "RUN": 3}
    substates = CATALOGUE.enums["substate_t"]
    assert [substates[n] for n in ("CALIB", "READY", "ALIGN", "SPIN", "FREEWHEEL", "STARTUP", "TEST")] == list(range(7))
    assert CATALOGUE.enums["control_mode_t"] == {"POSITION": 0, "SPEED": 1, "TORQUE": 2, "TRAJECTORY": 3, "TEST": 4}


def test_flags_have_a_bit_each_and_faults_a_remedy() -> None:
    for flags in CATALOGUE.flags.values():
        assert len({f.bit for f in flags}) == len(flags)
        assert all(0 <= f.bit < 32 and f.cause for f in flags)
    assert all(fault.remedy for fault in CATALOGUE.flags["faults"])


def test_bus_voltage_is_scaled_as_in_the_reference_design() -> None:
    assert CATALOGUE["u_dc"].to_raw(24.0) == 21665  # DRM E47
    assert CATALOGUE["u_dc"].decode((21665).to_bytes(2, "little")) == pytest.approx(24.0, abs=1e-3)


def test_scales_follow_from_the_ranges_of_the_board() -> None:
    """The full scales of the reference design, and multiples of them to the last bit."""
    full = CATALOGUE.full_scale
    assert (full("bus_voltage"), full("stator_voltage"), full("current")) == (36.3, 24.2, 8.25)
    assert CATALOGUE.scales["integrated_voltage"].lsb == 24.2 / 2**23
    assert CATALOGUE.scales["observed_voltage"].lsb == 24.2 / 2**26
    assert CATALOGUE.scales["current_per_acceleration"].lsb == 8.25 / full("acceleration") / 2**16


@pytest.mark.parametrize("entry", [{"of": "missing"}, {"of": "turn"}, {"of": "volt", "over": "turn"}])
def test_a_multiple_of_no_full_scale_is_refused(entry: dict[str, Any]) -> None:
    scales = SMALL["scales"] | {"other": {"unit": "V", **entry}}
    with pytest.raises(CatalogueError, match="is no earlier scale with a full scale"):
        Catalogue.parse(SMALL | {"scales": scales})


def test_one_revolution_has_4000_counts() -> None:
    assert CATALOGUE["cmd.position"].encode([2.0 * math.pi, -2.0 * math.pi]) == (4000).to_bytes(4, "little") + (
        -4000
    ).to_bytes(4, "little", signed=True)


@given(st.sampled_from(sorted(n for n, v in CATALOGUE.variables.items() if v.size)), st.data())
def test_conversion_of_bytes_to_si_is_reversible(name: str, data: st.DataObject) -> None:
    variable = CATALOGUE[name]
    raw = [data.draw(st.integers(variable.format.low, variable.format.high)) for _ in range(variable.count)]
    stored = variable.encode_raw(raw)
    assert len(stored) == variable.size
    assert variable.decode_raw(stored) == raw
    for number, value in zip(raw, numbers(variable.decode(stored)), strict=True):
        if variable.minimum <= value <= variable.maximum:
            assert variable.to_raw(value) == number


def test_a_wrong_name_gets_suggestions() -> None:
    with pytest.raises(KeyError, match=r"axis1\.posittion.*axis1\.position"):
        CATALOGUE["axis1.posittion"]


def test_snapshot_variables_all_lie_in_the_snapshot() -> None:
    names = [v.name for v in CATALOGUE.snapshot_variables()]
    assert names[:4] == ["tick", "applied_tick", "applied_count", "u_dc"]
    assert "axis2.limits" in names
    assert "cmd.position" not in names


# ---- values
@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([math.nan, 0.0], "finite"),
        ([0.0, math.inf], "finite"),
        ([10.5, 0.0], r"10\.5 is outside -10 \.\. 10 rad"),
        ([0.0], "1 values given, 2 expected"),
        ([0.0, 0.0, 0.0], "3 values given"),
        (0.0, "1 values given"),
    ],
)
def test_wrong_values_are_refused(value: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        small()["cmd.x"].encode(value)


def test_raw_numbers_out_of_range_are_refused() -> None:
    with pytest.raises(ValueError, match="does not fit 2 bytes"):
        small()["u"].encode_raw([40_000])
    with pytest.raises(ValueError, match="3 bytes read, 2 expected"):
        small()["u"].decode_raw(b"abc")


def test_a_block_is_bytes_and_cannot_be_written() -> None:
    block = CATALOGUE["snapshot"]
    assert block.size == 0
    assert block.decode(b"\x01\x02") == b"\x01\x02"
    with pytest.raises(ValueError, match="read-only"):
        block.encode([1.0])


def test_labels_and_flags_are_decoded() -> None:
    catalogue = small()
    assert catalogue.label("mode_t", 1) == "B"
    assert catalogue.label("mode_t", 9) == "9"
    assert [f.name for f in catalogue.active("faults", 0b1000)] == ["HOT"]
    assert catalogue.active("faults", 0b0111) == []


def test_axis_variables_are_expanded() -> None:
    assert [n for n in small().variables if n.endswith("mode")] == ["axis1.mode", "axis2.mode"]
    assert small()["axis2.mode"].path == "a[1].mode"


def test_sources_are_expanded_and_need_no_path() -> None:
    assert CATALOGUE["axis2.i_q"].source == "axis[1].current_loop.current.q"
    assert CATALOGUE["axis2.i_q"].path.startswith("snapshot.")
    assert (CATALOGUE["axis2.i_a"].source, CATALOGUE["axis2.i_a"].path) == ("axis[1].sense.current.a", "")


def test_numbers_of_the_loops_have_the_scale_of_their_bits() -> None:
    """pi_sum_t has 55 fraction bits, and its upper half 23; the observer's voltages have 15 + F2."""
    voltage, current = CATALOGUE.scales["stator_voltage"].full_scale, CATALOGUE.scales["current"].full_scale
    assert voltage is not None
    assert current is not None
    assert CATALOGUE["axis1.pi_d"].lsb == pytest.approx(voltage / 2**23, rel=1e-15)
    assert CATALOGUE["axis1.pi_speed"].lsb == pytest.approx(current / 2**23, rel=1e-15)
    assert CATALOGUE["axis1.emf_alpha"].lsb == pytest.approx(voltage / 2 ** (15 + 11), rel=1e-15)
    assert CATALOGUE["axis1.pll_speed"].lsb == pytest.approx(2.0 * math.pi * 16_000.0 / 2**32, rel=1e-15)


# ---- the hash
def test_texts_do_not_change_the_hash() -> None:
    assert small(description="another text").hash == small().hash


@pytest.mark.parametrize("changes", [{"type": "frac32"}, {"access": "rw"}, {"name": "v"}, {"count": 2}])
def test_everything_that_changes_the_meaning_changes_the_hash(changes: dict[str, Any]) -> None:
    assert small(**changes).hash != small().hash


def test_a_scale_changes_the_hash() -> None:
    table = copy.deepcopy(SMALL)
    table["scales"]["volt"]["full_scale"] = 36.0
    assert Catalogue.parse(table).hash != small().hash


# ---- wrong tables
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"type": "float"}, "unknown type 'float'"),
        ({"scale": "ampere"}, "unknown scale 'ampere'"),
        ({"scale": "turn"}, "a fraction needs a scale with full_scale"),
        ({"scale": None}, "a fraction needs a scale with full_scale"),
        ({"type": "int32"}, "an integer one with lsb"),
        ({"access": "write"}, "access is 'write'"),
        ({"colour": "red"}, "unknown key colour"),
        ({"path": None}, "path or source missing"),
        ({"source": "b", "count": 2}, "only a single number can have a source"),
        ({"source": "b", "type": "block", "scale": None}, "only a single number can have a source"),
        ({"source": "b", "path": None, "access": "rw"}, "only a variable with a path can be writable"),
        ({"description": None}, "description missing"),
        ({"type": "enum", "scale": None}, "needs a key 'enum'"),
        ({"type": "enum", "scale": None, "enum": "nothing_t"}, "needs a key 'enum'"),
        ({"minimum": 5.0, "maximum": 4.0}, "limits 5 .. 4"),
        ({"maximum": 40.0}, "do not fit"),
        ({"name": "axis1.mode"}, "axis1.mode: named twice"),
    ],
)
def test_error_in_the_table_is_located(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(CatalogueError, match=message):
        small(**changes)


def test_error_of_an_invalid_file_has_its_path(tmp_path: Path) -> None:
    path = tmp_path / "broken.toml"
    path.write_text("[[variable]\n", encoding="utf-8")
    with pytest.raises(CatalogueError, match=r"broken\.toml"):
        Catalogue.load(path)
    path.write_text('[[variable]]\nname = "x"\n', encoding="utf-8")
    with pytest.raises(CatalogueError, match=r"broken\.toml: x: .* missing"):
        Catalogue.load(path)
