/* bench_plant.c - CPU time of one PWM period of both axes: the plant at switching level, the averaged plant, and
 * their ratio. The fastest of many blocks is used, because other processes disturb.
 *
 *   bench_plant [PERIODS [CASE]]
 */
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "plant/plant.h"
#include "plant/switching.h"
#include "plant/trig.h"

#define PERIOD 6250u
#define DEAD 100u
#define EDGES 24u  /* per period, both axes */
#define GROUP 8u   /* periods whose edges are computed in advance */
#define BLOCK 8u   /* groups in a block: a significant change of the electrical angle */

typedef struct {
    uint64_t clock;
    int axis, phase;
    switching_leg_t leg;
    bool scan; /* the converter samples before this edge */
} edge_t;

typedef struct {
    double volts, load; /* [V], [N m] */
} case_t;

static const case_t cases[] = {{0.0, 0.0}, {4.0, 0.05}, {11.0, 0.05}, {4.0, 0.0}, {11.0, 0.0}};

/* The fastest block at speed. */
typedef struct {
    double least, spent; /* [ns] */
} meter_t;

static void meter_add(meter_t *meter, double ns, unsigned n, unsigned groups)
{
    meter->spent += ns;
    if (n % BLOCK == BLOCK - 1u) {
        meter->least = (meter->spent < meter->least && n > groups / 4u) ? meter->spent : meter->least;
        meter->spent = 0.0;
    }
}

static double meter_per_period(const meter_t *meter) { return meter->least / (BLOCK * GROUP); }

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

/* Voltage on the q axis, like that of a controller. */
static void duties(double theta_e, double volts, double duty[3])
{
    double c;
    double s;
    plant_sincos(theta_e, &s, &c);
    const double alpha = -volts * s / 24.0;
    const double beta = 0.5 * PLANT_SQRT3 * volts * c / 24.0;
    duty[0] = 0.5 + alpha;
    duty[1] = 0.5 - 0.5 * alpha + beta;
    duty[2] = 0.5 - 0.5 * alpha - beta;
}

static unsigned cycle(edge_t *edge, int axis, const double duty[3], uint64_t start)
{
    static const switching_leg_t leg[4] = {SWITCHING_OPEN, SWITCHING_HIGH, SWITCHING_OPEN, SWITCHING_LOW};
    unsigned count = 0;
    for (int k = 0; k < 3; k++) {
        const unsigned low = (unsigned)(0.5 * PERIOD * (1.0 - duty[k]));
        const unsigned clock[4] = {low, low + DEAD, PERIOD - low, PERIOD - low + DEAD};
        for (int n = 0; n < 4; n++) {
            edge[count++] = (edge_t){start + clock[n], axis, k, leg[n], false};
        }
    }
    return count;
}

/* Edges of the next periods, axis 2 half a period later. */
static unsigned group(const switching_t *plant, double volts, uint64_t start, edge_t *edge)
{
    unsigned count = 0;
    for (unsigned n = 0; n < GROUP; n++) {
        for (int i = 0; i < 2; i++) {
            const switched_inverter_t *inverter = &plant->axis[i].inverter;
            double duty[3];
            duties(inverter->pole_pairs * (inverter->theta + n * 62.5e-6 * inverter->omega), volts, duty);
            count += cycle(edge + count, i, duty, start + n * PERIOD + (unsigned)i * (PERIOD / 2u));
        }
    }
    qsort(edge, count, sizeof edge[0], by_clock);
    for (unsigned n = 0; n < count; n += EDGES / 2u) {
        edge[n].scan = true;
    }
    return count;
}

static double run_switching(const board_config_t *config, unsigned groups, case_t c, unsigned *events)
{
    static switching_t plant;
    static edge_t edge[GROUP * EDGES];
    switching_event_t event;
    meter_t meter = {.least = 1e9};
    volatile uint16_t code = 0;
    switching_init(&plant, config);
    switching_set_load(&plant, 0, c.load);
    switching_set_load(&plant, 1, c.load);
    *events = 0;
    for (unsigned n = 0; n < groups; n++) {
        const unsigned count = group(&plant, c.volts, (uint64_t)n * GROUP * PERIOD + PERIOD, edge);
        const double begin = now_ns();
        for (unsigned e = 0; e < count; e++) {
            uint64_t next;
            while ((next = switching_next(&plant)) <= edge[e].clock) {
                switching_advance(&plant, next);
                while (switching_take(&plant, &event)) {
                    (*events)++;
                }
            }
            switching_advance(&plant, edge[e].clock);
            if (edge[e].scan) { /* twice per period: two currents, two offsets, bus */
                for (int k = 0; k < 2; k++) {
                    code = switching_current_code(&plant, 0, k);
                    code = switching_current_code(&plant, 1, k);
                }
                code = switching_bus_code(&plant);
            }
            switching_edge(&plant, edge[e].axis, edge[e].phase, edge[e].leg);
        }
        meter_add(&meter, now_ns() - begin, n, groups);
    }
    (void)code;
    return meter_per_period(&meter);
}

static double run_averaged(const board_config_t *config, unsigned groups, case_t c)
{
    static plant_t plant;
    static double duty[GROUP][2][3];
    meter_t meter = {.least = 1e9};
    volatile uint16_t code = 0;
    static const int phase[2] = {0, 1};
    plant_samples_t samples;
    uint16_t codes[2];
    plant_init(&plant, config);
    for (int i = 0; i < 2; i++) {
        plant.axis[i].inverter.on = true;
        plant.axis[i].motor.load = c.load;
    }
    uint64_t clock = 0;
    for (unsigned n = 0; n < groups; n++) {
        for (unsigned g = 0; g < GROUP; g++) {
            for (int i = 0; i < 2; i++) {
                const plant_motor_t *motor = &plant.axis[i].motor;
                duties(motor->pole_pairs * (motor->theta + g * 62.5e-6 * motor->omega), c.volts, duty[g][i]);
            }
        }
        const double begin = now_ns();
        for (unsigned g = 0; g < GROUP; g++) {
            for (int half = 0; half < 2; half++) {
                for (int i = 0; i < 2; i++) {
                    averaged_inverter_load(&plant.axis[i].inverter, duty[g][i], plant.bus.u);
                }
                plant_step(&plant, clock);
                clock += plant.step_ns;
                for (int i = 0; i < 2; i++) {
                    plant_sample(&plant, i, phase, half == i, &samples);
                    plant_sample_codes(&plant, i, &samples, codes);
                    code = (uint16_t)(codes[0] + codes[1]);
                }
                code = plant_bus_code(&plant);
            }
        }
        meter_add(&meter, now_ns() - begin, n, groups);
    }
    (void)code;
    return meter_per_period(&meter);
}

static plant_axis_t motor(void)
{
    return (plant_axis_t){
        .r_s = 0.55,
        .l_d = 0.403e-3,
        .l_q = 0.512e-3,
        .psi_m = 0.0154,
        .pole_pairs = 2,
        .inertia = 0.8e-5,
        .friction = 2e-3,
        .viscous = 1e-5,
        .encoder_lines = 1000,
        .i_full_scale = 8.25,
        .i_noise = 0.008,
        .i_break = 14.0,
        .dead_time = 1e-6,
        .v_drop = 0.7,
        .r_on = 0.03,
        .dead_time_min = 0.25e-6,
        .i_settle = 0.2e-6,
        .encoder_jitter = 0.02,
        .encoder_duty_error = 0.02,
        .encoder_hysteresis = 0.03,
        .winding_capacity = 25,
        .winding_resistance = 4,
        .sink_capacity = 60,
        .sink_resistance = 5,
    };
}

int main(int argc, char **argv)
{
    const unsigned groups = ((argc > 1) ? (unsigned)atoi(argv[1]) : 16000u) / GROUP;
    const board_config_t config = {
        .axis = {motor(), motor()},
        .bus = {.u_source = 24.0, .r_source = 0.1, .capacitance = 4.7e-3, .u_full_scale = 36.3, .u_noise = 0.02},
        .pwm_frequency = 16000.0,
        .ambient = 25.0,
        .seed = 1,
    };
    for (int v = 0; v < (int)(sizeof cases / sizeof cases[0]); v++) {
        if (argc > 2 && v != atoi(argv[2])) {
            continue;
        }
        unsigned events = 0;
        const double switching = run_switching(&config, groups, cases[v], &events);
        const double averaged = run_averaged(&config, groups, cases[v]);
        printf("%4.0f V %3.0f mN m: switching %5.0f ns, averaged %4.0f ns per period, ratio %.2f, %.1f encoder edges\n",
               cases[v].volts, 1e3 * cases[v].load, switching, averaged, switching / averaged,
               (double)events / (groups * GROUP));
    }
    return 0;
}
