"""What is kept of all realizations, whatever their number: values of each at the outages, and sums over them at every epoch.

Sums are taken along a tree that only the numbers of the realizations determine: eight neighbours make a node, eight nodes the next larger
one. So the same realizations give the same bits, whoever flew them, in whatever order, in one piece or after interruptions.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.evaluate.dataset import labelled
from insemu.evaluate.errors import within_outage
from insemu.evaluate.sketch import quantiles, sketched

if TYPE_CHECKING:
    import xarray as xr


Array = NDArray[np.float64]

#: Nodes that make the next larger one.
BASE = 8
#: Figures of an outage that are taken while it lasts.
DURING = ("planimetric_mean_m", "planimetric_max_m", "north_max_m", "east_max_m", "down_max_m")
#: Quantiles over the realizations that are told at every epoch, and of what.
LEVELS, SKETCHED = (0.05, 0.5, 0.95, 0.99), ("planimetric", "altimetric")
_SCALARS = ("nis", "dof", "lag_sum", "lag_count", "rejected", "fixes", "epochs")

#: Values of every realization: dimensions behind design and realization, unit, meaning.
RUNS: Mapping[str, tuple[tuple[str, ...], str, str]] = {
    "end_error": (("outage", "component"), "SI", "navigation error at the end of an outage, estimate minus truth"),
    "end_sigma": (("outage", "component"), "SI", "standard deviation the filter states there"),
    "end_major": (("outage",), "m", "standard deviation of the horizontal position it states there, along the axis in which it is largest"),
    "end_nees": (("outage",), "1", "normalised squared error there, scaled to nine states"),
    "planimetric_mean_m": (("outage",), "m", "mean planimetric error during an outage"),
    "planimetric_max_m": (("outage",), "m", "largest planimetric error during an outage"),
    "north_max_m": (("outage",), "m", "largest error north"),
    "east_max_m": (("outage",), "m", "largest error east"),
    "down_max_m": (("outage",), "m", "largest error down"),
    "smoothed_planimetric_mean_m": (("outage",), "m", "mean planimetric error after smoothing"),
    "smoothed_planimetric_max_m": (("outage",), "m", "largest planimetric error after smoothing"),
    "smoothed_down_max_m": (("outage",), "m", "largest error down after smoothing"),
    "stated_position": ((), "m", "stated position deviation, mean over the epochs"),
    "stated_heading": ((), "rad", "stated heading deviation, mean over the epochs"),
    "log_nees": ((), "1", "logarithm of the NEES, mean over the epochs"),
}  # fmt: skip
#: Sums over the realizations: dimensions behind design, and what is reported of them (name, unit, meaning).
_SUMS: Mapping[str, tuple[tuple[str, ...], str, str, str]] = {
    "error": (("time", "component"), "error_mean", "SI", "mean navigation error"),
    "error_square": (("time", "component"), "error_rms", "SI", "root mean square navigation error"),
    "sigma_square": (("time", "component"), "sigma_rms", "SI", "root mean square of the stated standard deviation"),
    "inside": (("time", "component"), "inside_3_sigma", "1", "share of the errors inside three stated deviations"),
    "inside_horizontal": (("time",), "inside_3_sigma_horizontal", "1", "share of the planimetric errors inside three stated deviations"),
    "nees": (("time",), "nees_mean", "1", "mean normalised squared error, scaled to nine states"),
    "block_nees": (("block", "time"), "block_nees_mean", "1", "mean NEES per degree of freedom where it is known"),
    "block_known": (("block", "time"), "block_known", "1", "share of the realizations in which it is known"),
    "axis_square": (("time", "axis"), "axis_error_rms", "rad/s, m/s^2", "root mean square of the estimated minus true sensor errors"),
    "axis_sigma_square": (("time", "axis"), "axis_sigma_rms", "rad/s, m/s^2", "root mean square of their stated deviation"),
    "axis_carried": (("time", "axis"), "axis_carried", "1", "share of the realizations in which a deviation is stated"),
    "observability": (("time", "state"), "observability_mean", "1", "mean share of the variance of a state that the fixes have removed"),
    "smoothed_square": (("time", "component"), "smoothed_error_rms", "SI", "root mean square error after smoothing"),
    "smoothed_sigma_square": (("time", "component"), "smoothed_sigma_rms", "SI", "root mean square of the smoother's stated deviation"),
    "smoothed_inside": (("time", "component"), "smoothed_inside_3_sigma", "1", "share of its errors inside three stated deviations"),
    "smoothed_nees": (("time",), "smoothed_nees_mean", "1", "mean normalised squared error after smoothing"),
}  # fmt: skip


def end_index(t: Array, outage: tuple[float, float]) -> int:
    """Index of the last of the epochs ``t`` of an outage (start, duration)."""
    return int(np.flatnonzero(t <= outage[0] + outage[1] + 1e-9)[-1])


@dataclass(frozen=True)
class Tally:
    """What is kept of some realizations that follow each other.

    Parameters
    ----------
    count : int
    runs : mapping of name to (design, realization, ...) array
        Of :data:`RUNS` and the scalars of a realization.
    sums : mapping of name to (design, ...) array
        Over the realizations, epoch by epoch.
    sketch : sparse array
        Of the planimetric error and the error in altitude; rows are (quantity, design, time).
    """

    count: int
    runs: Mapping[str, Array]
    sums: Mapping[str, Array]
    sketch: scipy.sparse.csr_array

    def to_bytes(self) -> bytes:
        """As it is kept."""
        arrays = {f"runs {k}": v for k, v in self.runs.items()} | {f"sums {k}": v for k, v in self.sums.items()}
        sketch = {f"sketch {k}": getattr(self.sketch, k) for k in ("data", "indices", "indptr")}
        stream = io.BytesIO()
        shape = np.array([self.count, *self.sketch.shape])
        np.savez_compressed(stream, allow_pickle=False, **arrays, **sketch, shape=shape)
        return stream.getvalue()

    @classmethod
    def of_bytes(cls, content: bytes) -> Tally:
        """The inverse; raises ``ValueError`` or ``KeyError`` where it is something else."""
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            held = {name: archive[name] for name in archive.files}
        count, *shape = (int(n) for n in held["shape"])
        parts = {k: {n.removeprefix(k): v for n, v in held.items() if n.startswith(k)} for k in ("runs ", "sums ")}
        sketch = scipy.sparse.csr_array(
            tuple(held[f"sketch {k}"] for k in ("data", "indices", "indptr")), shape=tuple(shape)
        )
        return cls(count, parts["runs "], parts["sums "], sketch)

    def mean(self, name: str, design: int) -> Array:
        """A sum over the number of realizations, (time, ...)."""
        return np.asarray(self.sums[name][design] / self.count)

    def runs_dataset(self, designs: Sequence[str]) -> xr.Dataset:
        """Values of every realization, labelled."""
        known = {k: v for k, v in self.runs.items() if k in RUNS}
        data = labelled(known, ("design", "realization"), {"design": list(designs)}, RUNS)
        rest = {k: v for k, v in self.runs.items() if k not in RUNS}
        return data.assign(labelled(rest, ("design", "realization"), {"design": list(designs)}).data_vars)

    def statistics_dataset(self, designs: Sequence[str], t: Array) -> xr.Dataset:
        """Statistics over the realizations at every epoch, labelled.

        Parameters
        ----------
        designs : sequence of str
        t : (time,) array
            s.
        """
        arrays, described = {}, {}
        for name, (dims, told, unit, meaning) in _SUMS.items():
            if name in self.sums:
                divisor = np.maximum(self.sums["block_known"], 1.0) if name == "block_nees" else self.count
                share = self.sums[name] / divisor
                if name == "block_nees":
                    share = np.where(self.sums["block_known"] > 0, share, np.nan)
                arrays[told] = np.sqrt(share) if told.endswith("_rms") else share
                described[told] = (dims, unit, meaning)
        found = quantiles(self.sketch, LEVELS).reshape(len(LEVELS), len(SKETCHED), len(designs), t.size)
        for k, name in enumerate(SKETCHED):
            arrays[f"{name}_quantile"] = np.moveaxis(found[:, k], 0, 1)
            described[f"{name}_quantile"] = (("level", "time"), "m", f"quantiles of the {name} error, to 1 %")
        return labelled(arrays, ("design",), {"design": list(designs), "time": t, "level": LEVELS}, described)


def tally(flown: Mapping[str, NDArray[Any]], t: Array, outages: Sequence[tuple[float, float]]) -> Tally:
    """What is kept of one realization.

    Parameters
    ----------
    flown : mapping of name to (design, ...) array
        Variables of :data:`insemu.evaluate.dataset.VARIABLES`, not necessarily all.
    t : (time,) array
        Output epochs, s.
    outages : sequence of (start_s, duration_s)
    """
    runs: dict[str, Array] = {name: flown[name] for name in _SCALARS if name in flown}
    sums: dict[str, Array] = {}
    error, sigma = flown["error"], flown.get("sigma")
    ends = [end_index(t, outage) for outage in outages]
    runs["end_error"] = error[:, ends]
    runs |= {k: v for k, v in _during(error, t, outages).items() if k in RUNS}
    sums |= {"error": error, "error_square": error**2}
    if sigma is not None:
        runs["end_sigma"] = sigma[:, ends]
        runs["stated_position"] = np.linalg.norm(sigma[..., :3], axis=-1).mean(axis=1)
        runs["stated_heading"] = sigma[..., 8].mean(axis=1)
        horizontal = np.hypot(error[..., 0], error[..., 1]) > 3.0 * np.hypot(sigma[..., 0], sigma[..., 1])
        sums |= {"sigma_square": sigma**2, "inside": _inside(error, sigma), "inside_horizontal": 1.0 - horizontal}
    if (major := flown.get("major")) is not None:
        runs["end_major"] = major[:, ends]
    if (nees := flown.get("nees")) is not None:
        runs["end_nees"] = nees[:, ends]
        runs["log_nees"] = np.log(np.maximum(nees, 1e-300)).mean(axis=1)
        sums["nees"] = nees
    if "block_nees" in flown:
        known = np.isfinite(flown["block_nees"])
        sums |= {"block_nees": np.where(known, flown["block_nees"], 0.0), "block_known": known.astype(np.float64)}
    if "axis_sigma" in flown:
        sums["axis_carried"] = (flown["axis_sigma"] > 0).astype(np.float64)
        sums |= {"axis_square": flown["axis_error"] ** 2, "axis_sigma_square": flown["axis_sigma"] ** 2}
    if "observability" in flown:
        sums["observability"] = flown["observability"]
    if (smoothed := flown.get("smoothed_error")) is not None:
        stated = flown["smoothed_sigma"]
        runs |= {f"smoothed_{k}": v for k, v in _during(smoothed, t, outages).items() if f"smoothed_{k}" in RUNS}
        sums |= {"smoothed_square": smoothed**2, "smoothed_sigma_square": stated**2}
        sums |= {"smoothed_inside": _inside(smoothed, stated), "smoothed_nees": flown["smoothed_nees"]}
    sketch = sketched(np.stack([np.hypot(error[..., 0], error[..., 1]), np.abs(error[..., 2])]))
    return Tally(1, {k: np.asarray(v)[:, None] for k, v in runs.items()}, sums, sketch)


def _inside(error: Array, sigma: Array) -> Array:
    """1 inside three sigma, 0 outside, NaN where the error is not known."""
    return np.where(np.isnan(error), np.nan, np.abs(error) <= 3.0 * sigma)


def _during(error: Array, t: Array, outages: Sequence[tuple[float, float]]) -> dict[str, Array]:
    """Figures :data:`DURING` of errors (design, time, 9), (design, outage) each; 0 without epochs."""
    out = {name: np.zeros((len(error), len(outages))) for name in DURING}
    for k, outage in enumerate(outages):
        inside = error[:, within_outage(t, *outage)]
        if inside.size:
            size = np.abs(inside)
            horizontal = np.hypot(inside[..., 0], inside[..., 1])
            out["planimetric_mean_m"][:, k] = horizontal.mean(axis=1)
            out["planimetric_max_m"][:, k] = horizontal.max(axis=1)
            for i, name in enumerate(("north_max_m", "east_max_m", "down_max_m")):
                out[name][:, k] = size[..., i].max(axis=1)
    return out


class _Open:
    """Nodes that follow each other, on the way to a larger one: sums are added at once, values of each realization joined at its end."""

    def __init__(self, begin: int) -> None:
        self.begin, self.count = begin, 0
        self.sums: Mapping[str, Array] = {}
        self.sketch: scipy.sparse.csr_array | None = None
        self.runs: list[dict[str, Array]] = []

    def add(self, node: Tally) -> None:
        self.sums = {k: self.sums[k] + v if self.count else v for k, v in node.sums.items()}
        self.sketch = node.sketch if self.sketch is None else self.sketch + node.sketch
        self.runs.append(dict(node.runs))
        self.count += node.count

    def joined(self) -> Tally:
        """All of them as one; each figure of the parts goes as it is joined, so that there is never twice of everything."""
        assert self.sketch is not None
        parts = self.runs
        runs = (
            parts[0] if len(parts) == 1 else {k: np.concatenate([p.pop(k) for p in parts], axis=1) for k in [*parts[0]]}
        )
        return Tally(self.count, runs, self.sums, self.sketch)


class Ladder:
    """Tallies of realizations that follow each other, added along the tree.

    Parameters
    ----------
    start : int
        Number of the first realization. What follows a start inside a node makes the nodes that it can; a total needs 0.
    made : callable
        Told of every node that is complete: its size, its first realization, itself.
    """

    def __init__(
        self, start: int = 0, made: Callable[[int, int, Tally], None] = lambda size, first, node: None
    ) -> None:
        self._next, self._made = start, made
        self._open: dict[int, _Open] = {}

    def push(self, node: Tally) -> None:
        """Add the next realization, or the next node."""
        first, size = self._next, node.count * BASE
        self._next += node.count
        while True:
            held = self._open.setdefault(size, _Open(first))
            held.add(node)
            if self._next % size:
                return
            del self._open[size]
            if held.begin % size:
                return
            first, node = held.begin, held.joined()
            self._made(size, first, node)
            size *= BASE

    def total(self) -> Tally:
        """Of everything that was pushed; nothing can be pushed any more."""
        whole = _Open(0)
        for size in sorted(self._open, reverse=True):
            whole.add(self._open.pop(size).joined())
        return whole.joined()


def pieces(span: range, held: Callable[[int, int], bool]) -> list[tuple[int, int]]:
    """Cut realizations into the largest nodes that are held, and single ones where none is: (size, first) each, in order.

    Parameters
    ----------
    span : range
    held : callable
        Whether there is a node of this size from this realization on.
    """
    out, r = [], span.start
    while r < span.stop:
        size = BASE
        found = 1
        while r % size == 0 and r + size <= span.stop:
            found = size if held(size, r) else found
            size *= BASE
        out.append((found, r))
        r += found
    return out
