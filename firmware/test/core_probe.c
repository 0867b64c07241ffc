#include "core_probe.h"

#include "config/servo_config.h"

int32_t probe_asr32(int32_t x, uint16_t n) { return asr32(x, n); }
int64_t probe_asr64(int64_t x, uint16_t n) { return asr64(x, n); }
int16_t probe_sat16(int32_t x) { return sat16(x); }
int32_t probe_sat32(int64_t x) { return sat32(x); }
frac16_t probe_f16_limit(int32_t x, frac16_t limit) { return f16_limit(x, limit); }
frac32_t probe_f32_limit(int64_t x, frac32_t limit) { return f32_limit(x, limit); }
frac16_t probe_f16_add(frac16_t a, frac16_t b) { return f16_add(a, b); }
frac16_t probe_f16_sub(frac16_t a, frac16_t b) { return f16_sub(a, b); }
frac16_t probe_f16_neg(frac16_t a) { return f16_neg(a); }
frac16_t probe_f16_abs(frac16_t a) { return f16_abs(a); }
frac32_t probe_f32_add(frac32_t a, frac32_t b) { return f32_add(a, b); }
frac32_t probe_f32_sub(frac32_t a, frac32_t b) { return f32_sub(a, b); }
frac32_t probe_f32_abs(frac32_t a) { return f32_abs(a); }
frac16_t probe_f16_add_wrap(frac16_t a, frac16_t b) { return f16_add_wrap(a, b); }
frac16_t probe_f16_sub_wrap(frac16_t a, frac16_t b) { return f16_sub_wrap(a, b); }
int32_t probe_i32_add_wrap(int32_t a, int32_t b) { return i32_add_wrap(a, b); }
int32_t probe_i32_sub_wrap(int32_t a, int32_t b) { return i32_sub_wrap(a, b); }
frac16_t probe_f16_mul(frac16_t a, frac16_t b) { return f16_mul(a, b); }
frac32_t probe_f32_mul16(frac16_t a, frac16_t b) { return f32_mul16(a, b); }
frac32_t probe_f32_from_f16(frac16_t a) { return f32_from_f16(a); }
frac16_t probe_f16_from_f32(frac32_t a) { return f16_from_f32(a); }
frac32_t probe_f32_gain(frac32_t x, gain_t gain) { return f32_gain(x, gain); }

frac32_t probe_pi(pi_state_t *state, const pi_gains_t *gains, frac32_t error, frac32_t feed_forward, frac32_t limit)
{
    return pi_limit(state, pi_sum(state, gains, error) + pi_sum_of(feed_forward), limit);
}

probe_period_t probe_current_loop(current_loop_t *loop, const current_loop_config_t *config, abc_t current,
                                  dq_t reference, frac16_t theta_e, frac16_t omega_e, frac16_t u_dc)
{
    loop->limited = false;
    current_loop_set_speed(loop, config, omega_e);
    const svm_t modulation = current_loop_step(loop, config, current, reference, theta_e, u_dc);
    return (probe_period_t){loop->current, loop->voltage, modulation, loop->limited};
}

void probe_sin_cos_all(int16_t *sines, int16_t *cosines)
{
    for (uint32_t angle = 0; angle < UINT32_C(65536); angle++) {
        const sin_cos_t value = sin_cos((frac16_t)(uint16_t)angle);
        sines[angle] = (int16_t)value.sin;
        cosines[angle] = (int16_t)value.cos;
    }
}

void probe_f16_mul_all(frac16_t a, int16_t *products)
{
    for (int32_t b = INT16_MIN; b <= INT16_MAX; b++) {
        products[b - INT16_MIN] = f16_mul(a, (frac16_t)b);
    }
}

void probe_f16_sqrt_many(const int32_t *x, int16_t *roots, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        roots[i] = f16_sqrt(x[i]);
    }
}

void probe_clarke_many(const abc_t *x, ab_t *result, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        result[i] = clarke(x[i]);
    }
}

void probe_park_many(const ab_t *x, const frac16_t *angle, dq_t *result, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        result[i] = park(x[i], sin_cos(angle[i]));
    }
}

void probe_park_inverse_many(const dq_t *x, const frac16_t *angle, ab_t *result, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        result[i] = park_inverse(x[i], sin_cos(angle[i]));
    }
}

void probe_svm_many(const ab_t *modulation, svm_t *result, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        result[i] = svm(modulation[i]);
    }
}

void probe_run(servo_t *servo, uint32_t periods)
{
    for (uint32_t i = 0; i < periods; i++) {
        servo_m1_isr(servo);
        servo_m2_isr(servo);
        servo_background(servo);
    }
}

uint32_t probe_servo_size(void) { return (uint32_t)sizeof(servo_t); }
const servo_config_t *probe_config(void) { return &servo_config; }
