"""What any process may have next to its parameters: a name under which axes share it, and a covariate that it follows."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError, shown
from insemu.noise import grammar
from insemu.noise.follow import KEYS, KNOWN, Follows
from insemu.noise.parameters import Parametrised

#: A name that a shared process may have, with the sign by which the axis sees it.
_NAME = re.compile(r"-?[A-Za-z]\w{0,39}")

_TIMELESS = "{} has no correlation times that could follow a covariate; expected GM, AR1 or AR"
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Common(Parametrised):
    """A process as others refer to it, whatever its kind."""

    #: Whether its correlation times may follow a covariate.
    slows: ClassVar[bool] = False
    #: Name that the process has on every axis that sees it, behind a minus where the axis sees it with the other sign; empty: its own.
    shared: str = field(default="", kw_only=True)
    #: Covariate that the level or the correlation times follow; None: they are constant.
    follows: Follows | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_common()

    def check_common(self) -> None:
        """Raise ``InputError`` where the name of a shared process is none, or the process cannot follow a covariate so."""
        if self.follows is not None and not isinstance(self.follows, Follows):
            raise InputError(f"{self.symbol}: follows is {shown(self.follows)}, expected Follows(covariate, slope)")
        if self.follows is not None and self.follows.what == "time" and not self.slows:
            raise InputError(
                f"{self.symbol}: what=time, but it has no correlation times that could follow {self.follows.covariate}; expected GM, AR1 or AR"
            )
        if self.shared and not (isinstance(self.shared, str) and _NAME.fullmatch(self.shared)):
            raise InputError(
                f"{self.symbol}: shared is {shown(self.shared)}, expected a name such as warmth, or -warmth for the other sign"
            )

    @property
    def specified(self) -> bool:
        """Whether every parameter has a value, and the slope by which it follows a covariate."""
        return super().specified and (self.follows is None or self.follows.slope is not None)

    def unchecked(self, values: Mapping[str, float]) -> Self:
        """The same with these values of parameters that are its own fields, not checked: for a search that asks thousands of times inside bounds.

        A class that does more when it is made than check its parameters is made as always.
        """
        if type(self).__post_init__ is not Common.__post_init__:
            return self.with_parameters(values)
        out = object.__new__(type(self))
        own = vars(self)
        vars(out).update({name: own[name] for name in self.__dataclass_fields__ if name in own} | dict(values))
        return out

    def under(self, covariates: Mapping[str, float]) -> Self:
        """The process at some values of covariates, which follows nothing."""
        if self.follows is None:
            return self
        gain = float(self.follows.gain(self.follows.of(covariates, self.symbol)))
        return self.slowed(gain) if self.follows.what == "time" else replace(self, follows=None).scaled(gain)

    def slowed(self, factor: float) -> Self:
        """The process that follows nothing, its correlation times ``factor`` times as long; raises ``InputError`` where it has none."""
        raise InputError(_TIMELESS.format(self.symbol))

    def timed(self, factor: Array, dt: float) -> tuple[Array, Array, Array]:
        """Steps of ``carried`` where the correlation times are multiplied: ``x_k = Phi_k x_(k-1) + scale_k drive w_k``; c stays.

        Parameters
        ----------
        factor : (n,) array
            Factor of the correlation times at every sample.
        dt : float
            Sampling interval, s.

        Returns
        -------
        Phi, drive, scale : (n, k, k), (k,), (n,) arrays

        Raises
        ------
        InputError
            A process without correlation times that could follow a covariate.
        """
        raise InputError(_TIMELESS.format(self.symbol))

    def refuse(self, method: str) -> None:
        """Raise ``InputError`` where an estimator is not defined for the process, with the reason."""
        super().refuse(method)
        if self.follows is not None:
            raise InputError(
                f"{self} follows {self.follows.covariate}; it is fitted to segments of a log with that covariate "
                "(insemu fit-covariate, insemu.fit.fit_following)"
            )

    def common_arguments(self) -> list[str]:
        """The name of a shared process, and how it follows a covariate, as text of a model has them."""
        shared = [f"shared={self.shared}"] if self.shared else []
        return shared + ([] if self.follows is None else self.follows.arguments())

    def common_mapping(self) -> dict[str, Any]:
        """The same as plain data for YAML."""
        shared = {"shared": self.shared} if self.shared else {}
        return shared | ({} if self.follows is None else self.follows.to_mapping())


def common_keys(given: dict[str, Any]) -> dict[str, Any]:
    """Take the keys that any process may have out of its arguments: ``shared``, and how it follows a covariate."""
    out: dict[str, Any] = {"shared": given.pop("shared", "")}
    found = {key: given.pop(key) for key in KEYS if key in given}
    if "follows" not in found:
        if found:
            raise InputError(f"found '{next(iter(found))}' without 'follows', the covariate that it belongs to")
        return out
    unit = KNOWN.get(found["follows"], "") if isinstance(found["follows"], str) else ""
    for key, of in (("slope", "1"), ("at", unit or "1"), ("above", unit or "1")):
        if key in found:
            found[key] = grammar.quantity(found[key], of, key)
    return out | {"follows": Follows(found.pop("follows"), **found)}
