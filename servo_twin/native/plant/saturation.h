/* saturation.h - flux linkage of a winding axis whose iron saturates, without the magnet's.
 *
 *   i = (lambda / L) (1 + (lambda / lambda_s)^2 / 3),  lambda_s = L i_s
 *   d(lambda)/di = L / (1 + (lambda / lambda_s)^2)
 * L is that without current; at i = 4/3 i_s it is half of it for small changes, 3/4 for all of the flux. Each axis has its
 * own, so the energy of the field is a function of the two fluxes. No libm (trig.h).
 */
#ifndef PLANT_SATURATION_H
#define PLANT_SATURATION_H

#include <math.h>

typedef struct {
    double l;     /* without current [H] */
    double per_s; /* 1 / lambda_s; 0: it never saturates [1 / (V s)] */
} saturation_t;

static inline saturation_t saturation_of(double l, double i_s)
{
    return (saturation_t){l, (i_s > 0.0) ? 1.0 / (l * i_s) : 0.0};
}

static inline double saturation_current(saturation_t s, double flux)
{
    const double x = flux * s.per_s;
    return flux / s.l * (1.0 + (1.0 / 3.0) * x * x);
}

/* For small changes [H]. */
static inline double saturation_inductance(saturation_t s, double flux)
{
    const double x = flux * s.per_s;
    return s.l / (1.0 + x * x);
}

/* Flux of a current, by Newton's method from above: the curve bends upwards, so it never falls short. */
static inline double saturation_flux(saturation_t s, double current)
{
    double flux = s.l * current;
    for (int n = 0; s.per_s > 0.0 && n < 60; n++) {
        const double change = (saturation_current(s, flux) - current) * saturation_inductance(s, flux);
        flux -= change;
        if (fabs(change) <= 1e-15 * fabs(flux)) {
            break;
        }
    }
    return flux;
}

#endif
