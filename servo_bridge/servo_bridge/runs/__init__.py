"""Recording of a run: every message of the bridge, and of the nodes around it, into a file."""
