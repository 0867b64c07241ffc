#include "plant/switched_inverter_legs.h"

double inverter_blocking_excess(const switched_inverter_t *inv, double u, plant_vector_t psi, double omega, int *source,
                                int *sink)
{
    const double w = inv->pole_pairs * omega;
    const double side = HALF_SQRT3 * w * psi.alpha;
    const double emf[3] = {-w * psi.beta, 0.5 * w * psi.beta + side, 0.5 * w * psi.beta - side};
    /* every leg blocks while the star point's potential lies between these two */
    double star_min = leg_min(inv, 0, u) - emf[0];
    double star_max = leg_max(inv, 0, u) - emf[0];
    *source = *sink = 0;
    for (int k = 1; k < 3; k++) {
        const double from = leg_min(inv, k, u) - emf[k];
        const double to = leg_max(inv, k, u) - emf[k];
        if (from > star_min) {
            star_min = from;
            *source = k;
        }
        if (to < star_max) {
            star_max = to;
            *sink = k;
        }
    }
    return star_min - star_max;
}

int inverter_find_conducting_pair(switched_inverter_t *inv, double u)
{
    int source = 0;
    int sink = 0;
    inv->positive = inv->negative = 0u;
    inv->non_conducting = inv->unplugged ||
                          inverter_blocking_excess(inv, u, inv->psi, inv->omega, &source, &sink) <= 0.0 ||
                          source == sink;
    if (inv->non_conducting) {
        return -1;
    }
    set_sign(inv, source, 1);
    set_sign(inv, sink, -1);
    return 3 - source - sink;
}

void inverter_remove_all_currents(switched_inverter_t *inv)
{
    inv->i = (plant_vector_t){0.0, 0.0};
    inv->psi.alpha = inv->psi_m * inv->cosine;
    inv->psi.beta = inv->psi_m * inv->sine;
    inv->torque = 0.0;
    for (int k = 0; k < 3; k++) {
        inv->phase[k] = 0.0;
        set_sign(inv, k, 0);
    }
}
