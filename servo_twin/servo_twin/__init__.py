"""The world around the chip: virtual board, digital twin, viewer and experiments."""

from pkgutil import extend_path

# A source folder that nothing has been compiled into comes before the installed package where it is the current
# directory, as in `colcon test`. The compiled modules are then taken from the installed package.
__path__ = extend_path(__path__, __name__)
