/* switching_encoder.h - encoder edges of the switching plant: prediction, deferral, disturbances.
 * Internal: only the files switching* include it.
 */
#ifndef PLANT_SWITCHING_ENCODER_H
#define PLANT_SWITCHING_ENCODER_H

#include "plant/switching_schedule.h"

/* Extrapolate the motion of the shaft anew, and find its next edge. */
void switching_update_trajectory(switching_t *plant, int axis);

/* Pass the deferred edges up to the present clock, before the trajectory that predicted them changes. */
void switching_pass_deferred(switching_t *plant, int axis);

/* Pass the edge that is due at the present clock. */
void switching_pass_edge(switching_t *plant, int axis);

/* An encoder line, at level `before`, may have changed without motion of the shaft. */
void switching_update_line(switching_t *plant, int axis, int line, bool before);

/* Draw the time of the next disturbance of a line. */
void switching_schedule_glitch(switching_t *plant, int axis, int line);

/* A disturbance begins or ends. */
void switching_toggle_glitch(switching_t *plant, int axis, int line);

/* Slip of the disc by a number of edges; call switching_update_other_clock afterwards. */
void switching_start_slip(switching_t *plant, int axis, int32_t edges);

/* Pass an edge of a slipping disc. */
void switching_slip(switching_t *plant, int axis);

#endif
