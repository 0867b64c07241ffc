/* core_inlines.c - the inline functions of the core as ordinary functions that a test can call. */
#include <stdbool.h>
#include <stdint.h>

#define static
#define inline
#include "control/current_loop.h"
#include "control/field_weakening.h"
#include "control/path_filter.h"
#include "control/pll.h"
#include "diagnosis/heat_sink_monitor.h"
#include "diagnosis/shaft_monitor.h"
#include "diagnosis/winding_model.h"
#include "drive/current_sense.h"
#include "sensing/emf_check.h"
#include "sensing/encoder.h"
