/* fake_hal.h - a board without physics: a test writes what the firmware reads and reads what it writes. */
#ifndef TEST_FAKE_HAL_H
#define TEST_FAKE_HAL_H

#include "hal/hal.h"

#define FAKE_EVENTS 512
#define FAKE_SERIAL 512
#define FAKE_FLASH (HAL_FLASH_SECTORS * HAL_FLASH_SECTOR_WORDS)

typedef enum {
    FAKE_ADC_SELECT, /* value: pair */
    FAKE_ADC_CURRENTS,
    FAKE_ADC_OFFSETS,
    FAKE_ADC_BUS, /* axis: 0xFFFF */
    FAKE_PWM_DUTY, /* value: duty of phase a */
    FAKE_PWM_ENABLE, /* value: on */
    FAKE_BREAK_CLEAR,
    FAKE_ENCODER_COUNT,
    FAKE_ENCODER_START, /* value: period */
    FAKE_ENCODER_PRESET, /* value: count */
    FAKE_INDEX_COUNT,
    FAKE_CAPTURE_ARM,
    FAKE_CAPTURE_TAKE, /* value: an edge was captured */
    FAKE_EDGE_AGE,
    FAKE_WATCHDOG, /* axis: 0xFFFF */
} fake_call_t;

typedef struct {
    uint16_t call; /* fake_call_t */
    uint16_t axis;
    int32_t value;
} fake_event_t;

typedef struct {
    /* inputs of the firmware */
    uint16_t current_code[3]; /* per phase */
    uint16_t offset_code[3];
    uint16_t temperature_code;
    uint16_t count;
    uint16_t index;
    uint32_t age;
    edge_capture_t edge;
    bool edge_waits;
    bool over_current; /* while it is set, the latch cannot be released */
    bool break_latched;
    uint16_t inputs; /* HAL_INPUT_ bits */
    bool enable_used;
    bool holding_released;
    /* outputs of the firmware */
    phase_pair_t pair;
    int16_t duty[3];
    bool outputs_on;
    bool armed;
    uint32_t times_on;  /* transitions of the outputs from off to on */
    uint32_t times_off; /* transitions of the outputs from on to off */
} fake_axis_t;

struct hal {
    fake_axis_t axis[HAL_AXES];
    uint16_t bus_code;
    uint16_t monitor[HAL_ANALOG_OUTS];
    bool brake_resistor;
    bool reset_by_watchdog;
    uint16_t late_loops;
    uint16_t receiver_overruns;
    uint16_t duties_done[HAL_AXES];
    uint32_t watchdog;
    uint8_t serial_in[FAKE_SERIAL];
    uint16_t serial_in_size;
    uint16_t serial_in_taken;
    uint8_t serial_out[FAKE_SERIAL];
    uint16_t serial_out_size;
    uint32_t flash[FAKE_FLASH];
    bool flash_absent;
    uint16_t flash_polls; /* polls for which a command is busy */
    uint16_t flash_left;  /* remaining polls of the present command */
    uint16_t flash_commands; /* started commands */
    uint16_t flash_reads;  /* reads during a command, which are not permitted */
    bool flash_erases;     /* the present command is an erase */
    uint16_t flash_at;     /* sector or word of the present command */
    uint32_t flash_value;
    bool flash_fails; /* the controller reports an error from now on */
    uint32_t flash_stuck; /* bits that no command changes */
    bool logging;
    uint16_t events;
    fake_event_t event[FAKE_EVENTS];
};

/* Mid-scale currents, a bus of 24 V, shafts at rest for a long time. */
void fake_hal_init(hal_t *hal);

#endif
