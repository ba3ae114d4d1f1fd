"""Arrays that the compiled loop fills, and the result that is made of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu import lanes
from insemu.augment import StateLayout
from insemu.filters.events import Events
from insemu.filters.options import FilterOptions
from insemu.filters.results import FilterResult, FixTable, Nodes

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Buffers:
    """Arrays that the compiled loop fills."""

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
        one = replace(
            self, **{k: np.ascontiguousarray(v[..., lane]) for k, v in vars(self).items() if v.dtype.kind == "f"}
        )
        if rows.size == one.dof.size:
            return one
        return replace(one, **{k: getattr(one, k)[rows] for k in ("nu", "S", "nis", "dof", "ok", "epoch")})

    def passed(self, side_by_side: bool) -> dict[str, Any]:
        """As compiled code takes them."""
        return {k: lanes.lanes_of(v) if side_by_side and v.dtype.kind == "f" else v for k, v in vars(self).items()}

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
