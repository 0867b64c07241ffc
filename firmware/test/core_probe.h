/* core_probe.h - functions for tests that are not in the headers: inline functions, and loops that would be too
 * slow in Python. */
#ifndef TEST_CORE_PROBE_H
#define TEST_CORE_PROBE_H

#include "app/servo.h"
#include "control/svm.h"
#include "control/transforms.h"
#include "math/frac.h"
#include "math/trig.h"

int32_t probe_asr32(int32_t x, uint16_t n);
int64_t probe_asr64(int64_t x, uint16_t n);
int16_t probe_sat16(int32_t x);
int32_t probe_sat32(int64_t x);
frac16_t probe_f16_limit(int32_t x, frac16_t limit);
frac32_t probe_f32_limit(int64_t x, frac32_t limit);
frac16_t probe_f16_add(frac16_t a, frac16_t b);
frac16_t probe_f16_sub(frac16_t a, frac16_t b);
frac16_t probe_f16_neg(frac16_t a);
frac16_t probe_f16_abs(frac16_t a);
frac32_t probe_f32_add(frac32_t a, frac32_t b);
frac32_t probe_f32_sub(frac32_t a, frac32_t b);
frac32_t probe_f32_abs(frac32_t a);
frac16_t probe_f16_add_wrap(frac16_t a, frac16_t b);
frac16_t probe_f16_sub_wrap(frac16_t a, frac16_t b);
int32_t probe_i32_add_wrap(int32_t a, int32_t b);
int32_t probe_i32_sub_wrap(int32_t a, int32_t b);
frac16_t probe_f16_mul(frac16_t a, frac16_t b);
frac32_t probe_f32_mul16(frac16_t a, frac16_t b);
frac32_t probe_f32_from_f16(frac16_t a);
frac16_t probe_f16_from_f32(frac32_t a);
frac32_t probe_f32_gain(frac32_t x, gain_t gain);

/* One sample of a PI controller: both halves, and a feed-forward between them. */
frac32_t probe_pi(pi_state_t *state, const pi_gains_t *gains, frac32_t error, frac32_t feed_forward, frac32_t limit);

/* One PWM period at the electrical speed `omega_e`. */
typedef struct {
    dq_t current; /* measured */
    dq_t voltage; /* voltage set-point of the inverter */
    svm_t modulation; /* duties and sector */
    bool limited; /* the voltage is at its limit */
} probe_period_t;
probe_period_t probe_current_loop(current_loop_t *loop, const current_loop_config_t *config, abc_t current,
                                  dq_t reference, frac16_t theta_e, frac16_t omega_e, frac16_t u_dc);

/* Sine and cosine of every angle, from 0 upwards through the wrap: 65536 values each. */
void probe_sin_cos_all(int16_t *sines, int16_t *cosines);

/* f16_mul of a with every second factor, from -32768 upwards: 65536 values. */
void probe_f16_mul_all(frac16_t a, int16_t *products);

void probe_f16_sqrt_many(const int32_t *x, int16_t *roots, uint32_t count);
void probe_clarke_many(const abc_t *x, ab_t *result, uint32_t count);
void probe_park_many(const ab_t *x, const frac16_t *angle, dq_t *result, uint32_t count);
void probe_park_inverse_many(const dq_t *x, const frac16_t *angle, ab_t *result, uint32_t count);
void probe_svm_many(const ab_t *modulation, svm_t *result, uint32_t count);

/* Whole PWM periods of a board: M1, M2, background. */
void probe_run(servo_t *servo, uint32_t periods);

uint32_t probe_servo_size(void);
const servo_config_t *probe_config(void);

#endif
