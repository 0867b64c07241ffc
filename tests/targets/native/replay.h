/* replay.h - the recording in the image of the machine. */
#ifndef TARGETS_REPLAY_H
#define TARGETS_REPLAY_H

#include <stdbool.h>

/* Replay it; false if the image is none. */
bool replay_recording(void);

#endif
