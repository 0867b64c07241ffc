/* switched_inverter_motor.h - motor equations of the switched inverter: vectors, flux and current, rotor angle, shaft.
 * Internal: only the files switched_inverter* include it.
 */
#ifndef PLANT_SWITCHED_INVERTER_MOTOR_H
#define PLANT_SWITCHED_INVERTER_MOTOR_H

#include <math.h>

#include "plant/inline.h"
#include "plant/switched_inverter.h"
#include "plant/trig.h"

#define INSTANT 1e-14 /* shorter times count as zero [s] */
#define CURRENT_EPS 1e-12 /* residue of rounding, counts as zero [A] */
#define THIRD (1.0 / 3.0)
#define SIXTH (1.0 / 6.0)
#define HALF_SQRT3 (0.5 * PLANT_SQRT3)

/* Axes of the phases in the stator reference frame. */
static const plant_vector_t phase_axis[3] = {{1.0, 0.0}, {-0.5, HALF_SQRT3}, {-0.5, -HALF_SQRT3}};

/* State at the end of a step. */
typedef struct {
    plant_vector_t psi, i, charge; /* flux linkage [V s], current [A], integral of the current over the step [A s] */
    double theta, omega;           /* mechanical [rad], [rad/s] */
    double cosine, sine;           /* electrical angle [1] */
    symmetric_matrix_t inverse;    /* L^-1 [1/H] */
    double phase[3];               /* [A] */
    double torque;                 /* [N m] */
} step_end_t;

/* ---- vectors ---------------------------------------------------------------------------------------------------------- */

static inline double dot(plant_vector_t x, plant_vector_t y) { return x.alpha * y.alpha + x.beta * y.beta; }

static inline double cross(plant_vector_t x, plant_vector_t y) { return x.alpha * y.beta - x.beta * y.alpha; }

static inline plant_vector_t times(symmetric_matrix_t m, plant_vector_t x)
{
    return (plant_vector_t){m.aa * x.alpha + m.ab * x.beta, m.ab * x.alpha + m.bb * x.beta};
}

static inline void phases_of(plant_vector_t i, double phase[3])
{
    const double half = -0.5 * i.alpha;
    const double side = HALF_SQRT3 * i.beta;
    phase[0] = i.alpha;
    phase[1] = half + side;
    phase[2] = half - side;
}

/* ---- flux and current ------------------------------------------------------------------------------------------------- */

/* Inverse inductance in the stator reference frame at the rotor angle with cosine c and sine s [1/H]. */
static inline symmetric_matrix_t inverse_of(const switched_inverter_t *inv, double c, double s)
{
    const double along = inv->inv_l_half * (c * c - s * s);
    return (symmetric_matrix_t){inv->inv_l_mean + along, 2.0 * inv->inv_l_half * c * s, inv->inv_l_mean - along};
}

/* Current of saturated iron. */
plant_vector_t inverter_saturated_current(const switched_inverter_t *inv, plant_vector_t psi, double c, double s);

/* Current of a flux at the rotor angle with cosine c and sine s. */
static inline plant_vector_t current_of(const switched_inverter_t *inv, symmetric_matrix_t inverse, plant_vector_t psi,
                                        double c, double s)
{
    if (inv->saturates) {
        return inverter_saturated_current(inv, psi, c, s);
    }
    return times(inverse, (plant_vector_t){psi.alpha - inv->psi_m * c, psi.beta - inv->psi_m * s});
}

/* Flux and torque of the present currents. */
void inverter_update_flux(switched_inverter_t *inv);

/* Inductances without current, or differential ones [H]. */
void inverter_set_inductances(switched_inverter_t *inv, double l_d, double l_q);

/* Differential inductances of saturated iron at the present flux. */
void inverter_update_saturated_inductances(switched_inverter_t *inv);

/* Remove the rest of the current of phase k at its zero crossing, which is the error of a root. */
void inverter_remove_phase_current(switched_inverter_t *inv, int k);

/* Move the current along the axis `n` to zero, by the free voltage of that axis. `per_n` is L^-1 n, `per_l` 1 / (n L^-1 n).
 * Returns the integral of the voltage [V s]. */
PLANT_INLINE double clear_axis_current(plant_vector_t n, plant_vector_t per_n, double per_l, step_end_t *e)
{
    const double lift = -dot(n, e->i) * per_l;
    e->i.alpha += lift * per_n.alpha;
    e->i.beta += lift * per_n.beta;
    e->psi.alpha += lift * n.alpha;
    e->psi.beta += lift * n.beta;
    return lift;
}

/* Bounds of K and e' of i'' = K i' + e' at the present speed. */
static inline void update_curvature_bounds(switched_inverter_t *inv)
{
    const double w = fabs(inv->pole_pairs * inv->omega);
    inv->k_max = inv->r * inv->inv_l_max + w * (1.0 + inv->saliency);
    inv->emf_term_max = w * w * inv->psi_m * inv->inv_l_max;
}

/* ---- rotor and shaft -------------------------------------------------------------------------------------------------- */

/* Evaluate sine and cosine of the rotor angle, and L^-1. */
void inverter_evaluate_angle(switched_inverter_t *inv);

/* Count an incremental update of sine and cosine; evaluates them anew from time to time. */
void inverter_count_rotation(switched_inverter_t *inv);

/* Motion of the shaft in h seconds at the present acceleration and jerk. */
PLANT_INLINE void rotate(const switched_inverter_t *inv, double h, step_end_t *e)
{
    const double rotation = h * (inv->omega + h * (0.5 * inv->accel + (SIXTH * h) * inv->jerk));
    const double x = inv->pole_pairs * rotation;
    const double x2 = x * x;
    const double c = 1.0 - x2 * (0.5 - x2 * ((1.0 / 24.0) - x2 * (1.0 / 720.0)));
    const double s = x * (1.0 - x2 * (SIXTH - x2 * (1.0 / 120.0)));
    e->theta = inv->theta + rotation;
    e->cosine = inv->cosine * c - inv->sine * s;
    e->sine = inv->sine * c + inv->cosine * s;
    e->inverse = inverse_of(inv, e->cosine, e->sine);
}

/* False if an end stop blocks a resting shaft in `direction`. */
static inline bool direction_is_free(const switched_inverter_t *inv, double direction)
{
    return (direction > 0.0) ? inv->theta < inv->stop_max : inv->theta > inv->stop_min;
}

/* ---- roots ------------------------------------------------------------------------------------------------------------ */

/* First root within h of the parabola f0 + d0 t + c t^2 with f0 >= 0 and f(h) < 0. An f0 that rounding has made negative
 * counts as zero; then there may be no later root, so the result is limited to h. */
static inline double root_within(double f0, double d0, double c, double h)
{
    double t;
    if (f0 <= 0.0) {
        t = (d0 > 0.0 && c < 0.0) ? -d0 / c : 0.0;
    } else {
        const double square = d0 * d0 - 4.0 * c * f0;
        const double sum = ((square > 0.0) ? sqrt(square) : 0.0) - d0;
        t = (sum > 0.0) ? 2.0 * f0 / sum : h;
    }
    return (t < h) ? t : h;
}

/* The same with the parabola given by f(h) = f1. */
static inline double root_of(double f0, double d0, double f1, double h)
{
    return root_within(f0, d0, (f1 - f0 - d0 * h) / (h * h), h);
}

#endif
