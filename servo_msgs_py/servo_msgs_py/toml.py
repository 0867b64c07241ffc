"""The module `tomllib`; on Python 3.10 the package ``tomli``, from which it was adopted."""

import sys

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["tomllib"]
