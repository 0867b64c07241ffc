"""Configuration blocks of a running board: planning, transfer and reading back; used by command line and bridge."""
