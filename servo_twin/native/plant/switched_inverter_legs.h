/* switched_inverter_legs.h - conduction state of the three legs, limits of their voltages, current amplifiers at their shunts.
 * Internal: only the files switched_inverter* include it.
 */
#ifndef PLANT_SWITCHED_INVERTER_LEGS_H
#define PLANT_SWITCHED_INVERTER_LEGS_H

#include "plant/switched_inverter_motor.h"

#define LEG_A INVERTER_LEG(0)
#define LEG_B INVERTER_LEG(1)
#define LEG_C INVERTER_LEG(2)

/* Clarke transform and mean of legs that are at 1 V (in the set) or 0 V. */
static const double legs_at[INVERTER_LEG_SETS][INVERTER_LANES] PLANT_ALIGNED = {
    [LEG_A] = {2.0 * THIRD, 0.0, THIRD},
    [LEG_B] = {-THIRD, 1.0 / PLANT_SQRT3, THIRD},
    [LEG_A | LEG_B] = {THIRD, 1.0 / PLANT_SQRT3, 2.0 * THIRD},
    [LEG_C] = {-THIRD, -1.0 / PLANT_SQRT3, THIRD},
    [LEG_A | LEG_C] = {THIRD, -1.0 / PLANT_SQRT3, 2.0 * THIRD},
    [LEG_B | LEG_C] = {-2.0 * THIRD, 0.0, 2.0 * THIRD},
    [INVERTER_LEGS] = {0.0, 0.0, 1.0},
};
enum { LEGS_ALPHA, LEGS_BETA, LEGS_MEAN };

/* ---- signs of the currents -------------------------------------------------------------------------------------------- */

static inline int sign_of(const switched_inverter_t *inv, int k)
{
    return (int)(inv->positive >> INVERTER_LANE(k) & 1u) - (int)(inv->negative >> INVERTER_LANE(k) & 1u);
}

static inline void set_sign(switched_inverter_t *inv, int k, int sign)
{
    const unsigned leg = INVERTER_LEG(k) & ~inv->joined;
    inv->positive = (inv->positive & ~leg) | ((sign > 0) ? leg : 0u);
    inv->negative = (inv->negative & ~leg) | ((sign < 0) ? leg : 0u);
}

/* The only leg without current, -1: none, ALL_LEGS_ZERO: more than one. */
#define ALL_LEGS_ZERO 3
static inline int leg_at_zero(const switched_inverter_t *inv)
{
    static const int8_t leg[INVERTER_LEG_SETS] = {
        ALL_LEGS_ZERO,
        ALL_LEGS_ZERO,
        ALL_LEGS_ZERO,
        ALL_LEGS_ZERO,
        ALL_LEGS_ZERO,
        2,
        ALL_LEGS_ZERO,
        ALL_LEGS_ZERO,
        ALL_LEGS_ZERO,
        1,
        ALL_LEGS_ZERO,
        ALL_LEGS_ZERO,
        0,
        -1,
    };
    return leg[inv->positive | inv->negative | inv->joined];
}

/* ---- conduction state ------------------------------------------------------------------------------------------------- */

/* Set of lower gates that are on. */
static inline unsigned lower_of(const switched_inverter_t *inv) { return inv->gates >> INVERTER_LOWER; }

/* Legs at the positive rail. The result for a leg without current has no effect, here and below. */
static inline unsigned legs_at_upper_rail(const switched_inverter_t *inv)
{
    return (inv->negative & ~lower_of(inv)) | (inv->positive & inv->gates);
}

/* Conduction state of the legs without a short. */
static inline conduction_t separate_conduction(const switched_inverter_t *inv)
{
    const unsigned upper = legs_at_upper_rail(inv) & inv->separate;
    return (conduction_t){.upper = upper, .reversed = inv->negative & inv->separate, .lower = inv->separate & ~upper};
}

/* Conduction state of two legs shorted to each other, by the sign of their total current. Legs with different gates count as
 * open: their short-circuit current trips the comparator. */
static inline conduction_t joined_conduction(const switched_inverter_t *inv, int sign)
{
    const unsigned joined = inv->joined;
    const bool upper = (sign < 0) ? (lower_of(inv) & joined) != joined : (inv->gates & joined) == joined;
    return (conduction_t){
        .upper = upper ? joined : 0u, .reversed = (sign < 0) ? joined : 0u, .lower = upper ? 0u : joined};
}

/* Of all legs. Two legs shorted to each other without current are taken to be at -V. */
static inline conduction_t conduction_of(const switched_inverter_t *inv)
{
    conduction_t conduction = separate_conduction(inv);
    const int sign = (inv->unshorted >= 0) ? sign_of(inv, inv->unshorted) : 0;
    if (sign != 0) {
        const conduction_t joined = joined_conduction(inv, -sign);
        conduction.upper |= joined.upper;
        conduction.reversed |= joined.reversed;
        conduction.lower |= joined.lower;
    }
    return conduction;
}

/* Update the conduction state and the voltage vectors that follow from it. */
static inline void update_conduction(switched_inverter_t *inv)
{
    inv->conduction = conduction_of(inv);
    const double *upper = legs_at[inv->conduction.upper];
    const double *drops = inv->drops[inv->conduction.reversed];
    inv->switch_vector = (plant_vector_t){upper[LEGS_ALPHA], upper[LEGS_BETA]};
    inv->drop_vector = (plant_vector_t){drops[LEGS_ALPHA], drops[LEGS_BETA]};
    inv->leg_mean = inv->u * upper[LEGS_MEAN] + drops[LEGS_MEAN];
    if (inv->grounded >= 0 && sign_of(inv, inv->grounded) != 0) { /* at bus minus, not one drop below */
        const double *lift = legs_at[INVERTER_LEG(inv->grounded)];
        inv->drop_vector.alpha += inv->v_drop * lift[LEGS_ALPHA];
        inv->drop_vector.beta += inv->v_drop * lift[LEGS_BETA];
        inv->leg_mean += inv->v_drop * lift[LEGS_MEAN];
    }
}

/* ---- limits of the leg voltages --------------------------------------------------------------------------------------- */

static inline double conduction_voltage(const switched_inverter_t *inv, conduction_t conduction, double u)
{
    return ((conduction.upper != 0u) ? u : 0.0) + ((conduction.reversed != 0u) ? inv->v_drop : -inv->v_drop);
}

/* Limits of a leg without a short [V]. By a product instead of a branch, which would be unpredictable. */
static inline double separate_leg_min(const switched_inverter_t *inv, int k, double u)
{
    return u * (double)(int)(inv->gates >> INVERTER_LANE(k) & 1u) - inv->beyond_rail[k];
}

static inline double separate_leg_max(const switched_inverter_t *inv, int k, double u)
{
    return u * (double)(int)(~lower_of(inv) >> INVERTER_LANE(k) & 1u) + inv->beyond_rail[k];
}

/* Limits of any leg [V]. Those of the leg beside two that are shorted to each other are relative to these at -V. */
static inline double leg_min(const switched_inverter_t *inv, int k, double u)
{
    const double low = (k == inv->grounded) ? 0.0 : separate_leg_min(inv, k, u);
    return (k == inv->unshorted) ? low - conduction_voltage(inv, joined_conduction(inv, -1), u) - inv->v_drop : low;
}

static inline double leg_max(const switched_inverter_t *inv, int k, double u)
{
    const double high = (k == inv->grounded) ? 0.0 : separate_leg_max(inv, k, u);
    return (k == inv->unshorted) ? high - conduction_voltage(inv, joined_conduction(inv, 1), u) - inv->v_drop : high;
}

/* Leg k, at -V so far, moves to the voltage that keeps its current at zero, which is `needed` higher, limited to low .. high.
 * It floats there, or begins to conduct at the limit. Returns its change of voltage [V]. */
static inline double settle_leg(switched_inverter_t *inv, int k, double low, double high, double needed)
{
    const double floating_volts = needed - inv->v_drop;
    inv->floating_volts = floating_volts;
    double voltage = floating_volts;
    inv->floating = -1;
    if (floating_volts < low) {
        set_sign(inv, k, 1);
        voltage = low;
    } else if (floating_volts > high) {
        set_sign(inv, k, -1);
        voltage = high;
    } else {
        inv->floating = k;
    }
    return voltage + inv->v_drop;
}

/* ---- no current ------------------------------------------------------------------------------------------------------- */

/* Back-EMF in excess of the voltage that the legs block, all of them without current, at the flux `psi` of the magnet alone [V].
 * The current would flow out of leg *source and back into leg *sink. */
double inverter_blocking_excess(const switched_inverter_t *inv, double u, plant_vector_t psi, double omega, int *source,
                                int *sink);

/* With two or more legs without current: nothing flows unless the back-EMF exceeds the bus voltage, since a single leg has no
 * return path. Returns the leg that stays without current, -1 if all of them do. */
int inverter_find_conducting_pair(switched_inverter_t *inv, double u);

/* Set all currents to zero. */
void inverter_remove_all_currents(switched_inverter_t *inv);

/* ---- current amplifiers ----------------------------------------------------------------------------------------------- */

/* Exponential decay of the amplifiers in h seconds. */
static inline double amplifier_decay(const switched_inverter_t *inv, double h)
{
    const unsigned n = (unsigned)(int)(h * INVERTER_CLOCK_HZ + 0.5);
    const unsigned coarse = n / INVERTER_DECAY;
    return inv->decay_coarse[(coarse < INVERTER_DECAY) ? coarse : INVERTER_DECAY] * inv->decay_fine[n % INVERTER_DECAY];
}

/* 1 if the lower half of leg k conducts, so that its shunt carries the phase current. */
static inline double shunt_share(const switched_inverter_t *inv, int k)
{
    return (inv->conduction.lower & INVERTER_LEG(k)) != 0u ? 1.0 : 0.0;
}

#endif
