"""Build C parts of the virtual board for the tests, and describe them to Python."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from cffi import FFI
from servo_twin.plant import AxisPlant, BusPlant, PlantConfig

NATIVE = Path(__file__).resolve().parents[1] / "native"

HALF_NS = 31_250
"""Half a PWM period [ns]."""


class Native(NamedTuple):
    """A compiled library and the means to make objects for it."""

    ffi: FFI
    lib: Any


# cffi asks the compiler for everything that the dots leave open.
PLANT_CDEF = """
typedef struct { ...; } plant_random_t;
typedef struct { double alpha, beta; } plant_vector_t;
typedef struct {
    double r_s, l_d, l_q, psi_m, pole_pairs, inertia, friction, viscous;
    double load_inertia, shaft_stiffness, shaft_damping, backlash, load_friction;
    double cogging_torque, cogging_periods, cogging_phase;
    double i_saturation_d, i_saturation_q, winding_warms, magnet_coefficient, magnet_time;
    double disc_eccentricity, disc_phase, load_torque;
    double stop_min, stop_max, stop_stiffness, stop_damping, encoder_lines, theta_start, i_full_scale;
    double i_offset[3], i_noise, i_break, dead_time, v_drop, r_on, dead_time_min, i_settle;
    double encoder_jitter, encoder_duty_error, encoder_hysteresis;
    double winding_capacity, winding_resistance, sink_capacity, sink_resistance;
    double home_from, home_to, limit_min, limit_max, enable_closed, brake_torque, brake_open_time, brake_close_time;
} plant_axis_t;
typedef struct {
    double u_source, r_source, capacitance, u_full_scale, u_noise, r_brake, brake_capacity, brake_resistance;
} plant_bus_t;
typedef struct {
    plant_axis_t axis[2]; plant_bus_t bus; double pwm_frequency, ambient, baud; uint64_t seed; ...;
} board_config_t;

typedef struct {
    double r, load, i_d, i_q, omega, theta, sine, cosine, phase[3]; bool locked; ...;
} plant_motor_t;
void plant_motor_init(plant_motor_t *motor, const plant_axis_t *config);
double plant_motor_step(plant_motor_t *motor, plant_vector_t u, double dt);
double plant_motor_coast(plant_motor_t *motor, double dt);
void plant_motor_set_phases(plant_motor_t *motor, double i_a, double i_b);
void plant_motor_lock(plant_motor_t *motor, bool locked);
double plant_motor_torque(const plant_motor_t *motor);

typedef struct { bool on; double leg[3], share[3], heat; ...; } averaged_inverter_t;
void averaged_inverter_init(averaged_inverter_t *inverter, const plant_axis_t *config, double frequency, double step);
void averaged_inverter_load(averaged_inverter_t *inverter, const double duty[3], double u_dc);
double averaged_inverter_step(averaged_inverter_t *inverter, plant_motor_t *motor, double u, double dt, double *charge);
void averaged_inverter_open(averaged_inverter_t *inverter, plant_motor_t *motor, int phase, bool open);
void averaged_inverter_short(averaged_inverter_t *inverter, int phase, int to);
bool averaged_inverter_shorted(const averaged_inverter_t *inverter);
double averaged_inverter_shunt(const averaged_inverter_t *inverter, const plant_motor_t *motor, int phase, bool low);

typedef struct { double u_source, u, e_source, e_brake; ...; } supply_t;
void supply_init(supply_t *supply, const plant_bus_t *config, double ambient);
double supply_advance(supply_t *supply, double h, double i_load);
void supply_set(supply_t *supply, double volts);
void supply_dip(supply_t *supply, double volts, double seconds);
void supply_recover(supply_t *supply);

typedef struct { uint16_t count, index; bool oflag, armed, latched; int64_t edge; ...; } plant_encoder_t;
typedef struct { double theta_0, theta_1, omega_0, omega_1, start_ns, duration_ns; } plant_movement_t;
void plant_encoder_init(plant_encoder_t *encoder, const plant_axis_t *config);
void plant_encoder_move(plant_encoder_t *encoder, const plant_movement_t *movement, uint64_t reference_ns);
void plant_encoder_count(plant_encoder_t *encoder, double theta);
void plant_encoder_connect(plant_encoder_t *encoder, bool connected, double theta);
void plant_encoder_stick(plant_encoder_t *encoder, int line, bool stuck, bool level);
void plant_encoder_glitch(plant_encoder_t *encoder, int line, uint64_t now_ns);
void plant_encoder_reverse(plant_encoder_t *encoder, double theta);
void plant_encoder_arm(plant_encoder_t *encoder);
bool plant_encoder_take(plant_encoder_t *encoder, uint16_t *count, uint16_t *time);
uint32_t plant_encoder_age(const plant_encoder_t *encoder, uint64_t now_ns);

void plant_random_init(plant_random_t *random, uint64_t seed, uint64_t stream);
double plant_random_gauss(plant_random_t *random);
uint16_t plant_code(double code);
uint16_t plant_code_unipolar(double value, double full_scale);

typedef struct { averaged_inverter_t inverter; plant_motor_t motor; plant_encoder_t encoder; ...; } plant_drive_t;
typedef struct { plant_drive_t axis[2]; supply_t bus; uint64_t step_ns; ...; } plant_t;
void plant_init(plant_t *plant, const board_config_t *config);
void plant_step(plant_t *plant, uint64_t now_ns);
typedef struct { ...; } plant_samples_t;
void plant_sample(plant_t *plant, int axis, const int phase[2], bool low_side_centre, plant_samples_t *samples);
void plant_sample_codes(const plant_t *plant, int axis, const plant_samples_t *samples, uint16_t code[2]);
uint16_t plant_bus_code(plant_t *plant);
"""

CHIP_CDEF = """
typedef struct { uint16_t first, second; } adc_pair_t;
typedef struct { uint16_t count, time; } edge_capture_t;
typedef struct { bool enabled, broken; ...; } chip_axis_t;
typedef struct { uint32_t overruns, tx_lost; ...; } uart_t;
struct hal { plant_t plant; uart_t uart; chip_axis_t axis[2]; uint64_t now_ns; uint32_t breaks; ...; };
typedef struct hal hal_t;
typedef struct { uint64_t time_ns; int kind, axis; adc_pair_t currents, offsets; uint16_t bus; } fake_call_t;
typedef struct {
    hal_t *hal; fake_call_t call[4096]; int calls; bool log_background, deaf, echo; int16_t duty[2][3]; bool on[2];
    edge_capture_t capture; ...;
} servo_t;
void chip_init(hal_t *chip, const board_config_t *config, servo_t *servo);
bool chip_run(hal_t *chip, uint64_t until_ns, bool stop_after_scan);
bool hal_break_active(hal_t *hal, uint16_t axis);
void hal_break_clear(hal_t *hal, uint16_t axis);
uint16_t hal_inputs(hal_t *hal, uint16_t axis);
void hal_enable_input(hal_t *hal, uint16_t axis, bool used);
void hal_holding_brake(hal_t *hal, uint16_t axis, bool release);
void hal_capture_arm(hal_t *hal, uint16_t axis);
bool hal_capture_take(hal_t *hal, uint16_t axis, edge_capture_t *capture);
uint32_t hal_edge_age(hal_t *hal, uint16_t axis);
uint16_t hal_encoder_count(hal_t *hal, uint16_t axis);
void hal_encoder_preset(hal_t *hal, uint16_t axis, uint16_t count);
size_t uart_host_write(uart_t *uart, const uint8_t *data, size_t size, uint64_t now_ns);
size_t uart_host_read(uart_t *uart, uint8_t *data, size_t room);
uint64_t uart_next_ns(const uart_t *uart);
"""


def compile_c(
    folder: Path,
    name: str,
    cdef: str,
    preamble: str,
    sources: Sequence[Path],
    include: Sequence[Path] = (NATIVE,),
    defines: Sequence[str] = (),
) -> Native:
    """Compile C files into a module in `folder`."""
    builder = FFI()
    builder.cdef(cdef)
    builder.set_source(
        name,
        preamble,
        sources=[str(path) for path in sources],
        include_dirs=[str(path) for path in include],
        libraries=["m"],
        define_macros=[(macro, None) for macro in defines],
        extra_compile_args=["-std=c99", "-O1", "-ffp-contract=off", "-Wno-psabi"],
    )
    spec = importlib.util.spec_from_file_location(name, builder.compile(tmpdir=str(folder)))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return Native(module.ffi, module.lib)


def build(
    folder: Path,
    name: str,
    cdef: str,
    preamble: str,
    include: Sequence[Path],
    sources: Sequence[Path],
    defines: Sequence[str] = (),
) -> Native:
    """Compile the plant and more C files into a module of their own in `folder`."""
    return compile_c(
        folder, name, cdef, preamble, [*sorted((NATIVE / "plant").glob("*.c")), *sources], include, defines
    )


def c_axis(native: Native, axis: AxisPlant) -> Any:
    """``plant_axis_t *`` of one axis."""
    start = 0.35 if axis.theta_start == "random" else axis.theta_start
    return native.ffi.new("plant_axis_t *", {**axis.members(), "theta_start": start})


def c_bus(native: Native, bus: BusPlant) -> Any:
    """``plant_bus_t *`` of a bus."""
    return native.ffi.new("plant_bus_t *", dict(vars(bus)))


def c_config(native: Native, plant: PlantConfig, seed: int = 0, baud: float = 115200.0) -> Any:
    """``board_config_t *`` of a plant."""
    config = native.ffi.new("board_config_t *")
    plant.drawn(seed).fill(config)
    config.baud, config.seed = baud, seed
    return config


def plain(plant: PlantConfig | None = None, **axis: Any) -> PlantConfig:
    """Plant with an ideal inverter, ideal sensors and no friction, to which a test adds what it is about."""
    plant = plant or PlantConfig.load()
    ideal = {
        "dead_time": 0.0, "v_drop": 0.0, "r_on": 0.0, "friction": 0.0, "viscous": 0.0, "i_noise": 0.0,
        "i_offset": (0.0, 0.0, 0.0), "i_break": 1e9, "theta_start": 0.0,
    }  # fmt: skip
    for index in range(2):
        plant = plant.with_axis(index, **{**ideal, **axis})
    return plant.with_bus(u_noise=0.0)
