#include "stm32f405/gpio.h"

#include "port/stm32f405/registers.h"

#define PORT_SIZE 0x400u
#define PINS 16u

enum { LCKR = 0x1C }; /* which the port does not use */
enum { EMR = 0x04 }; /* which the port does not use */
enum { EXTICR1 = 0x08, EXTICR4 = 0x14 }; /* which the port does not use */

#define EXTI_NAME "EXTI"
#define EXTI_LINES 0xFFFFu /* those of pins */
#define SYSCFG_NAME "SYSCFG"
#define SYSCFG_GATE 14u /* of APB2 */

static const char *const names[SOC_PORTS] = {"GPIOA", "GPIOB", "GPIOC", "GPIOD"};

static unsigned field2(uint32_t word, unsigned pin) { return word >> (2u * pin) & 3u; }

static unsigned mode_of(const gpio_port_t *port, unsigned n) { return field2(port->moder, n); }

/* ---- levels --------------------------------------------------------------------------------------------------------- */

static bool level_of(const gpio_port_t *port, unsigned n)
{
    const uint32_t bit = UINT32_C(1) << n;
    const unsigned mode = mode_of(port, n);
    const bool open_drain = (port->otyper & bit) != 0;
    bool drives = false, high = false;
    if (mode == GPIO_OUTPUT) {
        high = (port->odr & bit) != 0;
        drives = true;
    } else if (mode == GPIO_FUNCTION && (port->function_driven & bit) != 0) {
        high = (port->function_level & bit) != 0;
        drives = true;
    }
    if (drives && !(open_drain && high)) {
        return high;
    }
    if ((port->driven & bit) != 0) {
        return (port->outside & bit) != 0;
    }
    return field2(port->pupdr, n) == 1u;
}

bool gpio_level(const gpio_t *gpio, unsigned pin) { return level_of(&gpio->port[pin >> 4], pin & 15u); }

bool gpio_has_function(const gpio_t *gpio, unsigned pin, unsigned function)
{
    const gpio_port_t *port = &gpio->port[pin >> 4];
    const unsigned n = pin & 15u;
    return mode_of(port, n) == GPIO_FUNCTION && (port->afr[n / 8u] >> (4u * (n % 8u)) & 15u) == function;
}

bool gpio_is_analog(const gpio_t *gpio, unsigned pin)
{
    return mode_of(&gpio->port[pin >> 4], pin & 15u) == GPIO_ANALOG;
}

/* ---- external interrupts -------------------------------------------------------------------------------------------- */

static void request_lines(gpio_t *gpio)
{
    const uint32_t active = gpio->pr & gpio->imr;
    for (unsigned line = 0; line < 5u; line++) {
        soc_request(gpio->soc, SOC_IRQ_EXTI0 + line, 0, (active >> line & 1u) != 0);
    }
    soc_request(gpio->soc, SOC_IRQ_EXTI9_5, 0, (active & 0x03E0u) != 0);
    soc_request(gpio->soc, SOC_IRQ_EXTI15_10, 0, (active & 0xFC00u) != 0);
}

static void edge(gpio_t *gpio, unsigned pin, bool rising)
{
    const unsigned line = pin & 15u;
    const uint32_t bit = UINT32_C(1) << line;
    const unsigned selected = gpio->exticr[line / 4u] >> (4u * (line % 4u)) & 15u;
    if (selected != pin >> 4 || ((rising ? gpio->rtsr : gpio->ftsr) & bit) == 0) {
        return;
    }
    if ((gpio->imr & bit) != 0) {
        gpio->pr |= bit;
        request_lines(gpio);
    }
    if ((gpio->emr & bit) != 0) {
        gpio->soc->signals->edge_line(gpio->soc->chip, line);
    }
}

static void update_pin(gpio_t *gpio, unsigned pin)
{
    gpio_port_t *port = &gpio->port[pin >> 4];
    const uint32_t bit = UINT32_C(1) << (pin & 15u);
    const bool level = level_of(port, pin & 15u);
    if (level != ((port->level & bit) != 0)) {
        port->level ^= bit;
        edge(gpio, pin, level);
        gpio->soc->signals->pin_changed(gpio->soc->chip, pin, level);
    }
}

static void update(gpio_t *gpio, unsigned p)
{
    for (unsigned n = 0; n < PINS; n++) {
        update_pin(gpio, p << 4 | n);
    }
}

void gpio_drive(gpio_t *gpio, unsigned pin, bool level)
{
    gpio_port_t *port = &gpio->port[pin >> 4];
    const uint32_t bit = UINT32_C(1) << (pin & 15u);
    port->driven |= bit;
    port->outside = level ? port->outside | bit : port->outside & ~bit;
    update_pin(gpio, pin);
}

void gpio_function(gpio_t *gpio, unsigned pin, bool driven, bool level)
{
    gpio_port_t *port = &gpio->port[pin >> 4];
    const uint32_t bit = UINT32_C(1) << (pin & 15u);
    const uint32_t now_driven = driven ? port->function_driven | bit : port->function_driven & ~bit;
    const uint32_t now_level = level ? port->function_level | bit : port->function_level & ~bit;
    if (now_driven != port->function_driven || now_level != port->function_level) {
        port->function_driven = now_driven;
        port->function_level = now_level;
        update_pin(gpio, pin);
    }
}

/* ---- registers ------------------------------------------------------------------------------------------------------ */

uint32_t gpio_read(void *peripheral, uint32_t offset)
{
    gpio_t *gpio = (gpio_t *)peripheral;
    const unsigned p = offset / PORT_SIZE;
    const gpio_port_t *port = &gpio->port[p];
    soc_check_gate(gpio->soc, names[p], SOC_AHB1, p);
    switch (offset % PORT_SIZE) {
    case GPIO_MODER:
        return port->moder;
    case GPIO_OTYPER:
        return port->otyper;
    case GPIO_OSPEEDR:
        return port->ospeedr;
    case GPIO_PUPDR:
        return port->pupdr;
    case GPIO_IDR: {
        uint32_t levels = 0;
        for (unsigned n = 0; n < PINS; n++) { /* the input of an analogue pin is off */
            levels |= (mode_of(port, n) != GPIO_ANALOG && level_of(port, n)) ? UINT32_C(1) << n : 0u;
        }
        return levels;
    }
    case GPIO_ODR:
        return port->odr;
    case GPIO_BSRR:
        return 0;
    case GPIO_AFRL:
        return port->afr[0];
    case GPIO_AFRH:
        return port->afr[1];
    default:
        soc_no_register(gpio->soc, names[p], offset % PORT_SIZE);
    }
}

void gpio_write(void *peripheral, uint32_t offset, uint32_t value)
{
    gpio_t *gpio = (gpio_t *)peripheral;
    const unsigned p = offset / PORT_SIZE;
    gpio_port_t *port = &gpio->port[p];
    bool configures = true;
    soc_check_gate(gpio->soc, names[p], SOC_AHB1, p);
    switch (offset % PORT_SIZE) {
    case GPIO_MODER:
        port->moder = value;
        break;
    case GPIO_OTYPER:
        port->otyper = value & 0xFFFFu;
        break;
    case GPIO_OSPEEDR:
        port->ospeedr = value;
        configures = false;
        break;
    case GPIO_PUPDR:
        port->pupdr = value;
        break;
    case GPIO_ODR:
        port->odr = value & 0xFFFFu;
        configures = false;
        break;
    case GPIO_BSRR: /* where a bit is set and reset, it is set */
        port->odr = (port->odr & ~(value >> 16)) | (value & 0xFFFFu);
        configures = false;
        break;
    case GPIO_AFRL:
        port->afr[0] = value;
        break;
    case GPIO_AFRH:
        port->afr[1] = value;
        break;
    default:
        soc_no_register(gpio->soc, names[p], offset % PORT_SIZE);
    }
    if (configures) {
        gpio->soc->signals->pins_configured(gpio->soc->chip);
    }
    update(gpio, p);
}

uint32_t gpio_exti_read(void *peripheral, uint32_t offset)
{
    gpio_t *gpio = (gpio_t *)peripheral;
    switch (offset) {
    case EXTI_IMR:
        return gpio->imr;
    case EMR:
        return gpio->emr;
    case EXTI_RTSR:
        return gpio->rtsr;
    case EXTI_FTSR:
        return gpio->ftsr;
    case EXTI_SWIER:
    case EXTI_PR:
        return gpio->pr;
    default:
        soc_no_register(gpio->soc, EXTI_NAME, offset);
    }
}

void gpio_exti_write(void *peripheral, uint32_t offset, uint32_t value)
{
    gpio_t *gpio = (gpio_t *)peripheral;
    soc_allow(gpio->soc, EXTI_NAME, offset, value, EXTI_LINES, "lines 16 to 22 are not modelled");
    switch (offset) {
    case EXTI_IMR:
        gpio->imr = value;
        break;
    case EMR:
        gpio->emr = value;
        break;
    case EXTI_RTSR:
        gpio->rtsr = value;
        break;
    case EXTI_FTSR:
        gpio->ftsr = value;
        break;
    case EXTI_SWIER:
        gpio->pr |= value & gpio->imr;
        break;
    case EXTI_PR:
        gpio->pr &= ~value;
        break;
    default:
        soc_no_register(gpio->soc, EXTI_NAME, offset);
    }
    request_lines(gpio);
}

uint32_t gpio_syscfg_read(void *peripheral, uint32_t offset)
{
    gpio_t *gpio = (gpio_t *)peripheral;
    soc_check_gate(gpio->soc, SYSCFG_NAME, SOC_APB2, SYSCFG_GATE);
    if (offset < EXTICR1 || offset > EXTICR4) {
        soc_no_register(gpio->soc, SYSCFG_NAME, offset);
    }
    return gpio->exticr[(offset - EXTICR1) / 4u];
}

void gpio_syscfg_write(void *peripheral, uint32_t offset, uint32_t value)
{
    gpio_t *gpio = (gpio_t *)peripheral;
    soc_check_gate(gpio->soc, SYSCFG_NAME, SOC_APB2, SYSCFG_GATE);
    if (offset < EXTICR1 || offset > EXTICR4) {
        soc_no_register(gpio->soc, SYSCFG_NAME, offset);
    }
    gpio->exticr[(offset - EXTICR1) / 4u] = value & 0xFFFFu;
}

void gpio_reset(void *peripheral, soc_reset_t cause)
{
    gpio_t *gpio = (gpio_t *)peripheral;
    (void)cause;
    for (unsigned p = 0; p < SOC_PORTS; p++) { /* what comes from outside stays */
        gpio_port_t *port = &gpio->port[p];
        const gpio_port_t before = *port;
        *port = (gpio_port_t){.outside = before.outside, .driven = before.driven, .level = before.level};
    }
    gpio->port[0].moder = 0xA8000000u;
    gpio->port[0].pupdr = 0x64000000u;
    gpio->port[1].moder = 0x00000280u;
    gpio->port[1].ospeedr = 0x000000C0u;
    gpio->port[1].pupdr = 0x00000100u;
    gpio->imr = gpio->emr = gpio->rtsr = gpio->ftsr = gpio->pr = 0;
    for (unsigned k = 0; k < 4u; k++) {
        gpio->exticr[k] = 0;
    }
    for (unsigned p = 0; p < SOC_PORTS; p++) {
        update(gpio, p);
    }
}
