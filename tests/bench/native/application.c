/* application.c - the complete two-axis application as on a chip, to measure its size. */
#include "app/servo.h"
#include "bench_board.h"
#include "config/servo_config.h"
#include "machine.h"

static servo_t servo;
static hal_t hal;

/* Handlers called by the interrupt controller. */
typedef void (*interrupt_t)(void);
void application_m1(void);
void application_m2(void);
void application_edge_1(void);
void application_edge_2(void);
void application_break_1(void);
void application_break_2(void);

void application_m1(void) { servo_m1_isr(&servo); }
void application_m2(void) { servo_m2_isr(&servo); }
void application_edge_1(void) { servo_edge_isr(&servo, 0); }
void application_edge_2(void) { servo_edge_isr(&servo, 1); }
void application_break_1(void) { servo_over_current_isr(&servo, 0); }
void application_break_2(void) { servo_over_current_isr(&servo, 1); }

extern const interrupt_t application_vectors[6];
const interrupt_t application_vectors[6] = {
    application_m1, application_m2, application_edge_1, application_edge_2, application_break_1, application_break_2,
};

int main(void)
{
    machine_start();
    bench_board_init(&hal);
    servo_init(&servo, &hal, &servo_config);
    for (volatile uint32_t i = 0;; i++) {
        if (i < 6U) {
            application_vectors[i](); /* in place of the interrupts, so that the linker keeps all handlers */
        }
        servo_background(&servo);
    }
}
