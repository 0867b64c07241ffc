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
    int32_t reference_position;   /* position that the count has not left by more than two */
    int32_t last_position;     /* position of the last tick */
    uint16_t ticks_without_movement;    /* slow ticks that it has not */
    uint16_t window_ticks;  /* slow ticks of the present window .. */
    uint16_t window_changes; /* .. and those in which the count has changed */
    int32_t last_change;  /* way of the last change .. */
    bool not_alternating;       /* .. and one of this window was not its opposite */
    uint8_t alternating_windows;  /* windows in a row with more changes than a resting shaft makes */
    uint16_t step_counts;    /* counts of the last tick that moved the shaft, a part of which it may have stood .. */
    uint16_t earlier_step_counts; /* .. and of the one before */
    bool stopped_abruptly;      /* it has come to rest at once */
    frac16_t last_i_q_ref;  /* i_q* of the last tick */
    dq_t unexplained_voltage;        /* voltage that the current does not need, of late */
    uint16_t unexplained_ticks; /* slow ticks of unexplained voltage without a count, less those without */
    uint16_t ticks_without_current;    /* those of them without current */
    uint16_t windup_ticks;  /* slow ticks of so much of it that no current follows */
    uint8_t test_ticks;  /* slow ticks for which a current has been asked to see whether any flows .. */
    bool along_q;     /* .. in this direction .. */
    bool negative_q;        /* .. or against it: i_q* may be at its limit .. */
    frac16_t current_before_test;  /* .. in which this has flowed before */
    uint16_t probe_ticks; /* slow ticks for which one has been sent to see whether the voltage stays .. */
    frac16_t i_q_ref_at_probe;    /* .. with an i_q* that does .. */
    uint8_t voltage_change_ticks;   /* .. and of late has not */
    dq_t reference_voltage;         /* that voltage at first .. */
    uint32_t expected_rotation;   /* .. how far it would have turned since if it were a back-EMF, 2^16 a turn .. */
    bool direction_changed;      /* .. and it has pointed elsewhere */
    bool direction_was_constant;       /* it has not for longer than that */
} encoder_monitor_t;

/* The shaft rests at `position`. */
void encoder_monitor_start(encoder_monitor_t *monitor, int32_t position);

/* One slow tick with an encoder, in every state; sets `observation->ticks_without_movement`. `kp` is the gain of the q current controller. */
void encoder_monitor_step(encoder_monitor_t *monitor, const winding_config_t *config, gain_t kp,
                          observation_t *observation, evidence_t *evidence);

/* The shaft has just stopped at once, or the encoder has died, and the angle with it: it will show. */
static inline bool encoder_monitor_stop_unconfirmed(const encoder_monitor_t *monitor)
{
    return monitor->stopped_abruptly && monitor->ticks_without_movement < ENCODER_CONFIRM_TICKS;
}

void encoder_monitor_suspect(const encoder_monitor_t *monitor, const observation_t *observation, evidence_t *evidence);

#endif
