"""Bursts: samples of the recorder of a board at the rate of its control loops, written to files and topics."""
