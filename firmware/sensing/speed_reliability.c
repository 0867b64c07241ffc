#include "sensing/speed_reliability.h"

void speed_reliability_reset(speed_reliability_t *reliability) { *reliability = (speed_reliability_t){0}; }

static void take(speed_reliability_t *r, frac16_t speed)
{
    const int32_t old = r->speed[r->next];
    const int32_t new = speed;
    r->sum += new - old;
    r->squares += (int64_t)(new *new) - old * old;
    r->speed[r->next] = speed;
    r->next = (uint16_t)((r->next + 1U) % SPEED_RELIABILITY_SIZE);
    if (r->filled < SPEED_RELIABILITY_SIZE) {
        r->filled++;
    }
}

bool speed_reliability_add(speed_reliability_t *reliability, const speed_reliability_config_t *config, frac32_t speed)
{
    reliability->ticks++;
    if (reliability->ticks < config->period) {
        return false;
    }
    reliability->ticks = 0;
    take(reliability, f16_from_f32(speed));
    if (speed_reliability_holds(reliability, config)) {
        reliability->failures = 0;
    } else if (reliability->failures < UINT16_MAX) {
        reliability->failures++;
    }
    return true;
}

bool speed_reliability_holds(const speed_reliability_t *reliability, const speed_reliability_config_t *config)
{
    /* 64^2 variance = 64 sum(x^2) - sum(x)^2, and 64^2 mean^2 = sum(x)^2: exact, and below 2^58. */
    const int64_t mean = (int64_t)reliability->sum * reliability->sum;
    const int64_t variance = reliability->squares * SPEED_RELIABILITY_SIZE - mean;
    return reliability->filled == SPEED_RELIABILITY_SIZE && variance * 65536 <= mean * config->variance_threshold;
}

frac32_t speed_reliability_mean(const speed_reliability_t *reliability)
{
    return reliability->sum * (INT32_C(1) << (16 - SPEED_RELIABILITY_BITS));
}
