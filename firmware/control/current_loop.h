/* current_loop.h - the fast loop's controllers: i_d, i_q, decoupling, bus-ripple compensation (DRM 2.3.2, F7). */
#ifndef SERVO_CONTROL_CURRENT_LOOP_H
#define SERVO_CONTROL_CURRENT_LOOP_H

#include "control/dead_time.h"
#include "control/pi.h"
#include "control/svm.h"

typedef struct {
    pi_gains_t d;
    pi_gains_t q;
    gain_t omega_l_d;  /* omega_e L_d i: full-scale speed x L_d x full-scale current / full-scale voltage */
    gain_t omega_l_q;  /* the same with L_q: DRM E20/E21 write one L_s, the rotor has two */
    gain_t omega_psi;  /* omega_e psi_m */
    gain_t angle_step; /* electrical angle per PWM period at full-scale speed */
    dead_time_config_t dead_time;
    frac16_t modulation_limit; /* longest voltage over 2/3 u_dc; sqrt(3)/2 would leave a low side too short to sample */
} current_loop_config_t;

typedef struct {
    pi_state_t d;
    pi_state_t q;
    bool dead_time_off; /* leave the duties as the SVM made them */
} current_loop_t;

typedef struct {
    dq_t current; /* measured */
    dq_t voltage; /* what was asked of the inverter */
    svm_t modulation; /* duties and sector */
    bool limited; /* the voltage is at its limit */
} current_loop_output_t;

void current_loop_reset(current_loop_t *loop);

/* One PWM period. `theta_e` is the angle at the sampling instant, `omega_e` the electrical speed (full scale: pole pairs
 * x full-scale speed), `u_dc` the bus voltage of this period. */
current_loop_output_t current_loop_step(current_loop_t *loop, const current_loop_config_t *config, abc_t current,
                                        dq_t reference, frac16_t theta_e, frac16_t omega_e, frac16_t u_dc);

#endif
