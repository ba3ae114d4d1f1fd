"""Experiments with known truth behind the statistical claims of the estimators.

``python -m tests.fit_experiments NAME [--series N]`` prints a table; the slow tests assert on the same numbers. Seeds are fixed, so a
printed table can be had again.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import typer

from insemu import units
from insemu.fit import fit
from insemu.fit.covariance import covariance_of_curve
from insemu.fit.em import fit_em
from insemu.fit.gmwm import fit_curve
from insemu.fit.likelihood import fit_mli
from insemu.fit.selection import RANK_DOF, prediction_distance, select
from insemu.noise import DR, GM, QN, RW, WN, NoiseModel
from insemu.records import Series
from insemu.variance import wavelet_variance

app = typer.Typer(add_completion=False, no_args_is_help=True)


def structure_of(model: NoiseModel) -> NoiseModel:
    return NoiseModel(tuple(type(p)() for p in model))


def values_of(model: NoiseModel) -> np.ndarray:
    return np.array([v for p in model for v in p.parameters.values()])


# -- bias, coverage and the test of fit -----------------------------------------------------------------------------------------------

#: At 100 Hz, 100,000 samples.
COVERAGE = {
    "WN + RW": WN(0.1) + RW(0.01),
    "WN + GM": WN(0.1) + GM(0.05, 0.1),
    "2 GM + WN": GM(0.1, 0.1) + GM(0.2, 5.0) + WN(0.02),
    "QN + WN + RW": QN(0.001) + WN(0.01) + RW(0.005),
}


def coverage(name: str, series: int = 500, weighting: str = "auto", seed: int = 20140) -> dict[str, np.ndarray | float]:
    """Bias in standard deviations, coverage of 95 % intervals, rejections of the test of fit at 5 %."""
    truth, n, rate = COVERAGE[name], 100_000, 100.0
    structure, true = structure_of(truth), values_of(truth)
    found, inside, rejected = [], [], []
    for rng in np.random.default_rng(seed).spawn(series):
        curve = wavelet_variance(truth.simulate(n, 1.0 / rate, rng), rate, intervals="eta3")
        result = fit_curve(curve, structure, weighting=weighting)  # type: ignore[arg-type]
        found.append([e.value for e in result.parameters])
        inside.append([e.low <= t <= e.high for e, t in zip(result.parameters, true, strict=True)])
        rejected.append(result.test is not None and result.test.p_value < 0.05)
    values = np.array(found)
    return {
        "bias": (values.mean(axis=0) - true) / values.std(axis=0),
        "coverage": np.mean(inside, axis=0),
        "rejections": float(np.mean(rejected)),
    }


@app.command("coverage")
def print_coverage(series: int = 500, seed: int = 20140) -> None:
    for weighting in ("auto", "asymptotic", "intervals"):
        for name in COVERAGE:
            got = coverage(name, series, weighting, seed)
            print(
                f"{weighting:11s} {name:13s} bias/sd {np.round(got['bias'], 2)} ± {series**-0.5:.2f}  coverage % "
                f"{np.round(100 * np.asarray(got['coverage']), 1)}  test of fit rejects {100 * float(got['rejections']):.1f} %",
                flush=True,
            )


# -- selection ------------------------------------------------------------------------------------------------------------------------

#: At 100 Hz, 1,000,000 samples.
SELECTION = {
    "WN + RW": WN(0.1) + RW(0.01),
    "GM + WN": GM(0.05, 0.1) + WN(0.1),
    "2 GM + WN": GM(0.05, 0.02) + GM(0.2, 5.0) + WN(0.02),
    "QN + WN + RW": QN(0.001) + WN(0.01) + RW(0.005),
    "3 GM + WN": GM(0.1, 0.01) + GM(0.1, 0.5) + GM(0.2, 10.0) + WN(0.01),
}
GENERAL = "4*GM() + WN() + RW() + QN()"


def selection(name: str, series: int = 50, seed: int = 5, n: int = 1_000_000) -> dict[str, object]:
    """Structures named, and the prediction of a second record by the choice against that by the true structure fitted to the first.

    A prediction's distance is the mean square over the scales of the held-out variance minus the predicted one, in the truth's standard
    deviations. Differences are given in two standard errors: of the truth's own distance, which scatters with the held-out record only
    (the stricter one, and what ``worst`` is in), and of the fitted true structure's, which scatters with both records.
    """
    truth, rate = SELECTION[name], 100.0
    general = NoiseModel.parse(GENERAL)
    want = sorted(p.symbol for p in truth)
    named: Counter[str] = Counter()
    right, worse, floor, floor_of_both = 0, [], [], []
    for rng in np.random.default_rng(seed).spawn(series):
        one, two = rng.spawn(2)
        curve = wavelet_variance(truth.simulate(n, 1.0 / rate, one), rate, intervals="eta3")
        held_out = wavelet_variance(truth.simulate(n, 1.0 / rate, two), rate, intervals="eta3")
        ranking = select(curve, general)
        named[str(ranking.chosen.structure)] += 1
        right += sorted(p.symbol for p in ranking.chosen.structure) == want
        fitted = fit_curve(curve, structure_of(truth), weighting="asymptotic")
        chosen, error = prediction_distance(ranking.fit.model, held_out, truth)
        of_truth_fitted, both = prediction_distance(
            fitted.model,
            held_out,
            truth,
            fit_covariance=fitted.details["jacobian"] @ fitted.covariance @ fitted.details["jacobian"].T,
        )
        of_truth = prediction_distance(truth, held_out, truth)[0]
        worse.append((chosen - of_truth_fitted) / error)
        floor.append((of_truth_fitted - of_truth) / error)
        floor_of_both.append((of_truth_fitted - of_truth) / both)
    return {
        "right": right / series,
        "named": named,
        "worst": max(worse),
        "fitted_truth_beyond_two": float(np.mean(np.array(floor) > 2.0)),
        "fitted_truth_beyond_two_of_both": float(np.mean(np.array(floor_of_both) > 2.0)),
    }


@app.command("selection")
def print_selection(series: int = 50, seed: int = 5) -> None:
    for name in SELECTION:
        started = time.perf_counter()
        got = selection(name, series, seed)
        each = (time.perf_counter() - started) / series
        print(
            f"{name:13s} named right {100 * float(got['right']):.0f} %  {dict(got['named'])}\n   prediction of another record at worst "
            f"{float(got['worst']):+.2f} standard errors from the fitted true structure's; that one is beyond two standard errors of the "
            f"true values' own in {100 * float(got['fitted_truth_beyond_two']):.0f} % "
            f"({100 * float(got['fitted_truth_beyond_two_of_both']):.0f} % if they allow for the fit's scatter)  "
            f"({each:.2f} s per series, simulation included)",
            flush=True,
        )


#: Strong parts and the part whose size is chosen for a log-likelihood ratio; 2^17 samples at 100 Hz.
WEAK = {
    "RW behind WN": (NoiseModel((WN(0.1),)), NoiseModel((RW(1.0),))),
    "slow GM behind WN": (NoiseModel((WN(0.1),)), NoiseModel((GM(1.0, 0.01),))),
    "GM behind WN": (NoiseModel((WN(0.1),)), NoiseModel((GM(1.0, 0.5),))),
    "fast GM behind WN": (NoiseModel((WN(0.1),)), NoiseModel((GM(1.0, 20.0),))),
    "QN behind WN": (NoiseModel((WN(0.1),)), NoiseModel((QN(1.0),))),
    "RW behind QN + WN": (QN(0.003) + WN(0.1), NoiseModel((RW(1.0),))),
    "RW behind GM + WN": (GM(0.3, 2.0) + WN(0.1), NoiseModel((RW(1.0),))),
    "slow GM behind GM + WN": (GM(0.3, 5.0) + WN(0.1), NoiseModel((GM(1.0, 0.02),))),
    "WN behind GM": (NoiseModel((GM(1.0, 20.0),)), NoiseModel((WN(1.0),))),
    "WN behind RW": (NoiseModel((RW(1.0),)), NoiseModel((WN(1.0),))),
}


def scaled(model: NoiseModel, factor: float) -> NoiseModel:
    """The signal times a factor, for processes whose first parameter is an amplitude."""
    return NoiseModel(
        tuple(type(p)(*(v * factor if i == 0 else v for i, v in enumerate(p.parameters.values()))) for p in model)
    )


def weak(name: str, nats: float, series: int = 20, seed: int = 6) -> dict[str, object]:
    """Choices where the weakest part is worth so many nats: half the squared distance of the expected curve from the nearest model without it.

    ``kept`` counts records whose fitted variance is within a factor of two at the scale where the part counts most.
    """
    strong, part = WEAK[name]
    n, rate, general = 2**17, 100.0, NoiseModel.parse("2*GM() + WN() + RW() + QN()")
    like = wavelet_variance(strong.simulate(n, 1.0 / rate, np.random.default_rng(seed)), rate, intervals="eta3")
    scale = like.scale_samples

    def worth(factor: float) -> tuple[float, np.ndarray]:
        expected = (strong + scaled(part, factor)).wavelet_variance(scale, 1.0 / rate)
        null = fit_curve(replace(like, value=expected), structure_of(strong), weighting="asymptotic").model
        curve = null.wavelet_variance(scale, 1.0 / rate)
        V = covariance_of_curve(null, like)
        use = 2.0 * curve**2 / np.diag(V) >= RANK_DOF
        z = np.where(use, 3.0 * curve * (np.cbrt(expected / curve) - 1.0), 0.0)[use]
        return 0.5 * float(z @ np.linalg.solve(V[np.ix_(use, use)], z)), np.where(use, expected / curve, 1.0)

    high = 1e-6
    while worth(high)[0] < nats:  # a very large part would be taken over by the others
        high *= 1.5
    low = high / 1.5
    for _ in range(12):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if worth(middle)[0] < nats else (low, middle)
    truth = strong + scaled(part, high)
    most = int(np.argmax(np.abs(np.log(worth(high)[1]))))
    named: Counter[str] = Counter()
    right = kept = refuted = 0
    for rng in np.random.default_rng(seed).spawn(series):
        ranking = select(wavelet_variance(truth.simulate(n, 1.0 / rate, rng), rate, intervals="eta3"), general)
        named[str(ranking.chosen.structure)] += 1
        right += sorted(p.symbol for p in ranking.chosen.structure) == sorted(p.symbol for p in truth)
        fitted = ranking.fit.model.wavelet_variance(scale, 1.0 / rate)[most]
        kept += bool(0.5 < fitted / truth.wavelet_variance(scale, 1.0 / rate)[most] < 2.0)
        refuted += ranking.fit.test is not None and ranking.fit.test.p_value < 1e-4
    return {"right": right, "kept": kept, "refuted": refuted, "named": named, "part": scaled(part, high)}


@app.command("weak")
def print_weak(series: int = 20, seed: int = 6) -> None:
    for name in WEAK:
        for worth in (5.0, 15.0, 40.0):
            got = weak(name, worth, series, seed)
            print(
                f"{name:23s} {worth:4.0f} nats ({got['part']}): named right {got['right']} of {series}, variance kept {got['kept']}, refuted by "
                f"the test of fit {got['refuted']}  {dict(got['named'].most_common(3))}",
                flush=True,
            )


# -- Stebler et al. 2011: constrained EM --------------------------------------------------------------------------------------------------------

#: Figure: truth, start, what is done about the ramp, stopping rule. 6000 samples at 1 Hz.
EM = {
    "Fig. 2, good start": (WN(0.2) + RW(0.02) + DR(0.003), WN(0.5) + RW(1e-4) + DR(0.0), "least_squares", 1e-7),
    "Fig. 2, bad start": (WN(0.2) + RW(0.02) + DR(0.003), WN(5.0) + RW(10.0) + DR(10.0), "em", 1e-3),
    "Fig. 2, bad start, patient": (WN(0.2) + RW(0.02) + DR(0.003), WN(5.0) + RW(10.0) + DR(10.0), "em", 1e-7),
    "Fig. 3, ramp removed": (
        GM(0.5, 0.008) + WN(0.8) + DR(1e-3),
        GM(1.0, 1e-3) + WN(1.0) + DR(0.0),
        "least_squares",
        1e-7,
    ),
    "Fig. 3, ramp inside": (GM(0.5, 0.008) + WN(0.8) + DR(1e-3), GM(1.0, 1e-3) + WN(1.0) + DR(0.0), "em", 1e-7),
    "Fig. 5": (
        GM(0.5, 0.008) + RW(1e-4) + WN(0.3) + DR(1e-4),
        GM(1e-3, 1e-4) + RW(1e-5) + WN(5e-4) + DR(0.0),
        "least_squares",
        1e-7,
    ),
}


def em_runs(name: str, series: int = 200, seed: int = 2011) -> dict[str, object]:
    """Estimates of EM and of GMWM on the same signals, and how many EM runs said that they converged."""
    truth, start, ramp, tolerance = EM[name]
    structure = structure_of(truth)
    rows, moments, converged, seconds = [], [], 0, 0.0
    labels: list[str] = []
    for rng in np.random.default_rng(seed).spawn(series):
        y = truth.simulate(6000, 1.0, rng)
        began = time.perf_counter()
        result = fit_em(Series(y, 1.0, "", "y"), structure, start=start, ramp=ramp, tolerance=tolerance)  # type: ignore[arg-type]
        seconds += time.perf_counter() - began
        assert result.curve is not None
        rows.append([e.value for e in result.parameters])
        converged += result.converged
        moments.append([e.value for e in fit_curve(result.curve, structure, weighting="asymptotic").parameters])
        labels = [e.label for e in result.parameters]
    return {
        "labels": labels,
        "truth": values_of(truth),
        "em": np.array(rows),
        "gmwm": np.array(moments),
        "converged": converged,
        "seconds": seconds,
    }


@app.command("em")
def print_em(series: int = 200) -> None:
    total = 0.0
    for name in EM:
        got = em_runs(name, series)
        total += float(got["seconds"])  # type: ignore[arg-type]
        print(f"{name}: {got['converged']} of {series} converged, {float(got['seconds']):.0f} s")  # type: ignore[arg-type]
        for i, label in enumerate(got["labels"]):  # type: ignore[arg-type]
            line = f"   {label:9s} truth {got['truth'][i]:.4g}"  # type: ignore[index]
            for method in ("em", "gmwm"):
                column = got[method][:, i]  # type: ignore[index]
                q = np.percentile(column, [25, 50, 75])
                line += f" | {method.upper()} median {q[1]:.4g}, quartiles {q[0]:.4g} to {q[2]:.4g}"
            print(line, flush=True)
    print(f"EM in all: {total:.0f} s on one core")


# -- Nikolic et al. 2016: integrated maximum likelihood -----------------------------------------------------------------------------------------

SIGMA_W = units.parse("21.66 deg/h/sqrt(Hz)", "rad/s/sqrt(Hz)")
SIGMA_B, TAU_B = 1.26e-6, 530.5
#: sd(log tau_b) of an efficient estimator over 12 h: about 114 s at 530 s.
BOUND = 114.0 / 530.0


def integrated(series: int, rate: float, seed: int = 2016, **options: object) -> tuple[np.ndarray, np.ndarray]:
    """(sigma_w, sigma_b, tau_b) over their truths by integrated maximum likelihood and by GMWM, 12-hour records."""
    truth = WN(SIGMA_W) + GM.of_driving_density(SIGMA_B, 1.0 / TAU_B)

    def row(model: NoiseModel) -> tuple[float, float, float]:
        w, g = model.processes
        assert isinstance(w, WN) and isinstance(g, GM)
        sigma, beta = g.parameters["sigma"], g.parameters["beta"]
        return w.parameters["N"] / SIGMA_W, sigma * math.sqrt(2.0 * beta) / SIGMA_B, 1.0 / beta / TAU_B

    likelihood, moments = [], []
    for rng in np.random.default_rng(seed).spawn(series):
        x = truth.simulate(int(12 * 3600 * rate), 1.0 / rate, rng)
        result = fit_mli(Series(x, rate, "rad/s", "z"), structure_of(truth), **options)  # type: ignore[arg-type]
        likelihood.append(row(result.model))
        moments.append(row(result.details["start"]))
    return np.array(likelihood), np.array(moments)


def _integrated_lines(title: str, rows: np.ndarray) -> str:
    return (
        f"{title:34s} sigma_w within {100 * np.abs(rows[:, 0] - 1).max():.2f} %  median sigma_b {100 * (np.median(rows[:, 1]) - 1):+.1f} %  "
        f"median tau_b {100 * (np.median(rows[:, 2]) - 1):+.1f} %  sd(log tau_b) {np.log(rows[:, 2]).std(ddof=1):.3f} (bound {BOUND:.3f}, "
        f"allowed {1.5 * BOUND:.3f})"
    )


@app.command("integrated")
def print_integrated(series: int = 100, rate: float = 10.0, full: int = 10) -> None:
    choices: list[tuple[str, dict[str, object]]] = [
        ("uniform pattern", {}),
        ("logarithmic pattern", {"pattern": "log"}),
        ("not integrated", {"integrated": False}),
    ]
    for label, options in choices:
        rows, moments = integrated(series, rate, **options)
        print(_integrated_lines(f"{series} x {rate:g} Hz, {label}", rows), flush=True)
        if not options:
            print(_integrated_lines(f"{series} x {rate:g} Hz, GMWM", moments))
    if full:
        rows, moments = integrated(full, 400.0)
        print(_integrated_lines(f"{full} x 400 Hz, uniform pattern", rows))
        print(_integrated_lines(f"{full} x 400 Hz, GMWM", moments))
        for row in rows:
            print(f"   sigma_w {row[0]:.4f}  sigma_b {row[1]:.3f}  tau_b {row[2] * TAU_B:.0f} s")


# -- Balamuta et al. 2016: a NavChip-like gyroscope with outliers --------------------------------------------------------------------------------


def navchip() -> tuple[NoiseModel, float, int]:
    """The classical column of Table I of Balamuta et al. 2016; its Q2 and gamma2 are per-sample variances at 250 Hz."""
    rate = 250.0
    gms = [GM(math.sqrt(s), b) for b, s in ((6.28e-3, 1.28e-8), (0.25, 7.08e-9), (8.48, 6.48e-9))]
    model = NoiseModel(
        (*gms, WN.of_variance(6.94e-7, 1 / rate), QN(math.sqrt(2.29e-6) / rate), RW(math.sqrt(3.90e-14 * rate)))
    )
    return model, rate, int(3.5 * 3600 * rate)


def navchip_fits(seed: int = 2016) -> Iterator[tuple[str, dict[str, float]]]:
    """Plain and robust estimates with and without 1 % outliers (standard deviation nine times the signal's)."""
    model, rate, n = navchip()
    rng = np.random.default_rng(seed)
    clean = model.simulate(n, 1.0 / rate, rng)
    bad = clean.copy()
    hit = rng.random(n) < 0.01
    bad[hit] += 9.0 * clean.std() * rng.standard_normal(int(hit.sum()))
    structure = structure_of(model)
    for outliers, x in (("clean", clean), ("1 % outliers", bad)):
        for kind in ("plain", "robust"):
            result = fit(x, structure, rate_hz=rate, robust=kind == "robust")
            assert result.curve is not None
            curve = result.curve
            yield (
                f"{outliers}, {kind}",
                {e.label: e.value for e in result.parameters}
                | {
                    "worst": float(
                        np.abs(np.log(result.fitted / model.wavelet_variance(curve.scale_samples, 1 / rate)))[:-3].max()
                    )
                },
            )


@app.command("navchip")
def print_navchip() -> None:
    model, _, _ = navchip()
    labels = [f"{p.symbol}{i}.{k}" for i, p in model.indexed() for k in p.parameters]
    print(f"{'':22s}" + "".join(f"{label:>12s}" for label in labels))
    print(f"{'truth':22s}" + "".join(f"{v:12.4g}" for v in values_of(model)))
    for title, row in navchip_fits():
        print(
            f"{title:22s}"
            + "".join(f"{row[k]:12.4g}" for k in labels)
            + f"   curve within {math.exp(row['worst']):.3f} of the truth's"
        )


# -- outliers -------------------------------------------------------------------------------------------------------------------------

#: Kind, standard deviations (or size, of one size) of the outliers in those of the samples, and their share.
OUTLIERS = [
    ("none", 0.0, 0.0),
    *((kind, size, share) for kind in ("normal", "fixed") for size in (5.0, 10.0) for share in (0.01, 0.02, 0.05, 0.1)),
    ("bursts of 20", 10.0, 0.01),
]


def with_outliers(x: np.ndarray, kind: str, size: float, share: float, rng: np.random.Generator) -> np.ndarray:
    """A record to which outliers are added."""
    if kind.startswith("bursts"):
        hit = np.convolve(rng.random(x.size) < share / 20, np.ones(20), "full")[: x.size] > 0
    else:
        hit = rng.random(x.size) < share
    drawn = rng.standard_normal(x.size)
    return np.asarray(x + hit * size * x.std() * (np.sign(drawn) if kind == "fixed" else drawn))


@app.command("robust")
def print_robust(series: int = 40, efficiency: float = 0.6, seed: int = 2016, samples: int = 1 << 16) -> None:
    """Median over the truth, coverage and scatter of robust and plain fits of WN + GM under every kind of contamination."""
    truth = WN(0.01) + GM(0.005, 0.1)
    true, structure = values_of(truth), structure_of(truth)
    print(
        f"{'outliers':28s}{'robust: N sigma beta over the truth':>38s}{'95 % intervals hold':>24s}{'plain':>24s}{'relative variance':>24s}"
    )
    for kind, size, share in OUTLIERS:
        found, plain, inside = [], [], []
        for rng in np.random.default_rng(seed).spawn(series):
            x = with_outliers(truth.simulate(samples, 1.0, rng), kind, size, share, rng)
            result = fit(x, structure, rate_hz=1.0, robust=True, efficiency=efficiency)
            found.append([e.value for e in result.parameters])
            inside.append([e.low <= t <= e.high for e, t in zip(result.parameters, true, strict=True)])
            plain.append([e.value for e in fit(x, structure, rate_hz=1.0).parameters])
        cells = [np.median(found, axis=0) / true, np.mean(inside, axis=0), np.median(plain, axis=0) / true]
        cells.append(np.var(plain, axis=0) / np.var(found, axis=0))
        texts = [" ".join(f"{v:7.3f}" for v in c) for c in cells]
        print(
            f"{kind + f' {size:g} sigma, {share:.0%}':28s}{texts[0]:>38s}{texts[1]:>24s}{texts[2]:>24s}{texts[3]:>24s}",
            flush=True,
        )


if __name__ == "__main__":
    app()
