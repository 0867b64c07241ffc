/* rotor_search.h - initial rotor position without Hall sensors: bisection with coordinate correction (DRM 2.4.3, F15).
 *
 * A current vector at theta_M makes the shaft twitch towards it; the direction halves [theta_L, theta_H]. The current
 * grows slowly while nothing moves, and the windings are shorted as soon as something does, so that the shaft moves by
 * a few counts only. What it moved shifts both bounds.
 */
#ifndef SERVO_SENSING_ROTOR_SEARCH_H
#define SERVO_SENSING_ROTOR_SEARCH_H

#include "math/frac.h"

typedef struct {
    frac32_t current_step;    /* growth of Ip per slow tick */
    frac16_t current_limit;   /* largest Ip */
    uint16_t hold_ticks;      /* wait at the largest Ip before "no movement" */
    uint16_t rest_ticks;      /* standstill after a twitch before its movement is measured */
    uint16_t move_counts;     /* movement that counts as a twitch */
    int32_t angle_per_count;  /* electrical, 2^16 is a turn, 16 fraction bits */
    int32_t interval;         /* theta_H - theta_L at which the search ends, 2^16 is a turn */
} rotor_search_config_t;

typedef enum {
    ROTOR_SEARCH_PULL, /* the current at theta_M grows */
    ROTOR_SEARCH_REST, /* the windings are shorted until the shaft rests */
    ROTOR_SEARCH_FOUND,
    ROTOR_SEARCH_FAILED, /* no movement in any direction */
} rotor_search_phase_t;

typedef struct {
    rotor_search_phase_t phase;
    int32_t theta_l; /* bounds, 2^16 is a turn; not wrapped */
    int32_t theta_m;
    int32_t theta_h;
    frac32_t current; /* Ip */
    int32_t origin;   /* position at the start of this pull */
    int32_t rest_position;
    uint16_t timer;
    uint16_t searches; /* vectors tried so far */
    int16_t direction; /* of the last twitch: -1, 1, or 0 when nothing moved */
    bool from_side;    /* the vector that moved nothing is being checked from the side */
} rotor_search_t;

void rotor_search_start(rotor_search_t *search, int32_t position);

/* One slow tick with the position in counts. */
void rotor_search_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position);

/* Electrical angle of the vector; once found, of the rotor. */
frac16_t rotor_search_angle(const rotor_search_t *search);

#endif
