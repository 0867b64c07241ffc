#include "sensing/speed_reliability.h"

void speed_reliability_reset(speed_reliability_t *reliability) { *reliability = (speed_reliability_t){0}; }

static void take(speed_reliability_t *reliability, frac16_t speed)
{
    const int32_t old = reliability->speed[reliability->next];
    const int32_t new = speed;
    reliability->sum += new - old;
    reliability->squares += (int64_t)(new *new) - old * old;
    reliability->speed[reliability->next] = speed;
    reliability->next = (uint16_t)((reliability->next + 1U) % SPEED_RELIABILITY_SIZE);
    if (reliability->filled < SPEED_RELIABILITY_SIZE) {
        reliability->filled++;
    }
}

bool speed_reliability_add(speed_reliability_t *reliability, const speed_reliability_config_t *config, frac32_t speed)
{
    reliability->ticks++;
    const bool due = reliability->ticks >= config->period;
    if (due) {
        reliability->ticks = 0;
        take(reliability, f16_from_f32(speed));
        const bool holds = speed_reliability_holds(reliability, config);
        const uint16_t more = (uint16_t)(reliability->failures + ((reliability->failures < UINT16_MAX) ? 1U : 0U));
        reliability->failures = holds ? 0U : more;
    }
    return due;
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
