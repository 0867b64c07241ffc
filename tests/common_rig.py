"""Settings of every test run, which the ``conftest.py`` of each folder imports."""

from __future__ import annotations

import signal

from hypothesis import settings

# As in the foreground of a terminal: background shells ignore SIGINT, `nohup` SIGHUP, and processes inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
signal.signal(signal.SIGTERM, signal.SIG_DFL)
signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT, signal.SIGHUP, signal.SIGTERM))

# Reproducible random examples, without a time limit that could fail on a busy machine.
settings.register_profile("fixed", derandomize=True, deadline=None)
settings.load_profile("fixed")
