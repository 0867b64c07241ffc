"""Commissioning of an axis: a sequence of checked steps, and the pack that it leaves."""
