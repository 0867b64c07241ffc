/* diagnosis_inlines.c - the inline functions of the diagnosis as ordinary functions that a test can call
 * (core_inlines.c). */
#include <stdbool.h>
#include <stdint.h>

#include "config/contract_gen.h"
#include "diagnosis/evidence.h"
#include "diagnosis/observation.h"

#define static
#define inline
#include "diagnosis/heat_sink_monitor.h"
#include "diagnosis/oscillation_monitor.h"
#include "diagnosis/shaft_monitor.h"
#include "diagnosis/winding_model.h"
