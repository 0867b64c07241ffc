"""Bursts: what the recorder of a board samples at the rate of its loops; from the request to files and topics."""
