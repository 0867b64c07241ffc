/* feedback_data.h - where an axis takes its angle and speed from.
 *
 * A source fills the same numbers whatever it measures: the encoder, or the observer of a sensorless axis. The
 * controllers know only `feedback_t`.
 */
#ifndef SERVO_DRIVE_FEEDBACK_DATA_H
#define SERVO_DRIVE_FEEDBACK_DATA_H

#include "sensing/encoder.h"
#include "sensing/mt_speed.h"
#include "sensing/speed_observer.h"

struct axis;

typedef struct {
    frac16_t theta_e; /* electrical angle at the sampling instant, fast loop */
    frac32_t speed;   /* mechanical, slow loop */
    frac32_t mean_speed; /* over the last slow tick; as coarse as a count, but the sum of it is the way */
    int32_t position; /* multi-turn counts, slow loop */
    bool still;       /* no movement seen for the source's own longest interval */
} feedback_t;

typedef struct {
    void (*reset)(struct axis *axis);
    void (*fast)(struct axis *axis);               /* theta_e */
    bool (*slow)(struct axis *axis);               /* speeds, position, still; false: the source contradicts itself */
    void (*edge)(struct axis *axis);               /* edge interrupt */
    void (*resync)(struct axis *axis); /* a fault has been cleared: contradictions of the past are settled */
    void (*align)(struct axis *axis, frac16_t theta_e); /* the rotor stands at theta_e */
} feedback_source_t;

/* State of the encoder source. The edge interrupt has the lowest priority and may be cut in two by the slow loop, so it
 * only leaves the latched edge here; the slow loop computes. */
typedef struct {
    encoder_t position;
    mt_speed_t speed;
    speed_observer_t observer;
    bool observes; /* the observer runs and gives the speed */
    edge_capture_t edge;
    volatile bool edge_waits;
    bool skip_edge; /* the next edge may have been latched before the counter was preset */
    bool found; /* the rotor has been found before: positions count from there (E41) */
} encoder_feedback_t;

/* What the observer has seen the shaft turn, in counts of the encoder that is not there. */
typedef struct {
    int32_t counts; /* counts since the source was reset */
    uint16_t rest; /* 16 fraction bits */
    uint32_t angle; /* of the last slow tick, 2^32 is an electrical turn */
} observer_feedback_t;

#endif
