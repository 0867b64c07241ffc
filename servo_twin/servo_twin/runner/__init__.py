"""Runs many boards in parallel, on the cores of this machine or on a Dask cluster.

A `Work` is a picklable object with numbered trials. A result depends on the work and the number only, not on the number
of workers or the order of execution.
"""

from servo_twin.runner.run import HERE, Runner, run_in_order, run_to_file
from servo_twin.runner.work import RunError, TrialError, Work, WorkerLostError

__all__ = ["HERE", "RunError", "Runner", "TrialError", "Work", "WorkerLostError", "run_in_order", "run_to_file"]
