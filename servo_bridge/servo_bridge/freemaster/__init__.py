"""FreeMASTER version 4 over a serial line: frames, client and discovery. No ROS, usable alone."""
