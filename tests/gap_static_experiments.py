"""Experiments on the static side of the gap workflow: ``python -m tests.gap_static_experiments WHAT``.

``real``     a belief of white noise alone against run 1 of the ADIS16405; is every later run predicted better at every scale?
``thermal``  a belief without temperature against the sweep in the chamber
``effects``  every effect that a log at rest can show, hidden by the emulator at strengths that are worth 20 and 60 nats
``sets``     two and three effects on one axis
``null``     logs without any effect: how many are flagged, how many named
``map``      p-values of the map on logs without any effect against the uniform distribution, statistic by statistic and scale by scale
``beliefs``  logs without any effect believed as autoregressions and as a second-order Gauss-Markov process: how many are flagged; and hidden
             effects under a Gauss-Markov belief and under the same process written as AR1, AR(2) and ARMA: how many are named right
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

from benchmarks.trial.drives import wrong
from benchmarks.trial.expected import GAUSSIAN, Log
from benchmarks.trial.logs import BESIDE_NATS, STATIC_EFFECTS, HiddenLog, static_recording
from benchmarks.trial.score import interval
from insemu import formats
from insemu.effects import EffectUse
from insemu.emulate import corrupt
from insemu.gap import find_static_gap, load_measured
from insemu.gap.candidates import CANDIDATES, AxisState
from insemu.gap.candidates.axis import state_of
from insemu.gap.candidates.noise import turn_on_bias
from insemu.gap.checks.rest import axis_tests, spent_on, wavelet_moments, wavelet_p_values
from insemu.gap.data.log import reduce
from insemu.gap.evidence.model import Explanation
from insemu.gap.hypothesis import Found
from insemu.gap.policy import rules
from insemu.gap.problems.rest import search_axis, weigh_all
from insemu.gap.verdict import GapReport
from insemu.noise import AR, AR1, ARMA, GM, SIN, WN, NoiseModel, Process
from insemu.records import AXES, ImuRecord, Series
from insemu.variance import allan_variance
from tests.expected_leads import SLOW, leads_of, seen
from tests.shared_data import shared

#: Nominal sensor of the experiments with one axis.
WHITE = ("WN(N=1e-3 rad/s/sqrt(Hz))",)
EFFECTS = tuple(e for e in STATIC_EFFECTS if e != "none")
#: Effects whose evidence does not grow with a strength: any amount is plain in the samples.
PLAIN = frozenset({"quantization", "saturation", "dropped_samples"})


#: Expected lead over the best rival from which an effect comes first in all but a few draws (it is normal of twice that variance).
AHEAD = 6.0
#: Not weighed where only slow effects are compared.
QUICK = ("vibration_line", "vibration_band", "decimation_filter", "outliers")


def look(made: HiddenLog) -> GapReport:
    """The answer to a log."""
    return find_static_gap(
        made.log,
        made.beliefs,
        rng=np.random.default_rng(1),
        temperature=made.temperature,
        missing=made.missing,
        hold_out=False,
    )


def state_before(made: HiddenLog) -> AxisState:
    """The axis with the hidden effect as the search meets it."""
    s = made.log[made.axis]
    return state_of(reduce(s), Explanation.nominal(made.beliefs[s.name]), made.temperature)


def possible(effect: str, made: HiddenLog) -> bool:
    """Whether the effect is worth the threshold in this recording to somebody who knows what it is."""
    if effect in PLAIN:
        return True
    state = state_before(made)
    if effect in GAUSSIAN:
        return seen(made.known, made.uses[0], state.data) >= rules().least_nats
    candidate = turn_on_bias if effect == "turn_on_bias" else CANDIDATES[effect]
    return max((w.nats for w in candidate(state)), default=0.0) >= rules().least_nats


def effects(arguments: argparse.Namespace) -> None:
    """Detected, named, in the class, class size, per effect and expected nats."""
    heads = ("detected", "possible", "first", "top two", "named", "right", "in class", "size")
    print(f"{'effect':18s} nats {' '.join(heads)}  said")
    totals: dict[float, Counter[str]] = {20.0: Counter(), 60.0: Counter()}
    for effect in arguments.only or EFFECTS:
        for nats, total in totals.items():
            count: Counter[str] = Counter()
            said: Counter[str] = Counter()
            for k in range(arguments.draws):
                seed = (arguments.seed, EFFECTS.index(effect), int(nats), k)
                made = static_recording((effect,), nats, seed, arguments.hours, axes=1, sensors=WHITE)
                report = look(made)
                said[report.findings[0].effect if report.findings else report.verdict] += 1
                if len(report.findings) > 1:
                    said["and " + report.findings[1].effect] += 1
                count["drawn"] += 1
                count["possible"] += possible(effect, made)
                if not report.findings:
                    continue
                first = report.findings[0]
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
            _row(f"{effect:18s} {nats:4.0f}", count, ", ".join(f"{k} {v}" for k, v in said.most_common(6)))
    for nats, total in totals.items():
        _row(f"{'all':18s} {nats:4.0f}", total, "")
        for label, part, whole in (
            ("detected", "detected", "drawn"), ("worth 3 nats to who knows the truth", "possible", "drawn"), ("in the top two", "two", "drawn"),
            ("of those named, right", "right", "named"), ("of those detected, in the class", "class", "detected"),
        ):  # fmt: skip
            _share(f"  {nats:.0f} expected nats, {label}", total[part], total[whole])


def _share(label: str, k: int, n: int) -> None:
    if n:
        low, high = interval(k, n)
        print(f"{label}: {k} of {n} ({100 * low:.1f} to {100 * high:.1f} %)", flush=True)


def _row(head: str, count: Counter[str], tail: str) -> None:
    size = count["size"] / max(count["detected"], 1)
    print(
        f"{head} {count['detected']:4d}/{count['drawn']:<3d} {count['possible']:8d} {count['first']:6d} {count['two']:7d} {count['named']:6d} "
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
    """Both and only both; each effect for 60 nats alone and for 20 at least beside the others."""
    names_of = [tuple(s.split("+")) for s in arguments.only] or list(_SETS)
    count: Counter[tuple[int, str]] = Counter()
    for names in names_of:
        index = list(_SETS).index(names) if names in _SETS else len(_SETS)
        for k in range(arguments.draws):
            seed = (arguments.seed, 900 + index, k)
            made = static_recording(names, arguments.nats, seed, arguments.hours, axes=1, sensors=WHITE)
            leads = [
                min(leads_of(made.known, u, [v for v in made.uses if v is not u]).values(), default=math.inf)
                for u in made.uses
            ]
            worth = [h.beside for h in made.hidden]
            report = look(made)
            found = sorted(s.effect for s in report.findings)
            exact = found == sorted(names)
            # the classes of the steps hold the effects, one each and none over
            classed = len(report.findings) == len(names) and _matches(
                [{m.effect for m in s.members} for s in report.findings], list(names)
            )
            strata = ["all"]
            if min(worth) >= BESIDE_NATS:
                strata.append("worth")
                if min(leads) >= AHEAD:
                    strata.append("apart")
            for stratum in strata:
                count.update(
                    {
                        (len(names), f"{stratum} {w}"): int(v)
                        for w, v in (("drawn", 1), ("exact", exact), ("class", classed))
                    }
                )
            figures = " ".join(
                f"{w:.0f}" + (f"/{x:.0f}" if np.isfinite(x) else "") for w, x in zip(worth, leads, strict=True)
            )
            answer = "right" if exact else "class" if classed else "WRONG"
            gains = " + ".join(f"{s.effect} {s.nats:.0f}" for s in report.findings)
            print(f"{' + '.join(names):50s} {figures:18s} {answer:6s} {gains}", flush=True)
    strata_said = {
        "all": "all",
        "worth": f"each worth {BESIDE_NATS:.0f} expected nats beside the others",
        "apart": f"and each {AHEAD:.0f} expected nats ahead of every other slow effect in its place",
    }
    for size in sorted({s for s, _ in count}):
        for stratum, words in strata_said.items():
            n = count[size, f"{stratum} drawn"]
            _share(f"{size} effects, {words}: exactly these", count[size, f"{stratum} exact"], n)
            _share(f"{size} effects, {words}: each in its class", count[size, f"{stratum} class"], n)


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
    flagged, named, thresholds = 0, 0, []
    sides = arguments.axes // 3 if arguments.axes > 3 else 1
    for k in range(arguments.draws):
        axes, beliefs = [], {}
        for side in range(sides):
            made = static_recording(
                (), 0.0, (arguments.seed, 800, k, side), arguments.hours, axes=min(arguments.axes, 3), sensors=_NULLS
            )
            for s in made.log:
                name = s.name.replace("gyro", ("gyro", "accel")[side])
                axes.append(Series(s.values, s.rate_hz, s.unit, name))
                beliefs[name] = made.beliefs[s.name]
        report = find_static_gap(
            axes, beliefs, rng=np.random.default_rng(1), temperature=made.temperature, hold_out=False
        )
        flagged += report.verdict != "nothing missing"
        named += report.verdict == "named"
        thresholds.append(report.threshold_nats)
        if report.verdict != "nothing missing":
            gains = [(s.effect, s.axes, round(s.nats, 1)) for s in report.findings] or report.remainder
            print(k, report.verdict, gains, flush=True)
    n = arguments.draws
    print(
        f"threshold simulated in {sum(t > rules().least_nats for t in thresholds)} of {n} recordings, {max(thresholds):.2f} nats at the most"
    )
    _share(f"recordings of {len(axes)} axes flagged", flagged, n)
    _share(f"recordings of {len(axes)} axes named", named, n)


#: Sensors at 20 Hz whose processes are written in other ways than the search writes its candidates.
_WRITTEN = {
    "AR1": "AR1(phi=0.99875, sigma2=4e-10, rate_hz=20) + WN(N=1e-3)",
    "AR(2)": "AR(ar=[1.97, -0.9702], sigma2=2e-10, rate_hz=20) + WN(N=1e-3)",
    "AR(3)": "AR(ar=[2.499, -2.0385, 0.53946], sigma2=1e-10, rate_hz=20) + WN(N=1e-3)",
    "ARMA": "ARMA(ar=[1.2, -0.21], ma=[0.4], sigma2=1e-6, rate_hz=20) + WN(N=5e-4)",
    "GM2": "GM2(sigma=6e-4, Tc=20 s) + WN(N=1e-3)",
}
#: The process that hidden effects are held against, and effects of several kinds that can hide beside it.
_TWIN = "GM(sigma=4e-4, Tc=40 s) + WN(N=1e-3)"
_BESIDE = ("random_walk", "ramp", "white_noise", "vibration_line", "vibration_band", "telegraph")


def _written(model: NoiseModel, how: str, rate_hz: float) -> NoiseModel:
    """A sum with its Gauss-Markov process written as another that is the same."""
    out: list[Process] = []
    for p in model:
        if isinstance(p, GM) and how != "GM":
            phi, sigma2 = p.discrete(1.0 / rate_hz)
            one, two = AR1(phi, sigma2, rate_hz), AR((phi, 0.0), sigma2=sigma2, rate_hz=rate_hz)
            out.append({"AR1": one, "AR(2)": two, "ARMA": ARMA((phi,), (0.0,), sigma2, rate_hz)}[how])
        else:
            out.append(p)
    return NoiseModel(tuple(out))


def beliefs(arguments: argparse.Namespace) -> None:
    """False alarms and names where the belief is written as other processes."""
    n = int(arguments.hours * 3600 * arguments.rate)
    total = 0
    kinds = [k for k in _WRITTEN if k in (arguments.only or _WRITTEN)]
    hidden = [e for e in _BESIDE if e in (arguments.only or _BESIDE)]
    for i, kind in enumerate(kinds):
        truth, flagged, said = NoiseModel.parse(_WRITTEN[kind], "rad/s"), 0, Counter[str]()
        for k in range(arguments.draws):
            rng = np.random.default_rng([arguments.seed, 1000 + i, k])
            log = Series(truth.simulate(n, 1.0 / arguments.rate, rng), arguments.rate, "rad/s", "gyro_x")
            belief = {"gyro_x": wrong(truth, rng)}
            report = find_static_gap([log], belief, rng=np.random.default_rng(1), hold_out=False)
            flagged += report.verdict != "nothing missing"
            said.update(s.effect for s in report.findings)
        total += flagged
        _share(f"nominal, believed as {kind}: flagged {dict(said) or ''}", flagged, arguments.draws)
    if kinds:
        _share("nominal, all beliefs: flagged", total, arguments.draws * len(kinds))
    ways = ("GM", "AR1", "AR(2)", "ARMA")
    named, drawn = Counter[str](), 0
    for effect in hidden:
        right = Counter[str]()
        for k in range(max(arguments.draws // 10, 1)):
            made = static_recording(
                (effect,), 60.0, (arguments.seed, 1100, k), arguments.hours, axes=1, sensors=(_TWIN,)
            )
            for how in ways:
                as_written = {a: _written(m, how, 20.0) for a, m in made.beliefs.items()}
                report = look(replace(made, beliefs=as_written))
                right[how] += bool(report.findings) and report.findings[0].effect == effect
            drawn += 1
        named += right
        print(f"{effect:20s} named first: " + ", ".join(f"{how} {right[how]}" for how in ways), flush=True)
    for how in ways if drawn else ():
        _share(f"hidden effects named first, believed as {how}", named[how], drawn)


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
            state = state_of(reduce(log), Explanation.nominal(wrong(model, rng)))
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


def _again(uses: Sequence[EffectUse], known: Log, seed: Sequence[int]) -> AxisState:
    """Another draw of the same truth and the same belief, as the search meets it."""
    rng = np.random.default_rng(seed)
    t = np.arange(known.n) * known.dt
    still = ImuRecord(t, np.zeros((known.n, 3)), np.zeros((known.n, 3)), "mean")
    truth = dict.fromkeys(AXES[:3], known.truth)
    imu = corrupt(still, truth, rng, effects=uses, temperature=known.temperature).imu
    series = Series(imu.gyro[:, known.axis], 1.0 / known.dt, "rad/s", AXES[known.axis])
    return state_of(reduce(series), known.nominal(), known.temperature)


def pairs(arguments: argparse.Namespace) -> None:
    """What a recording's class holds, against repeated draws of the same truth."""
    inside = beside = comes_first = wrong_first = wrong_predicted = 0
    for effect in arguments.only or SLOW:
        for nats in (20.0, 60.0, 200.0):
            seed = (arguments.seed, 700 + EFFECTS.index(effect), int(nats))
            made = static_recording((effect,), nats, seed, arguments.hours, axes=1, sensors=WHITE)
            classes: list[list[str]] = []
            for k in range(arguments.draws):
                ranked = weigh_all(_again(made.uses, made.known, (*seed, 2, k)), QUICK)
                if ranked[0].nats >= rules().least_nats:
                    classes.append([w.effect for w in ranked if w.nats > ranked[0].nats - rules().lead])
            near, first = Counter(e for c in classes for e in c), Counter(c[0] for c in classes)
            for c in classes:
                if c[0] != effect:
                    wrong_first += 1
                    wrong_predicted += effect in c
                if effect not in c:
                    continue
                for rival in c:
                    if rival == effect:
                        continue
                    # in the other draws, so that no recording confirms itself
                    others = 0.1 * (len(classes) - 1)
                    inside += 1
                    beside += near[rival] - 1 >= others
                    comes_first += first[rival] - (c[0] == rival) >= others
            leads = sorted(leads_of(made.known, made.uses[0]).items(), key=lambda item: item[1])
            ahead = ", ".join(f"{e} {v:.1f}" for e, v in leads[:3])
            print(
                f"{effect:13s} {nats:3.0f} nats, ahead of {ahead}; first {dict(first)}; within {rules().lead:.0f} nats of it {dict(near)}",
                flush=True,
            )
    _share(
        "pairs that a recording's class predicts, the rival in the class in a tenth of the other draws", beside, inside
    )
    _share("the same, the rival first in a tenth of the other draws", comes_first, inside)
    _share("recordings in which a rival came first, the truth in their class", wrong_predicted, wrong_first)


def _believed(s: Series, kind: str) -> float:
    """White-noise density that a user would believe: from the differences of samples, or read from the Allan deviation at 1 s."""
    if kind == "differences":
        return float(np.std(np.diff(s.values)) / math.sqrt(2.0) * math.sqrt(s.dt))
    curve = allan_variance(s.values, s.rate_hz)
    return float(math.sqrt(np.exp(np.interp(0.0, np.log(curve.tau_s), np.log(curve.value)))))


def _taken_out(found: Sequence[Found[AxisState]], s: Series) -> NoiseModel:
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
            result = search_axis(state_of(data, nominal))
            print(f"{s.name}, believed white noise from {kind}: {result.outsider}")
            for f in result.found:
                print(f"   {f.chosen.effect} {f.chosen.variant} {f.chosen.nats:.1f} nats, class {_class(f)}")
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


def _class(found: Found[AxisState]) -> list[str]:
    return [w.effect for w in found.ranked if w.nats > found.ranked[0].nats - 3.0]


def thermal(_: argparse.Namespace) -> None:
    """What is named in the sweep."""
    log = load_measured(shared("real/imu_thermal_sweep.npz"))
    beliefs = {s.name: NoiseModel((WN(_believed(s, "differences")),)) for s in log.axes}
    report = find_static_gap(
        log.axes, beliefs, rng=np.random.default_rng(1), temperature=log.temperature, hold_out=False
    )
    print(report.verdict)
    for s in report.findings:
        print(
            f"  {s.effect} {s.variant} on {s.sensor} {','.join(s.axes)}: {s.nats:.0f} nats, class {[m.effect for m in s.members]}"
        )
    print("  left over:", report.remainder)


def main() -> None:
    """Parse and run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("real", "thermal", "effects", "sets", "null", "map", "beliefs", "pairs"))
    parser.add_argument("only", nargs="*", help="effects, pairs, beliefs: only these; sets: only these, as a+b")
    parser.add_argument("--draws", type=int, default=10)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--rate", type=float, default=20.0, help="map: samples per second")
    parser.add_argument("--axes", type=int, default=6)
    parser.add_argument("--axes-of", type=int, nargs="*", help="real: numbers of axes")
    parser.add_argument("--nats", type=float, default=60.0, help="sets: what each effect is worth alone")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    {**globals(), "map": map_of_nothing}[arguments.what](arguments)


if __name__ == "__main__":
    main()
