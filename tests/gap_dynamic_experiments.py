"""Which effects a drive cannot tell apart: predicted from the normal matrix, against repeated draws of the innovations.

    python -m tests.gap_dynamic_experiments --tracks car helicopter --draws 100

For every single-number effect at 20 nats in a recording: a rival whose signature leaves lambda / 2 nats of it unexplained falls behind by a normal
number of mean lambda / 2 and variance lambda, and is predicted to be confused with it where that is below 3 nats in at least a tenth of the draws;
observed are the rivals that come first, or within 3 nats of the first, in at least a tenth.
"""

from __future__ import annotations

import argparse

import numpy as np

from insemu.gap.dynamic import LEAD
from insemu.gap.hidden_drives import TRACKS, stage
from insemu.gap.hypotheses import bank, linear_gains, pooled_gains
from insemu.gap.preparation import fast_parts, prepare
from insemu.gap.scene import Scene

#: Evidence of the hidden effect, nats.
NATS = 20.0


def confusions(track: str, seed: int, minutes: float, draws: int) -> tuple[int, int, int, int]:
    """Pairs predicted, of those confused; pairs confused, of those predicted."""
    s = stage(seed, minutes, 50.0, track=track)
    recording = s.record()
    scene = Scene.of(prepare(recording, s.nominal, fast_parts(recording), {}))
    data, rng = scene.data, np.random.default_rng([seed, 9])
    variants = [v for v in bank(scene) if not v.process and v.effect != "ramp"]
    noise = data.G.T @ rng.standard_normal((data.y.size, draws))
    predicted, confused = set(), set()
    for i, column in enumerate(scene.columns[: scene.catalogue]):
        own = float(data.A[i, i])
        beta = np.sqrt(2.0 * NATS / own) if own > 0.0 else np.inf
        if not beta < 1e3 * column.scale:
            continue  # this recording does not show it at all
        key = (column.effect, column.sensor)
        gains = pooled_gains(variants, linear_gains(variants, data.A, data.A[:, [i]] * beta + noise))
        table = np.stack(list(gains.values()))
        near = table > table.max(axis=0) - LEAD
        for k, rival in enumerate(gains):
            if rival != key and near[k].mean() >= 0.1:
                confused.add((i, rival))
        for rival in gains:
            left = min(
                own
                - float(
                    data.A[i, v.index]
                    @ np.linalg.lstsq(data.A[np.ix_(v.index, v.index)], data.A[v.index, i], rcond=1e-10)[0]
                )
                for v in variants
                if (v.effect, v.sensor) == rival
            )
            behind = NATS * max(left, 0.0) / own
            if rival != key and behind - 1.28 * np.sqrt(2.0 * behind) < LEAD:
                predicted.add((i, rival))
    both = len(predicted & confused)
    return len(predicted), both, len(confused), both


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tracks", nargs="+", default=list(TRACKS), choices=TRACKS)
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    print(f"{'track':12s} {'predicted':>9s} {'confused':>9s}   {'observed':>9s} {'predicted':>9s}")
    for track in options.tracks:
        p, pc, c, cp = confusions(track, options.seed, options.minutes, options.draws)
        print(f"{track:12s} {p:9d} {pc:9d}   {c:9d} {cp:9d}")


if __name__ == "__main__":
    main()
