"""A level that follows a covariate: noise that depends on temperature, speed, angular rate, specific force or vibration.

Any process may follow one covariate x: the standard deviation of its driving noise and of its white noise is multiplied by a gain g(x), so that
its ``Q`` follows x while its correlation times stay. The level that is written is that at ``x = at``, where the gain is 1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError, nearest, shown
from insemu.noise.block import StateBlock
from insemu.noise.compiled import draws

if TYPE_CHECKING:
    from insemu.noise.process import Process

Array = NDArray[np.float64]
Law = Literal["exp", "power"]

#: Covariates that emulator, filter and recordings know, with their SI units; a log's own columns may have other names.
KNOWN = {"temperature": "degC", "speed": "m/s", "rate": "rad/s", "force": "m/s^2", "vibration": "m/s^2"}
#: Keys of a process that say how it follows, in text and YAML.
KEYS = ("follows", "slope", "at", "law", "above")
#: Largest logarithm of a gain: beyond, a law is far outside the covariates that it was fitted to.
LARGEST_LOG_GAIN = 20.0


@dataclass(frozen=True)
class Follows:
    """How a level follows a covariate.

    Parameters
    ----------
    covariate : str
        One of :data:`KNOWN`, or the name of a column.
    slope : float or None
        b of the law, per SI unit of the covariate (``exp``) or a pure number (``power``); None where it is to be estimated.
    at : float
        Covariate at which the level is the one that is written; None: zero, and a fit takes the mean of the covariate.
    law : {"exp", "power"}
        ``exp``: gain exp(b (x - at)), a level of exp(a + b x). ``power``: gain ((x - above) / (at - above))^b, zero up to ``above``.
    above : float
        Of ``power``: the covariate at which the level vanishes.

    Raises
    ------
    InputError
        A name that is none, a number that is not finite, a power law whose ``at`` is not above ``above``.
    """

    covariate: str
    slope: float | None = None
    at: float | None = None
    law: Law = "exp"
    above: float = 0.0

    def __post_init__(self) -> None:
        if not (isinstance(self.covariate, str) and self.covariate.replace("_", "a").isalnum()):
            raise InputError(
                f"follows is {shown(self.covariate)}, expected a covariate ({', '.join(KNOWN)}) or the name of a column"
            )
        if self.law not in get_args(Law):
            raise InputError(f"law is {shown(self.law)}" + nearest(str(self.law)[:40], get_args(Law)))
        for name in ("slope", "at", "above"):
            value = getattr(self, name)
            if value is not None and not math.isfinite(value):
                raise InputError(f"{name} of {self.covariate} is {value!r}, expected a finite number")
        if self.law == "power" and (self.at is not None or self.slope is not None) and self.origin <= self.above:
            raise InputError(
                f"at of {self.covariate} is {self.origin:g}, expected a value above {self.above:g}, where the level vanishes"
            )
        if self.law == "exp" and self.above:
            raise InputError("found 'above', which belongs to law=power")

    @property
    def origin(self) -> float:
        """Covariate at which the level is the one that is written."""
        return 0.0 if self.at is None else self.at

    @property
    def unit(self) -> str:
        """SI unit of the covariate, nothing where it is a column's."""
        return KNOWN.get(self.covariate, "")

    @property
    def slope_unit(self) -> str:
        """Unit of the slope."""
        return (
            (f"1/({self.unit})" if "/" in self.unit else f"1/{self.unit}") if self.law == "exp" and self.unit else "1"
        )

    def stretched(self, x: ArrayLike) -> Array:
        """What the logarithm of the gain is the slope times of: ``x - at``, of a power law log((x - above) / (at - above))."""
        x = np.asarray(x, dtype=np.float64)
        if self.law == "exp":
            return x - self.origin
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(np.maximum(x - self.above, 0.0) / (self.origin - self.above)))

    def gain(self, x: ArrayLike) -> Array:
        """Factor of the level at covariates ``x``; with a slope of 0 it is 1 everywhere.

        Raises
        ------
        InputError
            The slope is not known; a covariate that is no number, at which no law says a level.
        """
        if self.slope is None:
            raise InputError(f"no slope by which the level follows {self.covariate}; fit the model or give one")
        lost = np.isnan(np.asarray(x, dtype=np.float64))
        if lost.any():
            raise InputError(
                f"{int(lost.sum())} of {lost.size} values of {self.covariate} are no number, the first at row {int(np.argmax(lost))}; "
                "a level that follows it needs all of them"
            )
        with np.errstate(invalid="ignore"):
            u = self.slope * self.stretched(x)
        u = np.where(np.isnan(u), 0.0, u)  # a slope of 0 times an infinite logarithm
        return np.asarray(np.exp(np.minimum(u, LARGEST_LOG_GAIN)))

    def of(self, covariates: Mapping[str, Any] | None, what: str) -> Any:
        """The covariate among some; raises ``InputError`` naming ``what`` cannot go on without it."""
        if covariates is None or self.covariate not in covariates:
            there = f" (there are {', '.join(covariates)})" if covariates else ""
            raise InputError(f"{what} follows {self.covariate}, which is not given{there}")
        return covariates[self.covariate]

    def arguments(self) -> list[str]:
        """As text of a model has it."""
        out = [f"follows={self.covariate}"]
        out += [] if self.slope is None else [f"slope={self.slope!r}"]
        out += [] if self.at is None else [f"at={self.at!r}"]
        return (
            out + ([f"law={self.law}"] if self.law != "exp" else []) + ([f"above={self.above!r}"] if self.above else [])
        )

    def to_mapping(self) -> dict[str, Any]:
        """As plain data for YAML, numbers in SI."""
        out = {"follows": self.covariate, "slope": self.slope, "at": self.at}
        extra = {"law": self.law, "above": self.above} if self.law == "power" else {}
        return {k: v for k, v in (out | extra).items() if v is not None}


def fill(out: Array, block: StateBlock, gain: Array, rng: np.random.Generator) -> None:
    """Overwrite ``out`` with a draw of a state block whose noise is multiplied by a gain, sample by sample.

    Parameters
    ----------
    out : (n,) array
    block : StateBlock
        At gain 1.
    gain : (n,) or (1,) array
        Factor of the standard deviation of what drives sample k, and of its white noise, or of all; the start has the first.
    rng : Generator
    """
    root_Q, root_P = block.roots()
    state = gain[0] * (root_P @ rng.standard_normal(block.n))
    draws.standard_normal(out, rng)
    out *= math.sqrt(block.white) * gain
    draws.driven(out, np.array(block.Phi), root_Q, np.array(block.c), state, np.ascontiguousarray(gain), rng)


def draw(
    process: Process, out: Array, dt: float, rng: np.random.Generator, covariates: Mapping[str, Array] | None
) -> None:
    """Overwrite ``out`` with a draw of a process, whose level may follow a covariate.

    Parameters
    ----------
    process : Process
    out : (n,) array
    dt : float
        Sampling interval, s.
    rng : Generator
    covariates : mapping of str to (n,) array, or None
        What levels follow, SI.

    Raises
    ------
    InputError
        A process that follows a covariate and has no driving noise of its own, or the covariate is not given.
    """
    if process.follows is None:
        process.fill(out, dt, rng)
    elif process.single_draw or not process.own_block:
        raise InputError(
            f"{process} cannot be drawn: it has no driving noise of its own whose level could follow; expected GM, WN, RW, ..."
        )
    else:
        gain = process.follows.gain(process.follows.of(covariates, process.symbol))
        fill(out, process.block(dt), gain, rng)
