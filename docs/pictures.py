"""Pictures of the documentation that are drawn from the code when the site is built."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

import insemu as ins
from insemu.noise import NoiseModel
from insemu.report.style import COLOURS, style

DEG_H = np.deg2rad(1.0) / 3600.0
SHOWN = {
    "WN": ins.WN(N="0.3 deg/sqrt(h)"),
    "RW": ins.RW(K="20 deg/h/sqrt(h)"),
    "GM": ins.GM(sigma="20 deg/h", Tc="30 s"),
    "BI": ins.BI(B="8 deg/h"),
    "QN": ins.QN(Q="2 arcsec"),
    "DR": ins.DR(R=2e-9),
}


def _process(name: str, folder: Path) -> None:
    process, dt, n = SHOWN[name], 0.1, 6000
    rng = np.random.default_rng(1)
    with style():
        figure, (left, right) = plt.subplots(1, 2, figsize=(8.0, 2.6))
        for k, one in enumerate(rng.spawn(5)):
            left.plot(np.arange(n) * dt, process.simulate(n, dt, one) / DEG_H, color=COLOURS[k], lw=0.8)
        left.set(xlabel="time (s)", ylabel="deg/h", title="Five records")
        _allan(right, NoiseModel((process,)), dt, COLOURS[0], name)
        figure.savefig(folder / f"{name}.svg")
        plt.close(figure)


def _allan(axes: Axes, model: NoiseModel, dt: float, colour: str, label: str, dashed: bool = False) -> None:
    m = 2 ** np.arange(0, 15)
    value = np.sqrt(model.allan_variance(m, dt)) / DEG_H
    axes.loglog(m * dt, value, color=colour, label=label, ls="--" if dashed else "-")
    axes.set(xlabel="averaging time (s)", ylabel="Allan deviation (deg/h)", title="Allan deviation")


def _sum(folder: Path) -> None:
    parts = [SHOWN["QN"], SHOWN["WN"], SHOWN["BI"], SHOWN["RW"]]
    with style():
        figure, axes = plt.subplots(figsize=(7.0, 3.4))
        _allan(axes, NoiseModel(tuple(parts)), 0.1, "black", "sum")
        for k, p in enumerate(parts):
            _allan(axes, NoiseModel((p,)), 0.1, COLOURS[k], p.symbol, dashed=True)
        axes.legend(ncols=5)
        figure.savefig(folder / "sum.svg")
        plt.close(figure)


def _arrow(axes: Axes, at: tuple[float, float], to: tuple[float, float], text: str, colour: str) -> None:
    axes.annotate("", xy=to, xytext=at, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 2})
    axes.annotate(text, to, xytext=(4, 4), textcoords="offset points", color=colour, fontsize=10)


def _drawings(folder: Path) -> None:
    with style():
        figure, axes = plt.subplots(figsize=(6.0, 4.0))
        _arrow(axes, (0, 0), (0, 3), "north", COLOURS[6])
        _arrow(axes, (0, 0), (3, 0), "east", COLOURS[6])
        c, s = np.cos(np.deg2rad(35)), np.sin(np.deg2rad(35))
        _arrow(axes, (0, 0), (2.5 * s, 2.5 * c), "x: forward", COLOURS[0])
        _arrow(axes, (0, 0), (2.5 * c, -2.5 * s), "y: right", COLOURS[1])
        axes.plot(0, 0, "o", ms=12, color=COLOURS[2])
        axes.annotate("z: down, into the page", (-1.9, -0.5), color=COLOURS[2])
        arc = np.deg2rad(np.linspace(0, 35, 40))
        axes.plot(1.2 * np.sin(arc), 1.2 * np.cos(arc), color="black", lw=1)
        axes.annotate("heading", (0.15, 1.3))
        _bare(axes, (-2, 3.8), (-2, 3.5), figure, folder / "axes.svg")
        figure, axes = plt.subplots(figsize=(6.5, 3.2))
        axes.add_patch(plt.Rectangle((0, 0), 6, 1.2, fill=False, lw=1.5))
        axes.plot(2, 0.5, "s", ms=10, color=COLOURS[0])
        axes.annotate("IMU", (1.3, 0.35), color=COLOURS[0])
        axes.plot(3.5, 1.9, "^", ms=10, color=COLOURS[1])
        axes.annotate("antenna", (3.7, 1.95), color=COLOURS[1])
        _arrow(axes, (2, 0.5), (3.5, 1.9), "", "black")
        axes.annotate("lever arm = [1.5 m, 0, −1.4 m]", (0.2, 1.5))
        _arrow(axes, (4.5, 0.6), (5.7, 0.6), "x forward", COLOURS[6])
        _arrow(axes, (4.5, 0.6), (4.5, -0.5), "z down", COLOURS[6])
        _bare(axes, (-0.3, 7.2), (-0.8, 2.5), figure, folder / "lever_arm.svg")


def _bare(axes: Axes, x: tuple[float, float], y: tuple[float, float], figure: plt.Figure, path: Path) -> None:
    axes.set(xlim=x, ylim=y, aspect="equal")
    axes.axis("off")
    figure.savefig(path)
    plt.close(figure)


def write_pictures(folder: Path) -> None:
    """Draw every picture into a folder; those that are there already are left alone."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in SHOWN:
        if not (folder / f"{name}.svg").exists():
            _process(name, folder)
    if not (folder / "sum.svg").exists():
        _sum(folder)
        _drawings(folder)
