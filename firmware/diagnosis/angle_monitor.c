#include "diagnosis/angle_monitor.h"

#include "config/contract_gen.h"

/* Without these features the voltage is not known accurately enough. */
#define NEEDED (FEATURE_DEAD_TIME | FEATURE_BUS_COMPENSATION)

#define TICKS_MAX 4U
#define FILTER_SHIFT 2 /* four slow ticks: current noise times controller gain is as large as the back-EMF */
#define EMF_OVER_SIZE 3 /* a wrong angle rotates the expected back-EMF: the difference is at most twice its size */
#define ALL_PHASES ((UINT16_C(1) << OBSERVED_PHASES) - 1U)

void angle_monitor_start(angle_monitor_t *monitor)
{
    monitor->unexplained_voltage = (dq_t){0, 0};
    monitor->ticks = 0;
    monitor->conducting_phases = 0;
}

static frac16_t filtered(frac16_t unexplained_voltage, int32_t x)
{
    return sat16(unexplained_voltage + asr32(x - unexplained_voltage, FILTER_SHIFT));
}

/* u = R i +- omega L i (+ omega psi in q) + unexplained_voltage. */
static void filter(angle_monitor_t *m, gain_t resistance, const current_loop_config_t *loop, const observation_t *o)
{
    const int32_t omega = o->omega_e;
    const int32_t turned_d = i32_gain(asr32(omega * o->current.q, 15), loop->omega_l_q);
    const int32_t turned_q = i32_gain(asr32(omega * o->current.d, 15), loop->omega_l_d);
    m->unexplained_voltage.d =
        filtered(m->unexplained_voltage.d, o->voltage.d - i32_gain(o->current.d, resistance) + turned_d);
    m->unexplained_voltage.q =
        filtered(m->unexplained_voltage.q, o->voltage.q - i32_gain(o->current.q, resistance) - turned_q - o->emf);
}

/* Tolerated voltage: dead time, a quarter of the inductive drop, the change of the current, and half of the expected
 * back-EMF, which is a rotation of it by 29 degrees or an equal error of its size. Along the current half of the
 * resistive drop is added; a voltage far above that is not a back-EMF. The direction of a small current, and the
 * dead-time error at small current, are uncertain. */
static bool contradicts(const angle_monitor_t *m, const winding_config_t *config, const current_loop_config_t *loop,
                        const observation_t *o)
{
    const int32_t size = o->current_magnitude;
    const int32_t emf = i32_abs(o->emf);
    const int32_t inductive = i32_gain(asr32(i32_abs(o->omega_e) * size, 15), loop->omega_l_q);
    const bool certain = size >= 2 * (int32_t)config->current_min;
    const int32_t lost = certain ? config->emf_floor / 4 : 2 * (int32_t)config->emf_floor;
    const int32_t known = sat16(lost + inductive / 4 + i32_gain(o->current_change, config->inductance) + emf / 2);
    const int32_t along = o->drop / 2;
    const int32_t length = length_about(m->unexplained_voltage.d, m->unexplained_voltage.q);
    const int32_t across = i32_abs(asr32((int32_t)m->unexplained_voltage.d * o->current.q, 1) -
                                   asr32((int32_t)m->unexplained_voltage.q * o->current.d, 1));
    return length < known + along + EMF_OVER_SIZE * emf &&
           (length > known + along || (certain && across > asr32(known * size, 1)));
}

void angle_monitor_step(angle_monitor_t *m, const winding_config_t *config, const current_loop_config_t *loop,
                        const observation_t *o, evidence_t *evidence)
{
    const bool moves = o->ticks_without_movement == 0U; /* otherwise the encoder count itself is in doubt */
    if (!moves || (o->features & NEEDED) != NEEDED || o->current_magnitude < (int32_t)config->current_min) {
        m->unexplained_voltage = (dq_t){0, 0};
        m->ticks = 0;
        m->conducting_phases = 0;
        return;
    }
    filter(m, config->resistance, loop, o);
    if (i32_abs(o->emf) > config->emf_floor / 4 && contradicts(m, config, loop, o)) {
        m->ticks++;
    } else if (m->ticks > 0U) {
        m->ticks--;
    }
    if (m->ticks == 0U) {
        m->conducting_phases = 0;
    } else if (m->ticks > TICKS_MAX && m->conducting_phases == ALL_PHASES) {
        evidence->confirmed |= FOUND(FINDING_EMF_ANGLE_MISMATCH);
    }
}

void angle_monitor_suspect(const angle_monitor_t *m, const winding_config_t *config, const observation_t *o,
                           evidence_t *evidence)
{
    const int32_t explained = i32_abs(o->emf) + config->emf_floor / 4;
    if (!o->sensorless && length_about(m->unexplained_voltage.d, m->unexplained_voltage.q) > explained) {
        evidence->suspected |= SUSPECT_ANGLE;
    }
}
