"""The labelled dataset of an experiment: from one flown realization to the cache, to the results, to ``errors.nc``."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.evaluate.consistency import BLOCKS
from insemu.evaluate.errors import COMPONENT_UNITS, COMPONENTS
from insemu.records import AXES

if TYPE_CHECKING:
    import xarray as xr


#: Name to dimensions (of one design in one realization), unit and meaning. Angles rad, errors estimate minus truth.
VARIABLES: Mapping[str, tuple[tuple[str, ...], str, str]] = {
    "error": (("time", "component"), "SI", "navigation error, estimate minus truth"),
    "sigma": (("time", "component"), "SI", "standard deviation the filter states"),
    "nees": (("time",), "1", "normalised squared error of the nine navigation states, scaled to nine where fewer have a reference"),
    "major": (("time",), "m", "standard deviation of the horizontal position that the filter states, along the axis in which it is largest"),
    "smoothed_error": (("time", "component"), "SI", "error after smoothing"),
    "smoothed_sigma": (("time", "component"), "SI", "standard deviation the smoother states"),
    "smoothed_nees": (("time",), "1", "normalised squared error after smoothing"),
    "block_nees": (("block", "time"), "1", "NEES per degree of freedom; NaN where the truth is not known"),
    "smoothed_major": (("time",), "m", "the same of the smoother"),
    "axis_error": (("time", "axis"), "rad/s, m/s^2", "estimated minus true sensor error without white noise"),
    "axis_sigma": (("time", "axis"), "rad/s, m/s^2", "its standard deviation that the filter states"),
    "observability": (("time", "state"), "1", "share of the variance of a state behind the nine that the fixes have removed"),
    "state_name": (("state",), "", "names of these states; empty where a design has fewer"),
    "states": ((), "1", "number of states of the filter"),
    "nis": ((), "1", "sum of the normalised innovations squared over the accepted fixes"),
    "dof": ((), "1", "their degrees of freedom"),
    "lag_sum": (("lag",), "1", "sums of products of normalised innovations one and more fixes apart"),
    "lag_count": (("lag",), "1", "how many products there are"),
    "rejected": ((), "1", "fixes and standstill updates that the gate kept out"),
    "fixes": ((), "1", "fixes and standstill updates with any component"),
    "epochs": ((), "1", "IMU epochs filtered"),
}  # fmt: skip
#: Labels of the dimensions that are the same in every experiment.
LABELS: Mapping[str, Sequence[str]] = {"component": COMPONENTS, "block": BLOCKS, "axis": AXES}


def bytes_per_epoch(*, states: int, smoother: bool) -> int:
    """Memory of one epoch of one design in one realization.

    Parameters
    ----------
    states : int
        Behind the nine of the navigation.
    smoother : bool
        Whether the run is smoothed, too.
    """
    sizes = {"time": 1, "state": states, **{dim: len(labels) for dim, labels in LABELS.items()}}
    return sum(
        8 * prod(sizes[dim] for dim in dims)
        for name, (dims, _, _) in VARIABLES.items()
        if "time" in dims and (smoother or not name.startswith("smoothed"))
    )


def labelled(
    arrays: Mapping[str, ArrayLike],
    leading: Sequence[str],
    labels: Mapping[str, Any],
    variables: Mapping[str, tuple[tuple[str, ...], str, str]] = VARIABLES,
) -> xr.Dataset:
    """Arrays as a dataset.

    Parameters
    ----------
    arrays : mapping
        Some of ``variables``; each has the ``leading`` dimensions before its own.
    leading : sequence of str
        For example ``("design", "realization")``.
    labels : mapping of dimension to labels
        Besides :data:`LABELS`.
    variables : mapping
        Name to dimensions behind the leading ones, unit and meaning.
    """
    import xarray as xr

    said = {name: variables[name] for name in arrays}
    made = {
        name: ((*leading, *dims), np.asarray(arrays[name]), {"long_name": meaning, "units": unit})
        for name, (dims, unit, meaning) in said.items()
    }
    used = dict.fromkeys(dim for dims, _, _ in made.values() for dim in dims)
    coords: dict[str, Any] = {dim: list(values) for dim, values in {**LABELS, **labels}.items() if dim in used}
    if "component" in used:
        coords["component_unit"] = ("component", list(COMPONENT_UNITS))
    data = xr.Dataset(made, coords)
    if "time" in data.coords:
        data["time"].attrs["units"] = "s"
    return data


def of_designs(flown: Mapping[str, Mapping[str, Any]], t: NDArray[np.float64]) -> xr.Dataset:
    """One realization.

    Parameters
    ----------
    flown : mapping of design to arrays
        The variables of each; augmented states may differ in number and are filled up.
    t : (time,) array
        Output epochs, s.
    """
    widest = max(len(arrays["state_name"]) for arrays in flown.values())
    stacked: dict[str, list[Any]] = {}
    for arrays in flown.values():
        missing = widest - len(arrays["state_name"])
        for name, values in arrays.items():
            if name == "observability":
                values = np.pad(values, ((0, 0), (0, missing)), constant_values=np.nan)
            elif name == "state_name":
                values = [*values, *[""] * missing]
            stacked.setdefault(name, []).append(values)
    return labelled(stacked, ("design",), {"design": list(flown), "time": t})


def of_realizations(items: Mapping[int, xr.Dataset]) -> xr.Dataset:
    """Realizations by their number, ``design`` first; what never differs between them stands once."""
    import xarray as xr

    once = ["states", "state_name"]
    data = xr.concat([item.drop_vars(once) for item in items.values()], dim="realization", join="exact")
    first = next(iter(items.values()))
    data = data.assign({name: first[name] for name in once}).assign_coords(realization=np.array(list(items)))
    return data.transpose("design", "realization", ...)


def to_bytes(data: xr.Dataset) -> bytes:
    """A realization as it is kept."""
    arrays = {name: data[name].to_numpy() for name in data.data_vars}
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **{str(k): v for k, v in arrays.items()}, **_index(data))
    return stream.getvalue()


def _index(data: xr.Dataset) -> dict[str, NDArray[Any]]:
    return {f"label {dim}": data[dim].to_numpy() for dim in ("design", "time")}


def of_bytes(content: bytes) -> xr.Dataset:
    """The inverse of :func:`to_bytes`; raises ``ValueError`` or ``KeyError`` where it is something else."""
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    labels = {name.removeprefix("label "): arrays.pop(name) for name in list(arrays) if name.startswith("label ")}
    return labelled(arrays, ("design",), labels)
