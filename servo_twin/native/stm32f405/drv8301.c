#include "stm32f405/drv8301.h"

#define READ 0x8000u
#define ADDRESS(frame) ((frame) >> 11 & 15u)
#define DATA(frame) ((frame) & 0x7FFu)

enum { STATUS1, STATUS2, CONTROL1, CONTROL2 };

#define STATUS1_FAULT 0x400u
#define STATUS1_OC 0x3Fu /* FETLC_OC .. FETHA_OC */
#define STATUS2_ID 1u
#define CONTROL1_GATE_RESET 4u
#define CONTROL1_PWM_MODE 8u
#define CONTROL1_OCP_MODE(x) ((x) >> 4 & 3u)
#define CONTROL1_RESET 0x400u
#define CONTROL2_GAIN(x) ((x) >> 2 & 3u)
#define CONTROL2_DC_CAL(x, channel) ((x) >> (4u + (channel)) & 1u)

enum { OCP_LIMIT, OCP_LATCH, OCP_REPORT, OCP_NONE };

static bool works(const drv8301_t *drv) { return drv->ready_clock <= drv->soc->bus.now; }

bool drv8301_drives(const drv8301_t *drv, unsigned d)
{
    const drv8301_driver_t *driver = &drv->driver[d];
    const unsigned mode = CONTROL1_OCP_MODE(driver->control1);
    return works(drv) && !driver->latched && !(mode == OCP_LIMIT && driver->over_current);
}

bool drv8301_fault_pin(const drv8301_t *drv)
{
    bool fault = !works(drv);
    for (unsigned d = 0; d < DRV8301_DRIVERS; d++) {
        fault = fault || (drv->driver[d].status1 & STATUS1_FAULT) != 0;
    }
    return !fault;
}

unsigned drv8301_gain(const drv8301_t *drv, unsigned d) { return 10u << CONTROL2_GAIN(drv->driver[d].control2); }

bool drv8301_calibrates(const drv8301_t *drv, unsigned d, unsigned channel)
{
    return CONTROL2_DC_CAL(drv->driver[d].control2, channel) != 0;
}

static void changed(const drv8301_t *drv, unsigned d) { drv->soc->signals->driver_changed(drv->soc->chip, d); }

static void changed_all(const drv8301_t *drv)
{
    for (unsigned d = 0; d < DRV8301_DRIVERS; d++) {
        changed(drv, d);
    }
}

/* ---- enable --------------------------------------------------------------------------------------------------------- */

static void lose_registers(drv8301_driver_t *driver)
{
    driver->status1 = driver->control2 = 0;
    driver->control1 = CONTROL1_RESET;
    driver->latched = false;
    driver->answer = 0;
}

void drv8301_enable(drv8301_t *drv, bool level)
{
    if (level == drv->enabled) {
        return;
    }
    drv->enabled = level;
    drv->ready_clock = level ? drv->soc->bus.now + DRV8301_START_CLOCKS : CHIP_NEVER;
    for (unsigned d = 0; d < DRV8301_DRIVERS; d++) {
        lose_registers(&drv->driver[d]);
    }
    bus_plan(&drv->soc->bus, SOC_EVENT_DRIVER, drv->ready_clock);
    changed_all(drv);
}

void drv8301_event(void *peripheral, unsigned source)
{
    drv8301_t *drv = (drv8301_t *)peripheral;
    bus_plan(&drv->soc->bus, source, CHIP_NEVER);
    changed_all(drv);
}

/* ---- frames --------------------------------------------------------------------------------------------------------- */

static uint16_t answer_of(unsigned address, unsigned data) { return (uint16_t)(address << 11 | data); }

static void execute(drv8301_t *drv, unsigned d)
{
    drv8301_driver_t *driver = &drv->driver[d];
    const unsigned address = ADDRESS(driver->frame), data = DATA(driver->frame);
    if ((driver->frame & READ) != 0) {
        const unsigned value[4] = {driver->status1, STATUS2_ID, driver->control1, driver->control2};
        driver->answer = answer_of(address, (address <= CONTROL2) ? value[address] : 0u);
        if (address == STATUS1 && !driver->latched && !driver->over_current) {
            driver->status1 = 0;
        }
    } else if (address == CONTROL1) {
        if ((data & CONTROL1_GATE_RESET) != 0) { /* clears itself */
            driver->latched = driver->over_current && CONTROL1_OCP_MODE(data) == OCP_LATCH;
            driver->status1 = driver->latched ? driver->status1 : 0u;
        }
        if ((data & CONTROL1_PWM_MODE) != 0) {
            bus_fail(&drv->soc->bus, "DRV8301 %u: PWM with three inputs is not modelled", d + 1u);
        }
        driver->control1 = (uint16_t)(data & ~CONTROL1_GATE_RESET);
    } else if (address == CONTROL2) {
        driver->control2 = (uint16_t)(data & 0x7Fu);
    }
    if ((driver->frame & READ) == 0) {
        driver->answer = answer_of(STATUS1, driver->status1);
    }
    changed(drv, d);
}

void drv8301_select(drv8301_t *drv, unsigned d, bool level)
{
    drv8301_driver_t *driver = &drv->driver[d];
    if (driver->selected == !level) {
        return;
    }
    driver->selected = !level;
    if (driver->selected) {
        driver->frames = 0;
    } else if (driver->frames == 1u && works(drv)) { /* another number of clocks is a frame error */
        execute(drv, d);
    }
}

uint16_t drv8301_exchange(drv8301_t *drv, uint16_t frame)
{
    uint16_t answer = 0xFFFFu;
    unsigned drivers = 0;
    for (unsigned d = 0; d < DRV8301_DRIVERS; d++) {
        drv8301_driver_t *driver = &drv->driver[d];
        if (driver->selected) {
            drivers++;
            driver->frames++;
            driver->frame = frame;
            answer = works(drv) ? driver->answer : 0u;
        }
    }
    return (drivers == 1u) ? answer : 0xFFFFu;
}

/* ---- over-current --------------------------------------------------------------------------------------------------- */

void drv8301_over_current(drv8301_t *drv, unsigned d, bool tripped)
{
    drv8301_driver_t *driver = &drv->driver[d];
    driver->over_current = tripped;
    const unsigned mode = CONTROL1_OCP_MODE(driver->control1);
    if (tripped && works(drv) && mode != OCP_NONE) {
        driver->status1 |= STATUS1_FAULT | STATUS1_OC; /* which switch is not modelled */
        driver->latched = driver->latched || mode == OCP_LATCH;
    } else if (!tripped && !driver->latched) {
        driver->status1 &= (uint16_t)~STATUS1_FAULT; /* reported as long as it lasts */
    }
    changed(drv, d);
}

void drv8301_init(drv8301_t *drv, soc_t *soc)
{
    drv->soc = soc;
    drv->ready_clock = CHIP_NEVER;
    for (unsigned d = 0; d < DRV8301_DRIVERS; d++) {
        lose_registers(&drv->driver[d]);
    }
}
