"""What a filter has to offer to take part in experiments, comparisons and regression checks, and how a user's own filter is found."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Protocol, runtime_checkable

from numpy.typing import ArrayLike

from insemu.errors import InputError, nearest
from insemu.filters.ekf import FilterResult, InitialSigma
from insemu.records import GnssRecord, ImuRecord, Trajectory
from insemu.strapdown import NavState

#: Group of entry points under which packages offer their filters.
GROUP = "insemu.filters"


@runtime_checkable
class NavigationFilter(Protocol):
    """A filter: it gets records and a start, never the truth, and says where it was and how well it knows that.

    :class:`~insemu.filters.ekf.LooselyCoupledEKF` is one. The result's first nine states are position (metres north, east, down), velocity and
    attitude errors; its ``covariance`` at the asked epochs and its ``fixes`` are what consistency is judged by.
    """

    def run(
        self,
        imu: ImuRecord,
        gnss: GnssRecord | None,
        initial: NavState | Trajectory,
        initial_sigma: InitialSigma | ArrayLike,
    ) -> FilterResult:
        """Filter one record; called from several threads at a time."""
        ...


def user_filter(name: str) -> type[NavigationFilter]:
    """The class that an installed package offers under this name.

    A package offers one in its ``pyproject.toml``::

        [project.entry-points."insemu.filters"]
        mine = "my_package.filters:MyFilter"

    The name comes from a scenario; the code only ever from an installed package.

    Raises
    ------
    InputError
        No such entry point, or a class without the method ``run``.
    """
    offered = {e.name: e for e in entry_points(group=GROUP)}
    if name not in offered:
        hint = nearest(name, offered) if offered else f" (no installed package offers any under '{GROUP}')"
        raise InputError(f"no filter '{name}'" + hint)
    found = offered[name].load()
    if not callable(getattr(found, "run", None)):
        raise InputError(
            f"the filter '{name}' ({offered[name].value}) has no method run(imu, gnss, initial, initial_sigma)"
        )
    return found
