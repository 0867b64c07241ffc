"""The one way in which the tool says no."""

from __future__ import annotations


class ConfigError(ValueError):
    """The configuration cannot work; the message names the entry, its value, the reason and a way out."""


def refused(entry: str, value: object, reason: str, remedy: str) -> ConfigError:
    """Error about one entry, in the order in which people need it.

    Parameters
    ----------
    entry : str
        Full name, such as ``axis1.motor.inertia``.
    value : object
        What stands there, or what follows from it.
    reason : str
        Why it cannot work.
    remedy : str
        What to do about it.
    """
    shown = f"{value:g}" if isinstance(value, float) else f"{value}"
    return ConfigError(f"{entry} = {shown}: {reason}; {remedy}")
