"""What an aid measured against what IMU and fixes say that it should have, at the aid's own times and in blocks of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu import rotation
from insemu.effects import EFFECTS, steady
from insemu.filters import (
    AIDS,
    SETTINGS,
    FilterResult,
    SmootherResult,
    TrueMotion,
    aid_jacobian,
    cross_covariance,
    smooth,
    smoothed_at,
)
from insemu.gap.drive.preparation import Prepared
from insemu.gap.evidence.aid_model import AidResiduals
from insemu.records import AidRecord
from insemu.strapdown import correct

Array = NDArray[np.float64]

#: Longest time between nodes of the smoothed run, s: between two of them what is smoothed is a straight line.
NODE_S = 1.0
#: Block means times rows at the most: their covariance is one matrix, whose factoring goes with the third power.
MOST_MEANS = 450
#: Samples of an aid within the run below which nothing is looked at.
FEWEST = 30
#: Time over which the variance of what is faster than motion is taken, s.
SHAKEN_S = 2.0


@dataclass(frozen=True)
class Smoothed:
    """The run without the aid, smoothed: fixes from both sides.

    Parameters
    ----------
    result : FilterResult
    nodes : SmootherResult
    coloured : (3,) array, float
        Standard deviations, m NED, and correlation time, s, of errors of the fixes that last and that the filter's covariance knows nothing of.
    """

    result: FilterResult
    nodes: SmootherResult
    coloured: tuple[Array, float]

    @classmethod
    def of(cls, prepared: Prepared) -> Smoothed:
        """Run the filter once more with a node every second and smooth it."""
        result = prepared.densely(NODE_S)
        use = next((u for u in prepared.nominal.effects if u.id == "gnss_correlated_noise"), None)
        coloured = (np.zeros(3), 1.0) if use is None else (np.array(use["sigma"]), use.scalar("tau"))
        return cls(result, smooth(result), coloured)

    @cached_property
    def motion(self) -> TrueMotion:
        """Motion at every epoch of the span."""
        nav = smoothed_at(self.result, self.nodes, self.rows)
        q, width = nav[:, 6:10], np.diff(self.t)
        turn = rotation.vector_from_quaternion(
            rotation.quaternion_product(rotation.quaternion_conjugate(q[:-1]), q[1:])
        )
        # a rate is the mean over an interval: that of an epoch lies between those before and after it
        rate = turn / width[:, None]
        rate = 0.5 * (np.concatenate([rate[:1], rate]) + np.concatenate([rate, rate[-1:]]))
        return TrueMotion(nav[:, :3], nav[:, 3:6], rotation.dcm_from_quaternion(q), rate)

    @cached_property
    def rows(self) -> NDArray[np.int64]:
        """Epochs of the run between the first node and the last."""
        first, last = (int(k) for k in self.result.nodes.epoch[[0, -1]]) if self.result.nodes is not None else (0, 0)
        return np.arange(first, last + 1)

    @property
    def t(self) -> Array:
        """Their times, s."""
        return np.asarray(self.result.t[self.rows])

    def shown_to(self, aid: AidRecord) -> Shown | None:
        """What an aid should measure; None where nothing says so."""
        known = AIDS.get(aid.kind)
        if known is None or known.truth is None:
            return None
        settings = np.zeros(SETTINGS)
        settings[: len(aid.settings)] = aid.settings
        values, dt = known.truth(self.motion, settings), float(np.median(np.diff(self.t)))
        around = np.array([unit == "rad" for unit in known.rows.values()])
        values[:, around] = np.unwrap(values[:, around], axis=0)
        quiet = steady(values, dt)
        window = max(1, min(round(SHAKEN_S / dt), len(values)))
        shaken = scipy.ndimage.uniform_filter1d((values - quiet) ** 2, window, axis=0, mode="nearest")
        return Shown(self.t, quiet, np.gradient(quiet, self.t, axis=0), shaken, around)


@dataclass(frozen=True)
class Shown:
    """What an aid should measure at every epoch, less what is faster than motion: an aid takes means over it, or samples it at times of its own.

    Parameters
    ----------
    t : (n,) array
        s.
    values, slope : (n, rows) arrays
        SI, and its rate of change.
    shaken : (n, rows) array
        Variance of what is faster.
    around : (rows,) array of bool
        Rows that are angles, of which whole turns say nothing.
    """

    t: Array
    values: Array
    slope: Array
    shaken: Array
    around: NDArray[np.bool_]

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Values, their rate of change, and variance of what is faster at times (k,)."""
        values, slope, shaken = (
            np.column_stack([np.interp(t, self.t, x) for x in y.T]) for y in (self.values, self.slope, self.shaken)
        )
        return values, slope, shaken


@dataclass(frozen=True)
class Measured:
    """An aid and what it should have measured, sample by sample.

    Parameters
    ----------
    aid : AidRecord
        Without rows that are not used and measurements outside the run.
    off : (n, rows) array
        Measured minus predicted, SI.
    values, slope, shaken : (n, rows) arrays
        Predicted, its rate of change, and variance of what is faster than motion there.
    used : (rows,) array of bool
    """

    aid: AidRecord
    off: Array
    values: Array
    slope: Array
    shaken: Array
    used: NDArray[np.bool_]

    @classmethod
    def of(cls, aid: AidRecord, shown: Shown) -> Measured | None:
        """Compare an aid with what it should measure; None where there is too little of it."""
        usable = np.isfinite(aid.values) & np.isfinite(aid.std) & (aid.std > 0.0)
        used = usable.mean(axis=0) > 0.5 if len(aid) else np.zeros(aid.values.shape[1], dtype=bool)
        keep = usable[:, used].all(axis=1) & (aid.t >= shown.t[0]) & (aid.t <= shown.t[-1])
        if not used.any() or np.count_nonzero(keep) < FEWEST:
            return None
        aid = replace(aid.rows(keep), since=None)
        values, slope, shaken = shown.at(aid.t)
        off = aid.values - values
        off[:, shown.around] = np.angle(np.exp(1j * off[:, shown.around]))
        return cls(aid, off, values, slope, shaken, used)

    def rows_kept(self, keep: NDArray[np.bool_]) -> Measured:
        """The same with some of the measurements."""
        parts = {name: getattr(self, name)[keep] for name in ("off", "values", "slope", "shaken")}
        return replace(self, aid=self.aid.rows(keep), **parts)

    def unit_columns(self) -> tuple[tuple[tuple[str, str], ...], Array]:
        """Effect and label of every unit effect of this aid, and what it adds, (c, n, w)."""
        labels, columns = [], []
        for effect in EFFECTS.values():
            if self.aid.kind in effect.sensors and effect.does("aid_columns"):
                for label, column in effect.aid_columns(self.values, self.slope).items():
                    labels.append((effect.id, label))
                    columns.append(column[:, self.used])
        shape = (0, len(self.aid), int(self.used.sum()))
        return tuple(labels), np.stack(columns) if columns else np.zeros(shape)

    def blocks(self, smoothed: Smoothed) -> AidResiduals:
        """Means over blocks, what is left within them, and the covariance of the navigation behind the means."""
        aid, w = self.aid, int(self.used.sum())
        labels, columns = self.unit_columns()
        std = aid.std[:, self.used]
        y, G = self.off[:, self.used] / std, columns / std
        most = max(1, MOST_MEANS // w)
        width = max(NODE_S, (aid.t[-1] - aid.t[0]) / most * (1.0 + 1e-9))
        place = np.floor((aid.t - aid.t[0]) / width).astype(np.int64)
        _, block = np.unique(place, return_inverse=True)
        count = np.bincount(block).astype(np.float64)

        def mean(x: Array) -> Array:
            out = np.zeros((count.size, *x.shape[1:]))
            np.add.at(out, block, x)
            return np.asarray(out / count.reshape(-1, *[1] * (x.ndim - 1)))

        t, y_mean = mean(aid.t), mean(y)
        G_mean = np.stack([mean(g) for g in G]) if len(G) else np.zeros((0, count.size, w))
        dy, dG = y - y_mean[block], G - G_mean[:, block]
        at = np.searchsorted(smoothed.nodes.t, t).clip(0, smoothed.nodes.t.size - 1)
        J = np.stack([aid_jacobian(aid, nav)[self.used] for nav in smoothed.nodes.nav[at]])
        J = J / mean(std)[:, :, None]
        n = smoothed.nodes.covariance.shape[1]
        wide = np.zeros((*J.shape[:2], n))
        wide[:, :, :9] = J
        navigation = cross_covariance(smoothed.result, smoothed.nodes, at, wide)
        sigma, tau = smoothed.coloured
        if sigma.any():
            lasting = np.exp(-np.abs(t[:, None] - t) / tau)
            seen = np.einsum("kip,p,ljp->kilj", J[:, :, :3], sigma**2, J[:, :, :3])
            navigation = navigation + (seen * lasting[:, None, :, None]).reshape(navigation.shape)
        navigation = navigation + _squares(aid, smoothed, at, self.used, mean(std))
        # sampled at a constant rate a vibration may look slow: it counts as one measurement in each block
        ratio = self.shaken[:, self.used] / std**2
        navigation = navigation + np.diag(mean(ratio).ravel())
        settled = {e: EFFECTS[e].settled_with(self.values) for e, _ in labels}
        return AidResiduals(
            aid.kind, tuple(np.array(list(AIDS[aid.kind].rows))[self.used].tolist()), t, y_mean, G_mean, count,
            np.einsum("ni,ni->i", dy, dy), np.einsum("ni,cni->ic", dy, dG), np.einsum("cni,dni->icd", dG, dG),
            navigation, labels, np.asarray(np.exp(np.log(std).mean(axis=0))), settled,
            ratio.mean(axis=0),
        )  # fmt: skip


def _squares(aid: AidRecord, smoothed: Smoothed, at: NDArray[np.int64], used: NDArray[np.bool_], std: Array) -> Array:
    """Covariance (m w, m w) of what is seen of squares of attitude errors, held to last.

    Half of a second derivative times the square of a normal error has the root mean square of half of it times sqrt(3) variances.
    """
    nodes, out = smoothed.nodes, np.zeros((std.size, std.size))
    for axis in range(6, 9):
        u = np.zeros_like(std)
        for k, node in enumerate(at):
            sigma = float(np.sqrt(nodes.covariance[node, axis, axis]))
            nav, turned = nodes.nav[node], nodes.nav[node].copy()
            error = np.zeros(9)
            error[axis] = -sigma
            correct(turned, error)
            bent = (aid_jacobian(aid, turned) - aid_jacobian(aid, nav))[used, axis] / sigma
            u[k] = 0.5 * np.sqrt(3.0) * bent * sigma**2 / std[k]
        out += np.outer(u, u)
    return out
