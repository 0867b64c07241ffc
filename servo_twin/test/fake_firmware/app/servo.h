/* servo.h - replaces the application: records times and arguments of the calls by the chip. */
#ifndef FAKE_SERVO_H
#define FAKE_SERVO_H

#include "hal/hal.h"

#define FAKE_CALLS 4096

enum { CALL_M1, CALL_M2, CALL_EDGE, CALL_OVER_CURRENT, CALL_BACKGROUND };

typedef struct {
    uint64_t time_ns;
    int kind, axis;
    adc_pair_t currents, offsets; /* of axis 1 for CALL_M1, of axis 2 for CALL_M2 (offsets: of the other axis) */
    uint16_t bus;
} fake_call_t;

typedef struct {
    hal_t *hal;
    fake_call_t call[FAKE_CALLS];
    int calls;
    bool log_background;
    bool deaf;                     /* do not fetch received bytes */
    bool echo;                     /* return received bytes */
    int16_t duty[HAL_AXES][3];     /* written in every interrupt of the axis */
    bool on[HAL_AXES];
    edge_capture_t capture;        /* of the last edge interrupt */
    uint8_t pending;
    bool has_pending;
} servo_t;

typedef struct servo_config servo_config_t;
void servo_init(servo_t *servo, hal_t *hal, const servo_config_t *config);
void servo_m1_isr(servo_t *servo);
void servo_m2_isr(servo_t *servo);
void servo_edge_isr(servo_t *servo, uint16_t axis);
void servo_over_current_isr(servo_t *servo, uint16_t axis);
void servo_background(servo_t *servo);

#endif
