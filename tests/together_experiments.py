"""Experiments behind the claims about processes that axes share.

``python -m tests.together_experiments NAME [--series N]`` prints a table; the slow tests assert on the same numbers. Seeds are fixed.
"""

from __future__ import annotations

import math
import time
from collections import defaultdict
from dataclasses import replace

import numpy as np
import typer
from scipy import linalg

from insemu.fit import fit_together
from insemu.formats import read_log
from insemu.gap import find_static_gap
from insemu.noise import GM, RW, WN, CommonDraws, NoiseModel, shared_processes
from insemu.records import Series
from insemu.variance import wavelet_covariance
from tests.shared_data import shared

app = typer.Typer(add_completion=False, no_args_is_help=True)

#: Three accelerometers that see one process at levels of their own, y with the other sign; an hour at 50 Hz.
TRUTH = {
    "accel_x": WN(1e-3) + GM(1e-3, 0.05, shared="a") + RW(1e-4),
    "accel_y": WN(1.5e-3) + GM(1.5e-3, 0.05, shared="-a"),
    "accel_z": WN(1e-3) + GM(2e-3, 0.05, shared="a") + RW(1e-4),
}
RATE, N = 50.0, 180_000


def drawn(models: dict[str, NoiseModel], n: int, rate: float, rng: np.random.Generator) -> list[Series]:
    """A log whose axes share what their models share."""
    common, out = CommonDraws(models), []
    for axis, model in models.items():
        parts = model.simulate_components(n, 1.0 / rate, rng)
        common.share(axis, parts)
        out.append(Series(parts.sum(axis=0), rate, "m/s^2", axis))
    return out


def structure_of(model: NoiseModel) -> NoiseModel:
    return NoiseModel(tuple(type(p)(shared=p.shared.lstrip("-")) for p in model))


def coverage(series: int = 200, seed: int = 1601) -> tuple[dict[str, float], float]:
    """Coverage of 95 % intervals of every parameter of a joint fit, and rejections of its test of fit at 5 %."""
    inside: dict[str, list[bool]] = defaultdict(list)
    rejected = []
    asked = {a: structure_of(m) for a, m in TRUTH.items()}
    for rng in np.random.default_rng(seed).spawn(series):
        found = fit_together(drawn(TRUTH, N, RATE, rng), asked)
        for axis, result in found.items():
            true = {(p.symbol, i): p.parameters for i, p in TRUTH[axis].indexed()}
            assert [p.shared for p in result.model] == [p.shared for p in TRUTH[axis]]
            for e in result.parameters:
                inside[f"{axis} {e.label}"].append(e.low <= true[e.process, e.index][e.name] <= e.high)
        test = next(iter(found.values())).test
        rejected.append(test is not None and test.p_value < 0.05)
    return {k: float(np.mean(v)) for k, v in inside.items()}, float(np.mean(rejected))


@app.command("coverage")
def print_coverage(series: int = 200) -> None:
    """Joint fit of three axes that share a Gauss-Markov process."""
    began = time.process_time()
    inside, rejected = coverage(series)
    print(f"{series} logs of {N / RATE / 60:g} min, {(time.process_time() - began) / series:.2f} CPU s each")
    for name, share in inside.items():
        print(f"{name:20s} {100 * share:5.1f} %")
    print(f"all parameters       {100 * np.mean(list(inside.values())):5.1f} %")
    print(f"test of fit rejects  {100 * rejected:5.1f} % at 5 %")


#: Samples at 100 Hz, and share of the slow variance, of the pairs that are not independent.
LONG, SHARED = 60_000, 0.8


def independence(series: int = 300, seed: int = 1602) -> tuple[float, float]:
    """Rejections at 5 % of two independent axes of different colour, and of two that share most of a slow process, 30 correlation times long."""
    one, two, common = WN(1e-3) + GM(1e-3, 0.05), WN(3e-3) + RW(1e-4), GM(1e-3, 0.05)
    out = np.zeros(2)
    for rng in np.random.default_rng(seed).spawn(series):
        x, y = (m.simulate(20_000, 0.01, rng) for m in (one, two))
        g, *own = (common.simulate(LONG, 0.01, rng) for _ in range(3))
        seen = (WN(1e-3).simulate(LONG, 0.01, rng) + math.sqrt(1.0 - SHARED) * v + math.sqrt(SHARED) * g for v in own)
        out[0] += wavelet_covariance(x, y, 100.0).p_value < 0.05
        out[1] += wavelet_covariance(*seen, 100.0).p_value < 0.05
    return float(out[0] / series), float(out[1] / series)


@app.command("independence")
def print_independence(series: int = 300) -> None:
    """Size and power of the test of independence."""
    size, power = independence(series)
    print(
        f"independent axes rejected {100 * size:.1f} % at 5 %; {SHARED:.0%} of the slow variance shared found {100 * power:.1f} %"
    )


# -- the ADIS16405 -----------------------------------------------------------------------------------------------------------------------

#: Structure of each accelerometer; the first 50 min warm up.
ADIS = "WN() + GM() + GM(shared=a) + GM(shared=b)"
WARM_UP_S, BLOCK_S, TAU_FROM_S = 3000.0, 10.0, 5.0


def adis_run(number: int) -> list[Series]:
    log = read_log(shared(f"real/adis16405_static_run{number}.npz"), columns=["ax", "ay"])
    return [replace(s, values=s.values[round(WARM_UP_S * s.rate_hz) :]) for s in log.series()]


def block_differences(series: list[Series]) -> np.ndarray:
    m = round(BLOCK_S * series[0].rate_hz)
    return np.stack([np.diff(s.values[: len(s) // m * m].reshape(-1, m).mean(axis=1)) for s in series])


def log_score(models: dict[str, NoiseModel], series: list[Series], *, together: bool) -> float:
    """Log density of the differences of 10-s means of two axes."""
    y = block_differences(series)
    n, m, dt = y.shape[1], round(BLOCK_S * series[0].rate_hz), series[0].dt
    S = linalg.block_diag(*(linalg.toeplitz(models[s.name].difference_covariance(m, dt, n)) for s in series))
    if together:
        for one, two in shared_processes(models).values():
            cross = linalg.toeplitz(one.process.difference_covariance(m, dt, n)) * (two.weight / one.weight)
            S[:n, n:] += cross
            S[n:, :n] += cross
    L = linalg.cholesky(S, lower=True)
    z = linalg.solve_triangular(L, y.ravel(), lower=True)
    return float(-0.5 * z @ z - np.sum(np.log(np.diag(L))) - n * math.log(2.0 * math.pi))


def adis() -> list[tuple[int, float, float, float]]:
    """Per run: correlation of differences of 10-s means, p-value of independence, gain of log score with the process shared over without."""
    first = adis_run(1)
    asked = NoiseModel.parse(ADIS)
    found = fit_together(first, {s.name: asked for s in first}, tau_from=TAU_FROM_S)
    models = {axis: r.model for axis, r in found.items()}
    out = []
    for number in (1, 2, 3):
        series = adis_run(number)
        x, y = block_differences(series)
        p = wavelet_covariance(series[0].values, series[1].values, series[0].rate_hz).p_value
        gain = log_score(models, series, together=True) - log_score(models, series, together=False)
        out.append((number, float(np.corrcoef(x, y)[0, 1]), p, gain))
    return out


@app.command("adis")
def print_adis() -> None:
    """Accelerometers x and y of the ADIS16405: fitted to run 1, runs 2 and 3 predicted with the shared processes and without."""
    for number, r, p, gain in adis():
        print(
            f"run {number}: differences of {BLOCK_S:g}-s means correlate {r:.2f}, independence p {p:.1g}, "
            f"log score {gain:+.1f} nats with the shared processes"
            + (" (the run that was fitted)" if number == 1 else "")
        )


# -- naming it in a log at rest --------------------------------------------------------------------------------------------------------------

#: Three accelerometers at rest for an hour at 20 Hz; x and y share this part of their slow variance, which is worth about 20 nats.
REST = {a: WN(1e-3) + GM(s, 0.02) for a, s in (("accel_x", 1.0e-3), ("accel_y", 1.3e-3), ("accel_z", 1.6e-3))}
REST_RATE, REST_N, REST_SHARE = 20.0, 72_000, 0.48


def naming(series: int, share: float, seed: int = 1603) -> dict[str, float]:
    """Logs whose accelerometers x and y share a part of their slow variance: named, coverage, evidence, other findings."""
    found: dict[str, list[float]] = defaultdict(list)
    for k, rng in enumerate(np.random.default_rng(seed).spawn(series)):
        sign = "-" if k % 2 else ""
        truth = dict(REST)
        for axis, name in (("accel_x", "a"), ("accel_y", f"{sign}a")):
            white, slow = REST[axis]
            if share > 0.0:
                truth[axis] = (
                    white + replace(slow.scaled(math.sqrt(share)), shared=name) + slow.scaled(math.sqrt(1.0 - share))
                )
        report = find_static_gap(drawn(truth, REST_N, REST_RATE, rng), REST, rng=rng, hold_out=False)
        named = [f for f in report.findings if f.effect == "shared_process"]
        found["named"].append(
            report.verdict == "named"
            and report.findings[0].effect == "shared_process"
            and report.findings[0].axes == ("x", "y")
        )
        found["found"].append(bool(named))
        found["others"].append(len(report.findings) > len(named))
        if named:
            true = -share if sign else share
            found["covered"].append(named[0].parameters[0].low <= true <= named[0].parameters[0].high)
            found["nats"].append(named[0].nats)
    return {k: float(np.mean(v)) for k, v in found.items()}


@app.command("naming")
def print_naming(series: int = 150) -> None:
    """Shared process at 20 nats, and false alarms where nothing is shared."""
    at = naming(series, REST_SHARE)
    print(
        f"{series} logs, {at['nats']:.1f} nats in the mean: named {100 * at['named']:.1f} %, found {100 * at['found']:.1f} %, "
        f"interval of the correlation holds it in {100 * at['covered']:.1f} %, other effects in {100 * at['others']:.1f} %"
    )
    none = naming(series, 0.0, seed=1604)
    print(
        f"{series} logs that share nothing: {100 * none['found']:.1f} % found, other effects in {100 * none['others']:.1f} %"
    )


if __name__ == "__main__":
    app()
