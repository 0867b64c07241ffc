"""Interface of firmware, bridge and twin: variables, units, topic names and conversions."""
