#include "plant/thermal.h"

#include "plant/decay.h"

void thermal_init(thermal_t *body, double capacity, double resistance, double ambient)
{
    *body = (thermal_t){capacity, resistance, ambient, ambient};
}

void thermal_change(thermal_t *body, double capacity, double resistance)
{
    body->capacity = capacity;
    body->resistance = resistance;
}

double thermal_magnet(double h, double time) { return (time > 0.0) ? plant_one_minus_decay(h / time) : 1.0; }

void thermal_advance(thermal_t *body, double h, double energy)
{
    const double end = body->ambient + body->resistance * energy / h; /* final temperature at this power */
    body->t += (end - body->t) * plant_one_minus_decay(h / (body->resistance * body->capacity));
}
