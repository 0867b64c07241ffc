"""One runner for everything that runs many boards: on the cores of this machine, or on a Dask cluster.

What is run is a `Work`: a picklable object whose trials are numbered, and whose results follow from it and the number
alone. So results are the same however many workers there are, and in whatever order they finish.
"""

from servo_twin.runner.run import HERE, Runner, run_in_order
from servo_twin.runner.work import RunError, TrialError, Work, WorkerLostError

__all__ = ["HERE", "RunError", "Runner", "TrialError", "Work", "WorkerLostError", "run_in_order"]
