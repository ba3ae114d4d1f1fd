"""What a paper's setting must have been, from its printed table: hidden quantities of Table III estimated from its nine cells, with rivals.

Nothing is drawn: the covariance of the true errors of every design gives the mean planimetric error at the end of every outage (means of
Gaussian errors), and a turn-on bias adds its square times what a bias of one does. What the nine printed means scatter by comes from draws of the
linear twin at the best setting, in which all designs fly the same errors. What is left beside that (another flight, another filter) is one more
standard deviation, of independent relative errors of the cells, estimated along.
"""

from __future__ import annotations

import copy
import json
import math
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.stats import t as student

from insemu.evaluate import Experiment, LinearTwin
from insemu.evaluate.covariance import analyse
from insemu.noise import RC
from insemu.scenario import load
from insemu.strapdown import NavState

Array = NDArray[np.float64]
Document = dict[str, Any]

SCENARIO = Path(__file__).parents[2] / "scenarios" / "table3_synthetic.yaml"
#: Rate of the search, Hz: means differ by less than 1 % from those at 100 Hz.
RATE = 10.0
#: Slowest process of a sensor in Table II: standard deviation under reading (a), and its unit.
SLOW = {"gyro": (8.64e-4, "deg/s"), "accel": (900.0, "ug")}
#: Turn-on biases that are tried, of the gyroscopes in deg/s and of the accelerometers in mg.
BIASES = {"gyro": np.geomspace(0.015, 0.1, 60), "accel": np.geomspace(1.0, 40.0, 60)}
#: Designs that the paper has, too.
MODELS = ("model 1", "model 2", "model 3")
UNIT = {"gyro": math.radians(1.0), "accel": 9.80665e-3}
#: Factors on the slow gyroscope process in the belief of model 3, and minutes after mission start at which filters begin.
FACTORS = tuple(float(x) for x in np.round(np.geomspace(0.75, 5.0, 15), 3))
BEGINS = (0.0, 2.0, 4.0, 5.0, 5.5, 6.0, 6.5)
#: Relative errors of single cells that are tried beside those of sampling.
BESIDE = np.geomspace(0.005, 1.5, 40)


@dataclass(frozen=True)
class Reading:
    """A setting that may have given the printed cells.

    Parameters
    ----------
    name : str
    change : callable
        Changes the scenario's document.
    factors, begins : tuple of float
        What is tried for the factor on the slow process, and for the begin of the filters (min); one value is not estimated.
    sensor : {"gyro", "accel", ""}
        Which has a turn-on bias; "" none.
    against : str
        What speaks against it beside the cells.
    """

    name: str
    change: Callable[[Document], None] = lambda document: None
    factors: tuple[float, ...] = FACTORS
    begins: tuple[float, ...] = (0.0,)
    sensor: str = "gyro"
    against: str = ""

    @property
    def quantities(self) -> int:
        """How many are estimated."""
        return bool(self.sensor) + (len(self.factors) > 1) + (len(self.begins) > 1)


@dataclass(frozen=True)
class Fitted:
    """A reading at its best.

    Parameters
    ----------
    reading : Reading
    bias, factor, begin : float
        Of the highest likelihood: deg/s or mg, a number, min.
    cells : (3, 3) array
        Mean planimetric errors of models by outages, m.
    rms : float
        Of the log ratios to the printed ones.
    deviance : float
        -2 ln likelihood.
    intervals : mapping
        Quantity to its 95 % interval by the profile of the likelihood.
    correlation : mapping
        Pair of quantities to their correlation under the likelihood.
    """

    reading: Reading
    bias: float
    factor: float
    begin: float
    cells: Array
    rms: float
    deviance: float
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    correlation: Mapping[tuple[str, str], float] = field(default_factory=dict)

    @property
    def values(self) -> dict[str, tuple[str, float, str]]:
        """Estimated quantities: what they are, value, unit."""
        kind = {
            "gyro": ("gyroscope turn-on bias", "deg/s"),
            "accel": ("accelerometer turn-on bias", "mg"),
            "": ("", ""),
        }
        what, unit = kind[self.reading.sensor]
        every = {
            "bias": (what, self.bias, unit),
            "factor": ("slowest process that model 3 believes, over that of Table II", self.factor, "times"),
            "begin": ("begin of the filters after mission start", self.begin, "min"),
        }
        return {name: every[name] for name in every if name in self.intervals}

    def estimates(self) -> list[list[str]]:
        """Rows of a table: quantity, estimate, interval, unit."""
        out = []
        for name, (what, value, unit) in self.values.items():
            low, high = self.intervals[name]
            ends = f"{low:.2g} to {high:.2g}" if math.isfinite(high - low) else "not bounded"
            if math.isinf(high - low) and math.isfinite(low):
                ends = f"above {low:.2g}"
            elif math.isinf(high - low) and math.isfinite(high):
                ends = f"below {high:.2g}"
            out.append([what, f"{value:.2g}", ends, unit])
        return out

    def row(self, least: float) -> list[str]:
        """A row of a table of rivals, with the fall of 2 ln likelihood from the best (``least`` is its deviance)."""
        found = ", ".join(f"{value:.2g} {unit}" for _, value, unit in self.values.values())
        cells = " / ".join(", ".join(f"{x:.0f}" for x in row) for row in self.cells)
        return [
            self.reading.name, found, f"{self.rms:.3f}", f"{self.deviance - least:.1f}", cells, self.reading.against
        ]  # fmt: skip


def base() -> Document:
    """The same with filters that begin with the mission and without the turn-on bias."""
    document: Document = json.loads(json.dumps(whole()))  # what has anchors becomes several
    document["trajectory"]["begin"] = "0 s"
    document["truth"]["gyro"] = [p for p in document["truth"]["gyro"] if p["process"] != "RC"]
    return document


def whole() -> Document:
    """The scenario as it stands, with the paper's designs, at the rate of the search, without variants."""
    document: Document = yaml.safe_load(SCENARIO.read_text(encoding="utf-8"))
    document.update(variants={}, published=None, smoother=False)
    document["trajectory"]["rate"] = f"{RATE} Hz"
    document["designs"] = {name: document["designs"][name] for name in MODELS}
    return document


def experiment(document: Document) -> Experiment:
    """Of a changed document."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scenario.yaml"
        path.write_text(yaml.safe_dump(document), encoding="utf-8")
        return Experiment(load(path), path)


def _slow(document: Document, factor: float, sensor: str = "gyro") -> None:
    """Let model 3 believe in a slowest process of a sensor so many times as strong as in Table II."""
    sigma, unit = SLOW[sensor]
    slowest = min(
        (p for p in document["designs"]["model 3"][sensor] if "beta" in p), key=lambda p: float(p["beta"].split()[0])
    )
    slowest["sigma"] = f"{factor * sigma} {unit}"


def _horizontal(e: Experiment, design: str, sensor: str) -> tuple[Array, Array]:
    """Covariances (outages, 2, 2) of the horizontal error at outage ends: without a turn-on bias, and what one of a unit adds; m^2."""
    s, world = e.scenario, e.world
    ideal = world.recording(0, ideal=True).gnss
    assert ideal is not None and s.truth is not None
    fixes = type(ideal)(ideal.t, ideal.llh, ideal.vel_ned)
    ends = tuple(start + duration for start, duration in world.outage_windows)
    sigma = (s.gnss.position_sigma, s.gnss.velocity_sigma or (0.0, 0.0, 0.0))
    models = s.truth.models()

    def actual(bias: float) -> Array:
        truth = {a: m + RC(bias) if bias and a.startswith(sensor) else m for a, m in models.items()}
        found = analyse(
            e.ekf(design), truth, world.imu, fixes, NavState.of(world.reference), s.initial.sigma,
            true_gnss_sigma=sigma, at=ends,
        )  # fmt: skip
        return found.actual[:, :2, :2]

    rest = actual(0.0)
    return rest, actual(UNIT[sensor]) - rest if sensor else np.zeros_like(rest)


def mean_length(covariance: Array) -> Array:
    """Mean length of Gaussian vectors of two components, (..., 2, 2) to (...)."""
    values = np.clip(np.linalg.eigvalsh(covariance), 0.0, None)
    angle = (np.arange(180) + 0.5) * np.pi / 180
    return np.sqrt(np.pi / 2) * np.sqrt(values @ np.stack([np.cos(angle) ** 2, np.sin(angle) ** 2])).mean(axis=-1)


def tabulated(reading: Reading) -> Array:
    """Cells of every setting that is tried, (begins, factors, biases, 3, 3)."""
    biases = BIASES[reading.sensor] if reading.sensor else np.zeros(1)
    out = np.empty((len(reading.begins), len(reading.factors), biases.size, 3, 3))
    for i, begin in enumerate(reading.begins):
        document = base()
        reading.change(document)
        document["trajectory"]["begin"] = f"{begin} min"
        e = experiment(document)
        for d, name in enumerate(e.scenario.designs):
            for j, factor in enumerate(reading.factors):
                if name == "model 3":
                    _slow(changed := copy.deepcopy(document), factor, reading.sensor or "gyro")
                    rest, unit = _horizontal(experiment(changed), name, reading.sensor)
                elif j == 0:
                    rest, unit = _horizontal(e, name, reading.sensor)
                out[i, j, :, d] = mean_length(rest + biases[:, None, None, None] ** 2 * unit)
    return out


def sampling(document: Document, realizations: int = 24, draws: int = 2000) -> Array:
    """Covariance (9, 9) of the logs of printed means over so many realizations, from draws in which all designs fly the same errors.

    Parameters
    ----------
    document : dict
        A whole setting.
    realizations, draws : int
    """
    ends = LinearTwin(experiment(document)).draw(draws, np.random.default_rng(1))
    sizes = np.stack([np.linalg.norm(z[:, :, :2], axis=2) for z in ends.values()], axis=1).reshape(draws, 9)
    return np.cov(sizes.T / sizes.mean(axis=0)[:, None]) / realizations


def deviance(cells: Array, printed: Array, covariance: Array) -> Array:
    """-2 ln likelihood of printed cells given cells (..., 3, 3), at the best of the relative errors beside those of sampling."""
    values, vectors = np.linalg.eigh(covariance)
    off = (np.log(printed / cells)).reshape(*cells.shape[:-2], 9) @ vectors
    spread = np.clip(values, 0.0, None) + BESIDE[:, None] ** 2
    return np.min([(np.log(s) + off**2 / s).sum(axis=-1) for s in spread], axis=0)


def fitted(reading: Reading, printed: Array, covariance: Array, cells: Array | None = None) -> Fitted:
    """A reading at its best, with intervals.

    Parameters
    ----------
    reading : Reading
    printed : (3, 3) array
        Models by outages, m.
    covariance : (9, 9) array
        Of :func:`sampling`.
    cells : array, optional
        Of :func:`tabulated`.
    """
    cells = tabulated(reading) if cells is None else cells
    table = deviance(cells, printed, covariance)
    best = np.unravel_index(int(table.argmin()), table.shape)
    biases = BIASES[reading.sensor] if reading.sensor else np.zeros(1)
    axes = {"begin": np.array(reading.begins), "factor": np.array(reading.factors), "bias": biases}
    # of a variance that is estimated along with p of 9 means: Student's quantile turned into a fall of the likelihood
    rise = 9.0 * math.log1p(student.ppf(0.975, 9 - reading.quantities) ** 2 / (9 - reading.quantities))
    intervals, correlation = {}, {}
    weight = np.exp(-0.5 * (table - table.min()))
    weight /= weight.sum()
    grids = np.meshgrid(*axes.values(), indexing="ij")
    estimated = [k for k, values in enumerate(axes.values()) if values.size > 1]
    for k in estimated:
        profile = table.min(axis=tuple(a for a in range(3) if a != k)) - table.min()
        intervals[list(axes)[k]] = _inside(list(axes.values())[k], profile, rise)
        for other in estimated[: estimated.index(k)]:
            a, b = (np.log(grids[i]) if i else grids[i] for i in (other, k))
            a, b = (x - (weight * x).sum() for x in (a, b))
            correlation[list(axes)[other], list(axes)[k]] = float(
                (weight * a * b).sum() / math.sqrt((weight * a * a).sum() * (weight * b * b).sum())
            )
    found = cells[best]
    rms = float(np.sqrt(np.mean(np.log(printed / found) ** 2)))
    begin, factor, bias = (float(values[i]) for values, i in zip(axes.values(), best, strict=True))
    return Fitted(reading, bias, factor, begin, found, rms, float(table.min()), intervals, correlation)


def _inside(values: Array, profile: Array, rise: float) -> tuple[float, float]:
    """Ends of the region under a threshold, between the values that were tried by straight lines; infinite where it is open."""
    inside = np.flatnonzero(profile <= rise)

    def end(last: int, beyond: int) -> float:
        if not 0 <= beyond < values.size:
            return math.copysign(math.inf, beyond - last)
        share = (rise - profile[last]) / (profile[beyond] - profile[last])
        return float(values[last] + share * (values[beyond] - values[last]))

    return end(inside[0], inside[0] - 1), end(inside[-1], inside[-1] + 1)


def _stationary(document: Document) -> None:
    for name in ("model 2", "model 3"):
        document["designs"][name]["options"]["states"]["stationary_start"] = 1


def _cycles(document: Document) -> None:
    for process in (
        p
        for d in document["designs"].values()
        for sensor in ("gyro", "accel")
        for p in d[sensor]
        if isinstance(p, dict)
    ):
        if "beta" in process:
            process["beta"] = f"{2 * math.pi * float(str(process['beta']).split()[0])} Hz"


def _gnss(position: str, velocity: str | None) -> Callable[[Document], None]:
    return lambda document: document["gnss"].update(position_sigma=position, velocity_sigma=velocity)


def _in_turns(document: Document) -> None:
    document["gnss"]["outages"] = [{"start": f"{m} min", "duration": "60 s"} for m in (8, 12, 16)]


def _aligned(document: Document) -> None:
    document["initial"].update(tilt_sigma="5 deg", heading_sigma="10 deg")


ONE = (1.0,)
HEIGHT = "outages would have to lie in turns; models 1 and 2 would err by hundreds of metres in height"
STRAIGHT = "outages would have to lie in turns, of which the text says nothing"
#: The best supported reading, and its rivals.
BEST = Reading("turn-on bias, slow process stronger than printed and begun at zero, filters begin later", begins=BEGINS)
RIVALS = (
    Reading("Table II alone, reading (a)", _stationary, ONE, sensor=""),
    Reading("turn-on bias, stationary start", _stationary, ONE),
    Reading("turn-on bias, begun at zero", factors=ONE),
    Reading("turn-on bias, begun at zero, filters begin later", factors=ONE, begins=BEGINS),
    Reading("turn-on bias, slow process stronger, stationary start", _stationary),
    Reading("turn-on bias, slow process stronger, begun at zero"),
    Reading(
        "turn-on bias, beta in cycles per second, filters begin later", _cycles, ONE, BEGINS,
        against="the text's correlation times are 1 / beta",
    ),
    Reading("turn-on bias, slow process stronger, GNSS of 1 m and 0.1 m/s", _gnss("1 m", "0.1 m/s")),
    Reading("turn-on bias, slow process stronger, positions alone", _gnss("2 cm", None), against="the text speaks of position/velocity"),
    Reading("turn-on bias, slow process stronger, alignment to 5 and 10 deg", _aligned),
    Reading("turn-on bias, slow process stronger, outages in turns", _in_turns, against=STRAIGHT),
    Reading("accelerometer turn-on bias, slow process stronger", sensor="accel"),
    Reading("accelerometer turn-on bias, slow process stronger, outages in turns", _in_turns, sensor="accel", against=HEIGHT),
    Reading(
        "accelerometer turn-on bias, slow process stronger, outages in turns, filters begin later",
        _in_turns, (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0), BEGINS, "accel", against=HEIGHT,
    ),
)  # fmt: skip
