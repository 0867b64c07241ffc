/* rotor_hold.h - initial position of a rotor whose shaft a brake holds and a load pulls.
 *
 * Beyond the reference design, whose search needs a shaft that rests by itself. The full current flows before the brake opens.
 * From then on the vector turns so that the shaft stays where it was: it converges to the angle at which the torque of the
 * current, I sin(phi), is that of the load, phi ahead of the rotor. With half of the current that is phi_2, the vector has
 * turned by D = phi_2 - phi_1, and sin(phi_1 + D) = 2 sin(phi_1) gives the rotor. A small way there and back in between shows
 * that the shaft follows, and is not held fast, or seen the wrong way round. No load above half of the largest torque can be
 * held.
 */
#ifndef SERVO_SENSING_ROTOR_HOLD_H
#define SERVO_SENSING_ROTOR_HOLD_H

#include "sensing/rotor_search.h"

/* `acceleration`: counts per slow tick squared by the full-scale current, 22 fraction bits. */
void rotor_hold_start(rotor_search_t *search, const rotor_search_config_t *config, int32_t position,
                      int32_t acceleration);

/* One slow tick. Once found, `current` is the part of it across the rotor, which holds the load. */
void rotor_hold_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position);

/* True when the brake is to open. */
bool rotor_hold_holds(const rotor_search_t *search);

#endif
