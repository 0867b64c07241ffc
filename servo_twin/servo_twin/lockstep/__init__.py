"""The twin itself: the same commands at the same ticks as the board, compared at the board's own instants. Pure."""
