"""A level or correlation times that follow a covariate: noise that depends on temperature, speed, angular rate, specific force or vibration.

Any process may follow one covariate x by a gain g(x), which is 1 at ``x = at``: what is written holds there. What follows is one of two:

- its level (``what=level``): the standard deviation of its driving noise and of its white noise is multiplied by g(x), so that its ``Q`` follows x
  while its correlation times stay;
- its correlation times (``what=time``, of GM, AR1 and AR): the time in which each pole forgets is multiplied by g(x), so that its ``Phi``
  follows x. A pole p becomes ``p |p|^(1/g - 1)``: its angle, the frequency of a pair, stays, and the process is stationary at any x. The other
  parameters stay as they are written: of GM the standard deviation, of AR1 and AR the innovation variance (the non-stationary AR1 of Balamuta et al.
  2016, section IV-B, with ``rho(x) = exp(-exp(-a - b x))``).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
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
What = Literal["level", "time"]

#: Covariates that emulator, filter and recordings know, with their SI units; a log's own columns may have other names.
KNOWN = {"temperature": "degC", "speed": "m/s", "rate": "rad/s", "force": "m/s^2", "vibration": "m/s^2"}
#: Keys of a process that say how it follows, in text and YAML.
KEYS = ("follows", "slope", "at", "law", "above", "what")
#: Largest logarithm of a gain: beyond, a law is far outside the covariates that it was fitted to.
LARGEST_LOG_GAIN = 20.0
#: The same of correlation times, in both directions: 400 times shorter or longer.
LARGEST_LOG_TIME = 6.0


@dataclass(frozen=True)
class Follows:
    """How a level or the correlation times of a process follow a covariate.

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
    what : {"level", "time"}
        What is multiplied by the gain: the level, or the correlation times.

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
    what: What = "level"

    def __post_init__(self) -> None:
        if not (isinstance(self.covariate, str) and self.covariate.replace("_", "a").isalnum()):
            raise InputError(
                f"follows is {shown(self.covariate)}, expected a covariate ({', '.join(KNOWN)}) or the name of a column"
            )
        if self.law not in get_args(Law):
            raise InputError(f"law is {shown(self.law)}" + nearest(str(self.law)[:40], get_args(Law)))
        if self.what not in get_args(What):
            raise InputError(f"what is {shown(self.what)}" + nearest(str(self.what)[:40], get_args(What)))
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
        """Factor of what follows at covariates ``x``; with a slope of 0 it is 1 everywhere.

        Raises
        ------
        InputError
            The slope is not known; a covariate that is no number, at which no law says anything.
        """
        if self.slope is None:
            raise InputError(f"no slope by which the {self.what} follows {self.covariate}; fit the model or give one")
        lost = np.isnan(np.asarray(x, dtype=np.float64))
        if lost.any():
            raise InputError(
                f"{int(lost.sum())} of {lost.size} values of {self.covariate} are no number, the first at row {int(np.argmax(lost))}; "
                f"a {self.what} that follows it needs all of them"
            )
        with np.errstate(invalid="ignore"):
            u = self.slope * self.stretched(x)
        u = np.where(np.isnan(u), 0.0, u)  # a slope of 0 times an infinite logarithm
        if self.what == "time":
            return np.asarray(np.exp(np.clip(u, -LARGEST_LOG_TIME, LARGEST_LOG_TIME)))
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
        out += [f"law={self.law}"] if self.law != "exp" else []
        out += [f"above={self.above!r}"] if self.above else []
        return out + ([f"what={self.what}"] if self.what != "level" else [])

    def to_mapping(self) -> dict[str, Any]:
        """As plain data for YAML, numbers in SI."""
        out = {"follows": self.covariate, "slope": self.slope, "at": self.at}
        extra: dict[str, Any] = {"law": self.law, "above": self.above} if self.law == "power" else {}
        extra |= {"what": self.what} if self.what != "level" else {}
        return {k: v for k, v in (out | extra).items() if v is not None}


def require_constant(models: Iterable[Iterable[Process]], what: str) -> None:
    """Raise ``InputError`` where a process of some models follows a covariate, which ``what`` does not know."""
    for model in models:
        for process in model:
            if process.follows is not None:
                raise InputError(
                    f"{what} takes constant noise, and {process} follows {process.follows.covariate}; "
                    f"write it as it is at one {process.follows.covariate} (in Python NoiseModel.under)"
                )


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


#: Samples that a draw with moving coefficients holds the transitions of.
_PIECE = 65_536


def fill_timed(out: Array, process: Process, dt: float, gain: Array, rng: np.random.Generator) -> None:
    """Overwrite ``out`` with a draw of a process whose correlation times are multiplied by a gain, sample by sample.

    Parameters
    ----------
    out : (n,) array
    process : Process
        At gain 1.
    dt : float
        Sampling interval, s.
    gain : (n,) or (1,) array
        Factor of the correlation times at sample k, or at all; it starts as it would be at the first for ever.
    rng : Generator
    """
    gain = np.broadcast_to(gain, out.shape)
    block = process.slowed(float(gain[0])).carried(dt)
    state = block.roots()[1] @ rng.standard_normal(block.n)
    c = np.array(block.c)
    out[0] = c @ state
    for first in range(1, out.size, _PIECE):
        rows = slice(first, min(first + _PIECE, out.size))
        Phi, drive, scale = process.timed(gain[rows], dt)
        draws.moved(out[rows], Phi, drive, scale, c, state, rng)


def draw(
    process: Process, out: Array, dt: float, rng: np.random.Generator, covariates: Mapping[str, Array] | None
) -> None:
    """Overwrite ``out`` with a draw of a process, whose level or correlation times may follow a covariate.

    Parameters
    ----------
    process : Process
    out : (n,) array
    dt : float
        Sampling interval, s.
    rng : Generator
    covariates : mapping of str to (n,) array, or None
        What processes follow, SI.

    Raises
    ------
    InputError
        A process that follows a covariate and has no driving noise of its own, or the covariate is not given.
    """
    if process.follows is None:
        process.source(out.size, dt, rng)(out)
    elif process.single_draw or not process.own_block:
        raise InputError(
            f"{process} cannot be drawn: it has no driving noise of its own whose level could follow; expected GM, WN, RW, ..."
        )
    else:
        gain = np.atleast_1d(process.follows.gain(process.follows.of(covariates, process.symbol)))
        if process.follows.what == "time":
            fill_timed(out, process, dt, gain, rng)
        else:
            fill(out, process.block(dt), gain, rng)
