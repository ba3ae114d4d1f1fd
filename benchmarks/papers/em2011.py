"""Stebler et al. 2011: its simulations of 6000 samples, and the tactical IMU."""

from __future__ import annotations

import math

import numpy as np

from benchmarks.papers.exhibit import Cell, Content, Statement, Task, exhibit
from benchmarks.papers.runs import scenario_run
from insemu.fit import fit
from insemu.noise import DR, RW, WN
from tests.fit_experiments import em_runs

TRUTH = WN(0.2) + RW(0.02) + DR(0.003)


@exhibit("em2011", "Figure 2", "EM from good and bad starts beside slopes of Allan, Hadamard and total variance")
def figure_2(task: Task) -> Content:
    count = 200 if task.full else 40
    cells = []
    spread: dict[str, np.ndarray] = {}
    for method in ("slopes", "hadamard-slopes", "total-slopes"):
        rows = [
            [e.value for e in fit(TRUTH.simulate(6000, 1.0, rng), "WN() + RW() + DR()", method, rate_hz=1.0).parameters]
            for rng in task.draws(count, count)
        ]
        spread[method] = np.array(rows)
    good, bad = em_runs("Fig. 2, good start", count), em_runs("Fig. 2, bad start", count)
    for name, values in (("EM, good start", good["em"]), *spread.items()):
        if name == "slopes":
            continue
        for k, (label, truth) in enumerate((("sigma_WN", 0.2), ("sigma_RW", 0.02), ("ramp", 0.003))):
            column = np.asarray(values)[:, k]
            middle, error = float(np.median(column)), 3.0 * 1.2533 * float(column.std(ddof=1)) / math.sqrt(count)
            cells.append(Cell(f"{name}: median {label}", truth, middle, middle - error, middle + error, "", 0.05))
    walk = {name: values[:, 1].std() for name, values in spread.items()}
    lost = float(np.mean(spread["slopes"][:, 1] == 0))
    right, ratio = (float(np.median(r["em"][:, 1]) / 0.02) for r in (good, bad))
    said = [
        Statement(
            "from a good start EM finds the truth", f"random walk {right:.2f} times the truth", abs(right - 1) < 0.1
        ),
        Statement(
            "from a bad start it ends elsewhere",
            f"random walk {ratio:.2f} times the truth; {bad['converged']} of {count} said to have converged",
            abs(ratio - 1) > 0.1,
        ),
        Statement(
            "lines by eye on the Allan plot do not separate walk and ramp",
            f"walk not visible in {100 * lost:.0f} %",
            lost > 0.2,
        ),
        Statement(
            "Hadamard and total variance do; their scatter is alike",
            f"sd of the walk {walk['hadamard-slopes']:.2g}, {walk['total-slopes']:.2g}",
            bool(0.5 < walk["total-slopes"] / walk["hadamard-slopes"] < 2.0),
        ),
    ]
    why = "medians differ from the truth by more than their scatter"
    return Content(cells, said, why, "3 standard errors of the median, or 5 %")


@exhibit(
    "em2011",
    "Figures 3 to 6",
    "A Gauss-Markov noise by EM: the ramp taken off first or estimated inside; beside a random walk",
)
def figure_3(task: Task) -> Content:
    count = 200 if task.full else 16
    first, inside, both = (em_runs(name, count) for name in ("Fig. 3, ramp removed", "Fig. 3, ramp inside", "Fig. 5"))
    beta = [float(np.median(r["em"][:, list(r["labels"]).index("GM1.beta")]) / 0.008) for r in (first, inside, both)]
    at = next(i for i, label in enumerate(both["labels"]) if label.startswith("RW"))
    walk = float(np.median(both["em"][:, at]) / both["truth"][at])
    said = [
        Statement(
            "with the ramp taken off first beta is nearly right",
            f"median {beta[0]:.2f} times the truth",
            abs(beta[0] - 1) < 0.3,
        ),
        Statement("with the ramp inside it is not", f"{beta[1]:.2f} times", abs(beta[1] - 1) > 0.3),
        Statement(
            "beside a Gauss-Markov noise a weak random walk is seriously biased",
            f"{walk:.1f} times the truth",
            walk > 2.0,
        ),
    ]
    return Content(statements=said, because="EM behaves otherwise")


@exhibit(
    "em2011",
    "Figures 8 and 9",
    "Outages of 20 and 130 s with a tactical IMU: the manufacturer's model and the one by EM",
)
def figure_8(task: Task) -> Content:
    run = scenario_run("scenarios/outages_smoothed.yaml")
    out = task.printed["outages"][1]["max_error_m_manufacturer_vs_em"]
    names = list(run.end)
    cells = []
    for axis, k in (("north", 0), ("east", 1), ("down", 2)):
        for name, printed in zip(names[:2], out[axis], strict=True):
            e = np.abs(run.results.error[run.results.names.index(name)][:, run.results.end_index(1), k])
            low, high = np.percentile(e, [2.5, 97.5])
            cells.append(Cell(f"130 s, {axis}, {name}", abs(printed), float(e.mean()), float(low), float(high), "m"))
    means = [run.end[n].mean(axis=0) for n in names[:2]]
    said = [
        Statement("the errors are of metres in 130 s", f"{means[0][1]:.0f} m", 5 < means[0][1] < 100),
        Statement(
            "the model by EM halves them",
            f"{100 * (1 - means[1][1] / means[0][1]):.0f} % less",
            means[1][1] < 0.7 * means[0][1],
        ),
    ]
    why = "most of the error comes from the white noise of the gyroscopes, which both models know; the paper has one drive"
    return Content(cells, said, why, "2.5 to 97.5 % of our drives")
