"""Posterior predictive check: recordings emulated from a model along the motion of a real one, held against that one statistic by statistic.

A model that is right makes recordings in which the measured one is nothing special. The motion is the measured one (:func:`motion_of`); noise and
effects are the model's; the fixes come at the recorded times with the recorded standard deviations. The filter knows the model. The gap is also
said in the quantity that is asked for: metres at the end of outages, emulated against measured, outage by outage.

References
----------
.. [1] Gelman, Meng and Stern (1996), Posterior predictive assessment of model fitness via realized discrepancies, Statistica Sinica 6.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu import earth, rotation
from insemu.blas import on_one_thread
from insemu.effects import compensated
from insemu.emulate import corrupt, fixes_at
from insemu.errors import InputError
from insemu.filters import FilterOptions, FilterResult, InitialSigma, run_filter
from insemu.gap.beliefs.nominal import Nominal
from insemu.gap.data import louder
from insemu.gap.drive import FIRST, by_filter, for_filter, known_outliers, outlying, starting_state, with_sigma, without
from insemu.gap.problems import drive_without
from insemu.lost import Lost, as_noise, restored
from insemu.records import AXES, GnssRecord, ImuRecord, Recording, Trajectory
from insemu.scenario import code_version
from insemu.strapdown import NavState, mechanize_array, trajectory_of
from insemu.work import Lines, Store, processes, run_items

Array = NDArray[np.float64]
#: Statistics of the innovations and errors at the end of outages, m, of an emulated recording.
Made = tuple[Array, Array]

#: Time in which the twin's motion comes back to the estimated one, s: short next to what a bias needs to carry it away, long next to a fix.
FOLLOW_S = 5.0
#: Length of an outage, from the start of one to that of the next, and how late a fix may be at its end, s.
OUTAGE_S, APART_S, LATE_S = 60.0, 30.0, 2.0
#: Fewest fixes that a statistic of the measured recording is of.
FEWEST = 30
COMPONENTS = ("north", "east", "down", "velocity north", "velocity east", "velocity down")


@dataclass(frozen=True)
class Statistic:
    """A statistic of the measured recording among those of the emulated ones.

    Parameters
    ----------
    name, where : str
    measured : float
    low, middle, high : float
        Quantiles 2.5, 50 and 97.5 % of the emulated.
    percentile : float
        Share of the emulated ones below the measured, 0 to 1.
    """

    name: str
    where: str
    measured: float
    low: float
    middle: float
    high: float
    percentile: float

    @property
    def outside(self) -> bool:
        """Whether the measured one is outside the 95 % band of the emulated ones."""
        return not self.low <= self.measured <= self.high


@dataclass(frozen=True)
class OutageErrors:
    """Horizontal errors at the end of outages, m, measured and emulated.

    Parameters
    ----------
    starts : (k,) array
        s.
    measured : (k,) array
        Distance from the fix at the end.
    low, middle, high : (k,) arrays
        Quantiles 5, 50 and 95 % of the emulated.
    """

    starts: Array
    measured: Array
    low: Array
    middle: Array
    high: Array

    @property
    def inside(self) -> int:
        """Outages whose measured error lies in the 90 % band."""
        return int(np.sum((self.low <= self.measured) & (self.measured <= self.high)))


@dataclass(frozen=True)
class Check:
    """How a recording looks to a model.

    Parameters
    ----------
    recordings : int
        Emulated ones.
    statistics : tuple of Statistic
    outages : OutageErrors
    assumed : tuple of str
        What nobody states of the fixes, in words.
    """

    recordings: int
    statistics: tuple[Statistic, ...]
    outages: OutageErrors
    assumed: tuple[str, ...] = ()

    @property
    def outside(self) -> int:
        """Statistics outside their 95 % band; one in twenty is chance."""
        return sum(s.outside for s in self.statistics)

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        o = self.outages
        return {
            "recordings": self.recordings,
            "assumed": list(self.assumed),
            "outside_95": self.outside,
            "statistics": [vars(s) for s in self.statistics],
            "outages": {
                "length_s": OUTAGE_S,
                "inside_90": o.inside,
                **{k: np.asarray(v).tolist() for k, v in vars(o).items()},
            },
        }


@dataclass(frozen=True)
class Twin:
    """A recording's motion with a model: what recordings are emulated from.

    Parameters
    ----------
    imu : ImuRecord
        Ideal, in body axes.
    motion : Trajectory
        At its rows.
    measured : Recording
        As it was recorded: times and standard deviations of the fixes, temperature.
    gnss : GnssRecord
        Its fixes with standard deviations.
    model, bare : Nominal
        The model, and what is left of it for a filter on a recording less its effects.
    beliefs : mapping of axis to NoiseModel
        As the filter carries them.
    start : tuple
        State and standard deviations.
    outages : (k,) array
        Starts, s.
    """

    imu: ImuRecord
    motion: Trajectory
    measured: Recording
    gnss: GnssRecord
    model: Nominal
    bare: Nominal
    beliefs: dict[str, Any]
    start: tuple[NavState, InitialSigma]
    outages: Array

    def recording(self, seed: int, number: int) -> Recording:
        """One emulated recording, the same whatever is asked next to it."""
        of_imu, of_fixes = np.random.default_rng([seed, number]).spawn(2)
        effects = self.model.effects
        imu = corrupt(
            self.imu, self.model.beliefs, of_imu, effects=[u for u in effects if u.inertial], reference=self.motion,
            temperature=self.measured.imu.temperature,
        ).imu  # fmt: skip
        g = self.gnss
        assert g.pos_std_ned is not None
        fixes = fixes_at(
            self.motion, g.t, g.pos_std_ned, g.vel_std_ned, self.model.gnss.lever_arm, rng=of_fixes, effects=effects
        )
        at = np.isin(g.t, fixes.t)
        llh = np.where(np.isfinite(g.llh[at]), fixes.llh, np.nan)
        vel = (
            None
            if g.vel_ned is None or fixes.vel_ned is None
            else np.where(np.isfinite(g.vel_ned[at]), fixes.vel_ned, np.nan)
        )
        return Recording(imu, replace(fixes, llh=llh, vel_ned=vel))

    def flown(self, recording: Recording) -> FilterResult:
        """The filter that knows the model, on a recording less the model's effects."""
        arm = self.bare.gnss.lever_arm
        taken = compensated(recording, self.model.effects, trajectory=self.motion, lever_arm=arm)
        assert taken.gnss is not None
        return self.run_without_outliers(taken.imu, with_sigma(taken.gnss, self.bare))

    def run_without_outliers(self, imu: ImuRecord, gnss: GnssRecord) -> FilterResult:
        """The filter on a recording less the model's effects; where the model knows outliers, on the fixes that are none."""
        gone = outlying(by_filter(lambda g: self.run(imu, g), gnss), known_outliers(self.model.effects, gnss))
        return self.run(imu, without(gnss, gone))

    def run(self, imu: ImuRecord, gnss: GnssRecord) -> FilterResult:
        """The filter on a recording less the model's effects."""
        first = int(np.searchsorted(imu.t, self.motion.t[0] - 0.5 * imu.dt))
        options = FilterOptions(store="fixes", node_every=10.0)
        arm = np.array(self.bare.gnss.lever_arm)
        return run_filter(imu.rows(slice(first, None)), gnss, *self.start, self.beliefs, lever_arm=arm, options=options)


@on_one_thread
def check(
    measured: Recording,
    model: Nominal,
    *,
    recordings: int = 200,
    seed: int = 1,
    workers: int = 1,
    progress: Callable[[str], None] = lambda _: None,
    store: Store[Made] | None = None,
) -> Check:
    """Emulate recordings from a model along the motion of a measured one, and say where that stands among them.

    Parameters
    ----------
    measured : Recording
        A drive or flight with fixes.
    model : Nominal
        For example the refined one.
    recordings : int
        To be emulated.
    seed : int
    workers : int
        Processes.
    progress : callable
        Told what is being done.
    store : Store, optional
        Keeps what was made of each emulated recording, of this recording and model alone.

    Raises
    ------
    InputError
        No fixes, fewer than twenty recordings, or no outage of a minute that ends with a fix.
    """
    if recordings < 20:
        raise InputError(f"{recordings} emulated recordings say nothing of a band, expected at least 20")
    progress("the motion of the recording")
    believed, drive = model.parted().on(measured)
    measured = drive.measured
    twin, own = twin_of(measured, believed)
    names, values = statistics_of(own)
    ends = outage_errors(own, twin.outages)
    known = np.isfinite(ends)
    if not known.any():
        raise InputError(
            f"has no stretch of {OUTAGE_S:g} s that ends with a fix, expected one for an outage", where=measured.source
        )
    done = 0

    def count(_: Made) -> None:
        nonlocal done
        done += 1
        progress(f"emulated recording {done} of {recordings}")

    with processes(workers) as pool:
        of = tuple(dict.fromkeys(where for _, where in names if where in COMPONENTS))
        own_key = f"{_identity(measured, model)}-{seed}"
        items = {f"{own_key}-{k}": (twin, seed, k, of) for k in range(recordings)}
        made = list(run_items(items, _one, pool=pool, store=store, done=count).values())
    drawn, metres = np.stack([m[0] for m in made]), np.stack([m[1] for m in made])
    low, middle, high = np.nanquantile(drawn, [0.025, 0.5, 0.975], axis=0)
    share = (drawn < values).mean(axis=0) + 0.5 * (drawn == values).mean(axis=0)
    statistics = tuple(
        Statistic(*name, *(float(x) for x in row))
        for name, *row in zip(names, values, low, middle, high, share, strict=True)
    )
    bands = np.nanquantile(metres[:, known], [0.05, 0.5, 0.95], axis=0)
    return Check(recordings, statistics, OutageErrors(twin.outages[known], ends[known], *bands), drive.said)


def _identity(measured: Recording, model: Nominal) -> str:
    """Of a recording, a model and the code, by what they hold."""
    said = hashlib.sha256(code_version().encode())
    said.update(json.dumps([model.raw, {k: str(v) for k, v in model.beliefs.items()}], default=str).encode())
    imu, gnss = measured.imu, measured.gnss
    for x in (imu.t, imu.gyro, imu.accel, *((gnss.t, gnss.llh, gnss.vel_ned) if gnss is not None else ())):
        said.update(b"" if x is None else np.ascontiguousarray(x).tobytes())
    return said.hexdigest()[:16]


def kept(path: Path) -> Lines[Made]:
    """Emulated recordings that are kept in a file.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError
        A file of something else, or one that another process adds to.
    """
    return Lines(
        path,
        lambda made: {"statistics": made[0].tolist(), "metres": made[1].tolist()},
        lambda line: (np.array(line["statistics"], dtype=float), np.array(line["metres"], dtype=float)),
        "emulated recordings of 'insemu gap-check'",
    )


def _one(item: tuple[Twin, int, int, tuple[str, ...]]) -> Made:
    twin, seed, number, of = item
    result = twin.flown(twin.recording(seed, number))
    return statistics_of(result, of)[1], outage_errors(result, twin.outages)


def twin_of(measured: Recording, model: Nominal) -> tuple[Twin, FilterResult]:
    """The motion of a recording with a model, and the filter's run on the recording itself."""
    # outliers are found by one rule in what was measured and in what is emulated: a statistic of both is the same function
    drawn = replace(model, effects=tuple(u for u in model.effects if u.id not in FIRST))
    # what was lost is filled in, as it is in what is emulated
    lost: tuple[Lost, ...] = ()
    if any(u.effect.does("restored") for u in model.effects):
        imu, lost = restored(measured.imu)
        measured = replace(measured, imu=imu)
    taken, bare = drive_without(measured, drawn)
    imu, gnss, state, sigma = starting_state(taken, bare)
    span = float(imu.t[-1] - imu.t[0])
    more = as_noise([] if "dropped_samples" in model.filled else [s for each in lost for s in each.stretches], span)
    beliefs = {
        name: louder(for_filter(bare.beliefs[name], imu.dt, span), float(v)) for name, v in zip(AXES, more, strict=True)
    }
    assert measured.gnss is not None
    # on a fixed grid: models that start the filter at other times have the same outages
    first = math.ceil((imu.t[0] + OUTAGE_S) / APART_S) * APART_S
    outages = np.arange(first, imu.t[-1] - OUTAGE_S, APART_S)
    stated = with_sigma(measured.gnss, model)
    empty = Trajectory(imu.t, np.zeros((len(imu), 3)), np.zeros((len(imu), 3)), np.zeros((len(imu), 3)))
    twin = Twin(imu, empty, measured, stated, model, bare, beliefs, (state, sigma), outages)
    own = twin.run_without_outliers(imu, with_sigma(gnss, bare))
    ideal, motion = motion_of(imu, own)
    temperature = measured.imu.temperature
    if temperature is not None:
        temperature = np.interp(ideal.t, measured.imu.t, temperature)
        measured = replace(measured, imu=replace(ideal, temperature=temperature))
    return replace(twin, imu=ideal, motion=motion, measured=measured), own


def motion_of(imu: ImuRecord, result: FilterResult) -> tuple[ImuRecord, Trajectory]:
    """An ideal IMU record and the trajectory that follows from it exactly, along the motion that a filter estimated.

    The measured increments less the estimated errors of the sensors, turned and pushed towards the filter's estimate at every node as a critically
    damped follower of :data:`FOLLOW_S` would be. What the vehicle shakes stays in it.

    Parameters
    ----------
    imu : ImuRecord
        n rows, less the effects that are known.
    result : FilterResult
        Of the filter on it, every epoch stored.
    """
    record = imu.as_increments()
    step = np.diff(record.t, prepend=2.0 * record.t[0] - record.t[1])[:, None]
    errors = np.stack([result.imu_states[:, _own(result, name)].sum(axis=1) for name in AXES], axis=1)
    gyro, accel = record.gyro - errors[:, :3] * step, record.accel - errors[:, 3:] * step
    nodes = result.nodes
    assert nodes is not None
    edges = np.unique(np.concatenate([[0], nodes.epoch, [len(record) - 1]]))
    nav = np.empty((len(record), 10))
    nav[0] = result.nav[0]
    for first, last in pairwise(edges):
        now, aim = nav[first], result.nav[first]
        away = earth.position_difference(aim[None, :3], now[None, :3])[0]
        push = 2.0 / FOLLOW_S * (aim[3:6] - now[3:6]) + away / FOLLOW_S**2
        C = rotation.dcm_from_quaternion(now[6:10])
        turned = rotation.quaternion_product(rotation.quaternion_conjugate(now[6:10]), aim[6:10])
        turn = rotation.vector_from_quaternion(turned) / FOLLOW_S
        rows = slice(first + 1, last + 1)
        gyro[rows] += turn * step[rows]
        accel[rows] += (C.T @ push) * step[rows]
        piece = slice(first, last + 1)
        part = ImuRecord(record.t[piece], gyro[piece], accel[piece], "increment")
        nav[piece] = mechanize_array(part, now)
    ideal = replace(record, gyro=gyro, accel=accel)
    return ideal, trajectory_of(record.t, nav, "motion of the recording")


def _own(result: FilterResult, axis: str) -> slice:
    at = result.layout[axis]
    return slice(at.start - 9, at.stop - 9)


def statistics_of(result: FilterResult, of: Sequence[str] | None = None) -> tuple[list[tuple[str, str]], Array]:
    """Names, with the component of the fix, and values of the statistics of whitened innovations.

    Parameters
    ----------
    result : FilterResult
    of : sequence of str, optional
        Components, those with :data:`FEWEST` fixes where they are not given; NaN of one without fixes.
    """
    fixes = result.fixes
    use = np.isfinite(fixes.innovation) & fixes.accepted[:, None]
    nu = np.where(use, np.nan_to_num(fixes.innovation), 0.0)
    S = np.where(use[:, :, None] & use[:, None, :], np.nan_to_num(fixes.S), 0.0)
    S[:, np.arange(6), np.arange(6)] += ~use
    y = np.linalg.solve(np.linalg.cholesky(S), nu[:, :, None])[:, :, 0]
    names: list[tuple[str, str]] = []
    values: list[float] = []
    for c, where in enumerate(COMPONENTS):
        x = y[use[:, c], c]
        if (where not in of) if of is not None else (x.size < FEWEST):
            continue
        x = x if x.size > 1 else np.full(2, math.nan)
        sd = max(float(x.std()), 1e-12)
        z = (x - x.mean()) / sd
        own = {
            "mean": float(x.mean()),
            "root mean square": math.sqrt(float(np.mean(x**2))),
            "correlation of neighbours": float(np.mean(z[1:] * z[:-1])),
            "kurtosis": float(np.mean(z**4)),
            "largest": float(np.abs(x).max()),
        }
        names += [(name, where) for name in own]
        values += own.values()
    names.append(("NIS per degree of freedom", "all"))
    values.append(float(np.sum(y[use] ** 2)) / max(int(use.sum()), 1))
    return names, np.array(values)


def outage_errors(result: FilterResult, starts: Array) -> Array:
    """Horizontal distance, m, from the fix at the end of outages of :data:`OUTAGE_S` to the position that was carried there without fixes.

    What the fixes of an outage moved is carried along by the stored transitions and taken off again: to first order the filter without them.

    Parameters
    ----------
    result : FilterResult
        With nodes and gains.
    starts : (k,) array
        s.

    Returns
    -------
    (k,) array
        NaN where no fix comes within :data:`LATE_S` of the end.
    """
    fixes, nodes = result.fixes, result.nodes
    assert nodes is not None and fixes.K is not None and fixes.H is not None
    use = np.isfinite(fixes.innovation) & fixes.accepted[:, None]
    nu = np.where(use, np.nan_to_num(fixes.innovation), 0.0)
    at = result.fixes_of_nodes()
    out = np.full(starts.size, np.nan)
    flying: dict[int, Array] = {}
    waiting = 0
    for k in range(1, nodes.t.size):
        flying = {i: nodes.Phi[k] @ d for i, d in flying.items()}
        for j in at.get(k, ()):
            for i in list(flying):
                late = fixes.t[j] - starts[i] - OUTAGE_S
                if late >= -1e-6 and np.isfinite(fixes.innovation[j, :2]).all():
                    free = fixes.innovation[j, :2] + (np.nan_to_num(fixes.H[j]) @ flying[i])[:2]
                    out[i] = float(np.hypot(*free)) if late <= LATE_S else math.nan
                    del flying[i]
                else:
                    flying[i] = flying[i] + np.nan_to_num(fixes.K[j]) @ nu[j]
        while waiting < starts.size and nodes.t[k] >= starts[waiting]:
            flying[waiting] = np.zeros(nodes.Phi.shape[1])
            waiting += 1
    return out
