"""Tables of emulated experiments held against the exact covariance of the linear error equations, in which nothing is drawn.

``python -m tests.analytic SCENARIO...`` takes the tables of ``docs/experiments*.md`` that ``insemu run`` printed (means over N realizations:
horizontal error at the end of an outage or during it, largest error, what the filter states, share inside 3 sigma, NEES) and the same figures from
``insemu.evaluate.analyse_designs``: means of Gaussian errors of that covariance, by quadrature. A cell agrees within 4 standard deviations of a mean
over N, taken as if one realization had one independent value, plus 5 % for what is not linear and for the mean that the emulator removes from a
record. The largest error of an outage is held against that at its end, which it exceeds by 20 % at most. Effects of the truth are left out
(vibration that averages away). Exit code 1 where a cell does not agree.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from insemu.evaluate import Experiment, analysable, analyse_designs
from insemu.evaluate.covariance import CovarianceAnalysis
from insemu.scenario import load
from tests.claims import ROOT

#: Standard deviations of a mean over the realizations, and what is allowed relative to the value besides.
BOUND, LINEAR = 4.0, 0.05
#: How much larger than at its end an error may have been during an outage.
LARGEST = 0.20
#: Cells of which the linear theory gives a fifth, why is open: with a turn-on bias that nobody carries; half, where errors of 300 m turn into
#: height or a filter is far too sure of itself. They count as our own draws.
APART = {
    ("turn_on_bias", "18AV", "NEES"),
    ("turn_on_bias", "GMWM", "NEES"),
    ("", "model 3", "altitude"),
    ("reading_b", "model 3 + bias", "NEES"),
}
HEADS = {
    "table3_synthetic": "Table III of Stebler et al. (2014), on simulated signals",
    "table3_reading_b": "Table III under reading (b): manoeuvres, fits, alignment, GNSS",
    "outages_smoothed": "The outages of Stebler et al. (2011), filtered and smoothed",
    "tables_9_10": "Tables 9 and 10 of Quinchia et al. (2013)",
}
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Expected:
    """Mean of a figure and the standard deviation that one realization has around it."""

    mean: float
    deviation: float
    above: float = 0.0

    def holds(self, printed: str, realizations: int) -> bool:
        value = float(printed.rstrip("%")) / (100.0 if printed.endswith("%") else 1.0)
        digits = printed.rstrip("%").partition("e")
        step = 10.0 ** (float(digits[2] or 0) - len(digits[0].partition(".")[2])) / (100.0 if "%" in printed else 1.0)
        most = BOUND * self.deviation / np.sqrt(realizations) + LINEAR * abs(self.mean) + 0.5 * step
        return bool(-most <= value - self.mean <= most + self.above * self.mean)


def _length(C: Array) -> tuple[float, float]:
    """Mean and deviation of the length of a Gaussian vector of two components with covariance C."""
    a, b = np.clip(np.linalg.eigvalsh(C), 0.0, None)
    angle = (np.arange(720) + 0.5) * np.pi / 720
    mean = float(np.sqrt(np.pi / 2) * np.mean(np.sqrt(a * np.cos(angle) ** 2 + b * np.sin(angle) ** 2)))
    return mean, float(np.sqrt(max(a + b - mean**2, 0.0)))


def expected(a: CovarianceAnalysis, start: float, duration: float) -> dict[str, Expected]:
    """The figures of one design and outage."""
    inside = (a.t > start + 1e-9) & (a.t <= start + duration + 1e-9)
    end = int(np.flatnonzero(inside)[-1])
    lengths = np.array([_length(C[:2, :2]) for C in a.actual[inside]])
    M = np.linalg.solve(a.believed[inside], a.actual[inside])
    spread = np.sqrt(2.0 * np.einsum("tij,tji->t", M, M)).mean() / 9.0
    covered = 2.0 * ndtr(3.0 * a.sigma[inside][:, :3] / a.rms[inside][:, :3]).mean() - 1.0
    down = float(a.rms[end, 2])
    return {
        "end": Expected(*_length(a.actual[end, :2, :2])),
        "largest": Expected(*_length(a.actual[end, :2, :2]), LARGEST),
        "altitude": Expected(down * np.sqrt(2 / np.pi), down * np.sqrt(1 - 2 / np.pi), LARGEST),
        "mean": Expected(float(lengths[:, 0].mean()), float(lengths[:, 1].mean())),
        "stated": Expected(float(np.hypot(*a.sigma[end, :2])), 0.0),
        "in 3 s": Expected(float(covered), float(np.sqrt(covered * (1.0 - covered)))),
        "NEES": Expected(float(np.einsum("tii->t", M).mean() / 9.0), float(spread)),
    }


def blocks(head: str) -> Iterator[list[str]]:
    """The printed tables of a section, each as its lines."""
    text = "\n".join(p.read_text(encoding="utf-8") for p in (ROOT / "docs").glob("experiments*.md"))
    section = text.split(f"## {head}\n", 1)[1].split("\n## ")[0]
    for block in re.findall(r"^```\n(.*?)^```", section, re.M | re.S):
        yield [line for line in block.splitlines() if line.strip()]


def cells(head: str, outages: dict[str, int], figure: str) -> Iterator[tuple[str, str, int, str, str]]:
    """Variant, design, number of the outage (-1: the mean of all), name of the figure and what is printed, of every cell that can be checked."""
    for block in blocks(head):
        variant = design = kind = ""
        for line in block:
            parts = re.split(r"\s{2,}", line.strip())
            if header := re.match(r"(design +(outage|no\. +filter|largest)|variant)|(default|drive_2): mean", line):
                kind = header[2] or header[1] or kind
                variant = {None: variant, "default": "", "drive_2": "drive_2"}[header[3]]
            elif kind == "outage":
                if not re.match(r"[\d.]+ min", parts[0]):
                    design, number = re.sub(r" \(\d+\)$", "", parts.pop(0)), -1
                number += 1
                names = ("end", "altitude", "stated", "in 3 s", "NEES")
                for name, value in zip(names, (parts[1], *parts[-4:]), strict=True):
                    yield "", design, number, name, value
            elif kind == "variant":
                first = not line.startswith(" ")
                if first:
                    variant = parts.pop(0).replace("default", "")
                if variant != "published":
                    k = outages[variant]
                    for number, value in enumerate(parts[1 : 1 + k]):
                        yield variant, parts[0], number, figure, value
                    rest = parts[1 + k + (not first) :]  # the first design has no ratio
                    yield variant, parts[0], -1, "altitude", rest[0]
                    yield variant, parts[0], -1, "NEES", rest[1]
            elif not kind and parts[1:2] == ["ours"] and figure == "mean":
                k = outages[variant]
                for number in range(k):
                    yield variant, parts[0], number, "mean", parts[2 + number]
                    yield variant, parts[0], number, "largest", parts[4 + k + number]


def check(stem: str) -> tuple[int, int]:
    """Print every cell that does not agree; how many agree, and how many there are."""
    file = ROOT / "scenarios" / f"{stem}.yaml"
    base = load(file)
    experiments = {v: load(file, variant=v or None) for v in ("", *base.variants)}
    outages = {v: len(s.gnss.outages) for v, s in experiments.items() if s.gnss is not None}
    figure = "mean" if base.published and "planimetric_mean_m" in base.published.figures else "end"
    wanted: dict[str, list[tuple[str, int, str, str]]] = {}
    for variant, *cell in cells(HEADS[stem], outages, figure):
        wanted.setdefault(variant, []).append(tuple(cell))  # type: ignore[arg-type]
    good = of = 0
    for variant, found in wanted.items():
        scenario = experiments[variant]
        assert scenario.truth is not None
        if variant == "strong_vibration":  # there the effects matter
            continue
        scenario = scenario.model_copy(update={"truth": scenario.truth.model_copy(update={"effects": ()})})
        experiment = Experiment(scenario, file)
        able = analysable(experiment)[0]
        analyses = analyse_designs(experiment)
        table = {
            (name, k): expected(analyses[name], *window)
            for name in able
            for k, window in enumerate(experiment.world.outage_windows)
        }
        count = len(experiment.world.outage_windows)
        for name in able:
            for which in ("altitude", "NEES"):
                all_of = [table[name, k][which] for k in range(count)]
                mean, deviation = np.mean([(e.mean, e.deviation) for e in all_of], axis=0)
                table.setdefault((name, -1), {})[which] = Expected(float(mean), float(deviation), all_of[0].above)
        for design, number, name, value in found:
            if design not in able or (variant, design, name) in APART:
                continue
            one = table[design, number][name]
            agrees = one.holds(value, scenario.realizations)
            good, of = good + agrees, of + 1
            if not agrees:
                print(
                    f"{variant or 'default'}, {design}, outage {number + 1}, {name}: {value} printed, {one.mean:.4g} expected "
                    f"(one realization +- {one.deviation:.3g})"
                )
        print(f"{stem} {variant or 'default'}: {good} of {of} cells agree so far", flush=True)
    return good, of


def main() -> int:
    """Run from the command line."""
    totals = [check(stem) for stem in sys.argv[1:] or HEADS]
    return int(any(good < of for good, of in totals))


if __name__ == "__main__":
    sys.exit(main())
