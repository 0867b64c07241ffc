/* encoder_watch.h - an encoder that says less than the shaft does.
 *
 * One dead line leaves a count that goes one back and forth with the edges of the other one, faster than a shaft at rest
 * can; two leave a count that stands while the voltage shows that the motor turns.
 */
#ifndef SERVO_DRIVE_ENCODER_WATCH_H
#define SERVO_DRIVE_ENCODER_WATCH_H

#include "control/transforms.h"
#include "drive/faults.h"

/* Slow ticks without movement after which the shaft is slower than any back-EMF that counts here. */
#define ENCODER_CALM_TICKS 4
#define ENCODER_DOUBT_TICKS 20 /* at rest after a sudden stop, before a current is sent through the windings */

typedef struct {
    int32_t anchor;   /* position that the count has not left by more than two */
    int32_t last;     /* position of the last tick */
    uint16_t calm;    /* slow ticks that it has not */
    uint16_t window;  /* slow ticks of the present window .. */
    uint16_t toggles; /* .. and those in which the count has changed */
    int32_t toggled;  /* way of the last change .. */
    bool hunts;       /* .. and one of this window was not its opposite */
    uint8_t windows;  /* windows in a row with more changes than a resting shaft makes */
    uint16_t pace;    /* counts of the last tick that moved the shaft, a part of which it may have stood .. */
    uint16_t earlier; /* .. and of the one before */
    bool sudden;      /* it has come to rest at once */
    frac16_t wanted;  /* i_q* of the last tick */
    dq_t rest;        /* voltage that the current does not need, of late */
    uint16_t turning; /* slow ticks of unexplained voltage without a count, less those without */
    uint16_t idle;    /* those of them without current */
    uint16_t in_vain; /* slow ticks of much of it */
    uint8_t asking;   /* slow ticks for which a current has been asked to see whether any flows .. */
    bool along_q;     /* .. in this direction .. */
    frac16_t before;  /* .. in which this has flowed before */
    uint16_t probing; /* slow ticks for which one has been sent to see whether the voltage stays .. */
    frac16_t held;    /* .. with an i_q* that does .. */
    uint8_t swings;   /* .. and of late has not */
    dq_t emf;         /* that voltage at first .. */
    uint32_t swept;   /* .. how far it would have turned since if it were a back-EMF, 2^16 a turn .. */
    bool turned;      /* .. and it has pointed elsewhere */
    bool rigid;       /* it has not for longer than that */
} encoder_watch_t;

struct axis;

/* The shaft rests at `position`. */
void encoder_watch_start(encoder_watch_t *watch, int32_t position);

/* One slow tick, after the source; in every state that has an encoder. */
fault_set_t encoder_watch_count(struct axis *axis);

/* One slow tick of current control with the encoder's angle. */
fault_set_t encoder_watch_voltage(struct axis *axis);

static inline bool encoder_watch_is_asking(const encoder_watch_t *watch)
{
    return watch->asking != 0U || watch->probing != 0U;
}

/* The shaft has just stopped at once, or the encoder has died, and the angle with it: it will show. */
static inline bool encoder_watch_wonders(const encoder_watch_t *watch)
{
    return watch->sudden && watch->calm < ENCODER_DOUBT_TICKS;
}

/* Current that is asked for then, to see whether any flows. */
dq_t encoder_watch_asks(const struct axis *axis);

/* What an over-current may really have been: windings shorted because the shaft seemed to rest. */
fault_set_t encoder_watch_suspects(const struct axis *axis);

/* One slow tick with shorted windings: what drives their current? */
fault_set_t encoder_watch_short(struct axis *axis);

#endif
