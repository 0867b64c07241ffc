#include "fake_chip.h"

#include <stdlib.h>

#include "port/mc56f84789/access.h"
#include "port/mc56f84789/registers.h"

typedef struct {
    fake_chip_t chip;
    hal_t hal;
    servo_t servo;
} fake_board_t;

static fake_board_t *board_of(fake_chip_t *chip) { return (fake_board_t *)(void *)chip; }

static void enter(fake_chip_t *chip, fake_kind_t kind, uint32_t address, uint16_t value)
{
    if (chip->accesses < FAKE_ACCESSES) {
        chip->access[chip->accesses++] = (fake_access_t){(int)kind, address, value};
    }
}

/* Registers are not zero unless the port has cleared them, except for flags. */
static void fill(uint16_t *memory)
{
    for (uint32_t address = 0xE000; address < 0xE800; address++) {
        memory[address] = 0x5A5A;
    }
    for (uint32_t module = PWMA_BASE; module <= PWMB_BASE; module += PWMB_BASE - PWMA_BASE) {
        for (uint32_t sm = 0; sm < PWM_SUBMODULES; sm++) {
            memory[module + PWM_SM(sm) + PWM_STS] = 0;
        }
        memory[module + PWM_FSTS0] = 0;
        memory[module + PWM_MCTRL] = 0;
    }
    for (uint32_t channel = 0; channel < 2 * TMR_CHANNELS; channel++) {
        memory[TMRA_BASE + TMR_CHANNEL(channel) + TMR_SCTRL] = 0;
    }
    memory[ADC_RDY] = 0;
    memory[OCCS_STAT] = 0;
    memory[QSCI0_BASE + QSCI_STAT] = 0;
}

fake_chip_t *fake_new(void)
{
    fake_board_t *board = (fake_board_t *)calloc(1, sizeof *board);
    board->hal.chip = &board->chip;
    uint16_t *memory = board->chip.memory;
    fill(memory);
    for (uint16_t n = 0; n < 2; n++) {
        const uint16_t module = (n == 0) ? PWMA_BASE : PWMB_BASE;
        for (uint16_t sm = 0; sm < PWM_SUBMODULES; sm++) {
            memory[module + PWM_SM(sm) + PWM_DISMAP0] = 0xFFFF;
            memory[module + PWM_SM(sm) + PWM_DISMAP1] = 0xFFFF;
            memory[module + PWM_SM(sm) + PWM_DTCNT0] = 0x07FF;
            memory[module + PWM_SM(sm) + PWM_DTCNT1] = 0x07FF;
        }
    }
    memory[ADC_PWR] = 0x1DA7;
    memory[COP_CTRL] = COP_CTRL_CEN;
    memory[SIM_NVMOPT2H] = 0x2955;
    memory[OCCS_OSCTL1] = OCCS_OSCTL1_ROPD | OCCS_OSCTL1_CLK_MODE;
    memory[OCCS_OSCTL2] = OCCS_OSCTL2_COPD;
    return &board->chip;
}

void fake_free(fake_chip_t *chip) { free(board_of(chip)); }

hal_t *fake_hal(fake_chip_t *chip) { return &board_of(chip)->hal; }

void fake_baud(fake_chip_t *chip, uint32_t baud) { board_of(chip)->hal.baud = baud; }

servo_t *fake_servo(fake_chip_t *chip) { return &board_of(chip)->servo; }

void fake_receive(fake_chip_t *chip, uint8_t byte) { chip->data[chip->data_in++ % 16] = byte; }

/* ---- registers -------------------------------------------------------------------------------------------------- */

/* Crystal, PLL and converter respond immediately. */
static uint16_t clock_status(const fake_chip_t *chip)
{
    const uint16_t ctrl = chip->memory[OCCS_CTRL];
    uint16_t stat = chip->memory[OCCS_STAT];
    if ((chip->memory[OCCS_OSCTL2] & OCCS_OSCTL2_COPD) == 0) {
        stat |= OCCS_STAT_OSC_OK;
    }
    if ((ctrl & OCCS_CTRL_PLLPD) == 0 && (ctrl & OCCS_CTRL_LCKON) != 0) {
        stat |= OCCS_STAT_LCK0 | OCCS_STAT_LCK1;
    }
    return stat | ((ctrl & OCCS_CTRL_ZSRC) ? OCCS_STAT_ZSRCS(OCCS_ZSRCS_PLL) : 0);
}

static uint16_t power(uint16_t pwr)
{
    const uint16_t off = (uint16_t)((pwr & (ADC_PWR_PD0 | ADC_PWR_PD1)) << 10);
    return (uint16_t)((pwr & ~(ADC_PWR_PSTS0 | ADC_PWR_PSTS1)) | off);
}

uint16_t chip_read(struct chip *chip, uint32_t address)
{
    uint16_t value = chip->memory[address];
    if (address == OCCS_STAT) {
        value = clock_status(chip);
    } else if (address == ADC_PWR) {
        value = power(value);
    } else if (address >= ADC_RSLT(0) && address <= ADC_RSLT(15)) {
        chip->memory[ADC_RDY] &= (uint16_t)~BIT(address - ADC_RSLT(0));
    } else if (address == QSCI0_BASE + QSCI_CTRL2) {
        value |= FIELD(8, chip->data_in - chip->data_out);
    } else if (address == QSCI0_BASE + QSCI_DATA) {
        value = chip->data[chip->data_out++ % 16];
    }
    enter(chip, FAKE_READ, address, value);
    return value;
}

static bool is_timer(uint32_t address) { return address >= TMRA_BASE && address < TMRB_BASE + TMR_CHANNEL(4); }

static void b_edge(fake_chip_t *chip, uint32_t base)
{
    for (uint32_t channel = 0; channel < TMR_CHANNELS; channel++) {
        uint16_t *timer = &chip->memory[base + TMR_CHANNEL(channel)];
        if ((timer[TMR_SCTRL] & TMR_SCTRL_CAPTURE_MODE_MASK) != 0 && (timer[TMR_SCTRL] & TMR_SCTRL_IEF) == 0) {
            timer[TMR_SCTRL] |= TMR_SCTRL_IEF;
            timer[TMR_CAPT] = timer[TMR_CNTR];
        }
    }
}

void chip_write(struct chip *chip, uint32_t address, uint16_t value)
{
    uint16_t *reg = &chip->memory[address];
    const uint32_t offset = address & 0xFF;
    const bool pwm = (address & 0xFE00) == PWMA_BASE;
    enter(chip, FAKE_WRITE, address, value);
    if (pwm && offset < PWM_SM(PWM_SUBMODULES) && offset % PWM_SM(1) == PWM_STS) {
        *reg &= (uint16_t)~value;
    } else if (pwm && offset == PWM_FSTS0) {
        *reg = (uint16_t)((*reg & PWM_FSTS_FFLAG_MASK & ~value) | (value & ~PWM_FSTS_FFLAG_MASK));
    } else if (pwm && offset == PWM_MCTRL) {
        const uint16_t cancelled = FIELD_GET(value, PWM_MCTRL_CLDOK_MASK);
        *reg = (uint16_t)(value & ~PWM_MCTRL_CLDOK_MASK & ~cancelled);
    } else if (address == ADC_STAT) {
        *reg &= (uint16_t)~value;
    } else if (is_timer(address) && (address & 0xF) == TMR_SCTRL) {
        const uint16_t flags = TMR_SCTRL_IEF | TMR_SCTRL_TOF | TMR_SCTRL_TCF;
        *reg = (uint16_t)((*reg & value & flags) | (value & ~flags));
        if (chip->slip > 0 && --chip->slip == 0) {
            b_edge(chip, address & 0xFFC0);
        }
    } else {
        *reg = value;
    }
}

void chip_interrupts(struct chip *chip, bool on) { enter(chip, FAKE_INTERRUPTS, 0, on); }

/* ---- application ------------------------------------------------------------------------------------------------ */

void servo_init(servo_t *servo, hal_t *hal, const servo_config_t *config)
{
    (void)config;
    servo->hal = hal;
    enter(hal->chip, FAKE_SERVO, FAKE_INIT, 0);
    for (uint16_t axis = 0; axis < HAL_AXES; axis++) {
        hal_pwm_enable(hal, axis, false);
        hal_adc_select(hal, axis, PHASE_PAIR_AB);
    }
}

void servo_m1_isr(servo_t *servo) { enter(servo->hal->chip, FAKE_SERVO, FAKE_M1, 0); }

void servo_m2_isr(servo_t *servo) { enter(servo->hal->chip, FAKE_SERVO, FAKE_M2, 1); }

void servo_edge_isr(servo_t *servo, uint16_t axis)
{
    fake_chip_t *chip = servo->hal->chip;
    enter(chip, FAKE_SERVO, FAKE_EDGE, axis);
    if (chip->takes_edge) {
        (void)hal_capture_take(servo->hal, axis, &chip->taken);
    }
}

void servo_over_current_isr(servo_t *servo, uint16_t axis) { enter(servo->hal->chip, FAKE_SERVO, FAKE_BREAK, axis); }
