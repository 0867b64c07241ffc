/* rotor_follow.h - detects from the voltage, without the encoder, whether the rotor follows a rotating current vector.
 *
 * The vector is rotated by a known angle and back. Voltage across the vector:
 *   u = omega L I + psi_m cos(delta) d(theta_e)/dt      (delta: angle between rotor and vector)
 * R I and most of the dead-time error are along the vector. With a blocked rotor only omega L I remains, which is known
 * and subtracted; a rotor that follows or oscillates changes the flux linkage across the vector by psi_m times its
 * rotation.
 */
#ifndef SERVO_SENSING_ROTOR_FOLLOW_H
#define SERVO_SENSING_ROTOR_FOLLOW_H

#include "math/frac.h"

typedef struct {
    uint16_t ticks;     /* slow ticks of the rotation, and of the rotation back */
    uint16_t step;      /* angle per slow tick, 2^16 is one turn */
    frac16_t inductive; /* omega L I, Q1.15 of full-scale voltage */
    int32_t flux_min; /* span of the flux linkage of a moved rotor: Q1.15 voltage summed over PWM periods */
} rotor_follow_config_t;

typedef struct {
    frac16_t theta; /* angle of the vector, Q1.15 of pi */
    uint16_t tick; /* slow ticks since the start */
    int32_t flux; /* flux linkage since the start: Q1.15 voltage across the vector, summed over PWM periods */
    int32_t low; /* smallest flux linkage since the start, as `flux` */
    int32_t high; /* largest flux linkage since the start, as `flux` */
} rotor_follow_t;

/* Begin with the vector at `theta`. */
void rotor_follow_start(rotor_follow_t *follow, frac16_t theta);

/* One PWM period; `u_across`: voltage across the vector, positive in the direction of the rotation. */
void rotor_follow_add(rotor_follow_t *follow, const rotor_follow_config_t *config, frac16_t u_across);

/* One slow tick: rotate the vector. True when it is back at its start. */
bool rotor_follow_step(rotor_follow_t *follow, const rotor_follow_config_t *config);

/* True if the rotor has moved. */
bool rotor_follow_seen(const rotor_follow_t *follow, const rotor_follow_config_t *config);

#endif
