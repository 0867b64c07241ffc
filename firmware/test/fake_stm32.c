#include "fake_stm32.h"

#include <stdlib.h>

#include "port/stm32f405/access.h"
#include "port/stm32f405/registers.h"
#include "port/stm32f405/settings.h"

typedef struct {
    fake_chip_t chip;
    hal_t hal;
    servo_t servo;
    dma_memory_t dma;
} fake_board_t;

static fake_board_t *board_of(fake_chip_t *chip) { return (fake_board_t *)(void *)chip; }

static uint32_t *word(fake_chip_t *chip, uint32_t address)
{
    const uint32_t area = (address >> 28 == 4U) ? 0U : (address >> 28 == 0xEU) ? 1U : 2U;
    return &chip->memory[area][(address & 0xFFFFFFU) / 4U % FAKE_REGISTERS];
}

uint32_t fake_get(fake_chip_t *chip, uint32_t address) { return *word(chip, address); }

void fake_set(fake_chip_t *chip, uint32_t address, uint32_t value) { *word(chip, address) = value; }

static void enter(fake_chip_t *chip, fake_kind_t kind, uint32_t address, uint32_t value)
{
    if (chip->accesses < FAKE_ACCESSES) {
        chip->access[chip->accesses++] = (fake_access_t){(int)kind, address, value};
    }
}

fake_chip_t *fake_new(void)
{
    fake_board_t *board = (fake_board_t *)calloc(1, sizeof *board);
    fake_chip_t *chip = &board->chip;
    board->hal.chip = chip;
    board->hal.dma = &board->dma;
    chip->clocks_per_read = 10000U; /* long pauses would fill the list */
    fake_set(chip, GPIOD_BASE + GPIO_IDR, 0xFFFFU); /* no fault, no contact */
    fake_set(chip, GPIOA_BASE + GPIO_MODER, UINT32_C(0xA8000000));
    fake_set(chip, GPIOB_BASE + GPIO_MODER, UINT32_C(0x00000280));
    fake_set(chip, FLASH_BASE + FLASH_CR, FLASH_CR_LOCK);
    return chip;
}

void fake_free(fake_chip_t *chip) { free(board_of(chip)); }

hal_t *fake_hal(fake_chip_t *chip) { return &board_of(chip)->hal; }

servo_t *fake_servo(fake_chip_t *chip) { return &board_of(chip)->servo; }

/* ---- registers -------------------------------------------------------------------------------------------------- */

/* A frame to the driver that is selected, with the answer to the one before. */
static uint32_t exchange(fake_chip_t *chip, uint32_t frame)
{
    for (uint16_t driver = 0; driver < 2; driver++) {
        if ((fake_get(chip, GPIOC_BASE + GPIO_ODR) & BIT(13U + driver)) == 0U) {
            const uint16_t address = frame >> 11 & 3U;
            const uint32_t answer = chip->answer[driver];
            if ((frame & 0x8000U) != 0U) {
                chip->answer[driver] = chip->driver[driver][address];
                if (address == 0U) {
                    chip->driver[driver][address] = 0;
                }
            } else if (chip->lost_writes > 0) {
                chip->lost_writes--;
            } else {
                chip->driver[driver][address] =
                    (uint16_t)(frame & ((address == 2U) ? 0x7FBU : 0x7FFU)); /* GATE_RESET ends itself */
            }
            return answer;
        }
    }
    return 0xFFFFU;
}

static void interrupt(fake_chip_t *chip)
{
    if (chip->interrupt != NULL && !chip->masked) {
        chip->interrupt(chip);
    }
}

uint32_t chip_read(struct chip *chip, uint32_t address)
{
    interrupt(chip);
    uint32_t value = *word(chip, address);
    if (address == TIM5_BASE + TIM_CNT) {
        *word(chip, address) += chip->clocks_per_read / TIM5_CLOCKS;
    }
    enter(chip, FAKE_READ, address, value);
    interrupt(chip);
    return value;
}

static void effect(fake_chip_t *chip, uint32_t address, uint32_t value)
{
    uint32_t *reg = word(chip, address);
    if (address == RCC_BASE + RCC_CR) {
        if (FIELD_GET(fake_get(chip, RCC_BASE + RCC_CFGR), RCC_CFGR_SWS) == RCC_CFGR_SWS_PLL) {
            *reg |= RCC_CR_PLLON;
        }
        *reg &= ~(RCC_CR_HSIRDY | RCC_CR_HSERDY | RCC_CR_PLLRDY);
        *reg |= (*reg & (RCC_CR_HSION | RCC_CR_HSEON | RCC_CR_PLLON)) << 1;
    } else if (address == RCC_BASE + RCC_CFGR) {
        *reg = (value & ~FIELD_MASK(RCC_CFGR_SWS)) | RCC_CFGR_SWS(value);
    } else if ((address & ~UINT32_C(0xC1F)) == GPIOA_BASE && (address & 0x3FFU) == GPIO_BSRR) {
        uint32_t *odr = word(chip, address - GPIO_BSRR + GPIO_ODR);
        *odr = (*odr & ~(value >> 16)) | (value & 0xFFFFU);
    } else if (address == TIM1_BASE + TIM_CR1 && fake_get(chip, TIM8_BASE + TIM_SMCR) != 0U) {
        *word(chip, TIM8_BASE + TIM_CR1) |= value & TIM_CR1_CEN;
    } else if (address == SPI3_BASE + SPI_DR) {
        *reg = exchange(chip, value);
        *word(chip, SPI3_BASE + SPI_SR) = SPI_SR_RXNE | SPI_SR_TXE;
    } else if (address == EXTI_BASE + EXTI_SWIER) {
        *word(chip, EXTI_BASE + EXTI_PR) |= value;
    } else if (address == FLASH_BASE + FLASH_CR && (value & FLASH_CR_STRT) != 0U) {
        *word(chip, FLASH_BASE + FLASH_SR) |= FLASH_SR_BSY;
    }
}

void chip_write(struct chip *chip, uint32_t address, uint32_t value)
{
    uint32_t *reg = word(chip, address);
    interrupt(chip);
    enter(chip, FAKE_WRITE, address, value);
    if (address == EXTI_BASE + EXTI_PR) {
        *reg &= ~value;
    } else if (address == DMA1_BASE + DMA_IFCR(5U) || address == DMA2_BASE + DMA_IFCR(2U)) {
        *word(chip, address - 8U) &= ~value;
    } else if ((address & 0xFFFFF8FFU) == ADC1_BASE && address != ADC_COMMON_BASE) {
        *reg &= value;
    } else if (address == RCC_BASE + RCC_PLLCFGR && (fake_get(chip, RCC_BASE + RCC_CR) & RCC_CR_PLLON) != 0U) {
        return;
    } else {
        const uint32_t kept = (address == TIM1_BASE + TIM_CR1 || address == TIM8_BASE + TIM_CR1) ? TIM_CR1_DIR : 0U;
        *reg = (value & ~kept) | (*reg & kept);
        effect(chip, address, value);
    }
    interrupt(chip);
}

void chip_interrupts(struct chip *chip, bool on)
{
    chip->masked = !on;
    enter(chip, FAKE_INTERRUPTS, 0, on);
}

uint32_t chip_interrupts_off(struct chip *chip)
{
    const bool before = chip->masked;
    interrupt(chip);
    chip->masked = true;
    return before;
}

void chip_interrupts_restore(struct chip *chip, uint32_t before)
{
    chip->masked = before != 0U;
    interrupt(chip);
}

/* ---- application ------------------------------------------------------------------------------------------------ */

static void call(const servo_t *servo, fake_servo_t what, uint32_t axis)
{
    enter(servo->hal->chip, FAKE_SERVO, what, axis);
}

void servo_init(servo_t *servo, hal_t *hal, const servo_config_t *config)
{
    (void)config;
    servo->hal = hal;
    call(servo, FAKE_INIT, 0);
    for (uint16_t axis = 0; axis < HAL_AXES; axis++) {
        hal_pwm_duty(hal, axis, 16384, 16384, 16384);
    }
}

void servo_m1_isr(servo_t *servo) { call(servo, FAKE_M1, 0); }

void servo_m2_isr(servo_t *servo) { call(servo, FAKE_M2, 1); }

void servo_over_current_isr(servo_t *servo, uint16_t axis) { call(servo, FAKE_BREAK, axis); }

void servo_background(servo_t *servo) { call(servo, FAKE_BACKGROUND, 0); }

void servo_edge_isr(servo_t *servo, uint16_t axis)
{
    fake_chip_t *chip = servo->hal->chip;
    call(servo, FAKE_EDGE, axis);
    if (chip->takes_edge) {
        (void)hal_capture_take(servo->hal, axis, &chip->taken);
    }
}
