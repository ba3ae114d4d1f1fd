"""A model beside a stream: rate of false alarms, power, and intervals.

``python -m tests.online_experiments [N]``: of N emulated streams of 400 windows, how many windows alarm that have no cause, at a stated
probability of 0.01 each, and how often the last intervals hold the truth; then how often a change of the level
by a factor is seen within three windows.
"""

from __future__ import annotations

import sys

import numpy as np
from scipy import stats

from insemu.fit import Alarm, OnlineFit
from insemu.noise import GM, WN, NoiseModel

RATE_HZ, WINDOWS, WINDOW_S, STATED = 10.0, 400, 60.0, 0.01
MODEL = WN(N=1e-3) + GM(sigma=1e-3, Tc=20.0)
FACTORS = (1.1, 1.2, 1.5)


def main() -> None:
    """Print the table."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    asked = NoiseModel.parse("WN() + GM()")
    window = round(WINDOW_S * RATE_HZ)
    false = asked_of = 0
    held: dict[str, list[bool]] = {}
    seen: dict[float, list[bool]] = {f: [] for f in FACTORS}
    for number in range(count):
        rng = np.random.default_rng([18, number])
        one = OnlineFit(asked, RATE_HZ, window_s=WINDOW_S, false_alarms=STATED, every=10**9)
        alarms = [e for e in one.push(MODEL.simulate(WINDOWS * window, 1 / RATE_HZ, rng)) if isinstance(e, Alarm)]
        false += len(alarms)
        asked_of += WINDOWS - one.learn
        found = one.fitted()
        for index, p in MODEL.indexed():
            for name, value in p.parameters.items():
                e = found[f"{p.symbol}{index}.{name}"]
                held.setdefault(e.label, []).append(bool(e.low <= value <= e.high))
        for factor in FACTORS:
            one = OnlineFit(asked, RATE_HZ, window_s=WINDOW_S, false_alarms=1e-3, every=10**9)
            list(one.push(MODEL.simulate(60 * window, 1 / RATE_HZ, rng)))
            after = list(one.push(factor * MODEL.simulate(3 * window, 1 / RATE_HZ, rng)))
            seen[factor].append(any(isinstance(e, Alarm) for e in after))
    low, high = stats.binomtest(false, asked_of).proportion_ci(method="wilson")
    print(
        f"false alarms: {false} of {asked_of} windows ({false / asked_of:.2%}, {low:.2%} to {high:.2%}), stated {STATED:.0%}"
    )
    for label, inside in held.items():
        print(f"  95 % interval of {label} after {WINDOWS} windows holds the truth: {sum(inside)} of {len(inside)}")
    for factor, those in seen.items():
        print(
            f"  level times {factor:g} seen within three windows of {WINDOW_S:g} s (stated 1e-3): {sum(those)} of {len(those)}"
        )


if __name__ == "__main__":
    main()
