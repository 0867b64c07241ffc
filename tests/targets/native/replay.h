/* replay.h - the recording in the image of the machine. */
#ifndef TARGETS_REPLAY_H
#define TARGETS_REPLAY_H

#include <stdbool.h>

/* Replay the image; false if it is not a recording. */
bool replay_recording(void);

#endif
