"""Nikolic et al. 2016: integrated maximum likelihood on simulations from its tables (10 Hz; the paper sampled at 400 Hz)."""

from __future__ import annotations

import math

import numpy as np

from benchmarks.papers.exhibit import Cell, Content, Statement, Task, exhibit
from insemu.fit import fit
from insemu.noise import GM, WN, NoiseModel
from tests.fit_experiments import SIGMA_B, SIGMA_W, TAU_B, integrated

RATE = 10.0


def standard(sigma_w: float, sigma_b: float, tau: float) -> NoiseModel:
    """Equation (22)."""
    return WN(sigma_w) + GM.of_driving_density(sigma_b, 1.0 / tau)


@exhibit("ml2016", "Table II, remark", "Power of broadband noise and bias of the BMX055 z gyroscope")
def table_2(task: Task) -> Content:
    g = task.printed["bmx055_z_gyro"]
    sigma_w = math.radians(g["sigma_w_deg_per_h_sqrtHz"] / 3600.0)
    bias = standard(sigma_w, g["sigma_b_rad_per_s2_sqrtHz"], g["tau_b_s"]).processes[1].parameters["sigma"]
    white = 2.0 * 47.0 * sigma_w**2
    pairs = [
        ("broadband noise, 47 Hz", 9.35e-7, white, "rad^2/s^2"),
        ("the same, rms", 0.0554, math.degrees(math.sqrt(white)), "deg/s"),
        ("bias", 4.76e-10, bias**2, "rad^2/s^2"),
        ("the same, rms", 0.0012, math.degrees(bias), "deg/s"),
        ("ratio", 33.0, 10.0 * math.log10(white / bias**2), "dB"),
    ]
    return Content([Cell(what, p, o, o * 0.99, o * 1.01, u, 0.05) for what, p, o, u in pairs], interval="rounding, 5 %")


@exhibit("ml2016", "Table III and Figure 11", "Repeatability over ten records of 12 h, beside GMWM")
def table_3(task: Task) -> Content:
    count = 100 if task.full else 10
    likelihood, moments = integrated(count, RATE, task.seed)
    mean, sd = task.printed["repeatability_10x12h"], {}
    cells = []
    for k, (name, one) in enumerate(
        (("sigma_w", math.degrees(SIGMA_W) * 3600.0), ("sigma_b", SIGMA_B), ("tau_b", TAU_B))
    ):
        values = likelihood[:, k] * one
        error = 3.0 * values.std(ddof=1) / math.sqrt(count)
        cells.append(
            Cell(
                f"{name}, mean",
                mean[name][0],
                float(values.mean()),
                float(values.mean() - error),
                float(values.mean() + error),
                "",
                0.05,
            )
        )
        sd[name] = (float(values.std(ddof=1)), mean[name][1])
        if name != "sigma_w":
            s = sd[name][0]
            # chi-square interval of a standard deviation from ten records
            cells.append(Cell(f"{name}, standard deviation", mean[name][1], s, 0.55 * s, 1.83 * s))
    tau = np.abs(likelihood[:, 2] - 1.0) * TAU_B
    said = [
        Statement(
            "sigma_w is accurate by both methods",
            f"within {100 * np.abs(likelihood[:, 0] - 1).max():.1f} and {100 * np.abs(moments[:, 0] - 1).max():.1f} %",
            bool(np.abs(np.r_[likelihood[:, 0], moments[:, 0]] - 1).max() < 0.02),
        ),
        Statement(
            "tau_b within about 120 s of 530 s",
            f"{np.quantile(tau, 0.68):.0f} s (68 %)",
            bool(np.quantile(tau, 0.68) < 180.0),
        ),
        Statement(
            "the device itself repeats sigma_w worse than the estimator does",
            f"printed {sd['sigma_w'][1]:g}, ours {sd['sigma_w'][0]:.2g} deg/h/sqrt(Hz)",
            sd["sigma_w"][0] < sd["sigma_w"][1],
        ),
    ]
    why = "ten records of a device scatter by more, or less, than ten of its model"
    return Content(cells, said, why, "3 standard errors of a mean, 95 % of a standard deviation from ten")


@exhibit("ml2016", "Table IV", "Sixteen gyroscopes: simulated for 12 h and identified again")
def table_4(task: Task) -> Content:
    cells = []
    for device, axes in task.printed["table_4"].items():
        for axis, row in axes.items():
            w, b, tau = map(float, row)  # YAML takes 4.85e3 for text
            x = standard(w, b, tau).simulate(int(12 * 3600 * RATE), 1.0 / RATE, task.draws(1, 1)[0])
            result = fit(x, "WN() + GM()", "mli", rate_hz=RATE)
            q = result["GM1.sigma"].value * math.sqrt(2.0 * result["GM1.beta"].value)
            # the driving density is known better than its two factors; the record shows it over a correlation time or a quarter of itself
            share = 1.96 * math.sqrt(max(tau, 300.0) / 43_200.0)
            e, t = result["WN1.N"], result["GM1.beta"]
            cells.append(Cell(f"{device} {axis} sigma_w", w, e.value, e.low, e.high, "rad/s/sqrt(Hz)", 0.01))
            cells.append(
                Cell(f"{device} {axis} sigma_b", b, q, q * math.exp(-share), q * math.exp(share), "rad/s^2/sqrt(Hz)")
            )
            cells.append(
                Cell(
                    f"{device} {axis} tau_b",
                    tau,
                    1.0 / t.value,
                    1.0 / t.high if t.high > 0 else math.nan,
                    1.0 / t.low if t.low > 0 else math.inf,
                    "s",
                )
            )
    said = [
        Statement(
            "the method gives back what it printed",
            f"{sum(c.agrees for c in cells)} of {len(cells)} cells",
            sum(c.agrees for c in cells) >= 0.9 * len(cells),
        )
    ]
    why = "12 h are less than ten correlation times of some devices, and an interval of 95 % misses one in twenty"
    return Content(cells, said, why, "95 % intervals of one 12-h record")


@exhibit(
    "ml2016", "Figure 10", "Integrated against direct likelihood, uniform and logarithmic pattern, by bias diffusion"
)
def figure_10(task: Task) -> Content:
    count = 20 if task.full else 3
    errors: dict[str, list[float]] = {"ML_i uniform": [], "ML_i log": [], "ML uniform": []}
    options = {"ML_i uniform": {}, "ML_i log": {"pattern": "log"}, "ML uniform": {"integrated": False}}
    for factor in (1.0, 10.0):
        model = standard(SIGMA_W, SIGMA_B * factor, TAU_B)
        for rng in task.draws(count, count):
            x = model.simulate(int(12 * 3600 * RATE), 1.0 / RATE, rng)
            for name, given in options.items():
                result = fit(x, "WN() + GM()", "mli", rate_hz=RATE, **given)
                q = result["GM1.sigma"].value * math.sqrt(2.0 * result["GM1.beta"].value)
                errors[name].append(abs(math.log(q / SIGMA_B / factor)))
    half = {name: (np.mean(v[:count]), np.mean(v[count:])) for name, v in errors.items()}
    said = [
        Statement(
            "with strong bias diffusion all do well",
            ", ".join(f"{k} {100 * v[1]:.0f} %" for k, v in half.items()),
            all(v[1] < 0.15 for v in half.values()),
        ),
        Statement(
            "near the real one integrated likelihood is no worse than direct",
            ", ".join(f"{k} {100 * v[0]:.0f} %" for k, v in half.items()),
            bool(half["ML_i uniform"][0] < 1.5 * half["ML uniform"][0]),
        ),
    ]
    return Content(statements=said, because="the order of the methods is another")
