/* encoder_monitor.h - an encoder whose count lags the shaft.
 *
 * One dead line leaves a count that goes one back and forth with the edges of the other one, faster than a shaft at rest
 * can; two leave a count that stands while the voltage shows that the motor turns.
 */
#ifndef SERVO_DIAGNOSIS_ENCODER_MONITOR_H
#define SERVO_DIAGNOSIS_ENCODER_MONITOR_H

#include "diagnosis/evidence.h"
#include "diagnosis/observation.h"

/* Slow ticks at rest after a sudden stop, before a current is sent through the windings. */
#define ENCODER_CONFIRM_TICKS 20U

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
    uint16_t windup;  /* slow ticks of so much of it that no current follows */
    uint8_t testing;  /* slow ticks for which a current has been asked to see whether any flows .. */
    bool along_q;     /* .. in this direction .. */
    bool back;        /* .. or against it: i_q* may be at its limit .. */
    frac16_t before;  /* .. in which this has flowed before */
    uint16_t probing; /* slow ticks for which one has been sent to see whether the voltage stays .. */
    frac16_t held;    /* .. with an i_q* that does .. */
    uint8_t swings;   /* .. and of late has not */
    dq_t emf;         /* that voltage at first .. */
    uint32_t swept;   /* .. how far it would have turned since if it were a back-EMF, 2^16 a turn .. */
    bool turned;      /* .. and it has pointed elsewhere */
    bool rigid;       /* it has not for longer than that */
} encoder_monitor_t;

/* The shaft rests at `position`. */
void encoder_monitor_start(encoder_monitor_t *monitor, int32_t position);

/* One slow tick with an encoder, in every state; sets `observation->calm`. `kp` is the gain of the q current controller. */
void encoder_monitor_step(encoder_monitor_t *monitor, const winding_config_t *config, gain_t kp,
                          observation_t *observation, evidence_t *evidence);

/* The shaft has just stopped at once, or the encoder has died, and the angle with it: it will show. */
static inline bool encoder_monitor_stop_unconfirmed(const encoder_monitor_t *monitor)
{
    return monitor->sudden && monitor->calm < ENCODER_CONFIRM_TICKS;
}

void encoder_monitor_suspect(const encoder_monitor_t *monitor, const observation_t *observation, evidence_t *evidence);

#endif
