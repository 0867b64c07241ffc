/* saturation.h - flux linkage of a winding axis with saturated iron, without that of the magnet.
 *
 *   i = (lambda / L) (1 + (lambda / lambda_s)^2 / 3),  lambda_s = L i_s
 *   d(lambda)/di = L / (1 + (lambda / lambda_s)^2)
 * L is the inductance without current. At i = 4/3 i_s the differential inductance is half of it, and flux over current 3/4 of
 * it. The axes are independent (no cross-saturation), so the field energy is a function of the two fluxes. No libm (trig.h).
 */
#ifndef PLANT_SATURATION_H
#define PLANT_SATURATION_H

#include <math.h>

typedef struct {
    double l;     /* without current [H] */
    double per_s; /* 1 / lambda_s; 0: no saturation [1/(V s)] */
} saturation_t;

/* `l` inductance without current [H], `i_s` current scale [A]; 0: no saturation. */
static inline saturation_t saturation_of(double l, double i_s)
{
    return (saturation_t){l, (i_s > 0.0) ? 1.0 / (l * i_s) : 0.0};
}

/* Current of a flux [A]. */
static inline double saturation_current(saturation_t s, double flux)
{
    const double x = flux * s.per_s;
    return flux / s.l * (1.0 + (1.0 / 3.0) * x * x);
}

/* Differential inductance [H]. */
static inline double saturation_inductance(saturation_t s, double flux)
{
    const double x = flux * s.per_s;
    return s.l / (1.0 + x * x);
}

/* Flux of a current [V s], by Newton's method from above, which converges monotonically as the curve is convex. */
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
