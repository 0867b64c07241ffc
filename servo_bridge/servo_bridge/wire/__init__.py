"""The serial line: port, session with the board, telemetry scope, queue of writes, time. No ROS."""
