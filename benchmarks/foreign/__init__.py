"""Recordings from simulators that share no code with ours, and how the gap workflow answers them: see ``python -m benchmarks.foreign --help``."""
