/* bench_plant.c - what one PWM period of both axes costs: plant at switching level, averaged plant. Prints nanoseconds. */
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "plant/plant.h"
#include "plant/switching.h"
#include "plant/trig.h"

#define PERIOD 6250u
#define DEAD 100u
#define EDGES 24
#define BLOCK 50u /* the quickest counts: others use the machine as well */

typedef struct {
    unsigned clock; /* in the period */
    int axis, phase;
    switching_leg_t leg; /* or -1: both axes are sampled */
} edge_t;

static double now_ns(void)
{
    struct timespec t;
    (void)clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

static int by_clock(const void *a, const void *b)
{
    const edge_t *x = (const edge_t *)a;
    const edge_t *y = (const edge_t *)b;
    return (x->clock > y->clock) - (x->clock < y->clock);
}

static void cycle(unsigned *count, edge_t *edge, int axis, const double duty[3], unsigned shift)
{
    for (int k = 0; k < 3; k++) {
        const unsigned low = (unsigned)(0.5 * PERIOD * (1.0 - duty[k]));
        const unsigned clock[4] = {low, low + DEAD, PERIOD - low, PERIOD - low + DEAD};
        const switching_leg_t leg[4] = {SWITCHING_OPEN, SWITCHING_HIGH, SWITCHING_OPEN, SWITCHING_LOW};
        for (int n = 0; n < 4; n++) {
            edge[(*count)++] = (edge_t){(clock[n] + shift) % PERIOD, axis, k, leg[n]};
        }
    }
}

/* Voltage at an angle that turns with the rotor, as a controller would give it. */
static void duties(double theta_e, double volts, double duty[3])
{
    double c;
    double s;
    plant_sincos(theta_e, &s, &c);
    const double alpha = -volts * s / 24.0;
    const double beta = volts * c / 24.0;
    duty[0] = 0.5 + alpha;
    duty[1] = 0.5 - 0.5 * alpha + 0.8660254 * beta;
    duty[2] = 0.5 - 0.5 * alpha - 0.8660254 * beta;
}

static double run_switching(const board_config_t *config, unsigned periods, double volts, unsigned *events)
{
    static switching_t plant;
    static edge_t edge[2 * EDGES];
    switching_event_t event;
    double spent = 0.0;
    double least = 1e9;
    uint16_t sink = 0;
    switching_init(&plant, config);
    switching_set_load(&plant, 0, 0.05 * (volts > 1.0));
    switching_set_load(&plant, 1, 0.05 * (volts > 1.0));
    *events = 0;
    for (unsigned n = 0; n < periods; n++) {
        unsigned count = 0;
        for (int i = 0; i < 2; i++) {
            double duty[3];
            duties(plant.axis[i].bridge.pole_pairs * plant.axis[i].bridge.theta, volts, duty);
            cycle(&count, edge, i, duty, i == 0 ? 0u : PERIOD / 2u);
        }
        qsort(edge, count, sizeof edge[0], by_clock);
        const uint64_t start = (uint64_t)n * PERIOD;
        const double begin = now_ns();
        for (unsigned e = 0; e < count; e++) {
            const uint64_t clock = start + edge[e].clock;
            if (e == count / 2u) { /* a scan: two currents, two offsets, bus */
                for (int k = 0; k < 2; k++) {
                    sink ^= switching_current_code(&plant, 0, k);
                    sink ^= switching_current_code(&plant, 1, k);
                }
                sink ^= switching_bus_code(&plant);
            }
            uint64_t next;
            while ((next = switching_next(&plant)) <= clock) {
                switching_advance(&plant, next);
                while (switching_take(&plant, &event)) {
                    (*events)++;
                }
            }
            switching_advance(&plant, clock);
            switching_edge(&plant, edge[e].axis, edge[e].phase, edge[e].leg);
        }
        spent += now_ns() - begin;
        if (n % BLOCK == BLOCK - 1u) {
            least = (spent < least) ? spent : least;
            spent = 0.0;
        }
    }
    if (volts > 100.0) {
        printf("%u", sink);
    }

    return least / BLOCK;
}

static double run_averaged(const board_config_t *config, unsigned periods, double volts)
{
    static plant_t plant;
    double spent = 0.0;
    double least = 1e9;
    plant_init(&plant, config);
    for (int i = 0; i < 2; i++) {
        plant.axis[i].inverter.on = true;
        plant.axis[i].motor.load = 0.05 * (volts > 1.0);
    }
    uint64_t clock = 0;
    for (unsigned n = 0; n < periods; n++) {
        double duty[2][3];
        for (int i = 0; i < 2; i++) {
            duties(plant.axis[i].motor.pole_pairs * plant.axis[i].motor.theta, volts, duty[i]);
        }
        const double begin = now_ns();
        for (int i = 0; i < 2; i++) {
            plant_inverter_load(&plant.axis[i].inverter, duty[i], plant.bus.u_dc);
        }
        for (int k = 0; k < 2 * PLANT_STEPS_PER_HALF; k++, clock += plant.step_ns) {
            plant_step(&plant, clock);
        }
        spent += now_ns() - begin;
        if (n % BLOCK == BLOCK - 1u) {
            least = (spent < least) ? spent : least;
            spent = 0.0;
        }
    }
    return least / BLOCK;
}

static plant_axis_t motor(void)
{
    return (plant_axis_t){.r_s = 0.55, .l_d = 0.403e-3, .l_q = 0.512e-3, .psi_m = 0.0154, .pole_pairs = 2, .inertia = 0.8e-5,
                          .friction = 2e-3, .viscous = 1e-5, .encoder_lines = 1000, .i_full_scale = 8.25, .i_noise = 0.008,
                          .i_break = 14.0, .dead_time = 1e-6, .v_drop = 0.7, .r_on = 0.03, .turn_off = 0.25e-6,
                          .i_settle = 0.2e-6, .encoder_jitter = 0.02, .encoder_duty_error = 0.02, .winding_capacity = 25,
                          .winding_resistance = 4, .sink_capacity = 60, .sink_resistance = 5};
}

int main(int argc, char **argv)
{
    const unsigned periods = (argc > 1) ? (unsigned)atoi(argv[1]) : 16000u;
    const board_config_t config = {.axis = {motor(), motor()}, .bus = {24.0, 0.1, 4.7e-3, 36.3, 0.02, 0.0},
                                   .pwm_frequency = 16000.0, .ambient = 25.0, .seed = 1};
    const double volts[3] = {0.0, 4.0, 11.0};
    for (int v = 0; v < 3; v++) {
        if (argc > 2 && v != atoi(argv[2])) {
            continue;
        }
        unsigned events = 0;
        double best;
        double averaged;
        best = run_switching(&config, periods, volts[v], &events);
        averaged = run_averaged(&config, periods, volts[v]);
        printf("%.0f V: switching %.0f ns, averaged %.0f ns per period, ratio %.2f, %.1f events per period\n", volts[v], best, averaged, best / averaged,
               (double)events / periods);
    }
    return 0;
}
