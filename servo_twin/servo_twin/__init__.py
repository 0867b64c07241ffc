"""The world around the chip: virtual board, digital twin, viewer and experiments."""
