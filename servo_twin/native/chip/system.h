/* system.h - clock generation (OCCS), system integration (SIM), watchdog (COP), power and flash controllers as far as a
 * start-up touches them. */
#ifndef CHIP_SYSTEM_H
#define CHIP_SYSTEM_H

#include <stdbool.h>
#include <stdint.h>

typedef enum { RESET_POWER_ON = 1u << 2, RESET_COP = 1u << 5, RESET_SOFTWARE = 1u << 6 } reset_cause_t;

typedef struct {
    uint16_t ctrl, divby, osctl1, osctl2, prot;
    uint64_t lock_clock; /* PLL locked */
    uint64_t switch_clock; /* ZSRCS follows ZSRC */
    uint64_t crystal_clock; /* OSC_OK */
} occs_t;

typedef struct {
    uint16_t ctrl, rstat, scr[4], pcr, pce[4], sd[4], prot, ips0, misc0, pwrmode;
} sim_t;

typedef struct {
    uint16_t ctrl, tout, intval;
    uint64_t start_clock; /* count is TOUT here */
    bool half_served; /* 5555 has been written */
    uint32_t services;
} cop_t;

#endif
