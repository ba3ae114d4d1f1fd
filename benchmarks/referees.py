"""How often the referee accuses a right filter, and finds one whose sigmas are 20 % too small where its stated power says that it would.

Run ``python -m benchmarks.referees`` (``--pages N``, ``--realizations N``, ``--worlds NAMES``; ``--families``: the page of the families instead). Every page has a seed of its own. A right filter
is the extended Kalman filter that is given the truth; ``tests/wrong_filters.py:Small`` has its estimates and 0.8 times its sigmas.
"""

from __future__ import annotations

import argparse

from insemu.evaluate import share_interval
from insemu.filters import FAMILIES
from insemu.referee import FALSE_ALARM, POWER, referee
from tests.wrong_filters import FACTOR


def families() -> None:
    """What the page of the families says."""
    for j in referee([*FAMILIES, "ukf"]):
        begun = ", ".join(f"{k} of {n} from {sigma}" for sigma, (k, n) in j.starts.items())
        print(f"{j.name}: accused in {', '.join(r.world.name for r in j.accused) or 'none'}; converge: {begun}")
        least = max(r.finds[0] for r in j.right), max(r.power["attitude"][0] for r in j.right)
        print(f"  finds all sigmas {100 * least[0]:.0f} % too small, those of the attitude {100 * least[1]:.0f} %")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pages", type=int, default=40)
    parser.add_argument("--realizations", type=int, default=16)
    parser.add_argument("--worlds", default="rest,turns,outages")
    parser.add_argument("--families", action="store_true")
    asked = parser.parse_args()
    if asked.families:
        families()
        return
    accused, claimed, found = [], 0, 0
    for seed in range(1000, 1000 + asked.pages):
        right, small = referee(
            ["ekf", "tests/wrong_filters.py:Small"],
            names=asked.worlds.split(","),
            realizations=asked.realizations,
            seed=seed,
        )
        accused += [seed] if right.accused else []
        claims = [r for r in small.right if r.finds[0] <= 1.0 - FACTOR]
        claimed += len(claims)
        found += sum(r.found for r in claims)
    low, high = share_interval(len(accused), asked.pages)
    print(
        f"right filter accused in {len(accused)} of {asked.pages} pages (95 %: {100 * low:.1f} to {100 * high:.1f} %; stated {100 * FALSE_ALARM:g} %)"
    )
    low, high = share_interval(found, claimed)
    print(
        f"sigma 20 % too small found in {found} of {claimed} worlds whose power says so (95 %: {100 * low:.1f} to 100 %; stated {100 * POWER:g} %)"
    )


if __name__ == "__main__":
    main()
