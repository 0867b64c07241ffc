#include "stm32f405/chip.h"

#include <string.h>

#include "port/stm32f405/registers.h"

static chip_t *chip_of(void *chip) { return (chip_t *)chip; }

/* ---- peripherals ---------------------------------------------------------------------------------------------------- */

typedef struct {
    uint32_t base, size;
    size_t offset; /* in chip_t */
    uint32_t (*read)(void *peripheral, uint32_t offset);
    void (*write)(void *peripheral, uint32_t offset, uint32_t value);
    void (*reset)(void *peripheral, soc_reset_t cause);
} peripheral_t;

#define TIMER(name) {name##_BASE, 0x400u, offsetof(chip_t, tim[SOC_##name]), tim_read, tim_write, tim_reset}
#define TIM12_BASE UINT32_C(0x40001800) /* which the port does not use */

static const peripheral_t peripherals[] = {
    {RCC_BASE, 0x400u, offsetof(chip_t, rcc), rcc_read, rcc_write, rcc_reset}, /* its reset is the first */
    {PWR_BASE, 0x400u, offsetof(chip_t, rcc), rcc_pwr_read, rcc_pwr_write, NULL},
    {GPIOA_BASE, SOC_PORTS * 0x400u, offsetof(chip_t, gpio), gpio_read, gpio_write, gpio_reset},
    {EXTI_BASE, 0x400u, offsetof(chip_t, gpio), gpio_exti_read, gpio_exti_write, NULL},
    {SYSCFG_BASE, 0x400u, offsetof(chip_t, gpio), gpio_syscfg_read, gpio_syscfg_write, NULL},
    TIMER(TIM1),
    TIMER(TIM8),
    TIMER(TIM2),
    TIMER(TIM3),
    TIMER(TIM4),
    TIMER(TIM5),
    TIMER(TIM12),
    {ADC1_BASE, 0x400u, offsetof(chip_t, adc), adc_read, adc_write, adc_reset},
    {DMA1_BASE, 0x800u, offsetof(chip_t, dma), dma_read, dma_write, dma_reset},
    {USART2_BASE, 0x400u, offsetof(chip_t, usart), usart_read, usart_write, usart_reset},
    {SPI3_BASE, 0x400u, offsetof(chip_t, spi), spi_read, spi_write, spi_reset},
    {FLASH_BASE, 0x400u, offsetof(chip_t, flash_control), flash_control_read, flash_control_write, flash_control_reset},
    {IWDG_BASE, 0x400u, offsetof(chip_t, iwdg), iwdg_read, iwdg_write, iwdg_reset},
};

#define PERIPHERALS (sizeof peripherals / sizeof peripherals[0])

static void *at(chip_t *chip, size_t offset) { return (uint8_t *)chip + offset; }

static const peripheral_t *find(uint32_t address)
{
    for (unsigned k = 0; k < PERIPHERALS; k++) {
        if (address - peripherals[k].base < peripherals[k].size) {
            return &peripherals[k];
        }
    }
    return NULL;
}

/* ---- debug units of the core ---------------------------------------------------------------------------------------- */

/* Place of a register without an effect, or NULL. */
static uint32_t *plain_register(chip_t *chip, uint32_t address)
{
    switch (address) {
    case DBGMCU_BASE + DBGMCU_APB1_FZ:
        return &chip->dbgmcu[0];
    case DBGMCU_BASE + DBGMCU_APB2_FZ:
        return &chip->dbgmcu[1];
    default:
        return NULL;
    }
}

/* ---- access --------------------------------------------------------------------------------------------------------- */

static uint8_t *memory_of(const chip_t *chip, uint32_t address, unsigned size)
{
    const bool reachable =
        address - SRAM1_MEMORY < SRAM1_MEMORY_SIZE + SRAM2_MEMORY_SIZE || address - FLASH_MEMORY < FLASH_MEMORY_SIZE;
    return (reachable && chip->memory != NULL) ? chip->memory(chip->soc.bus.board, address, size) : NULL;
}

/* A read waits for the end of a command. */
static bool read_flash(chip_t *chip, uint32_t address, unsigned size, uint32_t *value)
{
    const uint8_t *memory = memory_of(chip, address, size);
    if (chip->flash_control.busy_until != CHIP_NEVER) {
        chip->soc.bus.stall = chip->flash_control.busy_until - chip->soc.bus.now;
    }
    *value = 0;
    if (memory != NULL) {
        memcpy(value, memory, size);
    }
    return memory != NULL;
}

bool chip_load(void *self, uint32_t address, unsigned size, uint32_t *value)
{
    chip_t *chip = chip_of(self);
    const peripheral_t *peripheral = find(address);
    if (peripheral != NULL && size == sizeof(uint32_t)) {
        *value = peripheral->read(at(chip, peripheral->offset), address - peripheral->base);
        return true;
    }
    if (address - FLASH_MEMORY < FLASH_MEMORY_SIZE) {
        return read_flash(chip, address, size, value);
    }
    const uint32_t *plain = plain_register(chip, address);
    if (plain != NULL) {
        *value = *plain;
    }
    return plain != NULL;
}

bool chip_store(void *self, uint32_t address, unsigned size, uint32_t value)
{
    chip_t *chip = chip_of(self);
    const peripheral_t *peripheral = find(address);
    if (size != sizeof(uint32_t)) {
        return false;
    }
    if (peripheral != NULL) {
        bus_note(&chip->soc.bus, TRACE_WRITE, address >> 2, value);
        peripheral->write(at(chip, peripheral->offset), address - peripheral->base, value);
        chip->rcc.flash_latency = FIELD_GET(chip->flash_control.acr, FLASH_ACR_LATENCY);
        return true;
    }
    if (address - FLASH_MEMORY < FLASH_MEMORY_SIZE) {
        flash_control_program(&chip->flash_control, address - FLASH_MEMORY, value);
        return true;
    }
    uint32_t *plain = plain_register(chip, address);
    if (plain != NULL) {
        *plain = value;
    }
    return plain != NULL;
}

/* ---- gates ---------------------------------------------------------------------------------------------------------- */

typedef struct {
    uint8_t pin, function;
} gate_input_t;

static const gate_input_t gate_pins[CHIP_AXES][CHIP_PHASES][2] = {
    {{{SOC_PIN('A', 8), AF_A8_TIM1_CH1}, {SOC_PIN('B', 13), AF_B13_TIM1_CH1N}},
     {{SOC_PIN('A', 9), AF_A9_TIM1_CH2}, {SOC_PIN('B', 14), AF_B14_TIM1_CH2N}},
     {{SOC_PIN('A', 10), AF_A10_TIM1_CH3}, {SOC_PIN('B', 15), AF_B15_TIM1_CH3N}}},
    {{{SOC_PIN('C', 6), AF_C6_TIM8_CH1}, {SOC_PIN('A', 7), AF_A7_TIM8_CH1N}},
     {{SOC_PIN('C', 7), AF_C7_TIM8_CH2}, {SOC_PIN('B', 0), AF_B0_TIM8_CH2N}},
     {{SOC_PIN('C', 8), AF_C8_TIM8_CH3}, {SOC_PIN('B', 1), AF_B1_TIM8_CH3N}}},
};
static const soc_timer_t gate_timer[CHIP_AXES] = {SOC_TIM1, SOC_TIM8};

/* Level of an input of a gate driver, pulled down there. */
static bool gate_level(const chip_t *chip, unsigned axis, unsigned phase, unsigned side)
{
    const gate_input_t *gate = &gate_pins[axis][phase][side];
    if (gpio_has_function(&chip->gpio, gate->pin, gate->function)) {
        return (chip->tim[gate_timer[axis]].channel[phase].levels >> side & 1u) != 0;
    }
    return gpio_level(&chip->gpio, gate->pin);
}

static void update_gates(chip_t *chip, unsigned axis)
{
    bus_t *bus = &chip->soc.bus;
    const bool driven = drv8301_drives(&chip->drivers, axis);
    for (unsigned phase = 0; phase < CHIP_PHASES; phase++) {
        const unsigned levels =
            !driven ? 0u : (gate_level(chip, axis, phase, 0) ? 1u : 0u) | (gate_level(chip, axis, phase, 1) ? 2u : 0u);
        if (levels != chip->gates[axis][phase]) {
            chip->gates[axis][phase] = levels;
            bus_sync_plant(bus);
            bus_note(bus, TRACE_GATES, 4u * axis + phase, levels);
            bus->environment->set_gates(bus->board, axis, phase, levels);
        }
    }
}

/* ---- signals -------------------------------------------------------------------------------------------------------- */

/* Outputs of timers other than gates. */
static const struct {
    uint8_t timer, channel, pin, function;
} output_pins[] = {
    {SOC_TIM2, 0, SOC_PIN('A', 15), AF_A15_TIM2_CH1},
    {SOC_TIM2, 1, SOC_PIN('B', 3), AF_B3_TIM2_CH2},
    {SOC_TIM2, 2, SOC_PIN('B', 10), AF_B10_TIM2_CH3},
    {SOC_TIM2, 3, SOC_PIN('B', 11), AF_B11_TIM2_CH4},
};

/* Inputs of timers. */
static const struct {
    uint8_t timer, input, pin, function;
} input_pins[] = {
    {SOC_TIM3, 0, SOC_PIN('B', 4), AF_B4_TIM3_CH1},
    {SOC_TIM3, 1, SOC_PIN('B', 5), AF_B5_TIM3_CH2},
    {SOC_TIM4, 0, SOC_PIN('B', 6), AF_B6_TIM4_CH1},
    {SOC_TIM4, 1, SOC_PIN('B', 7), AF_B7_TIM4_CH2},
};

#define COUNT(table) (sizeof(table) / sizeof((table)[0]))

static void signal_timer_pins(void *self, soc_timer_t timer)
{
    chip_t *chip = chip_of(self);
    for (unsigned axis = 0; axis < CHIP_AXES; axis++) {
        if (gate_timer[axis] == timer) {
            update_gates(chip, axis);
        }
    }
    for (unsigned k = 0; k < COUNT(output_pins); k++) {
        if (output_pins[k].timer == timer) {
            const bool level = (chip->tim[timer].channel[output_pins[k].channel].levels & 1u) != 0;
            gpio_function(&chip->gpio, output_pins[k].pin,
                          gpio_has_function(&chip->gpio, output_pins[k].pin, output_pins[k].function), level);
        }
    }
}

static void signal_trigger(void *self, soc_timer_t timer, soc_trigger_t trigger, bool rising)
{
    chip_t *chip = chip_of(self);
    if (rising) {
        bus_note(&chip->soc.bus, TRACE_TRIGGER, timer, trigger);
    }
    adc_trigger(&chip->adc, timer, trigger, rising);
    for (unsigned k = 0; rising && trigger == SOC_TRIGGER_TRGO && k < SOC_TIMERS; k++) {
        tim_internal_trigger(&chip->tim[k], timer);
    }
}

static void signal_pin_changed(void *self, unsigned pin, bool level)
{
    chip_t *chip = chip_of(self);
    for (unsigned k = 0; k < COUNT(input_pins); k++) {
        if (input_pins[k].pin == pin) {
            if (gpio_has_function(&chip->gpio, pin, input_pins[k].function)) {
                tim_input(&chip->tim[input_pins[k].timer], input_pins[k].input, level);
            }
            return;
        }
    }
    if (pin == chip->enable_pin) {
        drv8301_enable(&chip->drivers, level);
    } else if (pin == chip->select_pin[0] || pin == chip->select_pin[1]) {
        drv8301_select(&chip->drivers, (pin == chip->select_pin[1]) ? 1u : 0u, level);
    } else {
        chip->soc.bus.environment->outputs_changed(chip->soc.bus.board);
    }
}

static void signal_pins_configured(void *self)
{
    chip_t *chip = chip_of(self);
    const gpio_t *gpio = &chip->gpio;
    chip->usart.sends = gpio_has_function(gpio, SOC_PIN('A', 2), AF_A2_USART2_TX);
    chip->usart.receives = gpio_has_function(gpio, SOC_PIN('A', 3), AF_A3_USART2_RX);
    chip->spi.connected = gpio_has_function(gpio, SOC_PIN('C', 10), AF_C10_SPI3_SCK) &&
                          gpio_has_function(gpio, SOC_PIN('C', 11), AF_C11_SPI3_MISO) &&
                          gpio_has_function(gpio, SOC_PIN('C', 12), AF_C12_SPI3_MOSI);
    for (unsigned k = 0; k < COUNT(input_pins); k++) {
        if (gpio_has_function(gpio, input_pins[k].pin, input_pins[k].function)) {
            tim_input(&chip->tim[input_pins[k].timer], input_pins[k].input, gpio_level(gpio, input_pins[k].pin));
        }
    }
    signal_timer_pins(self, SOC_TIM1);
    signal_timer_pins(self, SOC_TIM8);
    signal_timer_pins(self, SOC_TIM2);
}

static void signal_dma_request(void *self, soc_dma_t request, bool on)
{
    dma_request(&chip_of(self)->dma, request, on);
}

/* A DMA controller reaches the peripherals with any size of its transfers. */
static bool signal_dma_read(void *self, uint32_t address, unsigned size, uint32_t *value)
{
    if (find(address) != NULL) {
        return chip_load(self, address, sizeof(uint32_t), value);
    }
    const uint8_t *memory = memory_of(chip_of(self), address, size);
    *value = 0;
    if (memory != NULL) {
        memcpy(value, memory, size);
    }
    return memory != NULL;
}

static bool signal_dma_write(void *self, uint32_t address, unsigned size, uint32_t value)
{
    if (find(address) != NULL) {
        return chip_store(self, address, sizeof(uint32_t), value);
    }
    uint8_t *memory = (address >= SRAM1_MEMORY) ? memory_of(chip_of(self), address, size) : NULL;
    if (memory != NULL) {
        memcpy(memory, &value, size);
    }
    return memory != NULL;
}

static uint16_t signal_spi_exchange(void *self, uint16_t word)
{
    return drv8301_exchange(&chip_of(self)->drivers, word);
}

static void signal_driver_changed(void *self, unsigned driver)
{
    chip_t *chip = chip_of(self);
    update_gates(chip, driver);
    gpio_drive(&chip->gpio, chip->fault_pin, drv8301_fault_pin(&chip->drivers));
}

static void signal_edge_line(void *self, unsigned line)
{
    (void)self;
    (void)line;
}

static void signal_flash_changed(void *self, uint32_t first, uint32_t words)
{
    chip_t *chip = chip_of(self);
    for (uint32_t k = first; k < first + words; k++) {
        uint8_t *memory = memory_of(chip, FLASH_SECTOR_ADDRESS(1U) + 4u * k, sizeof(uint32_t));
        if (memory != NULL) {
            memcpy(memory, &chip->flash_control.flash.word[k], sizeof(uint32_t));
        }
    }
}

void chip_show_storage(chip_t *chip) { signal_flash_changed(chip, 0, FLASH_WORDS); }

static void reset_all(chip_t *chip, soc_reset_t cause)
{
    events_reset(&chip->soc.bus.events);
    chip->soc.bus.must_boot = true;
    for (unsigned k = 0; k < PERIPHERALS; k++) {
        if (peripherals[k].reset != NULL) {
            peripherals[k].reset(at(chip, peripherals[k].offset), cause);
        }
    }
    signal_pins_configured(chip);
}

static void signal_reset(void *self, soc_reset_t cause)
{
    reset_all(chip_of(self), cause);
    longjmp(chip_of(self)->soc.bus.escape, ESCAPE_RESET);
}

void chip_power_on(void *self) { reset_all(chip_of(self), SOC_RESET_POWER_ON); }

void chip_reset_by_software(void *self) { signal_reset(self, SOC_RESET_SOFTWARE); }

static const soc_signals_t signals = {
    .timer_pins = signal_timer_pins,
    .trigger = signal_trigger,
    .pin_changed = signal_pin_changed,
    .pins_configured = signal_pins_configured,
    .edge_line = signal_edge_line,
    .dma_request = signal_dma_request,
    .dma_read = signal_dma_read,
    .dma_write = signal_dma_write,
    .spi_exchange = signal_spi_exchange,
    .driver_changed = signal_driver_changed,
    .flash_changed = signal_flash_changed,
    .reset = signal_reset,
};

/* ---- for the board -------------------------------------------------------------------------------------------------- */

void chip_pin(chip_t *chip, unsigned pin, bool level) { gpio_drive(&chip->gpio, pin, level); }

bool chip_pin_level(const chip_t *chip, unsigned pin) { return gpio_level(&chip->gpio, pin); }

int32_t chip_peek(chip_t *chip, uint32_t address)
{
    jmp_buf within;
    volatile int32_t result = -1;
    uint32_t value = 0;
    memcpy(&within, &chip->soc.bus.escape, sizeof within);
    if (!chip->soc.bus.failed && setjmp(chip->soc.bus.escape) == 0 && chip_load(chip, address, sizeof value, &value)) {
        result = (int32_t)value;
    }
    memcpy(&chip->soc.bus.escape, &within, sizeof within);
    return result;
}

int chip_poke(chip_t *chip, uint32_t address, uint16_t value)
{
    jmp_buf within;
    volatile int result = -1;
    memcpy(&within, &chip->soc.bus.escape, sizeof within);
    if (!chip->soc.bus.failed && setjmp(chip->soc.bus.escape) == 0 &&
        chip_store(chip, address, sizeof(uint32_t), value)) {
        result = 0;
    }
    memcpy(&chip->soc.bus.escape, &within, sizeof within);
    return result;
}

/* ---- life ----------------------------------------------------------------------------------------------------------- */

static void handle(chip_t *chip, unsigned source, void (*handler)(void *, unsigned), void *peripheral)
{
    chip->soc.bus.events.handler[source] = (event_handler_t){handler, peripheral};
}

void chip_init(chip_t *chip, const chip_config_t *config, const chip_environment_t *environment, void *board)
{
    memset(chip, 0, sizeof *chip);
    soc_t *soc = &chip->soc;
    soc->signals = &signals;
    soc->chip = chip;
    soc->bus.environment = environment;
    soc->bus.board = board;
    chip->gpio.soc = chip->adc.soc = chip->dma.soc = chip->spi.soc = chip->rcc.soc = soc;
    chip->flash_control.soc = chip->iwdg.soc = soc;
    chip->enable_pin = config->enable_pin;
    memcpy(chip->select_pin, config->select_pin, sizeof chip->select_pin);
    chip->fault_pin = config->fault_pin;
    chip->memory = config->memory;
    events_reset(&soc->bus.events);
    for (unsigned k = 0; k < SOC_TIMERS; k++) {
        tim_init(&chip->tim[k], soc, (soc_timer_t)k);
        handle(chip, SOC_EVENT_TIMER + k, tim_event, &chip->tim[k]);
    }
    for (unsigned k = 0; k < SOC_ADCS; k++) {
        handle(chip, SOC_EVENT_ADC + k, adc_event, &chip->adc);
    }
    handle(chip, SOC_EVENT_USART, usart_event, &chip->usart);
    handle(chip, SOC_EVENT_SPI, spi_event, &chip->spi);
    handle(chip, SOC_EVENT_FLASH, flash_control_event, &chip->flash_control);
    handle(chip, SOC_EVENT_WATCHDOG, iwdg_event, &chip->iwdg);
    handle(chip, SOC_EVENT_DRIVER, drv8301_event, &chip->drivers);
    usart_init(&chip->usart, soc, config->baud);
    drv8301_init(&chip->drivers, soc);
    flash_init(&chip->flash_control.flash, config->flash, config->seed);
    chip->flash_control.busy_until = CHIP_NEVER;
    if (setjmp(soc->bus.escape) == 0) {
        chip_power_on(chip);
    }
}
