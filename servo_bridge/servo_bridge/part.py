"""Interface of the functions of the bridge that depend on the connection to the board."""

from __future__ import annotations

from servo_bridge.telemetry import Snapshot


class Part:
    """One function of the bridge; all methods are called in the thread of the executor.

    A part overrides what concerns it. The supervisor calls all parts in the order of its list.
    """

    def connected(self) -> None:
        """The link is up; the first sample follows."""

    def on_sample(self, snapshot: Snapshot) -> None:
        """Process the newest sample."""

    def lost(self, reason: str) -> None:
        """No board is connected: forget its state, and answer those who wait for it. Also before the first connection.

        Parameters
        ----------
        reason : str
            One line, for messages.
        """

    def close(self) -> None:
        """The bridge ends, after `lost`: end threads."""
