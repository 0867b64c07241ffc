"""The contract between firmware, bridge and twin: variables, units, topic names and conversions."""
