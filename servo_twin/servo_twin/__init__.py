"""Virtual board, digital twin, viewer and experiments."""

from pkgutil import extend_path

# In `colcon test` the current directory is a source folder without compiled modules, and it precedes the installed
# package. The compiled modules are then taken from the installed package.
__path__ = extend_path(__path__, __name__)
