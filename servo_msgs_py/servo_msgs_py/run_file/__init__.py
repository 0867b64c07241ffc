"""Recordings of runs: MCAP files with all messages of a board, its bridge and its twin.

`writer` makes them, `reader` reads them and the bags of others, `run_info` is the document in them that says what ran.
They need the libraries of the extra ``record`` of this package.
"""
