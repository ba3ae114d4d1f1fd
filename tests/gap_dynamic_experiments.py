"""Which effects a drive cannot tell apart: predicted from one recording, against repetitions of it with noise that the emulator draws anew.

    python -m tests.gap_dynamic_experiments --tracks car helicopter --draws 100
    python -m tests.gap_dynamic_experiments --whole --draws 20

Every single-number effect, and a random walk, a Gauss-Markov process and flicker on every axis, each at 20 nats. Predicted
(:mod:`insemu.gap.confusion`) are the rivals that stand beside the effect in at least a tenth of repetitions computed from the first recording's
filter alone. Observed: the same motion and sensors with other noise, emulated (true levels and processes, which the nominal model has wrong by up to
20 %), through the whole filter; the rivals that are worth anything and come first, or within 3 nats of the first, in at least a tenth of these. A
random process is drawn anew in each. The effect itself enters through its signature.

With ``--whole`` nothing is taken for linear: two effects of every track are hidden by the emulator, and what the first recording's report calls
confusable (at the size that it estimates) is held against the classes that the whole workflow gives in the first steps of the repetitions.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from benchmarks.trial.drives import Stage, draw_use, stage
from benchmarks.trial.score import interval
from benchmarks.trial.tracks import TRACKS
from benchmarks.trial.worth import size_effect
from insemu.gap import find_gap
from insemu.gap.candidates.shapes import PROCESSES, bank
from insemu.gap.confusion import Repetitions
from insemu.gap.drive.preparation import Flown
from insemu.gap.drive.scene import Scene
from insemu.gap.drive.signatures import Loop
from insemu.gap.policy import rules

Array = NDArray[np.float64]
Key = tuple[str, str]

#: Evidence of the hidden effect, nats.
NATS = 20.0
KINDS = ("one number", "process")


@dataclass(frozen=True)
class Truth:
    """An effect at 20 nats: its key, its columns and the root of its coefficients (one column where it is no process)."""

    key: Key
    label: str
    index: NDArray[np.int64]
    root: Array
    process: bool

    def coefficients(self, draws: int, rng: np.random.Generator) -> Array:
        """One column for each repetition."""
        if not self.process:
            return np.tile(self.root, (1, draws))
        return np.asarray(self.root @ rng.standard_normal((self.root.shape[1], draws)))


def truths(scene: Scene) -> list[Truth]:
    """Everything that is hidden, one after the other."""
    A, out = scene.data.A, []
    for i, column in enumerate(scene.columns[: scene.catalogue]):
        own = float(A[i, i])
        beta = np.sqrt(2.0 * NATS / own) if own > 0.0 else np.inf
        if beta < 1e3 * column.scale:  # else this recording does not show it at all
            out.append(Truth((column.effect, column.sensor), column.label, np.array([i]), np.array([[beta]]), False))
    for v in bank(scene):
        if v.effect not in PROCESSES or len(v.axes) > 1:
            continue
        root = v.shapes[len(v.shapes) // 2][1]
        worth = np.maximum(np.linalg.eigvalsh(root.T @ A[np.ix_(v.index, v.index)] @ root), 0.0)

        def beyond(x: float, worth: Array = worth) -> float:
            square = np.exp(2.0 * x) * worth
            return float(0.5 * np.sum(square - np.log1p(square))) - NATS

        size = float(np.exp(brentq(beyond, -60.0, 60.0)))
        out.append(Truth((v.effect, v.sensor), v.axes[0], v.index, size * root, True))
    return out


def emulated(s: Stage, flown: Flown, scene: Scene, draws: int, seed: int) -> Array:
    """Right-hand sides (c, draws) of recordings with other noise, through the whole filter."""
    out = []
    for k in range(draws):
        again = flown.prepared.on(replace(s, seed=int(np.random.SeedSequence([seed, k]).generate_state(1)[0])).record())
        loop = Loop.of(again.result)
        if not np.array_equal(loop.use, scene.loop.use):
            raise RuntimeError("a repetition has other fixes")
        out.append(scene.data.G.T @ loop.y[loop.use.ravel()] / scene.data.variance)
    return np.stack(out, axis=1)


def confusions(track: str, seed: int, minutes: float, draws: int, detail: bool) -> NDArray[np.int64]:
    """Pairs predicted, pairs confused, pairs that are both (3,): of effects of one number, of processes (2, 3)."""
    s = replace(stage(seed, minutes, 50.0, track=track), with_reference=True)
    flown = Flown.of(s.record(), s.nominal)
    scene = Scene.of(flown.prepared)
    variants, rng = bank(scene), np.random.default_rng([seed, 9])
    forecast = Repetitions.of(scene.data, rng)
    repeated = Repetitions(scene.data, emulated(s, flown, scene, draws, seed))
    counts = np.zeros((2, 3), dtype=np.int64)
    for truth in truths(scene):
        said = forecast.shares(variants, truth.index, truth.coefficients(forecast.noise.shape[1], rng))
        seen = repeated.shares(variants, truth.index, truth.coefficients(draws, rng))
        for rival in said:
            if rival == truth.key:
                continue
            p, c = said[rival] >= rules().confusable, seen[rival] >= rules().confusable
            counts[int(truth.process)] += (p, c, p and c)
            if detail and p != c:
                what = f"{' '.join(truth.key)} {truth.label} / {' '.join(rival)}"
                print(f"    {what:60s} predicted {said[rival]:.2f}, observed {seen[rival]:.2f}")
    return counts


def shares(kind: str, counts: NDArray[np.int64]) -> None:
    """Print how far what was predicted and what was observed agree."""
    predicted, confused, both = (int(n) for n in counts)
    for label, of in (("pairs predicted, confused", predicted), ("confusions, predicted", confused)):
        low, high = interval(both, of) if of else (0.0, 1.0)
        share = both / of if of else float("nan")
        print(f"{kind:12s} of the {label:26s} {both} of {of}: {share:.3f} (95 % interval {low:.3f} to {high:.3f})")


#: Effects of which ``--whole`` draws.
SHAPED = (
    "scale_factor",
    "scale_asymmetry",
    "misalignment",
    "g_sensitivity",
    "temperature",
    "lever_arm",
    "turn_on_bias",
    "imu_gnss_time_offset",
)


def whole(track: str, seed: int, minutes: float, draws: int) -> NDArray[np.int64]:
    """Pairs predicted, pairs confused, pairs that are both, by the whole workflow (3,)."""
    rng, counts = np.random.default_rng([seed, 11]), np.zeros(3, dtype=np.int64)
    for effect in rng.choice(SHAPED, 2, replace=False):
        s = stage(seed, minutes, 50.0, track=track, turn_on_bias=effect == "turn_on_bias")
        s = replace(s, with_reference=True)
        plain = Flown.of(s.record(), s.nominal).prepared
        use, hidden = size_effect(s, lambda plain=plain: plain, *draw_use(str(effect), s, rng), NATS)
        seeds = [s.seed, *(int(np.random.SeedSequence([seed, 1, k]).generate_state(1)[0]) for k in range(draws))]
        reports = [
            find_gap(
                replace(s, seed=k).record((use,)),
                s.nominal,
                rng=np.random.default_rng(1),
                hold_out=False,
                pictures=False,
            )
            for k in seeds
        ]
        own = (hidden.effect, hidden.sensor)
        first = reports[0].findings[0] if reports[0].findings else None
        if first is None or (first.effect, first.sensor) != own:
            print(
                f"    {track}, {' '.join(own)} of {hidden.nats:.0f} nats: not what the first recording was said to have",
                flush=True,
            )
            continue
        said = {(c.effect, c.sensor): c.share for c in first.confusable}
        found = Counter((m.effect, m.sensor) for r in reports[1:] if r.findings for m in r.findings[0].members)
        seen = {key: n / draws for key, n in found.items() if key != own and n >= rules().confusable * draws}
        counts += (len(said), len(seen), len(set(said) & set(seen)))
        words = [", ".join(f"{' '.join(k)} {v:.2f}" for k, v in table.items()) or "nothing" for table in (said, seen)]
        print(
            f"    {track}, {' '.join(own)} of {hidden.nats:.0f} nats: predicted {words[0]}; observed {words[1]}",
            flush=True,
        )
    return counts


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tracks", nargs="+", default=list(TRACKS), choices=TRACKS)
    parser.add_argument("--draws", type=int, default=120, help="emulated repetitions of each recording")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--detail", action="store_true", help="list the pairs on which prediction and observation differ"
    )
    parser.add_argument(
        "--whole", action="store_true", help="two effects of every track, through the whole workflow (2 s a repetition)"
    )
    options = parser.parse_args()
    if options.whole:
        rows = np.sum([whole(t, options.seed, options.minutes, options.draws) for t in options.tracks], axis=0)
        shares("whole", rows)
        return
    print(f"{'track':12s} {'hidden':12s} {'predicted':>9s} {'confused':>9s} {'both':>9s}")
    total = np.zeros((2, 3), dtype=np.int64)
    for track in options.tracks:
        counts = confusions(track, options.seed, options.minutes, options.draws, options.detail)
        total += counts
        for kind, row in zip(KINDS, counts, strict=True):
            print(f"{track:12s} {kind:12s} {row[0]:9d} {row[1]:9d} {row[2]:9d}", flush=True)
    for kind, row in zip((*KINDS, "all"), (*total, total.sum(axis=0)), strict=True):
        shares(kind, row)


if __name__ == "__main__":
    main()
