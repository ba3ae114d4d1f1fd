"""Wavelet moments of the segments of a log under a model whose levels or correlation times follow covariates."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError
from insemu.fit.coordinates import Coordinates
from insemu.fit.covariance import model_covariance
from insemu.fit.gmwm import fit_curve
from insemu.noise import Follows, NoiseModel, Process
from insemu.records import Series
from insemu.variance import WaveletVariance, wavelet_variance

Array = NDArray[np.float64]

#: A segment's longest scale is this part of it at most; longer scales are taken from the whole record.
LONGEST = 0.25
#: Points of a segment's covariate, quantiles, that a mean over it is taken from.
POINTS = 200
#: Largest slope that is searched, in logarithms of the level over the range of the covariate.
STEEPEST = 12.0
#: Covariates at which the variances of a process are taken whose correlation times follow; in between they are linear.
NODES = 33


@dataclass(frozen=True)
class Segments:
    """Wavelet moments of the segments of a log, and of the whole at the scales that no segment shows."""

    asked: NoiseModel
    curves: tuple[WaveletVariance, ...]
    whole: WaveletVariance
    keep: NDArray[np.bool_]
    rest: NDArray[np.bool_]
    points: Mapping[str, Array]
    edges: NDArray[np.int64]

    @classmethod
    def of(
        cls,
        series: Series,
        covariates: Mapping[str, ArrayLike],
        model: NoiseModel,
        segments: int,
        tau_from: float,
        tau_to: float,
    ) -> Segments:
        """The moments of a log cut into segments of one length; arguments and refusals are those of :func:`insemu.fit.fit_following`.

        Parameters
        ----------
        series : Series
        covariates : mapping of str to (n,) array
        model : NoiseModel
        segments : int
        tau_from, tau_to : float
        """
        n = len(series.complete("a fit of segments"))
        named = {p.follows.covariate for p in model if p.follows is not None}
        if not named:
            raise InputError(f"no level of {model} follows a covariate; write for example WN(follows=temperature)")
        for p in model:
            if p.single_draw:
                raise InputError(f"{p} is a signal, not noise, and cannot be fitted to segments", where=series.name)
        given = {name: _checked(name, covariates, n) for name in sorted(named)}
        length = n // segments if segments > 0 else 0
        levels = int(math.log2(length * LONGEST)) if length else 0
        if segments < 2 or levels < 2:
            raise InputError(
                f"found {segments} segments of {n} samples, expected at least 2 of at least {round(4 / LONGEST)} samples each",
                where=series.name,
            )
        edges = np.linspace(0, n, segments + 1).astype(np.int64)
        asked = NoiseModel(
            tuple(p if p.follows is None else replace(p, follows=_centred(p.follows, given)) for p in model)
        ).at_rate(series.rate_hz)
        curves = tuple(
            wavelet_variance(series.values[a:b], series.rate_hz, levels=levels) for a, b in itertools.pairwise(edges)
        )
        whole = wavelet_variance(series.values, series.rate_hz)
        quantiles = (np.arange(POINTS) + 0.5) / POINTS
        points = {
            name: np.array([np.quantile(v[a:b], quantiles) for a, b in itertools.pairwise(edges)])
            for name, v in given.items()
        }

        def used(tau: Array) -> NDArray[np.bool_]:
            return (tau >= tau_from * (1 - 1e-9)) & (tau <= tau_to * (1 + 1e-9))

        keep = used(curves[0].tau_s)
        rest = used(whole.tau_s) & (whole.scale_samples > curves[0].scale_samples[-1])
        return cls(asked, curves, whole, keep, rest, points, edges)

    @property
    def dt(self) -> float:
        """Sampling interval, s."""
        return 1.0 / self.whole.rate_hz

    @property
    def value(self) -> Array:
        """All moments of the log, stacked: segment by segment, then the longer scales of the whole."""
        return np.concatenate([*(c.value[self.keep] for c in self.curves), self.whole.value[self.rest]])

    @property
    def following(self) -> list[int]:
        """Places of the processes whose slope is to be estimated."""
        return [k for k, p in enumerate(self.asked) if p.follows is not None and p.follows.slope is None]

    def power(self, process: Process) -> Array:
        """Mean of the squared gain of the level in every segment, and over all: (segments + 1,)."""
        law = process.follows
        if law is None or law.what == "time":
            return np.ones(len(self.curves) + 1)
        own = np.mean(law.gain(self.points[law.covariate]) ** 2, axis=1)
        return np.append(own, own.mean())

    def expected(self, model: NoiseModel) -> Array:
        """All moments under a model, stacked."""
        short, long = self.curves[0].scale_samples[self.keep], self.whole.scale_samples[self.rest]
        own, rest = np.zeros((len(self.curves), short.size)), np.zeros(long.size)
        for p in model:
            if p.follows is not None and p.follows.what == "time":
                found = self.through(p, np.append(short, long))
                own, rest = own + found[:-1, : short.size], rest + found[-1, short.size :]
                continue
            power, plain = self.power(p), replace(p, follows=None)
            own += power[:-1, None] * plain.wavelet_variance(short, self.dt)
            rest += power[-1] * plain.wavelet_variance(long, self.dt)
        return np.concatenate([own.ravel(), rest])

    def curve(self, model: NoiseModel) -> Array:
        """Wavelet variance of the whole record under a model, at all its scales."""
        scale = self.whole.scale_samples.astype(np.float64)
        timed = [p for p in model if p.follows is not None and p.follows.what == "time"]
        rest = self.constant(NoiseModel(tuple(p for p in model if p not in timed)), -1)
        return np.asarray(sum((self.through(p, scale)[-1] for p in timed), start=rest.wavelet_variance(scale, self.dt)))

    def through(self, process: Process, scale: Array) -> Array:
        """Mean wavelet variance of a process whose correlation times follow, in every segment and over all: (segments + 1, scales)."""
        assert process.follows is not None
        name = process.follows.covariate
        x = self.points[name]
        nodes = np.linspace(x.min(), x.max(), NODES)
        value = np.array([self._curve(process.under({name: float(v)}), scale) for v in nodes])
        at = np.clip((x - nodes[0]) / (nodes[1] - nodes[0]), 0.0, NODES - 1 - 1e-9)
        low = at.astype(np.int64)
        weight = np.zeros((len(x), NODES))
        every = np.arange(len(x))[:, None]
        np.add.at(weight, (every, low), 1.0 - (at - low))
        np.add.at(weight, (every, low + 1), at - low)
        weight /= x.shape[1]
        return np.asarray(np.vstack([weight, weight.mean(axis=0)]) @ value)

    def _curve(self, process: Process, scale: Array) -> Array:
        """Wavelet variance of a process, compiled."""
        coefficient, shapes = process.coordinates(self.dt)
        unit = process.unit_wavelet_variance(0.5 * scale, [float(v or 0.0) for v in shapes])
        return np.asarray(float(coefficient or 0.0) * unit)

    def slowed(self, process: Process, segment: int) -> Process:
        """A process whose correlation times follow, at the mean of the logarithm of their gain in a segment; -1: in the whole record."""
        assert process.follows is not None
        u = np.log(process.follows.gain(self.points[process.follows.covariate])).mean(axis=1)
        return process.slowed(float(np.exp(u.mean() if segment < 0 else u[segment])))

    def constant(self, model: NoiseModel, segment: int) -> NoiseModel:
        """The model of constant levels with the same mean power in a segment; -1: in the whole record."""
        return NoiseModel(
            tuple(
                self.slowed(p, segment)
                if p.follows is not None and p.follows.what == "time"
                else replace(p, follows=None).scaled(math.sqrt(float(self.power(p)[segment])))
                for p in model
            )
        )

    def covariance(self, model: NoiseModel) -> Array:
        """Covariance of all moments of a Gaussian signal whose levels change slowly.

        Segments are independent of each other, but not of the longer scales of the whole record, which are means over the segments: with the
        covariance ``V_s`` of a whole record that is throughout like segment s, the moments of s covary with the longer scales by ``V_s``, and
        those among each other by the mean of ``V_s`` over the segments.
        """
        scale, n = self.curves[0].scale_samples[self.keep], self.whole.n_samples
        here = [self.constant(model, s) for s in range(len(self.curves))]
        out = scipy.linalg.block_diag(
            *(model_covariance(m, c.n_samples, scale, self.dt) for m, c in zip(here, self.curves, strict=True))
        )
        if not self.rest.any():
            return np.asarray(out)
        every = np.append(scale, self.whole.scale_samples[self.rest])
        through = np.array([model_covariance(m, n, every, self.dt) for m in here])
        k = scale.size
        across = through[:, :k, k:].reshape(-1, every.size - k)
        return np.block([[out, across], [across.T, through[:, k:, k:].mean(axis=0)]])

    # -- coordinates ----------------------------------------------------------------------------------------------------------------

    def model(self, tied: Coordinates, x: Array) -> NoiseModel:
        """The model at coordinates: those of the processes, then the slopes."""
        count = len(tied.free)
        parts = list(tied.model(x[:count]).processes)
        for k, slope in zip(self.following, x[count:] / self.widths(), strict=True):
            law = self.asked.processes[k].follows
            assert law is not None
            parts[k] = replace(parts[k], follows=replace(law, slope=float(slope)))
        return NoiseModel(tuple(parts))

    def widths(self) -> Array:
        """Range of the stretched covariate of every slope: a coordinate is the change of the logarithm of the level over it."""
        out = []
        for k in self.following:
            law = self.asked.processes[k].follows
            assert law is not None
            u = law.stretched(self.points[law.covariate])
            u = u[np.isfinite(u)]
            out.append(float(np.ptp(u)) if u.size else 0.0)
        return np.array(out)

    def bounds(self, tied: Coordinates) -> tuple[Array, Array]:
        """Limits of the coordinates."""
        low, high = tied.bounds(self.whole.n_samples, self.dt)
        steep = np.full(len(self.following), STEEPEST)
        return np.append(low, -steep), np.append(high, steep)

    def started(self, series: Series) -> tuple[Coordinates, list[Array]]:
        """Coordinates of the constant model nearest to the whole record with slopes to begin from.

        Slopes: as the curves of the segments change scale by scale; and 1 of power laws, 0 of others. Those of correlation times also begin on
        both sides of zero.
        """
        plain = NoiseModel(tuple(replace(p, follows=None) for p in self.asked))
        tau = self.whole.tau_s[np.concatenate([np.flatnonzero(self.keep), np.flatnonzero(self.rest)])]
        begin = fit_curve(
            self.whole,
            plain,
            weighting="intervals",
            tau_from=tau[0],
            tau_to=tau[-1],
            name=series.name,
            unit=series.unit,
        ).model
        begin = _shared_out(begin, self.asked)
        scale = self.curves[0].scale_samples[self.keep]
        shares = np.array([p.wavelet_variance(scale, self.dt) for p in begin])
        shares /= np.maximum(shares.sum(axis=0), 1e-300)
        logs = 0.5 * np.log(np.maximum([c.value[self.keep] for c in self.curves], 1e-300))
        weight = self.curves[0].edof[self.keep]
        seen: list[float] = []
        plainly: list[float] = []
        for k, width in zip(self.following, self.widths(), strict=True):
            law = self.asked.processes[k].follows
            assert law is not None
            if law.what == "time":
                seen, plainly = [*seen, 0.0], [*plainly, 0.0]
                continue
            u = np.mean(np.maximum(law.stretched(self.points[law.covariate]), -STEEPEST), axis=1)
            u = u - u.mean()
            slope = (u @ logs) / max(float(u @ u), 1e-300)
            w = weight * shares[k] ** 2
            seen.append(float(np.clip(w @ slope / max(float(w.sum()), 1e-300) * width, -3.0, 3.0)))
            plainly.append(width if law.law == "power" else 0.0)
        tied = Coordinates.of(plain, begin, float(np.std(np.diff(series.values))), self.dt)
        followed = NoiseModel(tuple(replace(p, follows=q.follows) for p, q in zip(tied.begin, self.asked, strict=True)))
        tied = replace(tied, begin=followed)
        timed = np.array([float(self.asked.processes[k].follows.what == "time") for k in self.following])  # type: ignore[union-attr]
        starts = [np.array(seen), np.array(plainly)]
        if timed.any():
            starts = [seen + side * timed for side in (-1.0, 0.0, 1.0)]
        return tied, [self._at_its_covariate(tied, np.append(tied.start, b)) for b in starts]

    def _at_its_covariate(self, tied: Coordinates, x: Array) -> Array:
        """Levels that are averages over the record, as those at the covariate ``at``."""
        x = x.copy()
        for place, (k, name) in enumerate(tied.free):
            p = self.model(tied, x).processes[k]
            if name == p.level.name:
                x[place] -= 0.5 * p.level.power * math.log(max(float(self.power(p)[-1]), 1e-12))
        return x


def _shared_out(begin: NoiseModel, asked: NoiseModel) -> NoiseModel:
    """Processes of one kind of which some follow share their variance: to one curve they are one."""
    parts = list(begin.processes)
    for kind in {p.symbol for p, q in zip(begin, asked, strict=True) if q.follows is not None}:
        alike = [k for k, p in enumerate(begin) if p.symbol == kind and not asked.processes[k].specified]
        sizes = [parts[k].parameters[parts[k].level.name] for k in alike]
        if len(alike) > 1 and min(sizes) < 0.1 * max(sizes):
            largest = parts[alike[int(np.argmax(sizes))]]
            for k in alike:
                parts[k] = largest.scaled(1.0 / math.sqrt(len(alike)))
    return NoiseModel(tuple(parts))


def _checked(name: str, covariates: Mapping[str, ArrayLike], n: int) -> Array:
    if name not in covariates:
        there = ", ".join(covariates)
        raise InputError(f"no covariate '{name}'" + (f", there are: {there}" if there else " is given"))
    x = np.asarray(covariates[name], dtype=np.float64)
    if x.shape != (n,):
        raise InputError(f"the covariate {name} has shape {x.shape}, expected ({n},)")
    if not np.isfinite(x).all():
        raise InputError(f"the covariate {name} has {int((~np.isfinite(x)).sum())} values that are not finite")
    if np.ptp(x) == 0.0:
        raise InputError(f"the covariate {name} is {x[0]:g} throughout: a level cannot be seen to follow it")
    return x


def _centred(law: Follows, given: Mapping[str, Array]) -> Follows:
    """A law whose level is that at the mean of the covariate, where it does not say at what."""
    if law.at is not None or law.slope is not None:
        return law
    mean = float(np.mean(given[law.covariate]))
    rounded = float(f"{mean:.2g}")
    return replace(law, at=rounded if rounded > law.above or law.law == "exp" else mean)
