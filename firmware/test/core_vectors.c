/* core_vectors.c - runs the portable core on many inputs and prints the outputs, to compare targets. */
#include <stdio.h>

#include "config/axis_config.h"
#include "control/current_loop.h"
#include "control/field_weakening.h"
#include "control/friction.h"
#include "control/path.h"
#include "drive/current_sense.h"
#include "math/trig.h"
#include "sensing/encoder.h"
#include "sensing/mt_speed.h"
#include "sensing/rotor_search.h"

#ifdef __AVR__
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>

static int put(char c, FILE *stream)
{
    (void)stream;
    while ((UCSR0A & (uint8_t)(1U << UDRE0)) == 0U) {
    }
    UDR0 = (uint8_t)c;
    return 0;
}

static FILE line;

static void begin(void)
{
    UCSR0B = (uint8_t)(1U << TXEN0);
    line.put = put;
    line.flags = _FDEV_SETUP_WRITE;
    stdout = &line;
}

static void finish(void)
{
    cli();
    sleep_mode(); /* ends the simulator */
}
#else
static void begin(void) {}
static void finish(void) {}
#endif

static uint32_t random_state = 1;

static uint32_t random32(void)
{
    random_state ^= random_state << 13;
    random_state ^= random_state >> 17;
    random_state ^= random_state << 5;
    return random_state;
}

static int16_t random16(void) { return (int16_t)(uint16_t)(random32() >> 11); }

static uint32_t sum;

/* The product spreads a difference over the word, the rotation keeps one of the highest bit: equal errors do not
 * cancel. */
static void add(int32_t value)
{
    const uint32_t mixed = sum ^ (uint32_t)value;
    sum = (mixed << 5 | mixed >> 27) * UINT32_C(16777619);
}

static void report(const char *what)
{
    printf("%s %08lX\n", what, (unsigned long)sum);
    sum = 0;
}

static void sums(frac32_t x, frac32_t y)
{
    add(f32_add(x, y));
    add(f32_sub(x, y));
    add(f32_abs(x));
    add(i32_add_wrap(x, y));
    add(i32_sub_wrap(x, y));
    add(sat16(x));
    add(sat32((int64_t)x * 3 - y));
    add(f32_gain(x, y));
    add(f16_from_f32(x));
    add(f16_sqrt(x));
    if (y >= 0) {
        add(f32_limit((int64_t)x * 2, y));
    }
}

static void products(frac16_t a, frac16_t b)
{
    add(f16_mul(a, b));
    add(f32_mul16(a, b));
    add(f16_add(a, b));
    add(f16_sub(a, b));
    add(f16_neg(a));
    add(f16_abs(a));
    add(f16_add_wrap(a, b));
    add(f16_sub_wrap(a, b));
    add(f32_from_f16(a));
    if (b >= 0) {
        add(f16_limit((int32_t)a * 3, b));
    }
}

/* Every pair of the range limits and of their neighbours. */
static void ends(void)
{
    static const frac16_t narrow[] = {FRAC16_MIN, FRAC16_MIN + 1, -16384, -182, -1, 0, 1, 181, 16384, FRAC16_MAX};
    static const frac32_t wide[] = {
        FRAC32_MIN, FRAC32_MIN + 1, INT32_C(-0x40000000), INT32_C(-32769), -1,         0,
        1,          INT32_C(32768), INT32_C(0x40000000),  FRAC32_MAX - 1,  FRAC32_MAX,
    };
    const uint16_t of_narrow = (uint16_t)(sizeof narrow / sizeof narrow[0]);
    const uint16_t of_wide = (uint16_t)(sizeof wide / sizeof wide[0]);
    for (uint16_t i = 0; i < of_narrow; i++) {
        for (uint16_t k = 0; k < of_narrow; k++) {
            products(narrow[i], narrow[k]);
        }
    }
    for (uint16_t i = 0; i < of_wide; i++) {
        for (uint16_t k = 0; k < of_wide; k++) {
            sums(wide[i], wide[k]);
        }
    }
    report("ends");
}

static void fractions(void)
{
    for (uint16_t i = 0; i < 300; i++) {
        const int16_t a = (i < 4) ? FRAC16_MIN : random16();
        const int16_t b = (i < 2) ? FRAC16_MIN : random16();
        const int32_t x = (int32_t)random32();
        add(f16_mul(a, b));
        add(f16_add(a, b));
        add(f16_sub(a, b));
        add(f16_abs(a));
        add(f16_add_wrap(a, b));
        add(f16_sub_wrap(a, b));
        add(f32_mul16(a, b));
        add(f16_limit(x, f16_abs(b)));
        add(f16_from_f32(x));
        add(f32_gain(x, (gain_t)random32()));
        add(asr32(x, i % 32U));
        add((int32_t)asr64((int64_t)x * (int32_t)random32(), i % 64U));
        add(f16_sqrt(x));
        const sin_cos_t s = sin_cos(a);
        add(s.sin);
        add(s.cos);
    }
    report("fractions");
}

/* Friction and changes of the path filter. */
static void shaping(void)
{
    for (uint16_t i = 0; i < 200; i++) {
        const friction_config_t friction = {(int32_t)(random32() >> 1), (int32_t)random32(),
                                            (int32_t)(random32() >> 4) + 1, (int32_t)(random32() >> 1)};
        add(friction_current(&friction, (frac32_t)random32()));
        path_t path;
        const uint16_t omega = (uint16_t)(random32() | 1U);
        const int32_t position = (int32_t)random32();
        path_reset(&path, position, (int64_t)(int32_t)random32() * 8, omega);
        path_retune(&path, i32_add_wrap(position, random16()), (int64_t)(random32() >> 4), omega,
                    (uint16_t)(random32() | 1U));
        add(path_stop(&path, (int64_t)(random32() >> 4) + 1));
        add((int32_t)asr64(path.ramp, 16));
        add((int32_t)asr64(path.filter, 16));
        add(path_at_rest(&path, position) ? 1 : 0);
    }
    report("shaping");
}

static void control(void)
{
    current_loop_t loop;
    current_loop_reset(&loop);
    path_t path;
    path_reset(&path, -5000, -300000, 1957);
    for (uint16_t i = 0; i < 300; i++) {
        loop.dead_time_off = (i & 32U) != 0U;
        const abc_t current = {random16(), random16(), random16()};
        const dq_t reference = {random16(), random16()};
        const current_loop_config_t *config = &servo_config.axis[i % 2U].current_loop;
        const frac16_t theta = random16();
        current_loop_turn(&loop, config, random16());
        const svm_t out = current_loop_step(&loop, config, current, reference, theta, (frac16_t)(random16() & 0x7FFF));
        add(loop.current.d);
        add(loop.current.q);
        add(loop.voltage.d);
        add(loop.voltage.q);
        add(out.duty.a);
        add(out.duty.b);
        add(out.duty.c);
        add((int32_t)out.sector);
        path_step(&path, (i < 150U) ? INT32_C(900000000) : INT32_C(-1000), INT64_C(2000000000), INT64_C(10000000),
                  1957);
        add((int32_t)asr64(path.output, 8));
        add(path_position(&path));
    }
    report("control");
}

/* A shaft that moves through the compare values, with and without an index pulse. */
static void encoder(void)
{
    const encoder_config_t *config = &servo_config.axis[0].encoder;
    encoder_t e;
    encoder_reset(&e, 3990, 0);
    int32_t count = 3990;
    uint16_t index = 0;
    for (uint16_t i = 0; i < 600; i++) {
        const int32_t move = random16() % 1500;
        count += move;
        if (count > 3999 || count < -3999) {
            count = (count > 0) ? count - 4000 : count + 4000;
            index = (uint16_t)(index + ((i % 7U) != 0U ? 1U : 0U));
        } else if ((i % 5U) == 0U) {
            index++;
        }
        add(encoder_update(&e, config, (uint16_t)count, index) ? 1 : 0);
        add(e.position);
        add(e.integral);
        add((int32_t)e.pending);
        add(encoder_theta_m(config, (uint16_t)count));
        add(encoder_theta_e(config, (uint16_t)count));
        add(encoder_count_at(config, random16()));
        if ((i % 50U) == 0U) {
            encoder_preset(&e, config, (uint16_t)(random16() % 1000));
            count = (int16_t)e.count;
        }
        if ((i % 90U) == 0U) {
            encoder_resync(&e, config);
        }
    }
    /* The largest encoder whose counts fit the register: differences need more than 16 bits. */
    const encoder_config_t large = {32768U, 3, UINT32_C(131072)};
    encoder_reset(&e, 0x8001U, 0);
    for (uint16_t i = 0; i < 200; i++) {
        const uint16_t at = (i % 3U == 0U) ? 0x8001U : 0x7FFFU;
        const uint16_t other = (uint16_t)random16();
        add(encoder_difference(&large, (i % 2U == 0U) ? at : other, at));
        add(encoder_update(&e, &large, (i % 5U == 0U) ? at : other, index) ? 1 : 0);
        add(e.position);
        add(encoder_theta_e(&large, other));
    }
    report("encoder");
}

static void speed(void)
{
    mt_speed_t mt;
    mt_speed_reset(&mt);
    for (uint16_t i = 0; i < 400; i++) {
        if ((random32() & 3U) != 0U) {
            const edge_capture_t capture = {(uint16_t)(random16() % 4000), (uint16_t)random16()};
            mt_speed_edge(&mt, &servo_config.axis[0].mt_speed, &servo_config.axis[0].encoder, capture);
            add(mt.speed);
        }
        mt_speed_slow(&mt, random32() >> 15, true);
        add(mt.speed);
    }
    report("speed");
}

static void search(void)
{
    rotor_search_t s;
    int32_t position = INT32_C(2147483600);
    rotor_search_start(&s, position);
    for (uint16_t i = 0; i < 2000; i++) {
        if (s.phase == ROTOR_SEARCH_PULL && s.current > INT32_C(20000000)) {
            position = i32_add_wrap(position, (int16_t)((uint16_t)rotor_search_angle(&s) - 23000U) < 0 ? 3 : -3);
        }
        if (rotor_search_drives(&s)) {
            rotor_search_watch(&s, &servo_config.axis[0].rotor_search, f16_from_f32(s.current),
                               (frac16_t)(uint16_t)(random32() >> 16));
        }
        rotor_search_step(&s, &servo_config.axis[0].rotor_search, position);
        add(s.theta_m);
        add((int32_t)s.reach);
        add(s.follow.flux);
        add(s.current);
        add((int32_t)s.phase);
    }
    report("search");
}

static void sense(void)
{
    current_sense_t s;
    current_sense_reset(&s);
    bool done = false;
    while (!done) {
        const adc_pair_t codes = {(uint16_t)(random32() & 0xFFFU), (uint16_t)(random32() & 0xFFFU)};
        done = current_sense_calibrate(&s, codes);
    }
    for (uint16_t i = 0; i < 300; i++) {
        const adc_pair_t codes = {(uint16_t)(random32() & 0xFFFU), (uint16_t)(random32() & 0xFFFU)};
        s.pair = current_sense_pair((uint16_t)(1U + i % 6U));
        s.duty = (abc_t){random16(), random16(), random16()};
        current_sense_track(&s, codes, 3277);
        const abc_t x = current_sense_read(&s, codes);
        add(x.a);
        add(x.b);
        add(x.c);
    }
    for (uint16_t i = 0; i < 100; i++) { /* no converter has 16 bits: saturation, not a wrap */
        s.pair = (phase_pair_t)(i % 3U);
        const abc_t x = current_sense_read(&s, (adc_pair_t){(uint16_t)random32(), (uint16_t)(random32() >> 16)});
        add(x.a);
        add(x.b);
        add(x.c);
    }
    report("sense");
}

static void weakening(void)
{
    field_weakening_t s = {0};
    for (uint16_t i = 0; i < 300; i++) {
        const field_weakening_config_t config = {f16_abs(random16()), f16_abs(random16()), f16_abs(random16()),
                                                 f16_abs(random16())};
        const field_weakening_input_t input = {
            .demand = {random16(), random16()},
            .u_max = f16_abs(random16()),
            .emf = random16(),
            .current = f16_abs(random16()),
            .wanted = i % 8U != 0U,
        };
        field_weakening_step(&s, &config, &input);
        add(s.d);
        add(s.q);
        add(field_weakening_i_d(&s));
        add(field_weakening_motoring(&s));
    }
    report("weakening");
}

int main(void)
{
    begin();
    ends();
    fractions();
    shaping();
    control();
    encoder();
    speed();
    search();
    sense();
    weakening();
    finish();
    return 0;
}
