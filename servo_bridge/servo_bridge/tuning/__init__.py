"""Configuration blocks of a board that runs: planned, sent and read back, by the command line and by the bridge."""
