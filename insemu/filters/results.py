"""What a filter returns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from insemu.augment import StateLayout
from insemu.records import Trajectory
from insemu.strapdown import trajectory_of

Array = NDArray[np.float64]


def log_density(v: Array, S: Array) -> Array:
    """Log densities of rows of ``v`` (k, c) under normal distributions of covariances ``S`` (k, c, c), without the constant."""
    L = np.linalg.cholesky(S)
    z = np.linalg.solve(L, v[:, :, None])[:, :, 0]
    return np.asarray(-0.5 * np.einsum("ki,ki->k", z, z) - np.sum(np.log(np.einsum("kii->ki", L)), axis=1))


@dataclass(frozen=True)
class FixTable:
    """What happened at every fix and aid, with w components: 6, unless an aid has more.

    Parameters
    ----------
    t : (f,) array
        Time of validity, s.
    epoch : (f,) array of int
        IMU row at which it was used. (With an estimated latency, one whose own time had passed already has ``dof`` 0.)
    kind : (f,) array of int
        0: GNSS (components: position north, east, down, velocity); else an aid, see :data:`insemu.filters.aids.CODES`.
    innovation : (f, w) array
        Measured minus predicted, m and m/s; NaN where a component is missing.
    S : (f, w, w) array
        Innovation covariance; NaN in rows and columns of missing components.
    nis : (f,) array
        Normalised innovation squared, chi-square with ``dof`` degrees of freedom.
    dof : (f,) array of int
        Components used; 0 for a fix of NaN.
    accepted : (f,) array of bool
    K : (f, n, w) array, optional
        Gain: the states move by ``K innovation``.
    H : (f, w, n) array, optional
        Derivative of the predicted fix by the errors.
    """

    t: Array
    epoch: NDArray[np.int64]
    kind: NDArray[np.int64]
    innovation: Array
    S: Array
    nis: Array
    dof: NDArray[np.int64]
    accepted: NDArray[np.bool_]
    K: Array | None = None
    H: Array | None = None

    def __len__(self) -> int:
        return self.t.size

    @classmethod
    def joined(cls, parts: Sequence[FixTable]) -> FixTable:
        """Tables of runs that follow each other, without gains; epochs are those of each run."""
        names = [f.name for f in fields(cls) if f.name not in ("K", "H")]
        return cls(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})

    @cached_property
    def complete(self) -> tuple[Array, Array]:
        """Innovations (f, w) and covariances (f, w, w) in which a missing component is a certain zero, which adds nothing to a density."""
        missing = ~np.isfinite(self.innovation)
        S = np.where(missing[:, :, None] | missing[:, None, :], 0.0, self.S)
        return np.where(missing, 0.0, self.innovation), S + missing[:, :, None] * np.eye(S.shape[1])

    @cached_property
    def log_densities(self) -> Array:
        """Log density of every innovation (f,), without the constant; their sum is the log-likelihood of the belief (Schweppe 1965)."""
        return log_density(*self.complete)

    @property
    def rejected(self) -> NDArray[np.int64]:
        """Indices of the fixes that the gate kept out."""
        return np.nonzero(~self.accepted & (self.dof > 0))[0]


@dataclass(frozen=True)
class Nodes:
    """The filter at fixes and at regular times between them: what a smoother needs, and what the gap room reads.

    Parameters
    ----------
    t : (k,) array
    epoch : (k,) array of int
    nav : (k, 10) array
        Navigation state after the update.
    states : (k, n - 9) array
        Estimates of the augmented states, after the update.
    P_before, P_after : (k, n, n) arrays
        Covariance before and after the update.
    Phi : (k, n, n) array
        Transition of the errors from the previous node (for the first, from the start) to this one.
    correction : (k, n) array
        Estimated error that the update took off.
    """

    t: Array
    epoch: NDArray[np.int64]
    nav: Array
    states: Array
    P_before: Array
    P_after: Array
    Phi: Array
    correction: Array

    def __len__(self) -> int:
        return self.t.size


@dataclass(frozen=True)
class FilterResult:
    """What a filter says about one record; see ``docs/filters.md``."""

    layout: StateLayout
    t: Array
    nav: Array
    sigma: Array
    imu_states: Array
    fixes: FixTable
    covariance_t: Array
    covariance: Array
    nodes: Nodes | None
    final_covariance: Array
    epochs: int
    seconds: float

    @classmethod
    def stated(
        cls,
        t: Array,
        nav: Array,
        covariance: Array,
        at: Sequence[float],
        *,
        seconds: float = 0.0,
        epochs: int = 0,
        fixes: FixTable | None = None,
    ) -> FilterResult:
        """What a filter of another kind says: navigation states and their covariance, row by row.

        Parameters
        ----------
        t : (k,) array
            s.
        nav : (k, 10) array
            Latitude, longitude (rad), height (m), velocity NED (m/s), quaternion body to NED.
        covariance : (k, 9, 9) array
            Of position (m north, east, down), velocity and attitude errors, as :func:`insemu.evaluate.navigation_error` defines these.
        at : sequence of float
            ``options.covariance_at``: the rows nearest to these times are kept as covariances.
        seconds, epochs : float, int
            What the run took, and over how many samples.
        fixes : FixTable, optional
            Innovations; without them consistency is judged by the errors alone.
        """
        rows = np.searchsorted(t, np.asarray(at, dtype=np.float64) - 1e-6).clip(0, t.size - 1)
        none = np.zeros(0, dtype=np.int64)
        nothing = FixTable(np.zeros(0), none, none, np.zeros((0, 6)), np.zeros((0, 6, 6)), np.zeros(0), none, none > 0)
        return cls(
            StateLayout.of_navigation(), t, nav, np.sqrt(np.einsum("kii->ki", covariance)), np.zeros((t.size, 0)), fixes or nothing, t[rows],
            covariance[rows], None, covariance[-1], epochs or t.size - 1, seconds,
        )  # fmt: skip

    def fixes_of_nodes(self) -> dict[int, list[int]]:
        """Rows of the fixes by the node at which they were used, in order; a velocity may come within the sample of a position."""
        out: dict[int, list[int]] = {}
        if self.nodes is not None:
            for row, node in enumerate(np.searchsorted(self.nodes.epoch, self.fixes.epoch).tolist()):
                out.setdefault(node, []).append(row)
        return out

    @cached_property
    def trajectory(self) -> Trajectory:
        """The estimated trajectory at the output times."""
        return trajectory_of(self.t, self.nav, "filter")
