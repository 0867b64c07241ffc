/* rotor_search.h - initial rotor position without Hall sensors: bisection with coordinate correction (DRM 2.4.3, F15).
 *
 * PULL: a current vector at theta_M with slowly growing current makes the shaft twitch towards it. The direction of the
 * twitch halves the interval [theta_L, theta_H], the movement shifts it.
 *
 * DECELERATE: during a twitch the vector follows the shaft, so the torque stays constant. The pull is then repeated in
 * reverse order with negative current, which stops the shaft after about the same distance, independent of the inertia;
 * friction shortens it.
 *
 * VERIFY: at full current the shaft comes to rest on the vector, whatever the error of the bisection (a heavy shaft
 * swings first). Then the vector is rotated to one side until the shaft follows, and back; if the shaft does not follow,
 * to the other side. The mean of both directions eliminates friction. The rotation also detects an end stop, which
 * twitches do not. With a reversed encoder the bisection ends opposite to the rotor, and the shaft runs away.
 *
 * DIRECTION: the shaft has run away repeatedly, or once when the time of the search is over, by a reversed encoder, a load
 * or a disturbance. The vector is rotated by one and a half electrical turns: only an encoder that counts against it is
 * reversed.
 *
 * TURN: if nothing moves at full current, the voltage during a wide rotation distinguishes a blocked shaft from a dead
 * encoder (rotor_follow.h).
 */
#ifndef SERVO_SENSING_ROTOR_SEARCH_H
#define SERVO_SENSING_ROTOR_SEARCH_H

#include "sensing/rotor_follow.h"

typedef struct {
    frac32_t current_step; /* increase of Ip per slow tick, with the rotor up to a quarter turn off the vector */
    frac32_t current_slew; /* largest change of Ip per slow tick that the current controller follows */
    frac16_t current_limit; /* largest Ip, Q1.15 of full-scale current */
    uint16_t hold_ticks; /* slow ticks at the largest Ip without a count before "no movement"; one swing of the shaft */
    uint16_t rest_ticks; /* slow ticks of standstill after a twitch before its movement is measured */
    uint16_t move_counts; /* smallest movement of a twitch, counts; at least 2, because an edge dithers by one count */
    uint16_t verify_angle; /* VERIFY: largest rotation of the vector, 2^16 is one turn; below 2^15 */
    uint16_t verify_step; /* VERIFY: angle per slow tick, 2^16 is one turn */
    int32_t angle_per_count; /* electrical angle per count, 2^16 is one turn, 16 fraction bits */
    int32_t interval; /* theta_H - theta_L at which the bisection ends, 2^16 is one turn */
    rotor_follow_config_t follow;
} rotor_search_config_t;

#define ROTOR_SEARCH_LOW_CURRENT_MAX UINT16_C(64) /* PWM periods: 4 ms */

typedef enum {
    ROTOR_SEARCH_PULL, /* growing current at theta_M */
    ROTOR_SEARCH_DECELERATE, /* decreasing negative current */
    ROTOR_SEARCH_REST, /* current ramp to zero, then shorted windings until standstill */
    ROTOR_SEARCH_VERIFY, /* rotation of the vector: the shaft must follow */
    ROTOR_SEARCH_TURN, /* no movement at full current: wide rotation, evaluated by the voltage */
    ROTOR_SEARCH_FOUND, /* done */
    ROTOR_SEARCH_NO_MOVEMENT, /* failed: the rotor does not move, not far enough, or does not stay on the vector */
    ROTOR_SEARCH_NO_COUNT, /* failed: the rotor moves, the encoder does not count */
    ROTOR_SEARCH_REVERSED, /* failed: the encoder counts in the wrong direction */
    ROTOR_SEARCH_LOW_CURRENT, /* failed: less than a quarter of the requested current flows */
    ROTOR_SEARCH_HOLD, /* search with a holding brake: rotor_hold.h */
    ROTOR_SEARCH_DIRECTION, /* the shaft has run away: rotation of the vector, evaluated by the count */
} rotor_search_phase_t;

typedef struct {
    rotor_search_phase_t phase;
    frac16_t theta_m; /* middle of the interval at the start of this pull, Q1.15 of pi */
    uint16_t reach; /* theta_H - theta_M = theta_M - theta_L, 2^16 is one turn */
    int16_t side; /* offset of the vector from theta_M, quarter turns: -1, 0, 1 */
    frac16_t vector; /* angle of the current vector, Q1.15 of pi */
    frac32_t current; /* Ip along the vector, negative in DECELERATE; Q1.31 of full-scale current */
    frac32_t reversed_current; /* DECELERATE: Ip after the reversal, Q1.31 of full-scale current */
    frac32_t reversal_step; /* DECELERATE: change of Ip per slow tick in the reversal, Q1.31 of full-scale current */
    bool current_decaying; /* REST: the current is still controlled, to zero */
    int32_t origin; /* position at the start of this pull or rotation, counts */
    int32_t last_position; /* position of the previous slow tick, counts */
    int32_t reference_position; /* REST: a movement leaves it by more than one count; VERIFY: start of the rotation */
    uint32_t ticks_without_movement; /* slow ticks since `reference_position` was set */
    uint32_t ticks_at_limit; /* slow ticks at the largest Ip */
    uint16_t timer; /* slow ticks without another count */
    uint16_t moving; /* slow ticks since the first count of this pull */
    uint16_t searches; /* number of pulls */
    int16_t direction; /* direction of the last twitch, or of the rotation in VERIFY: -1, 1; 0: no movement */
    bool follows; /* VERIFY: the shaft has followed this rotation */
    /* VERIFY: lead of the vector over the assumed rotor angle when the shaft followed. HOLD: rotation of the vector in
     * the check, then the angle of the vector at full current. Q1.15 of pi. */
    frac16_t lead_angle;
    bool verified; /* VERIFY: the shaft has returned; found as soon as it rests */
    int32_t half_turns_sum; /* DIRECTION: positions of the third half turn minus those of the second, counts */
    uint16_t runaways; /* times that the shaft ran away from the assumed position */
    uint16_t verify_failures; /* times that the shaft did not follow in VERIFY, or moved only in TURN */
    uint32_t balance_angle; /* HOLD: angle of the vector at which the shaft keeps its position, 2^32 is one turn */
    uint16_t damping; /* HOLD: rotation of the vector / rotation of the rotor per slow tick */
    uint16_t stage; /* HOLD: rotor_hold_stage_t */
    bool brake_released; /* HOLD: the holding brake is open */
    uint16_t low_current_periods; /* consecutive PWM periods with less than a quarter of the requested current */
    rotor_follow_t follow;
} rotor_search_t;

/* Begin at `position` [counts] with an unknown rotor angle. */
void rotor_search_start(rotor_search_t *search, int32_t position);

/* One PWM period with the vector applied: current along it, voltage across it. */
void rotor_search_add(rotor_search_t *search, const rotor_search_config_t *config, frac16_t current, frac16_t u_across);

/* One slow tick; `position` in counts. */
void rotor_search_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position);

/* The time of the search is over: a shaft that has run away is tested for the direction of the encoder. False: nothing is
 * left to test; true until the test has ended by itself. */
bool rotor_search_tests_direction(rotor_search_t *search, int32_t position);

/* True while the current vector must be applied. */
bool rotor_search_drives(const rotor_search_t *search);

/* Electrical angle of the vector; after ROTOR_SEARCH_FOUND, of the rotor. */
frac16_t rotor_search_angle(const rotor_search_t *search);

#endif
