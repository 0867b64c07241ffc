#include "diagnosis/winding_model.h"

/* Resistance of copper over that at 25 deg C, 14 fraction bits: 1 + 0.00393/K (T - 25 deg C). */
#define COPPER_COLD INT32_C(14774)  /* at 0 deg C: 0.90175 */
#define COPPER_SLOPE INT32_C(16484) /* per 256 deg C: 1.00608 */

void winding_model_init(winding_model_t *model, const winding_model_config_t *config)
{
    *model = (winding_model_t){.temperature = f32_from_f16(config->initial)};
}

/* Temperature rise by the losses of one step, 31 fraction bits. The ranges of the configuration keep the resistance
 * above 0 and the products within 63 bits (servo_msgs_py/axis_config.toml). */
static int64_t heating(const winding_model_t *model, const winding_model_config_t *config)
{
    const int32_t resistance = COPPER_COLD + asr32(COPPER_SLOPE * winding_model_shown(model), 15);
    const int64_t loss = asr64((int64_t)model->squares * resistance, 14);
    return asr64(loss * config->heating, 31);
}

void winding_model_step(winding_model_t *model, const winding_model_config_t *config, bool supervised)
{
    const int64_t excess = (int64_t)model->temperature - f32_from_f16(config->ambient);
    const int64_t lost = asr64(excess * config->cooling + (INT64_C(1) << 31), 32);
    model->temperature = sat32(model->temperature + heating(model, config) - lost);
    model->squares = 0;
    model->ticks = 0;
    const frac16_t now = winding_model_shown(model);
    model->hot = supervised && (now >= config->fault || (model->hot && now >= config->maximum));
}

frac16_t winding_model_limit(const winding_model_t *model, const winding_model_config_t *config, frac16_t max)
{
    const frac16_t now = winding_model_shown(model);
    if (now <= config->derating || max <= config->rated_current) {
        return FRAC16_MAX;
    }
    if (now >= config->maximum) {
        return config->rated_current;
    }
    /* i_rated + (i_max - i_rated) (T_max - T) / (T_max - T_derating) */
    const int32_t weighted = (int32_t)(max - config->rated_current) * (config->maximum - now);
    return (frac16_t)(config->rated_current + weighted / (config->maximum - config->derating));
}
