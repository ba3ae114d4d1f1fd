"""What any process may have beside its parameters: a name under which axes share it, and a covariate that its level follows."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

from insemu.errors import InputError, shown
from insemu.noise import grammar
from insemu.noise.follow import KEYS, KNOWN, Follows
from insemu.noise.parameters import Parametrised

#: A name that a shared process may have, with the sign by which the axis sees it.
_NAME = re.compile(r"-?[A-Za-z]\w{0,39}")


@dataclass(frozen=True)
class Common(Parametrised):
    """A process as others refer to it, whatever its kind."""

    #: Name that the process has on every axis that sees it, behind a minus where the axis sees it with the other sign; empty: its own.
    shared: str = field(default="", kw_only=True)
    #: Covariate that the level follows; None: it is constant.
    follows: Follows | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_shared()
        if self.follows is not None and not isinstance(self.follows, Follows):
            raise InputError(f"{self.symbol}: follows is {shown(self.follows)}, expected Follows(covariate, slope)")

    def check_shared(self) -> None:
        """Raise ``InputError`` where the name of a shared process is none."""
        if self.shared and not (isinstance(self.shared, str) and _NAME.fullmatch(self.shared)):
            raise InputError(
                f"{self.symbol}: shared is {shown(self.shared)}, expected a name such as warmth, or -warmth for the other sign"
            )

    @property
    def specified(self) -> bool:
        """Whether every parameter has a value, and the slope of a level that follows a covariate."""
        return super().specified and (self.follows is None or self.follows.slope is not None)

    def under(self, covariates: Mapping[str, float]) -> Self:
        """The process at some values of covariates, its level constant."""
        if self.follows is None:
            return self
        gain = self.follows.gain(self.follows.of(covariates, self.symbol))
        return replace(self, follows=None).scaled(float(gain))

    def refuse(self, method: str) -> None:
        """Raise ``InputError`` where an estimator is not defined for the process, with the reason."""
        super().refuse(method)
        if self.follows is not None:
            raise InputError(
                f"{self} follows {self.follows.covariate}; it is fitted to segments of a log with that covariate "
                "(insemu fit --covariate, insemu.fit.fit_following)"
            )

    def common_arguments(self) -> list[str]:
        """The name of a shared process, and how the level follows a covariate, as text of a model has them."""
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
