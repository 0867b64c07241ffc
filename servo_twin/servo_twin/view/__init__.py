"""Display of board and twin in the rerun viewer; only `recording` and `blueprint` import rerun."""
