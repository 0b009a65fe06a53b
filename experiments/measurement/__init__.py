"""Logs of a robot against its model: reading, checking, comparing, diagnosing, learning.

In layers, each of which knows only those before it: logs, checks, evidence, fits, selection.
"""

from experiments.measurement.logs.log import SIGNALS, BenchJoint, Log, SignalTable
from experiments.measurement.logs.log_reader import make_log, read_log

__all__ = ["SIGNALS", "BenchJoint", "Log", "SignalTable", "make_log", "read_log"]
