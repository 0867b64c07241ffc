/* rotor_search.h - initial rotor position without Hall sensors: bisection with coordinate correction (DRM 2.4.3, F15).
 *
 * A current vector at theta_M makes the shaft twitch towards it; the direction halves [theta_L, theta_H], and what the
 * shaft has moved shifts both. The current grows slowly while nothing moves.
 *
 * Gentle: the coordinate correction holds within a twitch too - the vector goes with the shaft, so that its torque keeps
 * its size - and the brake is the pull played backwards with the current reversed. The shaft then stops, whatever its
 * inertia, about as far behind the first counts as these were from rest; friction stops it sooner.
 *
 * Nothing is assumed without a test. Where the rotor is assumed to lie, the vector turns a little at full
 * current until the shaft follows, and back: this cancels friction, and shows a shaft that leans on an end stop, which
 * twitches alone do not, and a reversed encoder, with which the shaft runs away from the vector. Where the largest current
 * moves nothing at all, a vector that turns by a wide angle tells by its voltage a shaft that is held from one that moves
 * unseen.
 */
#ifndef SERVO_SENSING_ROTOR_SEARCH_H
#define SERVO_SENSING_ROTOR_SEARCH_H

#include "sensing/rotor_follow.h"

typedef struct {
    frac32_t current_step;    /* growth of Ip per slow tick, while the rotor may be a quarter turn off the vector */
    frac32_t current_slew;    /* largest change of Ip per slow tick that the current controller follows */
    frac16_t current_limit;   /* largest Ip */
    uint16_t hold_ticks;      /* wait at the largest Ip, without another count, before "no movement" */
    uint16_t rest_ticks;      /* standstill after a twitch before its movement is measured */
    uint16_t move_counts;     /* movement that counts as a twitch; at least 2, one is what an edge does by itself */
    uint16_t verify_angle;    /* largest turn of the vector for the shaft to follow, 2^16 is a turn; below 2^15 */
    uint16_t verify_step;     /* angle per slow tick */
    int32_t angle_per_count;  /* electrical, 2^16 is a turn, 16 fraction bits */
    int32_t interval;         /* theta_H - theta_L at which the search ends, 2^16 is a turn */
    rotor_follow_config_t follow;
} rotor_search_config_t;

#define ROTOR_SEARCH_NO_CURRENT_MAX UINT16_C(64) /* PWM periods: 4 ms */

typedef enum {
    ROTOR_SEARCH_PULL,     /* the current at theta_M grows */
    ROTOR_SEARCH_DECELERATE,    /* reversed, it shrinks */
    ROTOR_SEARCH_REST,     /* none; then the windings are shorted until the shaft rests */
    ROTOR_SEARCH_VERIFY,   /* does the shaft follow the vector where the rotor is assumed to lie? */
    ROTOR_SEARCH_TURN,     /* nothing moves: does the rotor follow a turning vector unseen? */
    ROTOR_SEARCH_FOUND,
    ROTOR_SEARCH_NO_MOVEMENT,     /* the rotor does not move, or not far enough */
    ROTOR_SEARCH_NO_COUNT,    /* the rotor moves, the encoder does not count */
    ROTOR_SEARCH_REVERSED, /* the encoder counts the wrong way: the shaft runs away from where it was found */
    ROTOR_SEARCH_NO_CURRENT,  /* no current flows */
    ROTOR_SEARCH_HOLD,     /* the other way to search: rotor_hold.h */
} rotor_search_phase_t;

typedef struct {
    rotor_search_phase_t phase;
    frac16_t theta_m;  /* middle of the bounds at the start of this pull */
    uint16_t reach;    /* theta_H - theta_M = theta_M - theta_L, 2^16 is a turn */
    int16_t side;      /* the vector stands this many quarter turns beside theta_M: -1, 0, 1 */
    frac16_t vector;   /* angle of the current vector now */
    frac32_t current;  /* Ip along the vector; negative while it brakes */
    frac32_t brake_current;     /* Ip of the brake after the reversal .. */
    frac32_t reversal_step;    /* .. which takes so much per slow tick */
    bool current_decaying;         /* the current of a twitch is still controlled, to zero */
    int32_t origin;    /* position at the start of this pull */
    int32_t last_position;      /* position: the farthest while it brakes, the last one while it comes to rest */
    int32_t
        reference_position; /* position that the resting shaft has not left by more than a count; at the start of the turn */
    uint32_t ticks_without_movement; /* slow ticks that it has not */
    uint32_t ticks_at_limit; /* slow ticks at the largest Ip */
    uint16_t timer; /* slow ticks without another count */
    uint16_t moving; /* slow ticks since this pull's first count */
    uint16_t searches; /* vectors tried so far */
    int16_t direction; /* -1 or 1: of the last twitch, 0 when nothing moved; of the turn that verifies */
    bool follows; /* the shaft has followed this turn .. */
    frac16_t lead_angle; /* .. when the vector was so far ahead of the rotor, as far as that was known */
    bool verified; /* it has come back: found, once it rests */
    uint16_t runaways; /* times that the shaft ran away from where it was found */
    uint16_t verify_failures; /* times that it did not follow there, or came free only in TURN */
    uint32_t balance_angle; /* HOLD: angle of the vector at which the shaft stays where it was, 2^32 is a turn */
    uint16_t damping; /* HOLD: turn of the vector against a turn of the rotor per slow tick */
    uint16_t stage; /* HOLD: rotor_hold_stage_t */
    bool brake_released; /* HOLD: nothing but the current holds the shaft */
    uint16_t no_current_periods; /* PWM periods with less than a quarter of the current asked for */
    rotor_follow_t follow;
} rotor_search_t;

void rotor_search_start(rotor_search_t *search, int32_t position);

/* One PWM period in which the vector was applied: the current along it, the voltage across it. */
void rotor_search_watch(rotor_search_t *search, const rotor_search_config_t *config, frac16_t current,
                        frac16_t u_across);

/* One slow tick with the position in counts. */
void rotor_search_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position);

/* True while a current vector is to be applied. */
bool rotor_search_drives(const rotor_search_t *search);

/* Electrical angle of the vector; once found, of the rotor. */
frac16_t rotor_search_angle(const rotor_search_t *search);

#endif
