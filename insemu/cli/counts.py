"""Largest counts that an option takes: what is above is a slip of the keyboard, and would end in a lack of memory."""

from __future__ import annotations

#: Threads or processes; the largest machines have some hundreds of cores.
WORKERS = 1024
#: Flights, recordings, simulated signals or trials; as of a scenario.
DRAWS = 100_000
#: Linear realizations, whose cost is about a hundredth of a flight's.
LINEAR = 1_000_000
