#include "recorder.h"

#include <stdlib.h>

#include "app/servo.h"
#include "app/variables.h"
#include "digest.h"
#include "trace.h"

#define CODE_MAX 4095U

/* A growing vector. */
typedef struct {
    uint8_t *byte;
    size_t size;
    size_t room;
} bytes_t;

typedef struct {
    bool running;
    bool in_call;
    const char *problem;
    uint32_t check_every;
    uint32_t disturb; /* one read in this number is disturbed */
    uint16_t disturbed_axes;
    uint64_t random;
    bool index_lost;
    uint16_t index_seen[HAL_AXES];
    uint16_t index_passed[HAL_AXES]; /* index count while pulses are lost */
    trace_call_t call;
    out_log_t out;
    bytes_t image;
    digest_t digest;
    bytes_t log;
    uint32_t *check;
    size_t checks;
    size_t check_room;
} run_recorder_t;

static run_recorder_t recorder;

/* ---- memory ----------------------------------------------------------------------------------------------------- */

static void *grown(void *memory, size_t count, size_t size, size_t *room)
{
    if (count < *room) {
        return memory;
    }
    const size_t more = 2 * *room + 1024;
    void *larger = realloc(memory, more * size);
    if (larger == NULL) {
        recorder.problem = "out of memory";
        return NULL;
    }
    *room = more;
    return larger;
}

static void put_byte(bytes_t *bytes, uint32_t byte)
{
    uint8_t *memory = (uint8_t *)grown(bytes->byte, bytes->size, sizeof *memory, &bytes->room);
    if (memory != NULL) {
        bytes->byte = memory;
        bytes->byte[bytes->size++] = (uint8_t)byte;
    }
}

static void put_word(bytes_t *bytes, uint32_t word)
{
    put_byte(bytes, word);
    put_byte(bytes, word >> 8);
}

static void put_long(bytes_t *bytes, uint32_t value)
{
    put_word(bytes, value);
    put_word(bytes, value >> 16);
}

/* trace.h */
static void record_call(void)
{
    put_byte(&recorder.image, (uint32_t)recorder.call.call);
    put_byte(&recorder.image, recorder.call.axis);
    put_byte(&recorder.image, recorder.call.size);
    for (uint16_t i = 0; i < recorder.call.size; i++) {
        put_word(&recorder.image, recorder.call.in[i]);
    }
}

/* ---- control ---------------------------------------------------------------------------------------------------- */

void record_begin(uint32_t check_every)
{
    free(recorder.image.byte);
    free(recorder.check);
    free(recorder.log.byte);
    recorder = (run_recorder_t){.check_every = check_every};
    put_long(&recorder.image, TRACE_NAME);
    put_long(&recorder.image, check_every);
    put_long(&recorder.image, UINT32_MAX); /* print nothing */
    put_long(&recorder.image, 0);
    if (!digest_init(&recorder.digest)) {
        recorder.problem = "too many scalars in the snapshot";
    }
    recorder.running = true;
}

bool record_end(void)
{
    recorder.running = false;
    recorder.call = (trace_call_t){.call = CALL_END};
    record_call();
    return recorder.problem == NULL;
}

void record_disturb(uint16_t axes, uint32_t one_in, uint32_t seed)
{
    recorder.disturb = one_in;
    recorder.disturbed_axes = axes;
    recorder.random = seed;
}

void record_lose_index(bool lost) { recorder.index_lost = lost; }

const char *record_problem(void) { return (recorder.problem != NULL) ? recorder.problem : ""; }
size_t record_size(void) { return recorder.image.size; }
const uint8_t *record_bytes(void) { return recorder.image.byte; }
uint32_t record_periods(void) { return recorder.digest.periods; }
uint32_t record_digest(void) { return recorder.digest.value; }
size_t record_checks(void) { return recorder.checks; }
const uint32_t *record_check_values(void) { return recorder.check; }
size_t record_log_size(void) { return recorder.log.size; }
const uint8_t *record_log(void) { return recorder.log.byte; }

/* ---- disturbance ------------------------------------------------------------------------------------------------ */

/* splitmix64 */
static uint32_t random32(void)
{
    recorder.random += UINT64_C(0x9E3779B97F4A7C15);
    uint64_t z = recorder.random;
    z = (z ^ (z >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    z = (z ^ (z >> 27)) * UINT64_C(0x94D049BB133111EB);
    return (uint32_t)((z ^ (z >> 31)) >> 32);
}

static bool disturbed(uint16_t axes)
{
    return recorder.running && recorder.disturb != 0U && (recorder.disturbed_axes & axes) != 0U &&
           random32() % recorder.disturb == 0U;
}

static uint16_t axis_bit(uint16_t axis) { return (uint16_t)(1U << axis); }

static uint16_t code_of(uint16_t axis, uint16_t code)
{
    if (!disturbed(axis_bit(axis))) {
        return code;
    }
    const uint32_t random = random32();
    return ((random >> 16) % 4U == 0U) ? (uint16_t)((random & 1U) * CODE_MAX) : (uint16_t)(random & CODE_MAX);
}

/* The mean is unchanged, otherwise faults of the bus would end the run. */
static uint16_t bus_code_of(uint16_t code)
{
    if (!disturbed(UINT16_MAX)) {
        return code;
    }
    const uint32_t random = code / 2U + random32() % (code + 1U);
    return (uint16_t)((random < CODE_MAX) ? random : CODE_MAX);
}

/* ---- words and calls -------------------------------------------------------------------------------------------- */

static void in(uint32_t word)
{
    if (!recorder.running) {
        return;
    }
    if (!recorder.in_call) {
        recorder.problem = "the board was read outside of an entry point";
    } else if (recorder.call.size >= EXCHANGE_IN_MAX) {
        recorder.problem = "one call read more than EXCHANGE_IN_MAX words";
    } else {
        recorder.call.in[recorder.call.size++] = (uint16_t)word;
    }
}

static void out1(out_t operation, uint16_t axis, uint16_t word)
{
    out_head(&recorder.out, operation, axis);
    out_word(&recorder.out, word);
}

static void log_call(uint32_t period, const servo_t *servo, bool fresh)
{
    put_long(&recorder.log, period);
    put_word(&recorder.log, (uint32_t)recorder.call.call);
    put_word(&recorder.log, recorder.call.axis);
    put_word(&recorder.log, recorder.out.size);
    for (uint16_t i = 0; i < recorder.out.size; i++) {
        put_word(&recorder.log, recorder.out.word[i]);
    }
    const size_t count_at = recorder.log.size;
    uint16_t count = 0;
    put_word(&recorder.log, count);
    for (uint16_t i = 0; fresh && i < servo_variables.entries; i++) {
        uint32_t value;
        if (digest_snapshot_field(servo, i, &value)) {
            put_word(&recorder.log, i);
            put_long(&recorder.log, value);
            count++;
        }
    }
    if (recorder.problem == NULL) {
        recorder.log.byte[count_at] = (uint8_t)count;
        recorder.log.byte[count_at + 1U] = (uint8_t)(count >> 8);
    }
}

static void keep_check(void)
{
    uint32_t *check = (uint32_t *)grown(recorder.check, recorder.checks, sizeof *check, &recorder.check_room);
    recorder.check = (check != NULL) ? check : recorder.check;
    if (check != NULL) {
        recorder.check[recorder.checks] = recorder.digest.value;
        recorder.checks++;
    }
}

static void begin(call_t call, uint16_t axis)
{
    if (recorder.in_call) {
        recorder.problem = "an entry point was called within another";
    }
    recorder.call.call = call;
    recorder.call.axis = axis;
    recorder.call.size = 0;
    recorder.out.size = 0;
    recorder.in_call = true;
}

static void end(const servo_t *servo)
{
    recorder.in_call = false;
    if (!recorder.running) {
        return;
    }
    if (recorder.out.size > EXCHANGE_OUT_MAX) {
        recorder.problem = "one call wrote more than EXCHANGE_OUT_MAX words";
        return;
    }
    record_call();
    const uint32_t period = recorder.digest.periods;
    log_call(period, servo, servo->snapshot.tick != recorder.digest.tick);
    digest_call(&recorder.digest, recorder.call.call, recorder.call.axis, 0, 0, &recorder.out, servo);
    if (recorder.digest.periods != period && recorder.digest.periods % recorder.check_every == 0U) {
        keep_check();
    }
}

/* ---- entry points ----------------------------------------------------------------------------------------------- */

/* Linker option --wrap: a call of NAME is a call of __wrap_NAME; the original is __real_NAME. */
void __real_servo_init(servo_t *servo, hal_t *hal, const servo_config_t *config);
void __real_servo_m1_isr(servo_t *servo);
void __real_servo_m2_isr(servo_t *servo);
void __real_servo_background(servo_t *servo);
void __real_servo_edge_isr(servo_t *servo, uint16_t axis);
void __real_servo_over_current_isr(servo_t *servo, uint16_t axis);
adc_pair_t __real_hal_adc_currents(hal_t *hal, uint16_t axis);
adc_pair_t __real_hal_adc_offsets(hal_t *hal, uint16_t axis);
uint16_t __real_hal_adc_bus(hal_t *hal);
bool __real_hal_over_current_active(hal_t *hal, uint16_t axis);
uint16_t __real_hal_encoder_count(hal_t *hal, uint16_t axis);
uint16_t __real_hal_index_count(hal_t *hal, uint16_t axis);
bool __real_hal_capture_take(hal_t *hal, uint16_t axis, edge_capture_t *capture);
uint32_t __real_hal_edge_age(hal_t *hal, uint16_t axis);
bool __real_hal_serial_get(hal_t *hal, uint8_t *byte);
void __real_hal_adc_select(hal_t *hal, uint16_t axis, phase_pair_t pair);
void __real_hal_pwm_duty(hal_t *hal, uint16_t axis, int16_t duty_a, int16_t duty_b, int16_t duty_c);
void __real_hal_pwm_enable(hal_t *hal, uint16_t axis, bool on);
void __real_hal_over_current_clear(hal_t *hal, uint16_t axis);
void __real_hal_encoder_start(hal_t *hal, uint16_t axis, uint16_t period);
void __real_hal_encoder_preset(hal_t *hal, uint16_t axis, uint16_t count);
void __real_hal_capture_arm(hal_t *hal, uint16_t axis);
bool __real_hal_serial_put(hal_t *hal, uint8_t byte);
void __real_hal_watchdog_service(hal_t *hal);
void __real_hal_duties_done(hal_t *hal, uint16_t axis);
uint16_t __real_hal_adc_temperature(hal_t *hal, uint16_t axis);
bool __real_hal_reset_by_watchdog(hal_t *hal);
uint16_t __real_hal_late_loops(hal_t *hal);
uint16_t __real_hal_receiver_overruns(hal_t *hal);
void __real_hal_brake_resistor(hal_t *hal, bool on);
uint16_t __real_hal_inputs(hal_t *hal, uint16_t axis);
void __real_hal_enable_input(hal_t *hal, uint16_t axis, bool used);
void __real_hal_holding_brake(hal_t *hal, uint16_t axis, bool release);
void __real_hal_analog_out(hal_t *hal, uint16_t channel, uint16_t value);
bool __real_hal_flash_present(hal_t *hal);
uint32_t __real_hal_flash_read(hal_t *hal, uint16_t word);
void __real_hal_flash_erase(hal_t *hal, uint16_t sector);
void __real_hal_flash_program(hal_t *hal, uint16_t word, uint32_t value);
hal_flash_t __real_hal_flash_result(hal_t *hal);

void __wrap_servo_init(servo_t *servo, hal_t *hal, const servo_config_t *config)
{
    begin(CALL_INIT, 0);
    __real_servo_init(servo, hal, config);
    end(servo);
}

void __wrap_servo_m1_isr(servo_t *servo)
{
    begin(CALL_M1, 0);
    __real_servo_m1_isr(servo);
    end(servo);
}

void __wrap_servo_m2_isr(servo_t *servo)
{
    begin(CALL_M2, 0);
    __real_servo_m2_isr(servo);
    end(servo);
}

void __wrap_servo_background(servo_t *servo)
{
    begin(CALL_BACKGROUND, 0);
    __real_servo_background(servo);
    end(servo);
}

void __wrap_servo_edge_isr(servo_t *servo, uint16_t axis)
{
    begin(CALL_EDGE, axis);
    __real_servo_edge_isr(servo, axis);
    end(servo);
}

void __wrap_servo_over_current_isr(servo_t *servo, uint16_t axis)
{
    begin(CALL_OVER_CURRENT, axis);
    __real_servo_over_current_isr(servo, axis);
    end(servo);
}

/* ---- inputs ----------------------------------------------------------------------------------------------------- */

static adc_pair_t pair_in(uint16_t axis, adc_pair_t codes)
{
    codes.first = code_of(axis, codes.first);
    codes.second = code_of(axis, codes.second);
    in(codes.first);
    in(codes.second);
    return codes;
}

adc_pair_t __wrap_hal_adc_currents(hal_t *hal, uint16_t axis)
{
    return pair_in(axis, __real_hal_adc_currents(hal, axis));
}

adc_pair_t __wrap_hal_adc_offsets(hal_t *hal, uint16_t axis)
{
    return pair_in(axis, __real_hal_adc_offsets(hal, axis));
}

uint16_t __wrap_hal_adc_bus(hal_t *hal)
{
    const uint16_t code = bus_code_of(__real_hal_adc_bus(hal));
    in(code);
    return code;
}

uint16_t __wrap_hal_adc_temperature(hal_t *hal, uint16_t axis)
{
    const uint16_t code = __real_hal_adc_temperature(hal, axis);
    in(code);
    return code;
}

uint16_t __wrap_hal_inputs(hal_t *hal, uint16_t axis)
{
    const uint16_t inputs = __real_hal_inputs(hal, axis);
    in(inputs);
    return inputs;
}

uint16_t __wrap_hal_late_loops(hal_t *hal)
{
    const uint16_t loops = __real_hal_late_loops(hal);
    in(loops);
    return loops;
}

uint16_t __wrap_hal_receiver_overruns(hal_t *hal)
{
    const uint16_t overruns = __real_hal_receiver_overruns(hal);
    in(overruns);
    return overruns;
}

bool __wrap_hal_reset_by_watchdog(hal_t *hal)
{
    const bool watchdog_reset = __real_hal_reset_by_watchdog(hal);
    in(watchdog_reset);
    return watchdog_reset;
}

bool __wrap_hal_over_current_active(hal_t *hal, uint16_t axis)
{
    const bool active = __real_hal_over_current_active(hal, axis);
    in(active);
    return active;
}

uint16_t __wrap_hal_encoder_count(hal_t *hal, uint16_t axis)
{
    const uint16_t count = __real_hal_encoder_count(hal, axis);
    in(count);
    return count;
}

uint16_t __wrap_hal_index_count(hal_t *hal, uint16_t axis)
{
    const uint16_t count = __real_hal_index_count(hal, axis);
    if (recorder.index_lost) {
        recorder.index_passed[axis] = (uint16_t)(count - recorder.index_seen[axis]);
    } else {
        recorder.index_seen[axis] = (uint16_t)(count - recorder.index_passed[axis]);
    }
    in(recorder.index_seen[axis]);
    return recorder.index_seen[axis];
}

bool __wrap_hal_capture_take(hal_t *hal, uint16_t axis, edge_capture_t *capture)
{
    const bool taken = __real_hal_capture_take(hal, axis, capture);
    in(taken);
    if (taken) {
        if (disturbed(axis_bit(axis))) {
            capture->count = (uint16_t)(random32() % 7999U - 3999U);
            capture->time = (uint16_t)random32();
        }
        in(capture->count);
        in(capture->time);
    }
    return taken;
}

uint32_t __wrap_hal_edge_age(hal_t *hal, uint16_t axis)
{
    uint32_t age = __real_hal_edge_age(hal, axis);
    if (disturbed(axis_bit(axis))) {
        age = random32() % (HAL_EDGE_AGE_OVERFLOW + 1U);
    }
    in(age & 0xFFFFU);
    in(age >> 16);
    return age;
}

bool __wrap_hal_serial_get(hal_t *hal, uint8_t *byte)
{
    const bool there = __real_hal_serial_get(hal, byte);
    in(there);
    if (there) {
        in(*byte);
    }
    return there;
}

bool __wrap_hal_flash_present(hal_t *hal) { return __real_hal_flash_present(hal); }

/* The replay has its own data flash, which also begins erased, so reads need not be recorded. */
uint32_t __wrap_hal_flash_read(hal_t *hal, uint16_t word) { return __real_hal_flash_read(hal, word); }

hal_flash_t __wrap_hal_flash_result(hal_t *hal)
{
    const hal_flash_t result = __real_hal_flash_result(hal);
    in((uint32_t)result);
    return result;
}

/* ---- outputs ---------------------------------------------------------------------------------------------------- */

void __wrap_hal_adc_select(hal_t *hal, uint16_t axis, phase_pair_t pair)
{
    out1(OUT_SELECT, axis, (uint16_t)pair);
    __real_hal_adc_select(hal, axis, pair);
}

void __wrap_hal_pwm_duty(hal_t *hal, uint16_t axis, int16_t duty_a, int16_t duty_b, int16_t duty_c)
{
    out1(OUT_DUTY, axis, (uint16_t)duty_a);
    out_word(&recorder.out, (uint16_t)duty_b);
    out_word(&recorder.out, (uint16_t)duty_c);
    __real_hal_pwm_duty(hal, axis, duty_a, duty_b, duty_c);
}

void __wrap_hal_pwm_enable(hal_t *hal, uint16_t axis, bool on)
{
    out1(OUT_ENABLE, axis, on);
    __real_hal_pwm_enable(hal, axis, on);
}

void __wrap_hal_over_current_clear(hal_t *hal, uint16_t axis)
{
    out_head(&recorder.out, OUT_OVER_CURRENT_CLEAR, axis);
    __real_hal_over_current_clear(hal, axis);
}

void __wrap_hal_encoder_start(hal_t *hal, uint16_t axis, uint16_t period)
{
    out1(OUT_ENCODER_START, axis, period);
    __real_hal_encoder_start(hal, axis, period);
}

void __wrap_hal_encoder_preset(hal_t *hal, uint16_t axis, uint16_t count)
{
    out1(OUT_PRESET, axis, count);
    __real_hal_encoder_preset(hal, axis, count);
}

void __wrap_hal_capture_arm(hal_t *hal, uint16_t axis)
{
    out_head(&recorder.out, OUT_ARM, axis);
    __real_hal_capture_arm(hal, axis);
}

bool __wrap_hal_serial_put(hal_t *hal, uint8_t byte)
{
    out1(OUT_SERIAL, 0, byte);
    const bool taken = __real_hal_serial_put(hal, byte);
    in(taken);
    return taken;
}

void __wrap_hal_brake_resistor(hal_t *hal, bool on)
{
    out1(OUT_BRAKE, 0, on);
    __real_hal_brake_resistor(hal, on);
}

void __wrap_hal_enable_input(hal_t *hal, uint16_t axis, bool used)
{
    out1(OUT_ENABLE_INPUT, axis, used);
    __real_hal_enable_input(hal, axis, used);
}

void __wrap_hal_holding_brake(hal_t *hal, uint16_t axis, bool release)
{
    out1(OUT_HOLDING, axis, release);
    __real_hal_holding_brake(hal, axis, release);
}

void __wrap_hal_analog_out(hal_t *hal, uint16_t channel, uint16_t value)
{
    out1(OUT_MONITOR, channel, value);
    __real_hal_analog_out(hal, channel, value);
}

void __wrap_hal_duties_done(hal_t *hal, uint16_t axis)
{
    out_head(&recorder.out, OUT_DONE, axis);
    __real_hal_duties_done(hal, axis);
}

void __wrap_hal_flash_erase(hal_t *hal, uint16_t sector)
{
    out1(OUT_ERASE, 0, sector);
    __real_hal_flash_erase(hal, sector);
}

void __wrap_hal_flash_program(hal_t *hal, uint16_t word, uint32_t value)
{
    out1(OUT_PROGRAM, 0, word);
    out_word(&recorder.out, (uint16_t)value);
    out_word(&recorder.out, (uint16_t)(value >> 16));
    __real_hal_flash_program(hal, word, value);
}

void __wrap_hal_watchdog_service(hal_t *hal)
{
    out_head(&recorder.out, OUT_WATCHDOG, 0);
    __real_hal_watchdog_service(hal);
}
