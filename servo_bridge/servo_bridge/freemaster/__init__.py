"""FreeMASTER protocol over a serial line: frames, client and discovery of variables. No ROS; can be used alone."""
