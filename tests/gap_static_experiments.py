"""Experiments on the static side of the gap workflow: ``python -m tests.gap_static_experiments WHAT``.

``real``     a belief of white noise alone against run 1 of the ADIS16405; is every later run predicted better at every scale?
``thermal``  a belief without temperature against the sweep in the chamber
``effects``  every effect that a log at rest can show, hidden by the emulator at strengths that are worth 20 and 60 nats
``sets``     two and three effects on one axis
``null``     logs without any effect: how many are flagged, how many named
``map``      p-values of the map on logs without any effect against the uniform distribution, statistic by statistic and scale by scale
``pairs``    pairs predicted indistinguishable against the confusions of repeated draws

Random effects are drawn by the emulator; levels believed are wrong by up to 20 %.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from insemu import formats
from insemu.effects import EffectUse
from insemu.emulate import corrupt
from insemu.gap import find_static_gap, load_measured
from insemu.gap.candidates import CANDIDATES, AxisState, state_of
from insemu.gap.disagreement import axis_tests, spent_on, wavelet_moments, wavelet_p_values
from insemu.gap.evidence import Explanation
from insemu.gap.reduced import reduce
from insemu.gap.sources import static_of
from insemu.gap.static_log import Found, search
from insemu.noise import SIN, WN, NoiseModel
from insemu.records import AXES, ImuRecord, Recording, Series
from insemu.variance import allan_variance
from tests.shared_data import shared

RATE = 20.0
WHITE = 1e-3
EFFECTS = (
    "white_noise", "random_walk", "gauss_markov", "flicker", "ramp", "telegraph", "temperature", "vibration_line", "vibration_band",
    "decimation_filter", "outliers", "quantization", "saturation", "dropped_samples", "turn_on_bias",
)  # fmt: skip
#: Effects whose evidence does not grow with a strength: any amount is plain in the samples.
PLAIN = {"quantization", "saturation", "dropped_samples"}
_CANDIDATE = {"quantization": "quantization_output"}


def hidden(effect: str, s: float, n: int, rng: np.random.Generator) -> EffectUse:
    """An effect of strength ``s`` (1 is near what an hour can show) on the x axis of the gyroscope."""
    dt = 1.0 / RATE
    span, sample = n * dt, WHITE / math.sqrt(dt)
    mean = WHITE / math.sqrt(span)

    def x(value: float) -> list[float]:
        return [value, 0.0, 0.0]

    memory = float(np.exp(rng.uniform(math.log(10.0), math.log(span / 15.0))))
    values: dict[str, dict[str, object]] = {
        "white_noise": {"N": x(WHITE * math.sqrt((1.2 + 0.1 * s) ** 2 - 1.0))},
        "random_walk": {"K": x(6.0 * s * mean / math.sqrt(span))},
        "gauss_markov": {"sigma": x(8.0 * s * mean), "beta": 1.0 / memory},
        "flicker": {"B": x(6.0 * s * mean)},
        "ramp": {"R": x(12.0 * s * mean / span * rng.choice([-1.0, 1.0]))},
        "telegraph": {"amplitude": x(9.0 * s * mean), "rate": 1.0 / rng.uniform(15.0, 90.0)},
        "temperature": {"c1": x(0.6 * s * mean)},
        "vibration_line": {"amplitude": x(7.0 * s * mean), "frequency": rng.uniform(0.1, 0.45) * RATE},
        "vibration_band": {"rms": x(0.1 * s * sample), "frequency": rng.uniform(0.1, 0.4) * RATE, "bandwidth": 0.01 * RATE},
        "decimation_filter": {"cutoff": RATE * 0.45 / (1.0 + 0.1 * s), "order": float(rng.integers(1, 4))},
        "outliers": {"probability": 5e-4, "sigma": x(2.5 * s * sample)},
        "quantization": {"lsb": x(0.15 * s * sample)},
        "saturation": {"limit": [3.0 * sample / math.sqrt(s), 1.0, 1.0]},
        "dropped_samples": {"probability": 2e-4 * s},
        "turn_on_bias": {"value": x(1e-4 * (1.0 + s))},
    }  # fmt: skip
    sensor = "imu" if effect == "dropped_samples" else "gyro"
    return EffectUse.from_mapping({"effect": effect, "sensor": sensor, **values[effect]})


def recording(
    uses: list[EffectUse], n: int, rng: np.random.Generator, truth: str = f"WN(N={WHITE} rad/s/sqrt(Hz))"
) -> tuple[Series, np.ndarray, np.ndarray | None]:
    """Log of the x axis with effects, temperature, and which samples the stamps skip."""
    t = np.arange(n) / RATE
    still = ImuRecord(t, np.zeros((n, 3)), np.zeros((n, 3)), "mean")
    model = NoiseModel.parse(truth, "rad/s")
    temperature = 25.0 + 8.0 * np.sin(2.0 * np.pi * (t / t[-1] * rng.uniform(0.7, 2.0) + rng.random()))
    made = corrupt(still, dict.fromkeys(AXES[:3], model), rng, effects=tuple(uses), temperature=temperature)
    imu = made.imu
    log = static_of(Recording(imu=replace(imu, temperature=np.interp(imu.t, t, temperature)), source="hidden"))
    assert log.temperature is not None
    return log.axes[0], log.temperature, log.missing


def wrong(truth: str, rng: np.random.Generator) -> NoiseModel:
    """The belief: every level off by up to 20 %."""
    out = []
    for p in NoiseModel.parse(truth, "rad/s"):
        name = p.parameters_meta()[0].name
        out.append(p.with_parameters({name: p.parameters[name] * rng.uniform(1.0 / 1.2, 1.2)}))
    return NoiseModel(tuple(out))


def gain_of(effect: str, state: AxisState) -> float:
    """What the effect's own candidate is worth."""
    from insemu.gap.candidates import turn_on_bias

    candidate = turn_on_bias if effect == "turn_on_bias" else CANDIDATES[_CANDIDATE.get(effect, effect)]
    return max((w.gain for w in candidate(state)), default=0.0)


def strength_for(effect: str, nats: float, n: int, draws: int = 3) -> float:
    """Strength at which the effect's own candidate is worth so many nats in the mean over a few draws."""
    if effect in PLAIN:
        return 2.0 if nats < 40 else 4.0
    s = 1.0
    for _ in range(6):
        gains = []
        for k in range(draws):
            rng = np.random.default_rng([77, k])
            series, temperature, _ = recording([hidden(effect, s, n, rng)], n, rng)
            state = state_of(reduce(series), Explanation.nominal(NoiseModel((WN(WHITE),))), temperature)
            gains.append(gain_of(effect, state))
        got = float(np.median(gains))
        if abs(got / nats - 1.0) < 0.15:
            break
        # most gains go with the square of the strength
        s = float(np.clip(s * min(max(math.sqrt(nats / max(got, 1.0)), 0.4), 2.5), 0.05, 60.0))
    return s


def effects(arguments: argparse.Namespace) -> None:
    """Detected, named, in the class, class size, per effect and strength."""
    n = int(arguments.hours * 3600 * RATE)
    heads = ("detected", "first", "top two", "named", "right", "in class", "size")
    print(f"{'effect':18s} nats {' '.join(heads)}  said")
    total: Counter[str] = Counter()
    for effect in arguments.only or EFFECTS:
        for nats in (20.0, 60.0):
            s = strength_for(effect, nats, n)
            count: Counter[str] = Counter()
            said: Counter[str] = Counter()
            for k in range(arguments.draws):
                rng = np.random.default_rng([arguments.seed, EFFECTS.index(effect), int(nats), k])
                series, temperature, missing = recording([hidden(effect, s, n, rng)], n, rng)
                # a level that is the effect itself is weighed against a belief that is right
                belief = (
                    NoiseModel((WN(WHITE),)) if effect == "white_noise" else wrong(f"WN(N={WHITE} rad/s/sqrt(Hz))", rng)
                )
                report = find_static_gap(
                    [series], {series.name: belief}, rng=rng, temperature=temperature, missing=missing, hold_out=False
                )
                said[report.steps[0].effect if report.steps else report.verdict] += 1
                count["drawn"] += 1
                if not report.steps:
                    continue
                first = report.steps[0]
                order = [m.effect for m in (*first.members, *first.runners_up)]
                count["detected"] += 1
                count["first"] += first.effect == effect
                count["two"] += effect in order[:2]
                count["class"] += effect in [m.effect for m in first.members]
                count["size"] += len(first.members)
                if report.verdict == "named":
                    count["named"] += 1
                    count["right"] += first.effect == effect
            total += count
            _row(f"{effect:18s} {nats:4.0f}", count, ", ".join(f"{k} {v}" for k, v in said.most_common(4)))
    _row(f"{'all':23s}", total, "")


def _row(head: str, count: Counter[str], tail: str) -> None:
    size = count["size"] / max(count["detected"], 1)
    print(
        f"{head} {count['detected']:4d}/{count['drawn']:<3d} {count['first']:6d} {count['two']:7d} {count['named']:6d} "
        f"{count['right']:6d} {count['class']:8d} {size:5.2f}  {tail}",
        flush=True,
    )


_SETS = (
    ("random_walk", "vibration_line"), ("gauss_markov", "outliers"), ("flicker", "vibration_band"), ("temperature", "random_walk"),
    ("gauss_markov", "ramp"), ("telegraph", "vibration_line"), ("temperature", "gauss_markov"), ("gauss_markov", "white_noise"),
    ("random_walk", "decimation_filter"), ("random_walk", "vibration_line", "outliers"), ("gauss_markov", "temperature", "vibration_line"),
    ("flicker", "vibration_band", "vibration_line"),
)  # fmt: skip


def sets(arguments: argparse.Namespace) -> None:
    """Both and only both; each effect at a strength that alone is worth 60 nats."""
    n = int(arguments.hours * 3600 * RATE)
    strengths = {e: strength_for(e, 60.0, n) for e in sorted({e for s in _SETS for e in s})}
    right: Counter[int] = Counter()
    near: Counter[int] = Counter()
    drawn: Counter[int] = Counter()
    for index, names in enumerate(_SETS):
        for k in range(arguments.draws):
            rng = np.random.default_rng([arguments.seed, 900 + index, k])
            series, temperature, missing = recording([hidden(e, strengths[e], n, rng) for e in names], n, rng)
            belief = wrong(f"WN(N={WHITE} rad/s/sqrt(Hz))", rng)
            report = find_static_gap(
                [series], {series.name: belief}, rng=rng, temperature=temperature, missing=missing, hold_out=False
            )
            found = sorted(s.effect for s in report.steps)
            exact = found == sorted(names)
            # the classes of the steps hold the effects, one each and none over
            classed = len(report.steps) == len(names) and _matches(
                [{m.effect for m in s.members} for s in report.steps], list(names)
            )
            drawn[len(names)] += 1
            right[len(names)] += exact
            near[len(names)] += classed
            print(
                f"{' + '.join(names):50s} {'right' if exact else 'class' if classed else 'WRONG':6s} {' + '.join(found)}",
                flush=True,
            )
    for size in sorted(drawn):
        print(
            f"{size} effects: exactly {right[size]} of {drawn[size]}, each in its class {near[size]} of {drawn[size]}"
        )


def _matches(classes: list[set[str]], names: list[str]) -> bool:
    if not names:
        return True
    return any(names[0] in c and _matches(classes[:i] + classes[i + 1 :], names[1:]) for i, c in enumerate(classes))


_NULLS = (
    "WN(N=1e-3 rad/s/sqrt(Hz))",
    "WN(N=1e-3 rad/s/sqrt(Hz)) + RW(K=2e-5 rad/s*sqrt(Hz))",
    "WN(N=1e-3 rad/s/sqrt(Hz)) + GM(sigma=2e-4 rad/s, beta=0.01)",
    "WN(N=1e-3 rad/s/sqrt(Hz)) + BI(B=2e-4 rad/s)",
    "WN(N=5e-4 rad/s/sqrt(Hz)) + BI(B=1e-4 rad/s) + RW(K=1e-5 rad/s*sqrt(Hz))",
)


def null(arguments: argparse.Namespace) -> None:
    """Flagged and named although nothing was hidden."""
    from scipy.stats import beta

    n = int(arguments.hours * 3600 * RATE)
    flagged, named, gains = 0, 0, []
    for k in range(arguments.draws):
        rng = np.random.default_rng([arguments.seed, 800, k])
        axes, beliefs = [], {}
        for name in AXES[: arguments.axes]:
            truth = str(rng.choice(_NULLS))
            series, temperature, _ = recording([], n, rng, truth)
            axes.append(Series(series.values, RATE, "rad/s", name))
            beliefs[name] = wrong(truth, rng)
        report = find_static_gap(axes, beliefs, rng=rng, temperature=temperature, hold_out=False)
        flagged += report.verdict != "nothing missing"
        named += report.verdict == "named"
        if report.verdict != "nothing missing":
            gains.append([(s.effect, s.axes, round(s.gain_nats, 1)) for s in report.steps] or report.remainder)
            print(k, report.verdict, gains[-1], flush=True)
    for label, x in (("flagged", flagged), ("named", named)):
        low = beta.ppf(0.025, x, arguments.draws - x + 1) if x else 0.0
        high = beta.ppf(0.975, x + 1, arguments.draws - x)
        print(
            f"{label}: {x} of {arguments.draws} recordings of {arguments.axes} axes ({100 * low:.1f} to {100 * high:.1f} %)"
        )


def map_of_nothing(arguments: argparse.Namespace) -> None:
    """p-values of the map where nothing is missing: Kolmogorov-Smirnov against uniform, and shares below 5 and 1 %."""
    from scipy.stats import kstest

    n = int(arguments.hours * 3600 * arguments.rate)
    collected: dict[str, list[float]] = {}
    for i, truth in enumerate(_NULLS):
        model = NoiseModel.parse(truth, "rad/s")
        for k in range(arguments.draws):
            rng = np.random.default_rng([arguments.seed, 900 + i, k])
            log = Series(model.simulate(n, 1.0 / arguments.rate, rng), arguments.rate, "rad/s", "gyro_x")
            state = state_of(reduce(log), Explanation.nominal(wrong(truth, rng)))
            spent = spent_on(state)
            for scale, _, _, p in wavelet_p_values(state.data, state.explanation, rng, spent):
                collected.setdefault(f"wavelet variance at {scale:.3g} s", []).append(p)
            for statistic, _, p in axis_tests(state, spent):
                collected.setdefault(statistic, []).append(p)
    for statistic, values in collected.items():
        p = np.array(values)
        print(
            f"{statistic:28s} {p.size} draws, against uniform p {kstest(p, 'uniform').pvalue:.2g}; "
            f"below 5 %: {100 * np.mean(p < 0.05):.1f} %, below 1 %: {100 * np.mean(p < 0.01):.1f} %"
        )


def pairs(arguments: argparse.Namespace) -> None:
    """Predicted classes of repeated draws against who came first in them."""
    n = int(arguments.hours * 3600 * RATE)
    slow = ("random_walk", "gauss_markov", "flicker", "telegraph", "ramp")
    predicted_confused = predicted = confused = confused_predicted = 0
    for effect in slow:
        s = strength_for(effect, 30.0, n)
        first: Counter[str] = Counter()
        classes: Counter[str] = Counter()
        for k in range(arguments.draws):
            rng = np.random.default_rng([arguments.seed, 700 + slow.index(effect), k])
            series, temperature, _ = recording([hidden(effect, s, n, rng)], n, rng)
            result = search(
                state_of(reduce(series), Explanation.nominal(wrong(f"WN(N={WHITE} rad/s/sqrt(Hz))", rng)), temperature)
            )
            if not result.found:
                continue
            ranked = result.found[0].ranked
            first[ranked[0].effect] += 1
            classes.update(w.effect for w in ranked if w.gain > ranked[0].gain - 3.0)
        said = {e: first[e] / arguments.draws for e in first}
        claimed = {e: classes[e] / arguments.draws for e in classes}
        print(f"{effect:14s} first: {said}  in the class: {claimed}", flush=True)
        for other in slow:
            if other == effect:
                continue
            together, swapped = claimed.get(other, 0.0) > 0.5, said.get(other, 0.0) >= 0.1
            predicted += together
            predicted_confused += together and swapped
            confused += swapped
            confused_predicted += swapped and claimed.get(other, 0.0) >= 0.1
    print(f"predicted indistinguishable and confused in a tenth of the draws: {predicted_confused} of {predicted}")
    print(f"confused in a tenth of the draws and predicted: {confused_predicted} of {confused}")


def _believed(s: Series, kind: str) -> float:
    """White-noise density that a user would believe: from the differences of samples, or read from the Allan deviation at 1 s."""
    if kind == "differences":
        return float(np.std(np.diff(s.values)) / math.sqrt(2.0) * math.sqrt(s.dt))
    curve = allan_variance(s.values, s.rate_hz)
    return float(math.sqrt(np.exp(np.interp(0.0, np.log(curve.tau_s), np.log(curve.value)))))


def _taken_out(found: Sequence[Found], s: Series) -> NoiseModel:
    """What the search took out of the samples, as processes: lines, and outliers as the white noise that they are on average."""
    parts: list[SIN | WN] = []
    for f in found:
        given = {v.name: v.value for v in f.chosen.values}
        if f.chosen.effect == "vibration_line":
            parts.append(SIN(given["amplitude"], given["frequency"]))
        elif f.chosen.effect == "outliers":
            parts.append(WN(given["sigma"] * math.sqrt(given["probability"] * s.dt)))
    return NoiseModel(tuple(parts))


def real(arguments: argparse.Namespace) -> None:
    """Which scales of the later runs the refined model predicts better than white noise alone, and which worse.

    At a scale where run 1's own wavelet variance predicts a later run no better than white noise does, beyond the sampling spread, the runs differ
    or white noise is right there, and a model of run 1 can only do better by chance; that is said beside it.
    """
    runs = [formats.read(shared(f"real/adis16405_static_run{k}.npz")) for k in (1, 2, 3)]
    for k in arguments.axes_of or range(6):
        s = runs[0][k]
        data = reduce(s)
        for kind in ("differences", "1 s"):
            nominal = Explanation.nominal(NoiseModel((WN(_believed(s, kind)),)))
            result = search(state_of(data, nominal))
            print(f"{s.name}, believed white noise from {kind}: {result.outsider}")
            for f in result.found:
                print(f"   {f.chosen.effect} {f.chosen.variant} {f.chosen.gain:.1f} nats, class {_class(f)}")
            refined = replace(result.end.explanation, regressors=())
            removed = _taken_out(result.found, s)
            first = [row[1] for row in wavelet_moments(data, nominal, np.random.default_rng(1))]
            for run in (0, 1, 2):
                other = reduce(runs[run][k], data.block)
                before = wavelet_moments(other, nominal, np.random.default_rng(1))
                after = wavelet_moments(other, refined, np.random.default_rng(1))
                worse, scales, lost, able = [], 0, 0, 0
                for (tau, measured, plain, _), (_, _, better, variance), own in zip(before, after, first, strict=True):
                    if tau <= 1.0:
                        continue
                    scales += 1
                    if removed.processes:
                        both = better + sum(float(p.wavelet_variance([round(tau / s.dt)], s.dt)[0]) for p in removed)
                        variance, better = variance * (both / better) ** 2, both
                    old, new = math.log(measured / plain), math.log(measured / better)
                    # log score of the estimate as a chi-square of the freedom that the refined model gives it, and its sampling spread
                    half = better**2 / variance
                    gain = half * (math.log(plain / better) + measured / plain - measured / better)
                    spread = math.sqrt(half) * abs(measured / plain - measured / better)
                    lost += gain < -2.0 * spread
                    if abs(new) > abs(old) or gain < 0.0:
                        one = 1.0 / math.sqrt(half)
                        apart = math.log(measured / own)
                        differ = run > 0 and abs(apart) > abs(old) - one
                        able += not differ
                        worse.append(
                            f"{tau:.3g} s (log ratio {old:+.3f} -> {new:+.3f}, sampling {one:.3f}; {gain:+.1f} +- {spread:.1f} nats"
                            + (f"; run 1's own curve is off by {apart:+.3f})" if differ else ")")
                        )
                print(
                    f"   run {run + 1}: better at {scales - len(worse)} of {scales} scales above 1 s, worse beyond twice the sampling spread "
                    f"at {lost}, where run 1's own curve is better at {able}; worse: {', '.join(worse) or 'none'}",
                    flush=True,
                )


def _class(found: Found) -> list[str]:
    return [w.effect for w in found.ranked if w.gain > found.ranked[0].gain - 3.0]


def thermal(_: argparse.Namespace) -> None:
    """What is named in the sweep."""
    log = load_measured(shared("real/imu_thermal_sweep.npz"))
    beliefs = {s.name: NoiseModel((WN(_believed(s, "differences")),)) for s in log.axes}
    report = find_static_gap(
        log.axes, beliefs, rng=np.random.default_rng(1), temperature=log.temperature, hold_out=False
    )
    print(report.verdict)
    for s in report.steps:
        print(
            f"  {s.effect} {s.variant} on {s.sensor} {','.join(s.axes)}: {s.gain_nats:.0f} nats, class {[m.effect for m in s.members]}"
        )
    print("  left over:", report.remainder)


def main() -> None:
    """Parse and run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("real", "thermal", "effects", "sets", "null", "map", "pairs"))
    parser.add_argument("only", nargs="*", help="effects: only these")
    parser.add_argument("--draws", type=int, default=10)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--rate", type=float, default=RATE, help="map: samples per second")
    parser.add_argument("--axes", type=int, default=6)
    parser.add_argument("--axes-of", type=int, nargs="*", help="real: numbers of axes")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    {**globals(), "map": map_of_nothing}[arguments.what](arguments)


if __name__ == "__main__":
    main()
