"""Errors of the configuration, with a uniform message."""

from __future__ import annotations


class ConfigError(ValueError):
    """The configuration cannot work; the message gives the entry, its value, the reason and a remedy."""


def refused(entry: str, value: object, reason: str, remedy: str) -> ConfigError:
    """Error about one entry: entry, value, reason, remedy.

    Parameters
    ----------
    entry : str
        Full name, such as ``axis1.motor.inertia``.
    value : object
        Its value, or a value computed from it.
    reason : str
        Why it cannot work.
    remedy : str
        Change that corrects it.
    """
    shown = f"{value:g}" if isinstance(value, float) else f"{value}"
    return ConfigError(f"{entry} = {shown}: {reason}; {remedy}")
