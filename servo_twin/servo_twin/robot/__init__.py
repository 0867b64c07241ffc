"""Joints of a robot in another simulator, moved by the drives of a virtual board."""
