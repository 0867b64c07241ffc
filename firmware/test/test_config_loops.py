"""Figures of the tuning tool: linear systems against closed forms, loops against the C, E43..E45, warnings."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable

import numpy as np
import pytest
from core_library import Core
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from quad_timer import TIMER_CLOCK
from servo_bench import Bench
from servo_tuning.assessment import Assessment, assess
from servo_tuning.configuration import Scales
from servo_tuning.errors import Problem, exactly
from servo_tuning.findings import findings
from servo_tuning.linear import System, expm, held, margins, poles, spectral_radius
from servo_tuning.loops import CurrentLoop, In, Out
from servo_tuning.remedies import refusal_of
from servo_tuning.sensors import EdgeDelay, edge_delay
from servo_tuning.tuned import Tuned
from tuning_tool import CATALOGUE, axis, case, configuration, table

TICK = 0.5e-3


# ---- linear systems -------------------------------------------------------------------------------------------------


@given(st.floats(1e-6, 1e3), st.floats(0.0, 100.0))
def test_exponential_of_a_damped_rotation(decay: float, angle: float) -> None:
    a = np.array([[-decay, -angle], [angle, -decay]])
    c, s = math.cos(angle), math.sin(angle)
    assert expm(a) == pytest.approx(math.exp(-decay) * np.array([[c, -s], [s, c]]), abs=1e-11)


def test_exponential_of_a_chain_of_integrators() -> None:
    a = np.diag(np.ones(3), 1) * 7.0
    assert expm(a)[0] == pytest.approx([1.0, 7.0, 24.5, 7.0**3 / 6.0], rel=1e-13)


@pytest.mark.parametrize("dt", [1e-6, 1e-3, 1.0, 1e3])
def test_zero_order_hold_of_a_lag(dt: float) -> None:
    f, g = held(np.array([[-20.0]]), np.array([[20.0]]), dt)
    assert f[0, 0] == pytest.approx(math.exp(-20.0 * dt), abs=1e-13)
    assert g[0, 0] == pytest.approx(-math.expm1(-20.0 * dt), rel=1e-12)


def delayed_integrator(omega: float, delay: float) -> Callable[[NDArray[np.float64]], NDArray[np.complex128]]:
    return lambda w: omega / (1j * w) * np.exp(-1j * w * delay)


@pytest.mark.parametrize(("omega", "delay"), [(100.0, 1e-3), (500.0, 1e-3), (1500.0, 0.9e-3)])
def test_margins_of_an_integrator_with_dead_time(omega: float, delay: float) -> None:
    """Crossover at omega, phase margin 90 degrees minus that of the dead time; -180 degrees at pi / (2 delay)."""
    found = margins(delayed_integrator(omega, delay), 1e5)
    assert found.crossover == pytest.approx(omega / (2.0 * math.pi), rel=1e-4)
    assert found.phase == pytest.approx(90.0 - math.degrees(omega * delay), abs=1e-2)
    assert found.gain == pytest.approx(math.pi / 2.0 / (omega * delay), rel=1e-4)


def test_loop_without_crossover_has_no_margins() -> None:
    found = margins(lambda w: np.full(w.shape, 0.1 + 0.0j), 1000.0)
    assert (found.crossover, found.phase, found.gain) == (None, None, None)


def test_phase_margin_of_a_resonance_is_the_nearest_one() -> None:
    """A stable loop crosses unity gain below a resonance at +90 degrees, far from -180 on either side."""
    low, high, damping = 300.0, 600.0, 0.01

    def response(w: NDArray[np.float64]) -> NDArray[np.complex128]:
        zeros, poles = (f**2 - w**2 + 2j * damping * f * w for f in (low, high))
        return np.asarray(delayed_integrator(50.0, 2e-4)(w) * zeros / poles * (high / low) ** 2)

    found = margins(response, 1e5)
    assert found.crossover == pytest.approx(high / (2.0 * math.pi), rel=0.2)
    assert found.phase is not None
    assert 60.0 < found.phase < 90.0


def test_gain_margin_at_half_the_sampling_frequency() -> None:
    """An integrator in discrete time, L = k / (z - 1): unstable from k = 2 on, where z = -1."""
    loop = System(np.array([[1.0]]), np.array([[0.5]]), np.array([[1.0]]), np.array([[0.0]]), 1.0)
    assert margins(loop.response, loop.nyquist).gain == pytest.approx(4.0, rel=1e-9)
    assert spectral_radius(loop.fed_back(0, 0, 3.999).a) < 1.0 < spectral_radius(loop.fed_back(0, 0, 4.001).a)


def test_discrete_poles_are_converted_to_continuous_ones() -> None:
    s = 2.0 * math.pi * 30.0 * cmath.exp(1j * (math.pi - math.acos(0.4)))
    z = cmath.exp(s * TICK)
    a = np.array(
        [[z.real, z.imag, 0.0, 0.0], [-z.imag, z.real, 0.0, 0.0], [0, 0, math.exp(-5.0 * TICK), 0], [0, 0, 0, 0]]
    )
    slow, pair = poles(a, TICK)
    assert (slow.pair, pair.pair) == (False, True)
    assert slow.frequency == pytest.approx(5.0 / (2.0 * math.pi))
    assert slow.damping == pytest.approx(1.0)
    assert pair.frequency == pytest.approx(30.0)
    assert pair.damping == pytest.approx(0.4)


def test_simulation_and_frequency_response_agree() -> None:
    loop = axis().shaft().speed.channel(Out.SPEED, In.SET_POINT)
    frequency = 40.0
    time = TICK * np.arange(4000)
    u = np.zeros((time.size, 1))
    u[:, 0] = np.sin(2.0 * math.pi * frequency * time)
    kernel = np.exp(-2j * math.pi * frequency * time[2000:])
    measured = (loop.simulate(u)[2000:, 0] * kernel).sum() / (u[2000:, 0] * kernel).sum()
    assert measured == pytest.approx(loop.response(np.array([2.0 * math.pi * frequency]))[0], abs=1e-6)


# ---- loops against the C --------------------------------------------------------------------------------------------


def test_current_loop_is_the_pi_of_the_firmware(core: Core) -> None:
    """The C controller with the committed integers in a loop with a winding: exact steps of half a period."""
    it = axis()
    gains = core.lib.probe_config().axis[0].current_loop.q
    state = core.ffi.new("pi_state_t *")
    pointer = core.ffi.new("pi_gains_t *", gains)
    scales = Scales.of(CATALOGUE)
    r, inductance = it.axis("motor.r_s"), it.axis("motor.l_q")
    decay = math.exp(-r / inductance * 0.5 / 16000.0)
    current, voltage, currents = 0.0, 0.0, []
    for _ in range(200):
        currents.append(current)
        error = round((1.0 - current) / scales.i * 2**31)
        raw = core.lib.probe_pi(state, pointer, error, 0, 2**31 - 1)
        after = decay * current + (1.0 - decay) / r * voltage
        voltage = raw / 2**31 * scales.u_s
        current = decay * after + (1.0 - decay) / r * voltage
    model = it.current_loop("q").closed.simulate(np.ones((200, 1)))[:, 0]
    assert max(abs(model - np.array(currents))) < 1e-6
    assert max(currents) > 1.0 / math.e, "the current has risen"


def edge_times(
    shaft: Callable[[NDArray[np.float64]], NDArray[np.float64]], slope: float, spacing: float, end: float
) -> NDArray[np.float64]:
    """Times at which a rising shaft passes the multiples of `spacing`, by iteration with its mean speed."""
    places = spacing * np.arange(1, int(slope * end / spacing), dtype=np.float64)
    times = places / slope
    for _ in range(60):
        times = times - (shaft(times) - places) / slope
    return times


@pytest.mark.parametrize("speed", [200.0, 40.0, 10.0, 5.0, 2.5, 1.2])
def test_edge_delay_is_that_of_the_firmware(core: Core, speed: float) -> None:
    """Slow oscillation about a constant speed through the C of the M/T method; edges and ticks are not synchronous."""
    frequency, swing = 7.3, 0.1 * speed
    omega = 2.0 * math.pi * frequency

    def shaft(t: NDArray[np.float64]) -> NDArray[np.float64]:
        return speed * t + swing / omega * np.sin(omega * t)  # its speed oscillates as a cosine

    end = 7.5
    config = core.lib.probe_config().axis[0]
    mt, address = core.ffi.new("mt_speed_t *"), core.ffi.addressof
    core.lib.mt_speed_reset(mt)
    times = edge_times(shaft, speed, 2.0 * math.pi / 2000.0, end)
    ticks = TICK * np.arange(1, int(end / TICK))
    speeds = np.empty(ticks.size)
    last = -1.0
    for k, now in enumerate(ticks):
        first = int(np.searchsorted(times, now - TICK))
        if first < times.size and times[first] <= now:
            last = float(times[first])
            capture = ((2 * (first + 1)) % 4000, int(last * TIMER_CLOCK) & 0xFFFF)
            core.lib.mt_speed_edge(mt, address(config.mt_speed), address(config.encoder), capture)
        age = 0x10000 if last < 0.0 else int(now * TIMER_CLOCK) - int(last * TIMER_CLOCK)
        core.lib.mt_speed_slow(mt, age, True)
        speeds[k] = mt.speed / 2**31 * 5000.0 * math.pi / 30.0
    whole = slice(ticks.size - round(50 / frequency / TICK), None)
    kernel = np.exp(-1j * omega * ticks[whole])
    measured = 2.0 * np.mean((speeds[whole] - np.mean(speeds[whole])) * kernel) / swing
    expected = complex(edge_delay(1000.0, TICK, speed).response(np.array([omega]))[0])
    assert abs(measured / expected) == pytest.approx(1.0, abs=0.03)
    delay = -math.degrees(cmath.phase(measured)) / 360.0 / frequency
    expected_delay = -math.degrees(cmath.phase(expected)) / 360.0 / frequency
    assert delay == pytest.approx(expected_delay, abs=0.1 * expected_delay)


def test_edge_delay_grows_if_edges_are_rarer_than_ticks() -> None:
    delays = [edge_delay(1000.0, TICK, speed).delay for speed in (1e6, 2.0 * math.pi / 2000.0 / TICK, 1.0)]
    assert delays == pytest.approx([1.5 * TICK, TICK, 2.0 * math.pi / 2000.0], rel=1e-5)


def test_current_loop_is_an_integrator_with_one_period_of_delay() -> None:
    """Pole-zero cancellation, half a period until the duties are loaded and half a period in the mean of their hold."""
    loop = axis().current_loop("q").margins()
    assert loop.crossover is not None
    assert loop.crossover == pytest.approx(1000.0, rel=0.03)
    assert loop.phase == pytest.approx(90.0 - 360.0 * loop.crossover / 16000.0, abs=1.0)


@pytest.mark.parametrize(("bandwidth", "lag"), [(500.0, 9.46), (1000.0, 9.46), (1600.0, 4.0), (1778.0, 0.0)])
def test_the_integral_part_of_a_current_loop_is_as_fast_as_its_margin_permits(bandwidth: float, lag: float) -> None:
    """A winding with L / R = 10 ms: pole-zero cancellation would let dead time hold its current for long."""
    it = axis(axis1__motor__r_s=0.0512, axis1__control__current_bandwidth=bandwidth)
    delayed = 90.0 - 360.0 * bandwidth / 16000.0
    phase = it.current_loop("q").margins().phase
    assert phase == pytest.approx(delayed - lag, abs=2.0)
    q, omega = it.designed.current_q, 2.0 * math.pi * bandwidth
    corner = q.ki / q.kp * 16000.0
    assert corner == pytest.approx(max(omega * math.tan(math.radians(lag)), 100.0), rel=0.02)


def test_current_loop_with_rarer_samples_has_less_margin() -> None:
    fast = axis().current_loop("q")
    slow = CurrentLoop(fast.resistance, fast.inductance, fast.gains, 2.0 * fast.period)
    ahead, behind = fast.margins().phase, slow.margins().phase
    assert ahead is not None
    assert behind is not None
    assert behind < ahead - 10.0


@pytest.mark.parametrize("number", [1, 2])
def test_phase_margin_of_the_speed_loop_by_hand(number: int) -> None:
    """An integrator after the PI controller, the hold, the delay to the fast loop and the current loop.

    The proportional part sees the mean of the slow period before the last, the integral part that of the last one.
    """
    it = axis(number)
    loop = it.shaft().speed_margins()
    assert loop.crossover is not None
    w = 2.0 * math.pi * loop.crossover
    z = cmath.exp(1j * w * TICK)
    integral = it.used.speed.ki * z / (z - 1.0)
    controller = it.used.speed.kp * cmath.exp(-1.5j * w * TICK) + integral * cmath.exp(-0.5j * w * TICK)
    current = it.current_loop("q").closed.response(np.array([w]))[0]
    delay = 0.5 * TICK + 0.5 / 16000.0
    by_hand = 90.0 + math.degrees(cmath.phase(controller) + cmath.phase(current) - w * delay)
    assert loop.phase == pytest.approx(by_hand, abs=0.5)


# ---- E43..E45 -------------------------------------------------------------------------------------------------------


def test_design_rule_by_hand() -> None:
    """4000 rpm, 2 A at 0.0462 N m/A, inertia 0.8e-5 kg m^2 with and 1.6e-6 kg m^2 without the disc."""
    rule = assess(axis()).rule
    torque = 1.5 * 2 * 0.0154 * 2.0
    assert rule.t_n_rotor == pytest.approx(4000.0 * math.pi / 30.0 * 1.6e-6 / torque, rel=1e-4)  # E43
    assert rule.t_n_rotor == pytest.approx(7.3e-3, abs=0.1e-3)
    assert rule.t_n_shaft == pytest.approx(5.0 * rule.t_n_rotor)
    assert rule.k_p == pytest.approx(15.0 / (math.pi * rule.t_n_shaft))  # E45, rpm per rad
    assert rule.k_v_rule * rule.t_n_shaft == pytest.approx(0.5)  # E44: Kp (pi / 30) T_N
    assert rule.k_v == pytest.approx(60.0, rel=1e-5)
    assert rule.k_v_t == pytest.approx(rule.k_v * rule.t_n_tuned)


def second_order(k_v_t: float) -> float:
    """Overshoot of E44 closed, K_v / (s (T s + 1)): damping 1 / (2 sqrt(K_v T))."""
    damping = 0.5 / math.sqrt(k_v_t)
    return math.exp(-math.pi * damping / math.sqrt(1.0 - damping**2)) if damping < 1.0 else 0.0


def test_e45_overshoots_and_a_quarter_does_not() -> None:
    """K_v T = 1/2 of E45 gives damping 0.707 and 4 % overshoot (DRM 2.7.3 requires none); the tool uses 1/4."""
    assert second_order(0.5) == pytest.approx(0.043, abs=0.001)
    assert second_order(0.25) == 0.0
    dt, lag = 1e-5, 1e-3
    f = math.exp(-dt / lag)
    for k_v_t in (0.5, 0.25):
        a, b = np.array([[f, 0.0], [dt, 1.0]]), np.array([[(1.0 - f) * k_v_t / lag], [0.0]])
        loop = System(a, b, np.array([[0.0, 1.0]]), np.zeros((1, 1)), dt).fed_back(0, 0)
        overshoot = max(float(loop.simulate(np.ones((3000, 1))).max()) - 1.0, 0.0)
        assert overshoot == pytest.approx(second_order(k_v_t), abs=2e-3)


# ---- findings -------------------------------------------------------------------------------------------------------


def assessed(**changes: object) -> tuple[Tuned, Assessment, list[str]]:
    it = axis(1, **changes)
    figures = assess(it)
    return it, figures, list(map(str, findings(it, figures)))


def test_the_committed_axes_cause_no_warning() -> None:
    for number in (1, 2):
        it = axis(number)
        figures = assess(it)
        assert findings(it, figures) == []
        for loop in figures.loops:
            assert loop.margins.phase is not None
            assert loop.margins.phase >= 45.0
        assert figures.rule.k_v_t <= 0.25
        assert figures.arrival.bare == pytest.approx(0.0, abs=1e-6)
        assert figures.arrival.lag == pytest.approx(314.0 / 60.0, rel=1e-2)


FINDINGS = [
    case("axis1.control.speed_bandwidth = 100", "phase margin of 3"),
    case("axis1.control.speed_bandwidth = 125", "gain margin"),
    case("axis1.control.current_bandwidth = 2500", "current d loop has a phase margin"),
    case("axis1.motor.inertia = 8e-06", "0.5 times", axis1__control__speed_bandwidth=120.0),
    case("axis1.control.position_gain = 150", "K_v T = 0.3"),
    case("axis1.control.position_gain = 250", "without shaping"),
    case(
        "axis1.control.position_gain = 90",
        "a shaped move overshoots by",
        axis1__control__speed_bandwidth=20.0,
        axis1__motor__inertia=3e-6,
    ),
    case("axis1.limits.speed = 400", "386.4 rad/s", axis1__limits__over_speed=420.0),
    case("axis1.control.path_current_use = 0.99", "the limit is 4 A"),
    case("axis1.limits.acceleration = 25000", "4.33 A"),
    case(
        "axis1.control.speed_bandwidth (in [defaults.control]) = 75",
        "one count at this frequency requires 0.755 A, more than 0.5 A",
        axis1__motor__inertia=1e-4,
        axis1__limits__current=1.0,
        axis1__rotor_search__current=1.0,
    ),
    case(
        "axis1.control.current_bandwidth (in [defaults.control]) = 1000",
        "oscillate at 693 Hz; write 1387",
        axis1__motor__inertia=5e-7,
        axis1__motor__rotor_inertia=5e-7,
        axis1__motor__l_d=0.15e-3,
        axis1__motor__l_q=0.15e-3,
        axis1__control__path_current_use=0.1,
    ),
    # 80 Hz with 2 % damping, three times the inertia of the rotor
    case(
        "axis1.load.stiffness = 0.379",
        "resonates at 80 Hz, and the loops are unstable",
        axis1__load__inertia=6e-6,
        axis1__load__damping=0.02,
    ),
    case("axis1: position K_v = 0.001 1/s", "rounding", axis1__control__position_gain=0.001),
]


@pytest.mark.parametrize(("beginning", "reason", "changes"), FINDINGS)
def test_unfavourable_values_cause_a_warning(beginning: str, reason: str, changes: dict[str, object]) -> None:
    _, _, sentences = assessed(**changes)
    named = [sentence for sentence in sentences if sentence.startswith(beginning) and reason in sentence]
    assert len(named) >= 1, sentences
    assert all("; " in sentence for sentence in sentences), "every warning contains a remedy"


def sprung(frequency: float, ratio: float) -> dict[str, object]:
    """Entries of a load with this resonance [Hz] and inertia over that of the rotor, 2 % damping."""
    load = 8e-6 * ratio / (1.0 + ratio)
    stiffness = (2.0 * math.pi * frequency) ** 2 * load / (1.0 + ratio)
    return {"axis1__load__inertia": load, "axis1__load__stiffness": stiffness, "axis1__load__damping": 0.02}


@pytest.mark.parametrize(
    ("frequency", "ratio", "unstable"),
    [(80.0, 1.0, False), (150.0, 1.0, False), (80.0, 3.0, True), (300.0, 1.0, True), (300.0, 10.0, True)],
)
def test_a_load_on_a_spring_is_unstable_where_the_board_oscillates(
    frequency: float, ratio: float, unstable: bool
) -> None:
    """As measured with the firmware (firmware/doc/oscillation.md)."""
    _, _, sentences = assessed(**sprung(frequency, ratio))
    assert any("axis1.load.stiffness" in sentence for sentence in sentences) == unstable


@pytest.mark.parametrize(("frequency", "ratio"), [(80.0, 3.0), (150.0, 10.0), (300.0, 1.0), (300.0, 10.0)])
def test_bandwidths_named_for_a_load_on_a_spring_are_stable(frequency: float, ratio: float) -> None:
    entries = sprung(frequency, ratio)
    design, figures, _ = assessed(**entries)
    (remedy, *_) = next(one for one in findings(design, figures) if one.entry == "axis1.load.stiffness").remedies
    assert remedy.also is not None
    assert remedy.value is not None
    assert remedy.also.value is not None
    slower = {"axis1__control__speed_bandwidth": remedy.value, "axis1__control__position_gain": remedy.also.value}
    _, _, sentences = assessed(**entries, **slower)
    assert not any("axis1.load.stiffness" in sentence for sentence in sentences)
    for key in slower:
        slower[key] *= 0.5
    _, _, sentences = assessed(**entries, **slower)
    assert not any("axis1.load.stiffness" in sentence for sentence in sentences)


@pytest.mark.parametrize("index", range(2))
def test_the_smallest_swing_of_an_oscillation_is_that_of_the_firmware(core: Core, index: int) -> None:
    bench = Bench(core)
    bench.to_spin(index)
    swing = bench.axis(index).diagnosis.oscillation.swing_min * 8.25 / 2**15
    assert swing == pytest.approx(axis(index + 1).oscillation_swing, rel=1e-3)


def test_a_swing_that_the_current_limit_does_not_permit_causes_a_warning() -> None:
    _, _, coarse = assessed(axis1__encoder__lines=100)
    assert any("axis1.encoder.lines" in s and "will not find an oscillation" in s for s in coarse)
    _, _, fine = assessed()
    assert not any("will not find" in sentence for sentence in fine)


@pytest.mark.parametrize(
    ("feedback", "lines", "inertia", "changed"),
    [
        ("encoder", 500, 1e-5, {"encoder.lines": 1000}),
        ("encoder", 1000, 2.4e-5, {}),
        ("observer", 500, 2.4e-5, {"observer.speed_part": 0.3}),
    ],
)
def test_each_remedy_of_a_swing_above_the_limit_permits_one(
    feedback: str, lines: int, inertia: float, changed: dict[str, float]
) -> None:
    changes: dict[str, object] = {"axis1__feedback": feedback, "axis1__encoder__lines": lines}
    changes |= {"axis1__motor__inertia": inertia, "axis1__limits__acceleration": 200.0}
    changes |= {"axis1__limits__current": 1.0, "axis1__rotor_search__current": 1.0, "axis1__observer__speed_part": 1.0}

    def blind(**others: object) -> list[Problem]:
        design = axis(**{**changes, **others})
        return [one for one in findings(design, assess(design)) if "will not find an oscillation" in one.fact]

    (found,) = blind()
    assert {one.entry for one in found.remedies} == {f"axis1.{path}" for path in changed}
    assert found.entry == "axis1.limits.current"
    assert found.advice
    for path, value in {**changed, "limits.current": 2.0}.items():
        assert not blind(**{f"axis1__{path.replace('.', '__')}": value}), path


def test_a_very_stiff_spring_is_a_rigid_shaft() -> None:
    it = axis(**sprung(20000.0, 3.0))
    assert it.axis.load is not None
    flexible, rigid = it.sprung(it.axis.load), it.shaft()
    omega = 2.0 * math.pi * np.array([5.0, 50.0, 200.0])
    assert flexible.speed_open(omega) == pytest.approx(rigid.speed_open(omega), rel=1e-3)


def test_warnings_apply_to_the_enabled_speed_sensor() -> None:
    """With the speed observer the loop has a larger margin than with the age of the M/T method."""
    wide = {"axis1__control__speed_bandwidth": 100.0}
    _, with_mt, warned = assessed(**wide)
    _, with_observer, quiet = assessed(**wide, axis1__features__speed_observer=True)
    assert any("speed loop" in sentence for sentence in warned)
    assert not any("speed loop" in sentence or "speed, observer loop" in sentence for sentence in quiet)
    assert with_mt.loops[2].margins == with_observer.loops[2].margins
    assert [loop.in_force for loop in with_mt.loops] == [True, True, True, True, False, False]
    assert [loop.in_force for loop in with_observer.loops] == [True, True, False, False, True, True]


def test_a_current_loop_too_slow_for_the_back_emf_is_the_first_remedy_of_an_unstable_shaft() -> None:
    """Outer loops that are slowed down would remain slow when the warning then asks for a faster current loop."""
    error = refusal_of(
        table(
            axis1__motor__psi_m=0.05,
            axis1__motor__inertia=5e-7,
            axis1__motor__rotor_inertia=5e-7,
            axis1__motor__l_d=0.1e-3,
            axis1__motor__l_q=0.1e-3,
            axis1__limits__speed=50.0,
            axis1__control__path_current_use=0.002,
        )
    )
    assert error is not None
    assert error.remedies[0] == exactly("axis1.control.current_bandwidth", 1778.0)


@pytest.mark.parametrize("bandwidth", [75.0, 5.0])
def test_back_calculation_is_not_much_faster_than_the_integral_part(bandwidth: float) -> None:
    """A saturated sample moves the integral part by Kc times the excess, which decays in the integral time."""
    design = axis(
        axis1__control__speed_bandwidth=bandwidth,
        axis1__control__position_gain=4.0,
        axis1__control__current_bandwidth=300.0,
        axis1__motor__l_q=4e-3,
        axis1__rotor_search__current=0.8,
    )
    used = design.used
    assert used.speed.kc == pytest.approx(min(0.5, 11.0 * used.speed.ki / used.speed.kp), rel=1e-4)
    assert used.current_q.kc == pytest.approx(11.0 * used.current_q.ki / used.current_q.kp, rel=1e-3)
    assert used.current_d.kc == 0.5


def test_a_stiffer_loop_has_a_smaller_deflection() -> None:
    soft, stiff = (assessed(axis1__control__position_gain=gain)[1].load_step for gain in (30.0, 100.0))
    assert stiff.stiffness > soft.stiffness
    assert stiff.deflection < soft.deflection
    assert stiff.recovery < soft.recovery


def test_integers_give_the_designed_gains_back() -> None:
    for number in (1, 2):
        for row in axis(number).rows():
            assert row.used == pytest.approx(row.designed, rel=2e-4), row.name


def test_the_window_of_a_mean_is_a_sinc() -> None:
    whole = EdgeDelay(window=1e-3, delay=0.0).response(np.array([1e-6, 2.0 * math.pi * 500.0, 2.0 * math.pi * 1000.0]))
    assert whole == pytest.approx([1.0, 2.0 / math.pi, 0.0], abs=1e-9)


def test_all_axes_are_tuned() -> None:
    assert [axis_.name for axis_ in configuration().axes] == ["axis1", "axis2"]
