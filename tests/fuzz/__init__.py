"""Fuzzing: inputs broken on purpose, made from a seed and a number, run in warm processes that are watched.

``python -m tests.fuzz --count 1000000`` or ``--minutes 60`` runs as many as are wanted and goes on where it stopped; a small share runs in
``tests/test_fuzz.py``. What counts as wrong: anything but an ``InputError`` (or a file that is not there), more than two seconds of processor
time, more than 1 GB, a process that dies, a file written by a refused command or outside the folders that it was given.
"""

from tests.fuzz.watch import TARGETS, Batch, Outcome, Target, run_batch

__all__ = ["TARGETS", "Batch", "Outcome", "Target", "run_batch"]
