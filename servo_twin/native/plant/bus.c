#include "plant/bus.h"

#include "plant/decay.h"

void plant_bus_init(plant_dc_bus_t *bus, const plant_bus_t *config, double step)
{
    *bus = (plant_dc_bus_t){
        .u_source = config->u_source,
        .r_source = config->r_source,
        .step_over_c = step / config->capacitance,
        .step_over_rc = step / (config->r_source * config->capacitance),
        .approach = plant_approach(step / (config->r_source * config->capacitance)),
        .u_dc = config->u_source,
    };
}

/* 1 - exp(-part step / (R C)), by the parabola through part = 0 and 1 with the right curvature. */
static double approach_after(const plant_dc_bus_t *bus, double part)
{
    return part * bus->approach * (1.0 + 0.5 * (1.0 - part) * bus->step_over_rc);
}

void plant_bus_step(plant_dc_bus_t *bus, double i_load)
{
    const double u = bus->u_dc;
    const double u_s = bus->u_source;
    const double target = u_s - bus->r_source * i_load; /* where the source would settle */
    const double free = u - bus->step_over_c * i_load;  /* the capacitor alone */
    double next;
    if (u <= u_s && target <= u_s) { /* the source feeds all along */
        next = u + (target - u) * bus->approach;
    } else if (u >= u_s && free >= u_s) { /* its diode blocks all along */
        next = free;
    } else if (u < u_s) { /* charged by braking motors: up to u_s with the source's help, then alone */
        const double way = (u_s - u) / (target - u);
        next = u + (target - u) * bus->approach;
        if (next > u_s) {
            double part = way / bus->approach; /* of the step until u_s: at most 1 to begin with, then less */
            for (int i = 0; i < 3; i++) {
                part = way * part / approach_after(bus, part);
            }
            next = u_s - (1.0 - part) * bus->step_over_c * i_load;
        }
    } else { /* discharged: down to u_s alone, then the source joins in */
        const double rest = (u_s - free) / (u - free);
        next = u_s + (target - u_s) * approach_after(bus, rest);
    }
    next = (next > free) ? next : free; /* the crossings are approximate; even so the source takes nothing back */
    bus->u_dc = (next > 0.0) ? next : 0.0;
}
