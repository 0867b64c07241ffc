/* switched_inverter_interval.h - linear intervals of the switched inverter: the fast integration.
 * Internal: only the files switched_inverter* include it.
 *
 * For some microseconds the rotor's angle and speed hardly change. In such an interval the currents obey
 *   i' = L^-1 v + K i + e + e' t,   K = -R L^-1 + w (J - L^-1 J L),   e = -w L^-1 J psi_m,   J = (0 -1; 1 0)
 * with L^-1 and K at its middle, and in e' the acceleration of the interval before. A segment is a parabola with i' and
 * i'' = K i' + e', or several parabolas at current zero crossings (segment_trajectory.h). The neglected term,
 * (h / tau)^3 / 6 of u / L, does not accumulate: at the end of the interval the flux is the exact integral of the voltages
 * minus R times the charge, the motion of the shaft follows from the impulse of the torque and the first moment of its
 * magnet part, and the currents are those of this flux at this angle.
 */
#ifndef PLANT_SWITCHED_INVERTER_INTERVAL_H
#define PLANT_SWITCHED_INVERTER_INTERVAL_H

#include "plant/switched_inverter.h"

/* Start an interval at the bus voltage u [V]. False if the state does not allow for one. */
bool inverter_interval_start(switched_inverter_t *inv, double u);

/* Begin a segment of the interval in progress. */
void inverter_interval_begin_segment(switched_inverter_t *inv, double u);

/* Advance by at most *rest seconds, as far as intervals apply; *rest becomes the time that is left. Returns the charge drawn
 * from the bus [A s]. */
double inverter_interval_advance(switched_inverter_t *inv, double *rest, double u);

/* Outputs of the amplifiers h seconds into the present segment [A]; false if it ends before. */
bool inverter_interval_amplifiers(const switched_inverter_t *inv, double h, double shown[INVERTER_LANES]);

/* End the interval in progress: flux, angle, speed and sums become those of the present instant. */
void inverter_interval_end(switched_inverter_t *inv);

/* Flux linkage [V s] at the present instant of an interval in progress. */
plant_vector_t inverter_interval_flux(const switched_inverter_t *inv);

#endif
