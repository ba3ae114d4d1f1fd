"""Parameters of a belief that make the innovations of a filter most likely, by Fisher scoring.

The innovations of an extended Kalman filter are nearly white and normal where its belief is right, so that their density is the likelihood of
the belief (Mehra 1970; Bar-Shalom et al. 2001, section 5.5). Its Fisher information follows from the derivatives of the innovations and of
their covariance, which a run of the filter for every parameter gives.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.filters.results import FixTable, log_density

Array = NDArray[np.float64]

#: Step of a parameter in a derivative, and the length of a step at which the search ends.
STEP, CLOSE = 1e-3, 0.01
#: Steps of the search at the most.
MOST_STEPS = 25
#: Largest change of a parameter in one step: a factor e where parameters are logarithms.
REACH = 1.0
#: A step is halved so often at the most before the search ends where it stands.
HALVINGS = 6
#: Innovations of a filter that is wrong in its model are not independent; scores are summed over so many seconds before they are squared.
BLOCK_S = 30.0


@dataclass(frozen=True)
class Innovations:
    """Innovations with their covariances, components that are missing made certain zeros."""

    t: Array
    nu: Array
    S: Array

    @classmethod
    def of(cls, fixes: FixTable) -> Innovations:
        """From a filter's table of fixes."""
        return cls(fixes.t, *fixes.complete)

    def rows(self, keep: NDArray[np.bool_]) -> Innovations:
        """Some of them."""
        return Innovations(self.t[keep], self.nu[keep], self.S[keep])

    def log_density(self) -> Array:
        """Log density of every fix, (f,), but for its constant."""
        return log_density(self.nu, self.S)


Run = Callable[[Array], Innovations]


@dataclass(frozen=True)
class Likeliest:
    """The most likely parameters (p,), the innovations there, and the log posterior."""

    x: Array
    innovations: Innovations
    value: float


def likeliest(run: Run, start: Array, sd: float, least: Array | None = None) -> Likeliest:
    """Search for the most likely parameters under a normal prior around zero.

    Parameters
    ----------
    run : callable
        Parameters (p,) to the innovations of the filter, the same fixes whatever the parameters; raises ``InputError`` where it diverges.
    start : (p,) array
        Where the search begins.
    sd : float
        Standard deviation of the prior of every parameter.
    least : (p,) array, optional
        What no parameter is smaller than.

    Raises
    ------
    InputError
        The filter does not run at the start.
    """
    low = np.full(start.size, -np.inf) if least is None else least

    def posterior(there: Innovations, x: Array) -> float:
        return float(there.log_density().sum() - 0.5 * (x / sd) @ (x / sd))

    x = np.maximum(start, low)
    here = run(x)
    value = posterior(here, x)
    for _ in range(MOST_STEPS):
        scores, information = _scores(here, _stepped(run, x))
        uphill = scores.sum(axis=0) - x / sd**2
        free = (x > low) | (uphill > 0.0)
        bent = information + np.eye(x.size) / sd**2
        move = np.zeros(x.size)
        move[free] = np.linalg.solve(bent[np.ix_(free, free)], uphill[free])
        move *= min(1.0, REACH / max(float(np.abs(move).max()), 1e-12))
        for _ in range(HALVINGS):
            to = np.maximum(x + move, low)
            try:
                there = run(to)
                new = posterior(there, to)
            except InputError:  # too far: the filter diverges there
                new = -np.inf
            if new > value:
                break
            move = 0.5 * move
        else:
            break
        length = float(np.abs(to - x).max())
        x, here, value = to, there, new
        if length < CLOSE:
            break
    return Likeliest(x, here, value)


def uncertainty(run: Run, found: Likeliest, sd: float) -> Array:
    """Covariance of likeliest parameters: the larger of the inverse information and of the sandwich of the scores (White 1982).

    Parameters
    ----------
    run : callable
    found : Likeliest
    sd : float
        As in :func:`likeliest`.

    Returns
    -------
    (p, p) array
    """
    here, precision = found.innovations, np.eye(found.x.size) / sd**2
    scores, information = _scores(here, _stepped(run, found.x))
    inverse = np.linalg.inv(information + precision)
    block = ((here.t - here.t[0]) // BLOCK_S).astype(int)
    sums = np.stack([np.bincount(block, s) for s in scores.T], axis=1)
    sandwich = inverse @ (sums.T @ sums + precision) @ inverse
    wider = np.sqrt(np.maximum(np.diag(sandwich) / np.diag(inverse), 1.0))
    return np.asarray(inverse * np.outer(wider, wider))


def _stepped(run: Run, x: Array) -> list[Innovations]:
    return [run(x + STEP * e) for e in np.eye(x.size)]


def _scores(here: Innovations, moved: Sequence[Innovations]) -> tuple[Array, Array]:
    """Scores of every fix (f, p) and the Fisher information (p, p), from runs with one parameter moved by :data:`STEP` each."""
    density = here.log_density()
    scores = np.stack([(m.log_density() - density) / STEP for m in moved], axis=1)
    nu = np.stack([np.linalg.solve(here.S, (m.nu - here.nu)[:, :, None])[:, :, 0] for m in moved], axis=1) / STEP
    S = np.stack([np.linalg.solve(here.S, m.S - here.S) for m in moved], axis=1) / STEP
    change = np.stack([(m.nu - here.nu) / STEP for m in moved], axis=1)
    information = np.einsum("fiw,fjw->ij", nu, change) + 0.5 * np.einsum("fivw,fjwv->ij", S, S)
    return scores, np.asarray(information)
