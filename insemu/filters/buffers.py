"""Arrays that the compiled loop fills, and the result that is made of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insemu import lanes
from insemu.augment import StateLayout
from insemu.filters.events import Events
from insemu.filters.options import FilterOptions
from insemu.filters.results import FilterResult, FixTable, Nodes

Array = NDArray[np.float64]


class Buffers(NamedTuple):
    """Arrays that a compiled loop overwrites.

    Parameters
    ----------
    nav, var, x : (rows, 10), (rows, n), (rows, m) arrays
        Navigation state, variances, estimates of the augmented states.
    nu, S, nis, dof, ok, epoch : (f, w), (f, w, w), (f,), (f,), (f,), (f,) arrays
        Where an event is used: innovation, its covariance, normalised innovation squared, number of components, whether it was accepted, epoch.
    K, H : (f, n, w), (f, w, n) arrays
        Gain and measurement matrix. Where no nodes are stored only the first gain is used, as working space.
    P : (covariances, n, n) array
        The whole covariance at asked epochs.
    node_at, node_nav, node_x, node_dx : (nodes,), (nodes, 10), (nodes, m), (nodes, n) arrays
        Epoch, states after the measurements, and the errors that the measurements took off.
    before, after, phi : (nodes, n, n) arrays
        Covariance before and after the measurements, transition from the node before.
    last : (n, n) array
        Covariance at the end.
    """

    nav: Array
    var: Array
    x: Array
    nu: Array
    S: Array
    nis: Array
    dof: Array
    ok: Array
    epoch: NDArray[np.int64]
    K: Array
    H: Array
    P: Array
    node_at: NDArray[np.int64]
    node_nav: Array
    node_x: Array
    node_dx: Array
    before: Array
    after: Array
    phi: Array
    last: Array

    @classmethod
    def of(
        cls,
        n: int,
        epochs: int,
        o: FilterOptions,
        events: Events,
        covariances: int,
        nodes: int,
        *,
        side_by_side: bool = False,
    ) -> Buffers:
        """Arrays for ``n`` states, so many epochs, whole covariances and nodes next to those of fixes; of lanes for several realizations."""
        f, w = events.z.shape
        stored = o.store == "fixes"
        rows = o.rows(epochs).size
        kept, g = (nodes + f, f) if stored else (0, 1)
        m = n - 9

        def room(*shape: int) -> Array:
            return lanes.empty((*shape, lanes.LANES)) if side_by_side else np.empty(shape)

        nu, S, nis, dof, ok = room(f, w), room(f, w, w), room(f), room(f), room(f)
        K, H = room(g, n, w), room(g, w, n)
        for values in (nu, S, nis, K, H):
            values.fill(np.nan)
        for values in (dof, ok):
            values.fill(0.0)
        before, after, phi = (room(kept, n, n) for _ in range(3))
        return cls(
            room(rows, 10), room(rows, n), room(rows, m), nu, S, nis, dof, ok, events.epoch.copy(), K, H, room(covariances, n, n),
            np.zeros(kept, dtype=np.int64), room(kept, 10), room(kept, m), room(kept, n), before, after, phi, room(n, n),
        )  # fmt: skip

    def of_lane(self, lane: int, rows: NDArray[np.int64]) -> Buffers:
        """Those of one realization of several, with the rows of its own events."""
        one = self._of(lambda v: np.ascontiguousarray(v[..., lane]))
        if rows.size == one.dof.size:
            return one
        return one._replace(**{k: getattr(one, k)[rows] for k in ("nu", "S", "nis", "dof", "ok", "epoch")})

    def in_lanes(self) -> Buffers:
        """As compiled code takes them for several realizations."""
        return self._of(lanes.lanes_of)

    def _of(self, change: Callable[[Array], Array]) -> Buffers:
        """With its numbers, not its integers, replaced by a function of them."""
        changed: dict[str, Any] = {k: change(v) for k, v in self._asdict().items() if v.dtype.kind == "f"}
        return self._replace(**changed)

    def result(
        self,
        layout: StateLayout,
        t: Array,
        o: FilterOptions,
        events: Events,
        cov_epoch: NDArray[np.int64],
        nodes: int,
        seconds: float,
    ) -> FilterResult:
        """What the filter returns.

        Parameters
        ----------
        layout : StateLayout
        t : (n,) array
            Epochs, s.
        o : FilterOptions
        events : Events
        cov_epoch : (k,) array of int
            Epochs of whole covariances.
        nodes : int
            How many were stored.
        seconds : float
            How long it took.
        """
        stored = o.store == "fixes"
        K, H = (self.K, self.H) if stored else (None, None)
        fixes = FixTable(
            events.t,
            self.epoch,
            events.kind,
            self.nu,
            self.S,
            self.nis,
            self.dof.astype(np.int64),
            self.ok.astype(bool),
            K,
            H,
        )
        at = self.node_at[:nodes]
        kept = (v[:nodes] for v in (self.node_nav, self.node_x, self.before, self.after, self.phi, self.node_dx))
        return FilterResult(
            layout=layout,
            t=t[o.rows(t.size)],
            nav=self.nav,
            sigma=np.sqrt(np.maximum(self.var, 0.0, out=self.var), out=self.var),
            imu_states=self.x,
            fixes=fixes,
            covariance_t=t[cov_epoch],
            covariance=self.P,
            nodes=Nodes(t[at], at, *kept) if stored else None,
            final_covariance=self.last,
            epochs=t.size - 1,
            seconds=seconds,
        )
