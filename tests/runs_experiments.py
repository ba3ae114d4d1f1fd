"""Experiments behind the claims about several runs of one sensor: ``python -m tests.runs_experiments NAME [--series N]``; seeds are fixed."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import numpy as np
import typer

from insemu.fit import fit, fit_runs
from insemu.formats import read_log
from insemu.noise import GM, WN, NoiseModel, process_label, with_factors
from insemu.records import Series
from tests.shared_data import shared

app = typer.Typer(add_completion=False, no_args_is_help=True)

BASE, RATE, N, RUNS = WN(0.1) + GM(0.05, 0.1), 100.0, 100_000, 6


def labels_of(model: NoiseModel) -> list[str]:
    return [f"{process_label(p.symbol, i)}.{name}" for i, p in model.indexed() for name in p.parameters]


def values_of(model: NoiseModel) -> np.ndarray:
    return np.array([v for p in model for v in p.parameters.values()])


def log_of(model: NoiseModel, n: int, rng: np.random.Generator) -> Series:
    return Series(model.simulate(n, 1.0 / RATE, rng), RATE, "m/s^2", "accel_x")


def coverage(spread: float, series: int, seed: int = 1801, n: int = N) -> dict[str, float]:
    """Coverage of 95 % intervals over all parameters, sensors of six runs and a seventh drawn with this spread of every logarithm.

    The median over runs, the parameters of the joint fit, the seventh's parameters, and what a log of it shows when fitted alone.
    """
    inside: dict[str, list[np.ndarray]] = defaultdict(list)
    structure, true = WN() + GM(), values_of(BASE)
    for rng in np.random.default_rng(seed).spawn(series):
        sensors = [
            with_factors(BASE, dict(zip(labels_of(BASE), np.exp(spread * rng.standard_normal(3)), strict=True)))
            for _ in range(RUNS + 1)
        ]
        found = fit_runs([log_of(m, n, rng) for m in sensors[:RUNS]], structure, bootstrap=0, rng=rng)
        alone = fit(log_of(sensors[RUNS], n, rng), structure, weighting="asymptotic")
        seventh, shown = values_of(sensors[RUNS]), np.array([e.value for e in alone.parameters])
        low, high = (np.array([getattr(e, end) for e in found.joint.parameters]) for end in ("low", "high"))
        inside["joint fit"].append((low <= true) & (true <= high))
        for name, target, ends in (
            ("median", true, ("low", "high")), ("seventh run", seventh, ("next_low", "next_high")), ("its log", shown, ("log_low", "log_high")),
        ):  # fmt: skip
            low, high = (np.array([getattr(s, end) for s in found.spreads]) for end in ends)
            inside[name].append((low <= target) & (target <= high))
    return {name: float(np.mean(v)) for name, v in inside.items()}


@app.command("coverage")
def print_coverage(series: int = 150) -> None:
    """Intervals of six runs and for a seventh at spreads of 0, 10 and 40 %."""
    for spread in (0.0, 0.1, 0.4):
        at = coverage(spread, series)
        print(
            f"spread {100 * spread:3.0f} %: " + ", ".join(f"{name} {100 * share:.1f} %" for name, share in at.items())
        )


def stationarity(spread: float, series: int, draws: int, seed: int = 1802, n: int = 10_000) -> float:
    """Share of sets of six runs whose near-stationarity is rejected at 5 %."""
    rejected = 0
    for rng in np.random.default_rng(seed).spawn(series):
        sensors = [
            with_factors(BASE, dict(zip(labels_of(BASE), np.exp(spread * rng.standard_normal(3)), strict=True)))
            for _ in range(RUNS)
        ]
        found = fit_runs([log_of(m, n, rng) for m in sensors], WN() + GM(), bootstrap=draws, rng=rng)
        rejected += found.p_value <= 0.05
    return rejected / series


@app.command("stationarity")
def print_stationarity(series: int = 200, draws: int = 99) -> None:
    """Size and power of the test of near-stationarity."""
    print(
        f"one sensor in all runs: rejected {100 * stationarity(0.0, series, draws):.1f} % at 5 % ({series} sets, {draws} draws each)"
    )
    print(f"spread 40 %: rejected {100 * stationarity(0.4, series // 4, draws):.1f} %")


def adis_runs(column: str) -> list[Series]:
    out = []
    for k in (1, 2, 3):
        (s,) = read_log(shared(f"real/adis16405_static_run{k}.npz"), columns=[column]).series()
        out.append(replace(s, values=s.values[300_000:]))
    return out


def left_out(column: str) -> list[float]:
    """Share of the scales at which the prediction interval of two runs holds the curve of the third, for each third."""
    runs = adis_runs(column)
    out = []
    for k in range(3):
        found = fit_runs(
            [r for j, r in enumerate(runs) if j != k], 2 * GM() + WN(), bootstrap=0, rng=np.random.default_rng(k)
        )
        own = fit(runs[k], 2 * GM() + WN()).curve
        assert own is not None
        out.append(float(np.mean([s.log_low <= v <= s.log_high for s, v in zip(found.curve, own.value, strict=False)])))
    return out


@app.command("adis")
def print_adis() -> None:
    """ADIS16405, one run left out after another (the first 50 min warm up)."""
    every = []
    for column in ("gx", "gy", "gz", "ax", "ay", "az"):
        shares = left_out(column)
        every += shares
        held = (f"run {k + 1} held at {100 * share:.0f} % of scales" for k, share in enumerate(shares))
        print(f"{column}: " + ", ".join(held))
    least = sum(share >= 0.9 for share in every)
    print(f"together: held at {100 * np.mean(every):.1f} % of scales, {least} of {len(every)} curves at 90 % or more")


if __name__ == "__main__":
    app()
