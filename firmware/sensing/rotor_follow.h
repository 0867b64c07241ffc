/* rotor_follow.h - does the rotor follow a turning current vector? Seen from the voltage, without the encoder.
 *
 * The vector turns by a known angle and back. Across it the windings need
 *   u = omega L I + psi_m cos(delta) d(theta_e)/dt      (delta: rotor against vector)
 * where R I and most of the error of dead time lie along it. A rotor that stays leaves only omega L I, which is known and
 * taken away; one that follows, or swings, changes the flux linkage across the vector by psi_m times its angle.
 */
#ifndef SERVO_SENSING_ROTOR_FOLLOW_H
#define SERVO_SENSING_ROTOR_FOLLOW_H

#include "math/frac.h"

typedef struct {
    uint16_t ticks;     /* slow ticks of the way there, and again of the way back */
    uint16_t step;      /* angle per slow tick, 2^16 is a turn */
    frac16_t inductive; /* omega L I */
    int32_t flux_min; /* span of the flux linkage that only a moving rotor makes: voltage summed over PWM periods */
} rotor_follow_config_t;

typedef struct {
    frac16_t theta; /* angle of the vector */
    uint16_t tick; /* slow ticks since the start */
    int32_t flux; /* sum of the voltage across the vector since the start, and its extremes */
    int32_t low; /* least flux */
    int32_t high; /* largest flux */
} rotor_follow_t;

/* The vector stands at `theta`. */
void rotor_follow_start(rotor_follow_t *follow, frac16_t theta);

/* One PWM period with the voltage across the vector (positive where the vector turns to). */
void rotor_follow_add(rotor_follow_t *follow, const rotor_follow_config_t *config, frac16_t u_across);

/* One slow tick: the vector turns. True when it is back. */
bool rotor_follow_step(rotor_follow_t *follow, const rotor_follow_config_t *config);

/* True when the rotor has moved. */
bool rotor_follow_seen(const rotor_follow_t *follow, const rotor_follow_config_t *config);

#endif
