/* feedback_data.h - data of the feedback sources (feedback.h). All sources provide feedback_t; the controllers use
 * nothing else.
 */
#ifndef SERVO_DRIVE_FEEDBACK_DATA_H
#define SERVO_DRIVE_FEEDBACK_DATA_H

#include "sensing/encoder.h"
#include "sensing/mt_speed.h"
#include "sensing/speed_observer.h"

struct axis;

typedef struct {
    frac16_t theta_e; /* fast loop: electrical angle at the sampling instant, Q1.15 of pi */
    frac32_t speed; /* slow loop: mechanical, Q1.31 of full-scale speed */
    frac32_t mean_speed; /* slow loop: mean of the last slow tick from whole position counts; the sum is the distance */
    int32_t position; /* slow loop: multi-turn position, nearest position count (POSITION_PER_TURN to a turn) */
    int32_t part; /* slow loop: position minus that count, 24 fraction bits */
    int32_t count; /* slow loop: encoder counts, for movements of a few counts; no relation to `position` */
    bool still; /* slow loop: no movement within the longest measuring interval of the source */
} feedback_t;

typedef struct {
    void (*reset)(struct axis *axis);
    void (*fast)(struct axis *axis); /* updates theta_e */
    bool (*slow)(struct axis *axis); /* updates speeds, position, still; false: contradictory measurements */
    void (*edge)(struct axis *axis); /* edge interrupt */
    void (*resync)(struct axis *axis); /* clears contradictions after a fault was cleared */
    void (*align)(struct axis *axis, frac16_t theta_e); /* sets the encoder offset: the rotor is at theta_e */
} feedback_source_t;

/* State of the encoder source. The edge interrupt has the lowest priority and may be interrupted by the slow loop:
 * it only stores the captured edge, the slow loop evaluates it. */
typedef struct {
    encoder_t counter;
    encoder_position_t position;
    int16_t resolution; /* a count of the encoder in whole position counts, at least 1 */
    mt_speed_t speed;
    speed_observer_t observer;
    bool observes; /* the speed observer is running and provides the speed */
    edge_capture_t edge; /* last captured edge */
    volatile bool edge_waits; /* `edge` is not evaluated yet */
    bool skip_edge; /* the next edge may have been captured before the counter was preset */
    bool found; /* a rotor search was successful before: the position is counted from there (E41) */
} encoder_feedback_t;

/* Position of a sensorless axis. */
typedef struct {
    int32_t counts; /* position counts; continues from the position at the reset of the source */
    uint16_t rest; /* fraction of a count, 16 fraction bits */
    uint32_t angle; /* electrical angle of the last slow tick, 2^32 is one turn */
} observer_feedback_t;

#endif
