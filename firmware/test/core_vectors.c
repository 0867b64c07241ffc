/* core_vectors.c - runs the portable core on many inputs and prints what comes out, for comparing targets. */
#include <stdio.h>

#include "config/axis_config.h"
#include "control/current_loop.h"
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

static void add(int32_t value) { sum = (sum << 5 | sum >> 27) ^ (uint32_t)value; }

static void report(const char *what)
{
    printf("%s %08lX\n", what, (unsigned long)sum);
    sum = 0;
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

static void control(void)
{
    current_loop_t loop;
    current_loop_reset(&loop);
    path_t path;
    path_reset(&path, -5000, -300000, 1957);
    for (uint16_t i = 0; i < 300; i++) {
        const abc_t current = {random16(), random16(), random16()};
        const dq_t reference = {random16(), random16()};
        const current_loop_output_t out =
            current_loop_step(&loop, &servo_config.axis[i % 2U].current_loop, current, reference, random16(),
                              random16(), (frac16_t)(random16() & 0x7FFF));
        add(out.current.d);
        add(out.current.q);
        add(out.voltage.d);
        add(out.voltage.q);
        add(out.modulation.duty.a);
        add(out.modulation.duty.b);
        add(out.modulation.duty.c);
        add((int32_t)out.modulation.sector);
        path_step(&path, (i < 150U) ? INT32_C(900000000) : INT32_C(-1000), INT64_C(3000000000), 1957);
        add((int32_t)asr64(path.output, 8));
        add(path_position(&path));
    }
    report("control");
}

/* A shaft that wanders through the compare values, with and without an index pulse. */
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
        mt_speed_slow(&mt, random32() >> 15);
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
        rotor_search_step(&s, &servo_config.axis[0].rotor_search, position);
        add(s.theta_m);
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
    report("sense");
}

int main(void)
{
    begin();
    fractions();
    control();
    encoder();
    speed();
    search();
    sense();
    finish();
    return 0;
}
