#include "arithmetic.h"

#include <string.h>

#include "app/event_log.h"
#include "comm/access.h"
#include "comm/sha1.h"
#include "config/servo_config.h"
#include "control/current_loop.h"
#include "control/field_weakening.h"
#include "control/friction.h"
#include "control/path_filter.h"
#include "diagnosis/winding_model.h"
#include "digest.h"
#include "drive/current_sense.h"
#include "math/root.h"
#include "math/trig.h"
#include "sensing/encoder.h"
#include "sensing/mt_speed.h"
#include "sensing/rotor_search.h"
#include "sensing/speed_observer.h"

/* Steps of a function with a state in one round. */
#define STEPS 16

/* Each takes up to six hashes. */
#define LOGINS 4

typedef struct {
    uint32_t random;
    uint32_t value;
} run_t;

/* ---- numbers: drawn one by one, as C does not define the order of arguments ------------------------------------- */

static uint32_t draw(run_t *run)
{
    uint32_t x = run->random;
    x ^= x << 13;
    x ^= x >> 17;
    x ^= x << 5;
    run->random = x;
    return x;
}

/* Every fourth number is at the ends or in the middle of the range, the others have any magnitude. */
static int32_t draw32(run_t *run)
{
    static const int32_t special[8] = {0,     1, -1, INT32_MAX, -INT32_MAX - 1, INT32_C(0x40000000), INT32_C(0x8000),
                                       0x7FFF};
    const uint32_t kind = draw(run);
    if ((kind & 3U) == 0U) {
        return special[(kind >> 2) & 7U];
    }
    return asr32((int32_t)draw(run), (unsigned)((kind >> 2) % 31U));
}

static int16_t draw16(run_t *run)
{
    static const int16_t special[8] = {0, 1, -1, INT16_MAX, -INT16_MAX - 1, 0x4000, -0x4000, 0x2000};
    const uint32_t kind = draw(run);
    if ((kind & 3U) == 0U) {
        return special[(kind >> 2) & 7U];
    }
    return (int16_t)asr32((int32_t)draw(run), (unsigned)(16U + ((kind >> 2) & 7U)));
}

/* Not negative. */
static int16_t draw_limit16(run_t *run) { return (int16_t)(draw16(run) & INT16_MAX); }
static int32_t draw_limit32(run_t *run) { return draw32(run) & INT32_MAX; }

static uint16_t draw_code(run_t *run) { return (uint16_t)(draw(run) & 4095U); }

static uint16_t draw_count(run_t *run, const encoder_config_t *config)
{
    const uint32_t period = config->counts;
    return (uint16_t)(draw(run) % (2U * period - 1U) - (period - 1U));
}

static gain_t draw_gain(run_t *run)
{
    const int32_t gain = draw32(run);
    return (gain < -INT32_MAX) ? -INT32_MAX : gain;
}

static abc_t draw_abc(run_t *run)
{
    abc_t x;
    x.a = draw16(run);
    x.b = draw16(run);
    x.c = draw16(run);
    return x;
}

static ab_t draw_ab(run_t *run)
{
    ab_t x;
    x.alpha = draw16(run);
    x.beta = draw16(run);
    return x;
}

static dq_t draw_dq(run_t *run)
{
    dq_t x;
    x.d = draw16(run);
    x.q = draw16(run);
    return x;
}

static pi_gains_t draw_gains(run_t *run)
{
    pi_gains_t gains;
    gains.kp = draw_gain(run);
    gains.ki = draw_gain(run);
    gains.kc = (gain_t)(draw(run) >> (32 - GAIN_BITS));
    return gains;
}

static const axis_config_t *draw_axis(run_t *run) { return &servo_config.axis[draw(run) % HAL_AXES]; }

/* ---- results ---------------------------------------------------------------------------------------------------- */

static void take(run_t *run, int32_t result) { run->value = digest_long(run->value, (uint32_t)result); }

static void take64(run_t *run, int64_t result)
{
    const uint64_t bits = (uint64_t)result;
    run->value = digest_long(run->value, (uint32_t)(bits & UINT32_MAX));
    run->value = digest_long(run->value, (uint32_t)(bits >> 32));
}

static void take_abc(run_t *run, abc_t x)
{
    take(run, x.a);
    take(run, x.b);
    take(run, x.c);
}

static void take_dq(run_t *run, dq_t x)
{
    take(run, x.d);
    take(run, x.q);
}

static void take_pi(run_t *run, const pi_state_t *state)
{
    take64(run, state->integral);
    take(run, state->excess);
}

/* ---- groups ----------------------------------------------------------------------------------------------------- */

static void fractions16(run_t *run)
{
    const int16_t a = draw16(run);
    const int16_t b = draw16(run);
    const int32_t wide = draw32(run);
    const int16_t limit = draw_limit16(run);
    take(run, f16_add(a, b));
    take(run, f16_sub(a, b));
    take(run, f16_mul(a, b));
    take(run, f16_neg(a));
    take(run, f16_abs(a));
    take(run, f16_add_wrap(a, b));
    take(run, f16_sub_wrap(a, b));
    take(run, f16_limit(wide, limit));
    take(run, f16_from_f32(wide));
    take(run, sat16(wide));
    take(run, f32_mul16(a, b));
    take(run, f32_from_f16(a));
}

static void fractions32(run_t *run)
{
    const int32_t a = draw32(run);
    const int32_t b = draw32(run);
    const int32_t limit = draw_limit32(run);
    const unsigned shift = (unsigned)(draw(run) % 31U);
    const int64_t wide = (int64_t)a * b;
    take(run, f32_add(a, b));
    take(run, f32_sub(a, b));
    take(run, f32_abs(a));
    take(run, f32_limit(wide, limit));
    take(run, f32_gain(a, b));
    take(run, i32_gain(a, b));
    take(run, i32_add_wrap(a, b));
    take(run, i32_sub_wrap(a, b));
    take(run, asr32(a, shift));
    take(run, sat32(wide));
    take64(run, asr64(wide, shift));
}

static void trigonometry(run_t *run)
{
    const int16_t angle = draw16(run);
    const int32_t square = draw32(run);
    const int16_t x = draw16(run);
    const int16_t y = draw16(run);
    const sin_cos_t at = sin_cos(angle);
    take(run, at.sin);
    take(run, at.cos);
    take(run, f16_sqrt(square));
    take(run, f16_angle(x, y));
}

static void transforms(run_t *run)
{
    const abc_t phases = draw_abc(run);
    const ab_t stator = draw_ab(run);
    const dq_t rotor = draw_dq(run);
    const sin_cos_t at = sin_cos(draw16(run));
    const ab_t x = clarke(phases);
    const ab_t back = park_inverse(rotor, at);
    take(run, x.alpha);
    take(run, x.beta);
    take_dq(run, park(stator, at));
    take(run, back.alpha);
    take(run, back.beta);
}

static void modulation(run_t *run)
{
    const svm_t result = svm(draw_ab(run));
    take_abc(run, result.duty);
    take(run, (int32_t)result.sector);
}

static void dead_time(run_t *run)
{
    dead_time_config_t config;
    config.duty = draw_limit16(run);
    config.v_drop = draw_limit16(run);
    config.slope = draw16(run);
    const abc_t duty = draw_abc(run);
    const abc_t current = draw_abc(run);
    const int32_t reciprocal = (INT32_C(1) << 29) / (INT32_C(8192) + draw_limit16(run) * INT32_C(3) / 4);
    take_abc(run, dead_time_compensate(&config, duty, current, reciprocal));
}

static void controller(run_t *run)
{
    const pi_gains_t gains = draw_gains(run);
    pi_state_t state;
    pi_reset(&state, draw32(run));
    for (uint16_t i = 0; i < STEPS; i++) {
        const int32_t error = draw32(run);
        const int32_t forward = draw32(run);
        const pi_sum_t sum = pi_sum(&state, &gains, error) + pi_sum_of(forward);
        take(run, pi_limit(&state, sum, draw_limit32(run)));
        take_pi(run, &state);
    }
}

static void current_control(run_t *run)
{
    current_loop_config_t config = draw_axis(run)->current_loop;
    if ((draw(run) & 1U) != 0U) {
        config.d = draw_gains(run);
        config.q = draw_gains(run);
        config.omega_l_d = draw_gain(run) / 4; /* the gains of one sum stay below 255 together */
        config.omega_l_q = draw_gain(run) / 4;
        config.omega_psi = draw_gain(run) / 4;
        config.angle_step = draw_gain(run);
        config.modulation_limit = draw_limit16(run);
    }
    current_loop_t loop;
    current_loop_reset(&loop);
    loop.dead_time_off = (draw(run) & 3U) == 0U;
    for (uint16_t i = 0; i < STEPS; i++) {
        const abc_t current = draw_abc(run);
        const dq_t reference = draw_dq(run);
        const int16_t theta = draw16(run);
        const int16_t omega = draw16(run);
        loop.limited = false;
        current_loop_set_speed(&loop, &config, omega);
        const svm_t out = current_loop_step(&loop, &config, current, reference, theta, draw_limit16(run));
        take_dq(run, loop.current);
        take_dq(run, loop.voltage);
        take_abc(run, out.duty);
        take(run, (int32_t)out.sector);
        take(run, loop.limited ? 1 : 0);
        take_pi(run, &loop.d);
        take_pi(run, &loop.q);
    }
}

static void root(run_t *run)
{
    for (uint16_t i = 0; i < STEPS; i++) {
        const unsigned shift = (unsigned)(draw(run) % 64U);
        const uint64_t x = ((uint64_t)draw(run) << 32 | draw(run)) >> shift;
        take(run, (int32_t)u64_sqrt(x));
        take(run, (int32_t)u64_sqrt(x * x));
    }
    take(run, (int32_t)u64_sqrt(0));
    take(run, (int32_t)u64_sqrt(UINT64_MAX));
}

static void path_filter(run_t *run)
{
    uint16_t omega = (uint16_t)(1000U + draw(run) % 5000U);
    const path_position_t most = INT64_C(1) << 31; /* 128 counts per slow tick */
    const unsigned small = 4U + (unsigned)(draw(run) % 16U);
    const path_position_t acceleration = (int64_t)(draw(run) >> small) + 1; /* up to 16 counts */
    path_filter_t path;
    const int32_t start = draw32(run);
    path_filter_reset(&path, start, (int64_t)draw32(run) * 2, omega);
    for (uint16_t i = 0; i < STEPS; i++) {
        const int32_t target = i32_add_wrap(path_filter_position(&path), draw32(run) / 2); /* within POSITION_REACH */
        if ((draw(run) & 7U) == 0U) {
            const uint16_t before = omega;
            omega = (uint16_t)(1000U + draw(run) % 5000U);
            path_filter_retune(&path, target, acceleration, before, omega);
        }
        path_filter_step(&path, target, (int64_t)draw(run) % most, acceleration, omega);
        take64(run, path.ramp);
        take64(run, path.speed);
        take64(run, path.filter);
        take64(run, path.output);
        take(run, path_filter_position(&path));
        take(run, path_filter_stopping_position(&path, acceleration));
        take(run, path_filter_at_rest(&path, target) ? 1 : 0);
    }
}

static void friction(run_t *run)
{
    friction_config_t config;
    config.coulomb = draw_limit32(run);
    config.viscous = draw_gain(run);
    const uint32_t wide = draw(run);
    config.smooth = INT32_C(0x10001) + (int32_t)(wide >> (2U + (wide & 15U)));
    config.slope = (int32_t)((INT64_C(1) << 47) / config.smooth);
    for (uint16_t i = 0; i < STEPS; i++) {
        take(run, friction_current(&config, draw32(run)));
    }
}

/* With a constant configuration and current limit. */
static void weakening(run_t *run)
{
    field_weakening_config_t config;
    config.margin = draw_limit16(run);
    config.gain = draw_limit16(run);
    config.i_d_max = draw_limit16(run);
    config.q_share = draw_limit16(run);
    field_weakening_input_t input;
    input.current = draw_limit16(run);
    field_weakening_t state = {0};
    for (uint16_t i = 0; i < STEPS; i++) {
        input.demand = draw_dq(run);
        input.u_max = draw_limit16(run);
        input.emf = draw16(run);
        input.enabled = draw(run) % 8U != 0U;
        field_weakening_step(&state, &config, &input);
        take(run, state.d);
        take(run, state.q);
        take(run, field_weakening_i_d(&state));
        take(run, field_weakening_motoring(&state));
    }
}

/* The configured number, or any up to 32000 counts. */
static encoder_config_t draw_encoder(run_t *run)
{
    encoder_config_t config = draw_axis(run)->encoder;
    if ((draw(run) & 1U) != 0U) {
        const uint16_t lines = (uint16_t)(100U + draw(run) % 16285U);
        config.counts = (uint16_t)(((lines > 8192U) ? 2U : 4U) * lines);
        config.pole_pairs = (uint16_t)(1U + draw(run) % 50U);
        config.angle_per_count = (UINT32_C(1) << 30) / lines;
    }
    return config;
}

static void encoder(run_t *run)
{
    const encoder_config_t any = draw_encoder(run);
    const encoder_config_t *config = &any;
    encoder_t state;
    encoder_position_t position = {draw32(run), 0, encoder_lines(config)};
    uint16_t index = (uint16_t)draw(run);
    encoder_reset(&state, draw_count(run, config), index);
    for (uint16_t i = 0; i < STEPS; i++) {
        const uint16_t count = draw_count(run, config);
        const uint16_t before = draw_count(run, config);
        take(run, encoder_theta_m(config, count));
        take(run, encoder_theta_e(&state, config, count));
        take(run, encoder_difference(config, count, before));
        take(run, encoder_count_at(config, draw16(run)));
        index = (uint16_t)(index + (draw(run) & 1U));
        take(run, encoder_update(&state, config, count, index) ? 1 : 0);
        if ((draw(run) & 7U) == 0U) {
            encoder_resync(&state, config);
        }
        if ((draw(run) & 7U) == 0U) {
            encoder_preset(&state, config, before);
        }
        take(run, state.position);
        take(run, state.integral);
        take(run, state.turns);
        take(run, state.count_init);
        take(run, (int32_t)state.pending);
        encoder_position_add(&position, config, draw16(run));
        take(run, position.whole);
        take(run, encoder_position_part(&position, config));
    }
}

static void speed(run_t *run)
{
    const axis_config_t *axis = draw_axis(run);
    mt_speed_t state;
    mt_speed_reset(&state);
    edge_capture_t edge;
    edge.time = (uint16_t)draw(run);
    for (uint16_t i = 0; i < STEPS; i++) {
        const uint32_t kind = draw(run);
        if ((kind & 3U) != 0U) {
            edge.count = draw_count(run, &axis->encoder);
            edge.time = (uint16_t)(edge.time + (draw(run) >> (16U + (kind >> 2) % 16U)));
            mt_speed_edge(&state, &axis->mt_speed, &axis->encoder, edge);
            take(run, state.speed);
        }
        if ((kind & 4U) != 0U) {
            mt_speed_slow(&state, draw(run) % (HAL_EDGE_AGE_OVERFLOW + 1U), (kind & 0x100U) != 0U);
        }
        take(run, state.speed);
        take(run, state.primed ? 1 : 0);
        take(run, (int32_t)state.interval);
    }
}

static void observer(run_t *run)
{
    const speed_observer_config_t *config = &draw_axis(run)->speed_observer;
    int32_t count = draw32(run);
    speed_observer_t state = {.half_count = INT32_C(1) << (SPEED_OBSERVER_BITS - 1)};
    speed_observer_reset(&state, config, count, 0, draw32(run));
    for (uint16_t i = 0; i < STEPS; i++) {
        const uint32_t kind = draw(run);
        count = i32_add_wrap(count, asr32((int32_t)(kind % 4096U) - 2048, (unsigned)((kind >> 12) % 12U)));
        const int32_t part = asr32(draw32(run), 8);
        take(run, speed_observer_step(&state, config, count, part, draw16(run)));
        take(run, state.offset);
        take(run, state.step);
        take(run, state.acceleration);
    }
}

/* A shaft that moves sometimes: by a small or large distance, in random or always the same direction. */
static int32_t draw_twitch(run_t *run, uint32_t habit)
{
    const uint32_t kind = draw(run);
    if ((kind & 15U) != 0U) {
        return 0;
    }
    const unsigned small = ((kind >> 4) & 7U) != 0U ? 9U : 0U;
    const int32_t moved = asr32((int32_t)((kind >> 7) % 8192U) - 4096, small);
    if ((habit & 2U) != 0U) {
        return moved;
    }
    return ((habit & 1U) != 0U) == (moved < 0) ? moved : -moved;
}

static void search(run_t *run)
{
    rotor_search_config_t any = draw_axis(run)->rotor_search;
    if ((draw(run) & 1U) != 0U) {
        any.current_limit = (int16_t)(draw_limit16(run) | 0x4000);
        any.current_step = draw_limit32(run) / 2;
        any.rest_ticks = 1;
        any.hold_ticks = (uint16_t)(draw(run) % 16U);
    }
    const rotor_search_config_t *config = &any;
    int32_t position = draw32(run);
    rotor_search_t state;
    rotor_search_start(&state, position);
    const uint32_t habit = draw(run);
    for (uint16_t i = 0; i < 20U * STEPS; i++) {
        position = i32_add_wrap(position, draw_twitch(run, habit));
        if (rotor_search_drives(&state)) {
            rotor_search_add(&state, config, f16_from_f32(state.current), (frac16_t)(uint16_t)draw(run));
        }
        rotor_search_step(&state, config, position);
    }
    take(run, (int32_t)state.phase);
    take(run, state.theta_m);
    take(run, (int32_t)state.reach);
    take(run, state.current);
    take(run, (int32_t)state.searches);
    take(run, state.follow.low);
    take(run, state.follow.high);
    take(run, rotor_search_angle(&state));
}

static void currents(run_t *run)
{
    current_sense_t sense;
    current_sense_reset(&sense);
    for (uint16_t phase = 0; phase < SENSE_PHASES; phase++) {
        sense.offset[phase] = (uint32_t)draw_code(run) << 16;
    }
    for (uint16_t i = 0; i < STEPS; i++) {
        adc_pair_t codes;
        codes.first = draw_code(run);
        codes.second = draw_code(run);
        sense.duty = draw_abc(run);
        sense.pair = current_sense_pair((uint16_t)(1U + draw(run) % 6U));
        take_abc(run, current_sense_read(&sense, codes));
        current_sense_track(&sense, codes, draw_limit16(run));
        take(run, (int32_t)sense.offset[i % SENSE_PHASES]);
        take(run, current_sense_offsets_plausible(&sense, draw_code(run)) ? 1 : 0);
    }
}

/* Within the ranges that a board accepts (servo_msgs_py/axis_config.toml). */
static void winding(run_t *run)
{
    winding_model_config_t config;
    config.heating = (draw32(run) & INT32_C(0x3FFFFFFF)) | 1;
    config.cooling = (draw32(run) & INT32_C(0x3FFFFFFF)) | 1;
    config.ambient = (frac16_t)(draw_limit16(run) / 2);
    config.initial = (frac16_t)(draw_limit16(run) - 12800);
    config.derating = draw_limit16(run);
    config.maximum = draw_limit16(run);
    config.fault = draw_limit16(run);
    config.rated_current = (frac16_t)(draw_limit16(run) | 1);
    winding_model_t model;
    winding_model_init(&model, &config);
    for (uint16_t i = 0; i < STEPS; i++) {
        const dq_t current = draw_dq(run);
        while (!winding_model_add(&model, current)) {
        }
        winding_model_step(&model, &config, (draw(run) & 1U) != 0U);
        take(run, model.temperature);
        take(run, model.hot ? 1 : 0);
        take(run, winding_model_limit(&model, &config, draw_limit16(run)));
    }
}

static void take_bytes(run_t *run, const uint8_t *data, uint16_t size)
{
    for (uint16_t i = 0; i < size; i++) {
        take(run, data[i]);
    }
}

static void draw_bytes(run_t *run, uint8_t *data, uint16_t size)
{
    for (uint16_t i = 0; i < size; i++) {
        data[i] = (uint8_t)(draw(run) & 0xFFU);
    }
}

/* Request of a client that knows the password. */
static void prove(const access_t *access, const uint8_t *password, uint8_t *key)
{
    uint8_t message[2U * ACCESS_SALT_SIZE + SHA1_SIZE];
    memcpy(message, access->salt, ACCESS_SALT_SIZE);
    memcpy(message + ACCESS_SALT_SIZE, password, SHA1_SIZE);
    memcpy(message + ACCESS_SALT_SIZE + SHA1_SIZE, access->salt, ACCESS_SALT_SIZE);
    sha1(message, sizeof message, key);
}

/* Log-ins with right and wrong passwords, to boards with and without them. */
static void passwords(run_t *run)
{
    uint8_t digest[ACCESS_LEVELS][SHA1_SIZE];
    access_passwords_t known = {{NULL, NULL, NULL}};
    access_t access;
    for (uint16_t level = 0; level < ACCESS_LEVELS; level++) {
        draw_bytes(run, digest[level], SHA1_SIZE);
        known.password[level] = (draw(run) & 3U) != 0U ? digest[level] : NULL;
    }
    take(run, access_guarded(&known));
    access_init(&access, &known);
    for (uint16_t i = 0; i < LOGINS; i++) {
        uint8_t bytes[1U + SHA1_SIZE];
        uint8_t answer[2U + ACCESS_SALT_SIZE];
        payload_writer_t reply = {answer, sizeof answer, 0, false};
        bytes[0] = (uint8_t)(draw(run) % 5U);
        payload_reader_t challenge = {bytes, (uint16_t)((draw(run) & 15U) != 0U), false};
        take(run, access_challenge(&access, draw(run), &challenge, &reply));
        draw_bytes(run, bytes + 1, SHA1_SIZE);
        if ((draw(run) & 1U) != 0U) {
            prove(&access, digest[draw(run) % ACCESS_LEVELS], bytes + 1);
        }
        payload_reader_t proof = {bytes, (uint16_t)(sizeof bytes - ((draw(run) & 15U) == 0U ? 1U : 0U)), false};
        take(run, access_prove(&access, &proof, &reply));
        take_bytes(run, answer, reply.size);
        take(run, access.level);
    }
}

/* Lines of the log, including those that no recorded run has: late loops, lost bytes, a watchdog. */
static void log_lines(run_t *run)
{
    static freemaster_t server;
    static snapshot_t snapshot;
    static event_log_t log;
    event_log_init(&log, (draw(run) & 1U) != 0U);
    pipe_init(&server.pipe, "log");
    for (uint16_t i = 0; i < STEPS; i++) {
        snapshot.tick = draw(run);
        for (uint16_t k = 0; k < HAL_AXES; k++) {
            snapshot.axis[k].faults = (draw(run) & 1U) != 0U ? (fault_set_t)(draw(run) & draw(run)) : 0U;
            snapshot.axis[k].state = (uint16_t)(draw(run) % 5U);
            snapshot.axis[k].substate = (uint16_t)(draw(run) % 7U);
        }
        snapshot.points_refused = (uint16_t)(draw(run) & 1U);
        snapshot.point_refusal = (uint16_t)(draw(run) & 15U);
        snapshot.late_loops = (uint16_t)(draw(run) & 1U);
        snapshot.receiver_overruns = (uint16_t)(draw(run) & 3U);
        event_log_compare(&log, &snapshot);
        event_log_compare(&log, &snapshot);
        event_log_refused(&log, (uint16_t)(draw(run) & 0x3FFU));
        event_log_refused(&log, 0);
        event_log_print(&log, &server);
        take_bytes(run, server.pipe.queue, server.pipe.size);
        server.pipe.size = 0;
    }
}

/* ---- the table -------------------------------------------------------------------------------------------------- */

typedef struct {
    const char *name;
    void (*round)(run_t *run);
} group_t;

static const group_t groups[] = {
    {"fractions of 16 bits", fractions16},
    {"fractions of 32 bits", fractions32},
    {"sine, cosine, square root, angle", trigonometry},
    {"Clarke and Park", transforms},
    {"space-vector modulation", modulation},
    {"dead-time compensation", dead_time},
    {"PI controller", controller},
    {"current control", current_control},
    {"root", root},
    {"path filter", path_filter},
    {"friction", friction},
    {"field weakening", weakening},
    {"encoder", encoder},
    {"speed", speed},
    {"speed observer", observer},
    {"rotor search", search},
    {"current sensing", currents},
    {"winding", winding},
    {"passwords", passwords},
    {"log", log_lines},
};

uint16_t arithmetic_groups(void) { return (uint16_t)(sizeof groups / sizeof groups[0]); }

const char *arithmetic_name(uint16_t group) { return groups[group].name; }

uint32_t arithmetic_digest(uint16_t group, uint32_t seed, uint32_t rounds)
{
    run_t run = {seed | 1U, DIGEST_START};
    for (uint32_t i = 0; i < rounds; i++) {
        groups[group].round(&run);
    }
    return run.value;
}
