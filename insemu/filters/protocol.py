"""What a filter has to offer to take part in experiments, comparisons and regression checks, and how a user's own filter is found."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from pkgutil import iter_modules
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError, nearest
from insemu.filters import adapters
from insemu.filters.ekf import LooselyCoupledEKF
from insemu.filters.families import FAMILIES, Family
from insemu.filters.options import FilterOptions, InitialSigma
from insemu.filters.results import FilterResult
from insemu.noise import NoiseModel
from insemu.records import GnssRecord, ImuRecord, Trajectory
from insemu.strapdown import NavState

Array = NDArray[np.float64]


class NotYet(InputError):
    """The estimate of a program that has not yet run on what was written for it."""


#: Group of entry points under which packages offer their filters.
GROUP = "insemu.filters"
#: Filters that come with insemu beside the compiled one, by the name that a scenario gives.
OWN = {
    name: EntryPoint(name, f"insemu.filters.{place}", GROUP)
    for name, place in (
        ("reference", "reference:ReferenceEKF"),
        ("ukf", "unscented:UnscentedKalmanFilter"),
        *((found.name, f"adapters.{found.name}:Adapter") for found in iter_modules(adapters.__path__)),
    )
}


@runtime_checkable
class NavigationFilter(Protocol):
    """A filter: it gets records and a start, never the truth, and says where it was and how well it knows that.

    :class:`~insemu.filters.ekf.LooselyCoupledEKF` is one. A class that a scenario names (``filter: NAME``) is called with the same arguments,
    ``Class(belief, dt, lever_arm=..., gravity=..., gnss_sigma=..., options=..., **settings)``, once per realization: ``belief`` maps axes to
    noise models (those that the design gives), ``options`` is :class:`~insemu.filters.ekf.FilterOptions`, ``settings`` are the design's.

    Where a recording carries further measurements, ``run`` is called with ``aids=`` (:class:`~insemu.records.AidRecord`), too.

    The result's first nine states are position (metres north, east, down), velocity and attitude errors. It has a row of ``nav`` and a
    covariance at every time of ``options.covariance_at``, and its ``fixes`` are what consistency is judged by.
    """

    def run(
        self,
        imu: ImuRecord,
        gnss: GnssRecord | None,
        initial: NavState | Trajectory,
        initial_sigma: InitialSigma | ArrayLike,
    ) -> FilterResult:
        """Filter one record; called from several threads at a time, on an object each."""
        ...


#: Filters of the running program.
REGISTERED: dict[str, type[NavigationFilter]] = {}


def register_filter(name: str, filter: type[NavigationFilter]) -> None:
    """Make a filter of one's own known to scenarios of this program (``filter: NAME``); an installed package offers it by an entry point.

    Raises
    ------
    InputError
        A name that comes with insemu, or a class without the method ``run``.
    """
    if name in {**OWN, **FAMILIES}:
        raise InputError(f"the filter '{name}' comes with insemu, expected another name")
    if not callable(getattr(filter, "run", None)):
        raise InputError(f"the filter '{name}' has no method run(imu, gnss, initial, initial_sigma)")
    REGISTERED[name] = filter


def named_filter(given: str) -> tuple[str, str, dict[str, Any], bool]:
    """A filter as it is asked for on the command line: ``(label, name, settings, correlated)``, name and settings as of a design.

    Parameters
    ----------
    given : str
        A name that a scenario could give; ``path/to/file.py:Class`` or ``package.module:Class``; or a folder through which another program
        gives its estimates (:mod:`insemu.filters.adapters.files`).

    Returns
    -------
    correlated : bool
        Whether the filter states a whole covariance: its attribute ``correlated``, true unless it says otherwise.

    Raises
    ------
    InputError
        No such file, module or class; see :func:`user_filter`.
    """
    settings: dict[str, Any] = {}
    place, _, cls = given.rpartition(":")
    if cls and place:
        path = Path(place)
        try:
            if path.suffix == ".py":
                spec = spec_from_file_location(path.stem, path)
                assert spec is not None and spec.loader is not None
                module = module_from_spec(spec)
                sys.modules[path.stem] = module
                spec.loader.exec_module(module)
            else:
                module = import_module(place)
            register_filter(cls, getattr(module, cls))
        except (ImportError, AttributeError, FileNotFoundError) as error:
            raise InputError(f"the filter cannot be imported: {error}", where=given) from None
        name = label = cls
    elif Path(given).is_dir():
        name, label, settings = "files", Path(given).name, {"folder": given}
    else:
        name = label = given
    kind: Any = LooselyCoupledEKF if name in FAMILIES else user_filter(name)
    return label, name, settings, bool(getattr(kind, "correlated", True))


@dataclass(frozen=True)
class FilterParts:
    """What a filter is made of: the arguments of :class:`~insemu.filters.ekf.LooselyCoupledEKF` and of a user's class."""

    belief: Mapping[str, NoiseModel]
    dt: float
    lever_arm: ArrayLike
    gravity: str
    gnss_sigma: tuple[Array, Array]
    options: FilterOptions

    def made(self, name: str | None, settings: Mapping[str, Any]) -> NavigationFilter:
        """The filter of a name: a family of the compiled filter, one that comes with insemu, or one that an installed package offers.

        Parameters
        ----------
        name : str or None
            None: the extended Kalman filter.
        settings : mapping
            Fields of :class:`~insemu.filters.families.Family`, or keyword arguments of the class.

        Raises
        ------
        InputError
            See :func:`user_filter`; settings that the family or the class does not take.
        """
        if name is None or name in FAMILIES:
            options = replace(self.options, family=Family.named(name or "ekf", settings))
            return LooselyCoupledEKF(**{**vars(self), "options": options})
        offered: Any = user_filter(name)
        try:
            made: NavigationFilter = offered(**vars(self), **settings)
        except TypeError as error:
            raise InputError(
                f"the filter '{name}' cannot be made with its settings ({error}); expected a class that takes belief, dt, lever_arm, gravity, "
                "gnss_sigma, options and the settings"
            ) from None
        return made


def _entry(name: str) -> EntryPoint:
    offered = {e.name: e for e in entry_points(group=GROUP)} | OWN
    if name not in offered:
        known = [*FAMILIES, *offered, *REGISTERED]
        raise InputError(f"no filter '{name}'{nearest(name, known)}; installed packages offer them under '{GROUP}'")
    return offered[name]


def user_filter(name: str) -> type[NavigationFilter]:
    """The class that an installed package offers under this name.

    A package offers one in its ``pyproject.toml``::

        [project.entry-points."insemu.filters"]
        mine = "my_package.filters:MyFilter"

    The name comes from a scenario; the code only ever from an installed package.

    Raises
    ------
    InputError
        No such entry point, one that cannot be imported, or a class without the method ``run``.
    """
    if name in REGISTERED:
        return REGISTERED[name]
    entry = _entry(name)
    try:
        found: type[NavigationFilter] = entry.load()
    except (ImportError, AttributeError) as error:
        extra = f": pip install 'insemu[{name}]'" if name in OWN else ""
        raise InputError(f"the filter '{name}' ({entry.value}) cannot be imported: {error}{extra}") from None
    if not callable(getattr(found, "run", None)):
        raise InputError(f"the filter '{name}' ({entry.value}) has no method run(imu, gnss, initial, initial_sigma)")
    return found


def user_filter_code(name: str) -> dict[str, Path]:
    """The source files that a user's filter stands in, so that results of other code are never taken for those of this one.

    All modules of its top-level package; only those of its own folder where the package has no single place.

    Raises
    ------
    InputError
        See :func:`user_filter`.
    """
    if name in {**OWN, **FAMILIES}:
        return {}  # the package's own code belongs to every experiment
    if name in REGISTERED:  # a script: its own file alone
        own = getattr(sys.modules.get(REGISTERED[name].__module__), "__file__", None)
        return {f"filter {name}": Path(own)} if own else {}
    top = sys.modules.get(user_filter(name).__module__.split(".")[0])
    file = getattr(top, "__file__", None)
    if file is None:
        return {}
    path = Path(file)
    files = sorted(path.parent.rglob("*.py")) if path.name == "__init__.py" else [path]
    return {f"filter {name}: {f.relative_to(path.parent)}": f for f in files if f.is_file()}


def check_result(name: str, run: object, times: Array, *, smoother: bool = False) -> None:
    """Refuse what a user's filter returned where it cannot be judged.

    Parameters
    ----------
    name : str
        Of the filter.
    run : object
        What its ``run`` returned.
    times : (k,) array
        At which it was asked for covariances, s.
    smoother : bool
        Whether nodes were asked for.

    Raises
    ------
    InputError
        Names what is missing.
    """
    who = f"the filter '{name}'"
    if not isinstance(run, FilterResult):
        raise InputError(f"{who} returned {type(run).__name__}, expected a FilterResult")
    for what, have in (("row of nav", run.t), ("covariance", run.covariance_t)):
        at = np.clip(np.searchsorted(have, times - 1e-6), 0, max(len(have) - 1, 0))
        bad = np.ones(times.size, dtype=bool) if len(have) == 0 else np.abs(have[at] - times) > 1e-6
        if bad.any():
            raise InputError(
                f"{who} returned no {what} at {times[bad][0]:g} s, expected one at every options.covariance_at"
            )
    n = run.layout.n
    if n < 9 or run.covariance.shape[1:] != (n, n) or run.nav.shape[1] < 10:
        raise InputError(
            f"{who} returned {n} states, covariances of shape {run.covariance.shape[1:]} and {run.nav.shape[1]} columns of nav, expected nine "
            "navigation states or more, square covariances of all states, and 10 columns"
        )
    if not (np.isfinite(run.nav).all() and np.isfinite(run.covariance[:, :9, :9]).all()):
        raise InputError(f"{who} returned numbers that are not finite")
    if smoother and run.nodes is None:
        raise InputError(f"{who} kept no nodes, which the scenario's smoother needs (options.store is 'fixes')")
