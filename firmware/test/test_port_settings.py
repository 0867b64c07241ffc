"""Register values of the MC56F84789 port: derived from quantities, on the host and with 16-bit int."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from firmware_compiler import FIRMWARE, STRICT, CompileC, CompileProgram, defined
from port_board import PORT, names_of

# The reference configuration, calculated by hand for a bus of 100 MHz, 16 kHz, 1 us of dead time and 115200 baud.
REFERENCE = {
    "PWM_PERIOD": 6250,
    "SET_PWM_INIT": 0xF3CB,
    "SET_PWM_VAL1": 0x0C34,
    "SET_PWM_VAL0": 0x0000,
    "SET_PWM_VAL4": 0xF402,  # 0.5 + 0.2 - 0.15 us after the low-side centre
    "SET_PWMA_SM1_VAL5": 0xF47D,  # 55 + 20 + 102.5 clocks after the low-side centre
    "SET_PWM_CTRL": 0x0800,
    "SET_PWMA_SM0_CTRL2": 0x0000,
    "SET_PWMA_SM12_CTRL2": 0x0204,
    "SET_PWMB_SM0_CTRL2": 0x0300,
    "SET_PWMB_SM12_CTRL2": 0x0304,
    "SET_PWMA_SM0_TCTRL": 0x0001,
    "SET_TCTRL_SAMPLE": 0x0010,
    "SET_PWM_DISMAP0": 0xFF11,
    "SET_PWM_DISMAP1": 0xFF00,
    "SET_PWM_DTCNT": 0x0064,
    "SET_PWM_FFILT0": 0x0202,
    "SET_PWM_FCTRL0": 0x3031,
    "SET_PWM_FSTS0": 0x0030,
    "SET_PWM_OUTEN": 0x0770,
    "SET_XBARA_PWMB_SYNC_0": 0x1400,
    "SET_XBARA_PWMB_SYNC_12": 0x1414,
    "SET_XBARB_SAMPLE": 0x1609,
    "SET_AOI_BFCRT01": 0x7FDF,
    "SET_AOI_BFCRT23": 0x0000,
    "SET_XBARA_ADC": 0x2E2E,
    "SET_ADC_CTRL1_STOPPED": 0x5005,
    "SET_ADC_CTRL1_ARMED": 0x1805,
    "SET_ADC_CTRL2": 0x0044,
    "SET_ADC_CTRL2_STOPPED": 0x4044,
    "SET_ADC_PWR2": 0x040F,
    "SET_ADC_SDIS": 0xC0C0,
    "SET_ADC_SCTRL": 0x0008,
    "SET_ADC_STAT_CLEAR": 0x1800,
    "SET_TMR0_LOAD": 0x0000,
    "SET_TMR0_CTRL": 0x80A5,
    "SET_TMR2_CTRL": 0x2800,
    "SET_TMR_CTRL_TIME": 0x3E80,
    "SET_TMR_SCTRL_CAPTURE": 0x00C0,
    "SET_TMR3_CSCTRL": 0x0800,
    "SET_TMR_FILT": 0x0105,
    "SET_QSCI_RATE": 0x01B2,
    "SET_QSCI_CTRL1": 0x002C,
    "SET_QSCI_CTRL2": 0x00A0,
    "SET_OCCS_DIVBY": 0x2031,
    "SET_OCCS_CTRL_PLL": 0x0084,
    "SET_OCCS_CTRL_RUN": 0x0085,
    "SET_COP_TOUT": 0x0186,
    "SET_COP_CTRL": 0x0303,
    "SET_SIM_PCE0": 0xFF7F,
    "SET_SIM_PCE1": 0x1000,
    "SET_SIM_PCE2": 0x0080,
    "SET_SIM_PCE3": 0x00EF,
    "SET_SIM_PCR": 0x0000,
    "SET_SIM_IPS0": 0x0000,
    "SET_GPSEL": 0xA000,
    "SET_GPSEH": 0x0005,
    "SET_GPSCL": 0x4010,
    "SET_GPSCH": 0x0001,
    "SET_GPSFH": 0x1401,
}


@pytest.fixture(scope="module")
def values(compile_c: CompileC, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """``values(*defines)``: every ``SET_`` value and the named quantities, for a configuration."""
    names = [name for name in names_of(PORT / "settings.h") if name.startswith("SET_")]
    names += ["PWM_PERIOD", "START_COUNT", "M1_COUNT", "SAMPLE_COUNT"]
    source = tmp_path_factory.mktemp("settings") / "settings_values.c"
    fields = ", ".join(f"(long)({name})" for name in names)
    source.write_text(
        '#include "port/mc56f84789/settings.h"\n'
        "extern const long settings_values[];\n"
        f"const long settings_values[] = {{{fields}}};\n",
        encoding="ascii",
    )

    def build(*defines: str) -> dict[str, int]:
        _, lib = compile_c("settings", [source], f"extern const long settings_values[{len(names)}];", defines)
        return dict(zip(names, lib.settings_values, strict=True))

    return build


def test_settings_have_the_reference_values(values: Any) -> None:
    found = values()
    assert {name: f"{found[name]:04X}" for name in REFERENCE} == {name: f"{v:04X}" for name, v in REFERENCE.items()}


def test_the_same_values_where_int_has_16_bits(compile_program: CompileProgram, tmp_path: Path) -> None:
    """Each value is an integer constant expression with 16-bit int, and no intermediate result overflows."""
    source = tmp_path / "sixteen.c"
    checks = "".join(f"SETTINGS_CHECK(is_{name}, {name} == 0x{value:X}UL);\n" for name, value in REFERENCE.items())
    source.write_text(
        f'#include "port/mc56f84789/settings.h"\n{checks}int main(void) {{ return 0; }}\n', encoding="ascii"
    )
    options = ["-mmcu=atmega1284p", "-Os", "-Woverflow"]
    compile_program("sixteen.elf", [source], options, compiler="avr-gcc")


# ---- registers that depend on a quantity ----------------------------------------------------------------------------

CARRIER = {"PWM_PERIOD", "START_COUNT", "M1_COUNT", "SAMPLE_COUNT", "SET_PWM_INIT", "SET_PWM_VAL1", "SET_PWM_VAL4"}
EVENTS = {"SET_PWMA_SM0_VAL5", "SET_PWMA_SM1_VAL5"}
SAMPLE = {"START_COUNT", "M1_COUNT", "SAMPLE_COUNT", "SET_PWM_VAL4", *EVENTS}
SCAN = {"START_COUNT", "M1_COUNT", *EVENTS}


@pytest.mark.parametrize(
    ("define", "moved"),
    [
        ("PWM_FREQUENCY_HZ=20000UL", CARRIER | EVENTS),
        ("DEAD_TIME_NS=1500UL", SAMPLE | {"SET_PWM_DTCNT"}),
        ("AMPLIFIER_DELAY_NS=800UL", SAMPLE),
        ("ADC_HOLD_NS=200UL", SAMPLE),
        ("ADC_CLOCK_HZ=10000000UL", SCAN | {"SET_ADC_CTRL2", "SET_ADC_CTRL2_STOPPED", "SET_ADC_PWR2"}),
        ("ADC_PAIRS=2U", SCAN | {"SET_ADC_SDIS", "SET_ADC_SCTRL"}),
        ("SERIAL_BAUD=921600UL", {"SET_QSCI_RATE"}),
        ("SERIAL_CLOCK_DOUBLE=1", {"SET_QSCI_RATE", "SET_SIM_PCR"}),
        ("WATCHDOG_MS=100UL", {"SET_COP_TOUT"}),
        ("ENCODER_FILTER_NS=400UL", {"SET_TMR_FILT"}),
        ("TIME_STAMP_DIVIDER=64UL", {"SET_TMR_CTRL_TIME"}),
        ("FAULT_FILTER_NS=200UL", {"SET_PWM_FFILT0"}),
        ("FAULT_HIGH=0", {"SET_PWM_FCTRL0", "SET_PWM_FCTRL0_SILENT"}),
        ("CRYSTAL_HZ=16000000UL", {"SET_OCCS_DIVBY"}),
        ("SYNC_LATENCY_CLOCKS=3", {"SET_PWMA_SM0_VAL0"}),
    ],
)
def test_a_quantity_changes_its_registers_only(values: Any, define: str, moved: set[str]) -> None:
    before, after = values(), values(define)
    assert {name for name in before if before[name] != after[name]} == moved


def test_slower_bus_changes_all_registers_in_clocks(values: Any) -> None:
    after = values("BUS_CLOCK_HZ=80000000UL", "TIME_STAMP_DIVIDER=128UL")
    assert after["PWM_PERIOD"] == 5000
    assert after["SET_PWM_DTCNT"] == 80
    assert after["SET_PWM_VAL4"] == (-2500 + 44) & 0xFFFF
    assert after["SET_ADC_CTRL2"] & 0x3F == 3
    assert after["SET_OCCS_DIVBY"] == 0x2027  # 320 MHz
    assert after["SET_QSCI_RATE"] == 347
    assert after["SET_COP_TOUT"] == 0x0186  # its clock is the internal oscillator


@pytest.mark.parametrize(
    ("baud", "rate"), [(115200, 0x01B2), (230400, 0x00D9), (460800, 0x006D), (921600, 0x0036), (1000000, 0x0032)]
)
def test_a_baud_rate_is_met_within_half_a_percent(values: Any, baud: int, rate: int) -> None:
    found = values(f"SERIAL_BAUD={baud}UL")["SET_QSCI_RATE"]
    assert found == rate
    assert abs(100e6 / (2 * found) / baud - 1) < 0.005


def test_half_of_the_bus_clock_needs_the_postscaler(values: Any) -> None:
    found = values("BUS_CLOCK_HZ=40000000UL", "FAULT_FILTER_NS=250UL", "TIME_STAMP_DIVIDER=128UL")
    assert found["SET_OCCS_DIVBY"] == 0x2127  # 320 MHz, halved


# ---- order of the instants (DRM F34) --------------------------------------------------------------------------------


@pytest.mark.parametrize("define", ["PWM_FREQUENCY_HZ=16000UL", "PWM_FREQUENCY_HZ=8000UL", "PWM_FREQUENCY_HZ=20000UL"])
def test_sampling_instants_are_in_order(values: Any, define: str) -> None:
    found = values(define)
    half = found["PWM_PERIOD"] // 2
    conversions = (8.5 + 6 + 6) * 5  # bus clocks
    assert -half < found["SAMPLE_COUNT"] < found["M1_COUNT"] < 0
    assert found["M1_COUNT"] - found["SAMPLE_COUNT"] >= conversions
    motor_2_done = found["SAMPLE_COUNT"] + half + conversions
    assert motor_2_done < found["START_COUNT"] < half - 500


# ---- impossible quantities -----------------------------------------------------------------------------------------


def compile_errors(tmp_path: Path, defines: Sequence[str]) -> str:
    source = tmp_path / "settings.c"
    source.write_text('#include "port/mc56f84789/settings.h"\ntypedef int nothing;\n', encoding="ascii")
    command = ["gcc", *STRICT, f"-I{FIRMWARE}", *defined(defines), "-fsyntax-only", str(source)]
    return subprocess.run(command, capture_output=True, text=True, check=False).stderr


@pytest.mark.parametrize(
    ("define", "check"),
    [
        ("PWM_FREQUENCY_HZ=15000UL", "pwm_period_is_whole_clocks"),
        ("PWM_FREQUENCY_HZ=32000UL", "pwm_period_is_even"),
        ("PWM_FREQUENCY_HZ=1000UL", "pwm_period_fits_the_counter"),
        ("PWM_FREQUENCY_HZ=2500UL", "a_compare_can_be_out_of_reach"),
        ("DEAD_TIME_NS=25000UL", "dead_time_fits_its_counter"),
        ("DEAD_TIME_NS=0UL", "dead_time_is_not_zero"),
        ("DEAD_TIME_NS=8000UL", "dead_time_leaves_a_pulse"),
        ("HALF_PULSE_MIN_CLOCKS=1", "shortest_pulse_is_swallowed"),
        ("FAULT_FILTER_NS=20UL", "fault_filter_can_be_set"),
        ("ADC_CLOCK_HZ=25000000UL", "adc_clock_within_the_chips_limit"),
        ("ADC_CLOCK_HZ=15000000UL", "adc_clock_divides_the_bus_clock"),
        ("ADC_CLOCK_HZ=1000000UL", "adc_divider_fits"),
        ("ADC_PAIRS=4U", "adc_pause_is_where_the_documents_agree"),
        ("ADC_HOLD_NS=900UL", "sample_lies_behind_the_centre"),
        ("AMPLIFIER_DELAY_NS=30000UL", "sample_lies_in_the_first_half"),
        ("AMPLIFIER_DELAY_NS=28000UL", "start_interrupt_has_time"),
        ("ENCODER_FILTER_NS=20UL", "encoder_filter_can_be_set"),
        ("TIME_STAMP_DIVIDER=100UL", "time_stamp_divider_exists"),
        ("SERIAL_BAUD=300UL", "baud_rate_is_not_too_low"),
        ("SERIAL_BAUD=12000000UL", "baud_rate_is_not_too_high"),
        ("SERIAL_BAUD=3000000UL", "baud_rate_deviates_less_than_1_6_percent"),
        ("WATCHDOG_MS=9000UL", "watchdog_time_fits"),
        ("BUS_CLOCK_HZ=120000000UL", "bus_clock_within_the_chips_limit"),
        ("BUS_CLOCK_HZ=12500000UL", "bus_clock_is_whole_megahertz"),
        ("CRYSTAL_HZ=7000000UL", "pll_is_a_multiple_of_the_crystal"),
        ("CRYSTAL_HZ=2000000UL", "crystal_within_the_chips_limits"),
        ("BUS_CLOCK_HZ=10000000UL", "pll_in_range"),
    ],
)
def test_impossible_quantities_do_not_compile(tmp_path: Path, define: str, check: str) -> None:
    assert f"check_{check}" in compile_errors(tmp_path, [define])


def test_reference_configuration_compiles_without_a_warning(tmp_path: Path) -> None:
    assert compile_errors(tmp_path, []) == ""
