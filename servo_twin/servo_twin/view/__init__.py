"""The rerun view of board and twin; only `recording` and `blueprint` import rerun."""
