#include "drive/faults.h"

uint16_t fault_code(fault_set_t faults)
{
    uint16_t code = 0;
    if (faults != 0U) {
        code = 1;
        while ((faults & 1U) == 0U) {
            faults >>= 1;
            code++;
        }
    }
    return code;
}
