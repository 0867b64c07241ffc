/* rotor_hold.h - initial rotor position of a shaft with a holding brake and a load.
 *
 * Extension of the reference design, whose search needs a shaft that rests without a brake. The full current flows
 * before the brake opens. Then the vector is rotated so that the shaft keeps its position: it converges to the lead
 * angle phi_1 over the rotor at which the torque of the current, I sin(phi_1), equals the load torque. With half of the
 * current the lead angle is phi_2; the vector has rotated by D = phi_2 - phi_1, and sin(phi_1 + D) = 2 sin(phi_1) gives
 * the rotor angle. A small rotation in between checks that the shaft follows. This excludes a blocked shaft and a
 * reversed encoder. Largest load: half of the largest torque.
 */
#ifndef SERVO_SENSING_ROTOR_HOLD_H
#define SERVO_SENSING_ROTOR_HOLD_H

#include "sensing/rotor_search.h"

/* Begin. `acceleration`: by the full-scale current, counts per slow tick squared, 22 fraction bits. */
void rotor_hold_start(rotor_search_t *search, const rotor_search_config_t *config, int32_t position,
                      int32_t acceleration);

/* One slow tick. After ROTOR_SEARCH_FOUND `current` is the q component, which holds the load. */
void rotor_hold_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position);

/* True from full current on: the brake may open. */
bool rotor_hold_opens_brake(const rotor_search_t *search);

#endif
