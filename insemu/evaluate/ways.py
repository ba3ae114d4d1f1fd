"""What the designs of a finished run took for the way, for a map."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from insemu import earth
from insemu.errors import InputError
from insemu.formats import Way

#: The file of a run that the ways come from.
ERRORS = "errors.nc"


def ways_of_run(folder: Path, realization: int = 0) -> list[Way]:
    """The reference and, behind it, the way of every design in one realization, with the sigma that it states.

    Parameters
    ----------
    folder : Path
        That ``insemu run`` wrote.
    realization : int
        Its number, from 0.

    Raises
    ------
    InputError
        No such realization; a reference that has no way (the fixes alone).
    """
    import xarray as xr

    with xr.open_dataset(folder / ERRORS, engine="h5netcdf") as data:
        names = [str(v) for v in data["design"].values]
        there = [int(r) for r in data["realization"].values]  # of many realizations some stay with all their epochs
        if realization not in there:
            some = f"0 to {there[-1]}" if there[-1] + 1 == len(there) else f"one of {', '.join(map(str, there))}"
            raise InputError(f"found {realization}, expected {some}", where="--realization")
        row = there.index(realization)
        t = np.asarray(data["time"].values, dtype=np.float64)
        truth = np.asarray(data["reference_llh"].values, dtype=np.float64)
        error, sigma = (np.asarray(data[v].values[:, row, :, :3], dtype=np.float64) for v in ("error", "sigma"))
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    rows = next(iter(summary["designs"].values()))["outages"]
    spans = [(float(r["start_s"]), float(r["start_s"]) + float(r["duration_s"])) for r in rows]
    known = np.isfinite(truth).all(axis=1) & np.isfinite(error).all(axis=(0, 2))
    if known.sum() < 2:
        raise InputError("has no reference of the position, which a map needs", where=str(folder))
    t, truth = t[known], truth[known]
    (north, east), h = earth.radii(truth[:, 0]), truth[:, 2]
    ways = [Way(t, truth, name="reference", outages=spans)]
    for name, e, s in zip(names, error[:, known], sigma[:, known], strict=True):
        llh = truth + np.column_stack([e[:, 0] / (north + h), e[:, 1] / ((east + h) * np.cos(truth[:, 0])), -e[:, 2]])
        ways.append(Way(t, llh, sigma=s, name=name, outages=spans))
    return ways
