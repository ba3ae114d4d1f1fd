"""The search for the minimum of the GMWM's distance: screening of starting points, then refinement of the best.

The model's curve is linear in one variance per process, so the search runs over correlation times and other shapes only, from every
combination on a coarse grid ranked by the flattened distance (34) of Stebler et al. 2014 and by the weighted one; the best of both are refined. That
is a search of the whole space at a cost of milliseconds, and why no start needs to be given.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from insemu.fit import _kernel
from insemu.fit.structure import Structure
from insemu.noise import NoiseModel

Array = NDArray[np.float64]

#: Refinements that the two rankings of starting points get each.
REFINED = 8


@dataclass(frozen=True)
class Solution:
    """A minimum: coefficients, shapes, weighted squared distance, whether the search ended by itself."""

    coefficients: Array
    shapes: Array
    objective: float
    converged: bool


def root_of_inverse(covariance: Array) -> Array:
    """A matrix W with W' W the inverse of a covariance; directions below 1e-10 in correlation are left out."""
    scale = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    keep = values > 1e-10 * values[-1]
    return np.ascontiguousarray((vectors[:, keep] / np.sqrt(values[keep])).T / scale)


@dataclass(frozen=True)
class Problem:
    """A structure, and the part of a curve that it is fitted to.

    Parameters
    ----------
    structure : Structure
    scale : (J,) array of int
        Scales in samples.
    value : (J,) array
        The curve, unit^2.
    n : int
        Samples of the record.
    """

    structure: Structure
    scale: NDArray[np.int64]
    value: Array
    n: int

    def model(self, at: Solution) -> NoiseModel:
        """The model at a solution."""
        return self.structure.specified(at.coefficients, at.shapes)

    def fitted(self, at: Solution) -> Array:
        """The curve (J,) at a solution."""
        return np.asarray(self.structure.columns(self.scale / 2.0, at.shapes)[0] @ at.coefficients)

    def alive(self, at: Solution) -> int:
        """Free parameters of the parts that have variance: a parameter at zero is not fitted, and neither is its shape."""
        s = self.structure
        parts = np.flatnonzero(at.coefficients > 0)
        held = [np.isnan(s.held[s.offsets[k] : s.offsets[k + 1]]).sum() for k in parts]
        return int((s.fixed[parts] < 0).sum() + sum(held))

    def rows(self, which: NDArray[np.bool_]) -> Problem:
        """The same at some of the scales."""
        return replace(self, scale=self.scale[which], value=self.value[which])

    def search(self, W: Array, starts: Array, *, refined: int = REFINED, flattened: bool = True) -> Solution:
        """Minimise ``|W (value - model)|^2`` from the best of ``starts``.

        Parameters
        ----------
        W : (rows, J) array
        starts : (s, shapes) array
        refined : int
            How many of each ranking are refined.
        flattened : bool
            Also rank by equation (34).
        """
        structure = self.structure
        m = self.scale / 2.0
        y = W @ self.value
        size = float(y @ y)
        unit = np.where(structure.fixed < 0, -1.0, structure.fixed)
        low, high = structure.bounds(self.n)
        rank = np.empty(starts.shape[0])
        parts = (structure.curves, structure.orders, structure.offsets, unit, m)
        chosen: list[int] = []
        if starts.shape[0] <= refined:
            chosen = list(range(starts.shape[0]))
        else:
            rankings = [(W, y)]
            if flattened:
                rankings.append((np.diag(1.0 / self.value), np.ones(self.value.size)))
            for rows, target in rankings:
                _kernel.screen(_kernel.Separable(*parts, np.ascontiguousarray(rows), target), starts, rank)
                order = np.argsort(rank, kind="stable")
                best = rank[order[0]]
                for i in order[:refined]:
                    if int(i) not in chosen and rank[i] <= 1e3 * best + 1e-6 * size:
                        chosen.append(int(i))
        whole = _kernel.Separable(*parts, W, y)
        found: Solution | None = None
        for i in chosen:
            s, x = starts[i].copy(), np.zeros(structure.curves.size)
            objective, iterations = _kernel.refine(whole, s, low, high, x, 200)
            if found is None or objective < found.objective:
                found = Solution(x, s, objective, iterations >= 0)
        assert found is not None
        if not found.converged:
            s, x = found.shapes.copy(), np.zeros(structure.curves.size)
            objective, iterations = _kernel.refine(whole, s, low, high, x, 3000)
            found = Solution(x, s, objective, iterations >= 0)
        coefficients, shapes = structure.sort(found.coefficients, found.shapes)
        return Solution(coefficients, shapes, found.objective, found.converged)
