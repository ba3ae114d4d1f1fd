"""Balamuta et al. 2016: the NavChip model simulated again, and its times."""

from __future__ import annotations

import math
import time

import numpy as np

from benchmarks.papers.exhibit import Cell, Content, Statement, Task, exhibit
from insemu.fit import fit
from insemu.noise import GM
from insemu.variance import robust_wavelet_variance, wavelet_variance
from tests.fit_experiments import navchip, structure_of


@exhibit("platform2016", "Table I", "3 GM + WN + QN + RW of a NavChip gyroscope, plain and robust; Figures 1 to 3")
def table_1(task: Task) -> Content:
    model, rate, n = navchip()
    x = model.simulate(n if task.full else n // 2, 1.0 / rate, task.draws(1, 1)[0])
    cells = []
    ends = []
    for kind in ("plain", "robust"):
        result = fit(x, structure_of(model), rate_hz=rate, robust=kind == "robust")
        for i, p in model.indexed():
            for name, truth in p.parameters.items():
                e = result[f"{p.symbol}{i}.{name}"]
                cells.append(Cell(f"{kind} {e.label}", truth, e.value, e.low, e.high, e.unit, 0.05))
        ends.append(
            float(
                np.abs(np.log(result.fitted / model.wavelet_variance(result.curve.scale_samples, 1 / rate)))[:-4].max()
            )
        )
    y = x.copy()
    y[::200] += 9.0 * x.std() * np.random.default_rng(task.seed).standard_normal(y[::200].size)
    plain, robust = wavelet_variance(y, rate).value[:4], robust_wavelet_variance(y, rate).value[:4]
    true = model.wavelet_variance(2 ** np.arange(1, 5), 1 / rate)
    said = [
        Statement(
            "classical and robust estimates agree on a clean signal",
            f"curves within {100 * max(ends):.1f} % of the truth's",
            max(ends) < 0.1,
        ),
        Statement(
            "with outliers the robust curve stays, the plain one does not (Figure 2)",
            f"first octaves {(robust / true).max():.2f} against {(plain / true).max():.2f} times the truth",
            bool((robust / true).max() < 1.1 < (plain / true).max()),
        ),
    ]
    why = "six processes of one record are nearly exchangeable: single parameters miss their intervals where the curve does not"
    return Content(cells, said, why, "95 % interval of one fit, or 5 %")


@exhibit("platform2016", "Tables II and III", "Seconds for 3 GM by length of the record")
def table_2(task: Task) -> Content:
    model = GM(1.0, 0.01) + GM(0.5, 0.1) + GM(0.3, 1.0)
    cells = []
    table = task.printed["seconds_3GM_by_n"]
    for kind in ("standard", "robust"):
        for n, printed in table[kind]["guessed_20000"].items():
            x = model.simulate(int(n), 1.0, task.draws(1, 1)[0])
            spent = []
            for _ in range(3):
                began = time.process_time()
                fit(x, "3*GM()", rate_hz=1.0, robust=kind == "robust")
                spent.append(time.process_time() - began)
            cells.append(Cell(f"{kind}, {int(n):,} samples", printed, min(spent), 0.0, math.inf, "s"))
    faster = [c.printed / c.ours for c in cells if c.printed > 0.2]
    said = [
        Statement(
            "no slower than printed for records that take long",
            f"{min(faster):.1f} to {max(faster):.0f} times as fast",
            min(faster) > 1.0,
        )
    ]
    return Content(
        [],
        [
            *said,
            *(
                Statement(
                    c.what, f"{c.ours:.3f} s, printed {c.printed:g} s", c.ours < 1.5 * c.printed or c.printed < 0.2
                )
                for c in cells
            ),
        ],
        "another machine",
    )
