#include "diagnosis/diagnosis.h"

void diagnosis_suspect(const diagnosis_t *diagnosis, const winding_config_t *config, const observation_t *observation,
                       evidence_t *evidence)
{
    current_sense_monitor_suspect(&diagnosis->current_sense, evidence);
    phase_monitor_suspect(&diagnosis->phase, evidence);
    encoder_monitor_suspect(&diagnosis->encoder, observation, evidence);
    angle_monitor_suspect(&diagnosis->angle, config, observation, evidence);
}
