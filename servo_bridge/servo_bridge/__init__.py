"""The wire to the servo board: FreeMASTER client, serial link, arbiter and the ROS 2 node."""
