"""The next experiment for a class that a drive leaves, and whether its promise is kept: ``python -m tests.gap_next_experiments --recordings 20``.

A car with a scale factor of 2 % on the accelerometer z, four minutes without a hill: scale factor, asymmetry and turn-on bias are one class.
"""

from __future__ import annotations

import argparse

import numpy as np

from benchmarks.trial.drives import stage
from insemu.effects import EffectUse
from insemu.gap import NextExperiment, design, find_gap, promise_text


def settle(recordings: int) -> NextExperiment | None:
    """Find the class and design what would settle it."""
    s = stage(11, 4.0, 50.0, track="car")
    hidden = EffectUse.from_mapping({"effect": "scale_factor", "sensor": "accel", "value": [0.0, 0.0, 0.02]})
    recording = s.record([hidden])
    report = find_gap(recording, s.nominal, rng=np.random.default_rng(1), hold_out=False, pictures=False)
    print(report)
    return design(recording, s.nominal, report, rng=np.random.default_rng(1), recordings=recordings)


def main() -> None:
    """Print the manoeuvres that were tried and what the best one promises."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--recordings", type=int, default=20)
    x = settle(parser.parse_args().recordings)
    assert x is not None
    for p in x.tried:
        print(
            f"{p.manoeuvre.name:50s} {p.duration_s:5.0f} s  {100.0 * p.share:5.1f} % of the pairs, lead {p.lead:6.1f} nats"
        )
    print("\n".join(promise_text(x)))


if __name__ == "__main__":
    main()
