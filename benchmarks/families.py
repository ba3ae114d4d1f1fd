"""Families of filters side by side: speed, agreement where errors are small, and who converges where they are large.

Run ``python -m benchmarks.families`` (``--flights N``, ``--picture FILE.svg``, ``--only speed``, ``small`` or ``large``). Every family flies the
same flights. A flight has converged if tilt, heading and horizontal position are within limits 60 s after the first fix (after the outage);
intervals are exact (Clopper & Pearson) at 95 %. Speeds are epochs in a CPU second of one core at full covariance rate, the best of several runs.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from insemu import strapdown
from insemu.evaluate import share_interval
from insemu.filters import FAMILIES, FilterOptions, FilterParts, FilterResult, InitialSigma
from insemu.records import GnssRecord, ImuRecord
from insemu.strapdown import NavState
from tests import filter_cases as cases

Array = NDArray[np.float64]
NAMES = (*FAMILIES, "ukf")
#: Converged: tilt, heading (rad), horizontal position (m).
LIMITS = (np.deg2rad(2.0), np.deg2rad(5.0), 5.0)
SIGMA = (1.0, 0.1)  # of the fixes, m and m/s
Flight = tuple[ImuRecord, GnssRecord, NavState]


def made(name: str, model: dict, **options: object):
    """The filter of a family."""
    parts = FilterParts(model, cases.DT, (0.0, 0.0, 0.0), "normal", (np.full(3, np.nan),) * 2, FilterOptions(**options))
    return parts.made(name, {})


def drawn(
    road: cases.Drive, count: int, begun: InitialSigma, start: Callable[..., NavState] = cases.start, **fixes: object
) -> list[Flight]:
    """Flights along one road."""
    out = []
    for k in range(count):
        rng = np.random.default_rng(k)
        imu = cases.corrupt(road.imu, cases.MODEL_15, rng)
        out.append((imu, cases.fixes(road, rng, **fixes), start(road, rng, begun)))
    return out


def unknown_heading(road: cases.Drive, rng: np.random.Generator, sigma: InitialSigma) -> NavState:
    """A start whose heading is anything."""
    near = cases.start(road, rng, sigma)
    return NavState(near.llh, near.vel_ned, near.rpy * [1.0, 1.0, 0.0] + [0.0, 0.0, rng.uniform(-np.pi, np.pi)])


def errors(
    name: str, road: cases.Drive, flights: Sequence[Flight], sigma: InitialSigma, at: Sequence[float]
) -> tuple[Array, Array]:
    """Errors (flights, times, 9) and NEES (flights, times) of a family; NaN where the filter gave up."""
    own = made(name, cases.MODEL_15, output_every=100, covariance_at=tuple(at))
    out, nees = np.full((len(flights), len(at), 9), np.nan), np.full((len(flights), len(at)), np.nan)
    rows = np.round(np.array(at) * cases.RATE).astype(int)
    for k, run in enumerate(own.run_many(*(list(part) for part in zip(*flights, strict=True)), sigma)):
        if isinstance(run, FilterResult):
            e = out[k] = strapdown.navigation_errors(run.nav[rows // 100], road.nav[rows])
            nees[k] = np.einsum("ki,ki->k", e, np.linalg.solve(run.covariance[:, :9, :9], e[:, :, None])[:, :, 0])
    return out, nees


def large(count: int) -> dict[str, dict[str, int]]:
    """Flights that converge, by case and family."""
    deg = np.deg2rad
    road, long = cases.later(cases.drive(100.0), 40.0), cases.later(cases.drive(290.0), 40.0)
    outage = ((60.0, 190.0),)
    kinds = {
        "heading unknown": (road, InitialSigma(1.0, 0.2, (deg(1), deg(1), np.pi / np.sqrt(3))), unknown_heading, {}),
        "tilt of 30 deg": (road, InitialSigma(1.0, 0.2, (deg(30), deg(30), deg(30))), cases.start, {}),
        "after 500 m": (long, cases.START_SIGMA, cases.start, {"outages": outage}),
    }
    found: dict[str, dict[str, int]] = {}
    for case, (way, sigma, start, fixes) in kinds.items():
        flights = drawn(way, count, sigma, start, sigma=SIGMA, **fixes)
        found[case] = {}
        for name in NAMES:
            e, _ = errors(name, way, flights, sigma, [190.0, 250.0] if fixes else [1.0, 60.0])
            before, last = e[:, 0], e[:, 1]
            if fixes and name == "ekf":
                print(
                    f"{case}: median error at the end of the outage {np.nanmedian(np.linalg.norm(before[:, :2], axis=1)):.0f} m"
                )
            good = np.abs(last[:, 6:8]).max(axis=1) < LIMITS[0]
            good &= (np.abs(last[:, 8]) < LIMITS[1]) & (np.linalg.norm(last[:, :2], axis=1) < LIMITS[2])
            found[case][name] = int(good.sum())
            low, high = share_interval(found[case][name], count)
            print(
                f"{case:16s}  {name:10s}  {100 * good.mean():5.1f} %  ({100 * low:.1f} to {100 * high:.1f})", flush=True
            )
    return found


def small(count: int) -> None:
    """Root mean square errors against those of the ekf, and NEES, where errors are small."""
    road, at = cases.drive(120.0), (30.0, 60.0, 90.0, 120.0)
    sigma = InitialSigma(0.5, 0.1, (0.003, 0.003, 0.01))
    flights = drawn(road, count, sigma, outages=((60.0, 90.0),))
    reference = None
    for name in NAMES:
        e, nees = errors(name, road, flights, sigma, at)
        size = np.sqrt(np.mean(e**2, axis=0))
        groups = np.stack([np.sqrt(np.mean(size[:, k : k + 3] ** 2, axis=1)) for k in (0, 3, 6)])
        reference = groups if reference is None else reference
        print(
            f"{name:10s}  largest change of an error {100 * np.abs(groups / reference - 1).max():6.2f} %",
            f" NEES/9 {np.round(nees.mean(axis=0) / 9, 3)}",
            flush=True,
        )


def speed() -> None:
    """Epochs in a CPU second, alone and in lanes."""
    road = cases.drive(60.0)
    flights = drawn(road, 8, cases.START_SIGMA)
    for name in NAMES:
        own = made(name, cases.MODEL_15, output_every=100)
        many = [list(part) for part in zip(*flights, strict=True)]
        works = [
            lambda own=own: own.run(*flights[0], cases.START_SIGMA),
            lambda own=own, many=many: own.run_many(*many, cases.START_SIGMA),
        ]
        best = []
        for work, epochs in zip(works, (6000, 48000), strict=True):
            work()
            times = []
            for _ in range(5):
                started = time.process_time()
                work()
                times.append(time.process_time() - started)
            best.append(epochs / min(times))
        print(f"{name:10s}  {best[0]:>10,.0f} epochs/s alone  {best[1]:>10,.0f} of eight", flush=True)


def draw(found: dict[str, dict[str, int]], count: int, path: Path) -> None:
    """The shares as a picture."""
    import matplotlib.pyplot as plt

    from insemu.report.style import COLOURS, style

    with style():
        figure, axes = plt.subplots(1, len(found), figsize=(9.0, 3.0), sharey=True)
        for k, (panel, (case, shares)) in enumerate(zip(axes, found.items(), strict=True)):
            for row, (_, good) in enumerate(shares.items()):
                low, high = share_interval(good, count)
                panel.plot([100 * low, 100 * high], [row, row], color=COLOURS[k], lw=2)
                panel.plot(100 * good / count, row, "o", color=COLOURS[k])
            panel.set(title=case, xlabel="converged (%)", xlim=(0, 101))
            panel.set_yticks(range(len(shares)), list(shares))
        axes[0].invert_yaxis()
        figure.savefig(path)
        plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=200)
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--only", choices=("speed", "small", "large"))
    asked = parser.parse_args()
    if asked.only in (None, "speed"):
        speed()
    if asked.only in (None, "small"):
        small(asked.flights)
    if asked.only in (None, "large"):
        found = large(asked.flights)
        if asked.picture is not None:
            draw(found, asked.flights, asked.picture)


if __name__ == "__main__":
    main()
