"""Files of labelled arrays are those that xarray writes, to every reader of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from insemu.evaluate import write_netcdf


def labelled(n: int) -> xr.Dataset:
    rng = np.random.default_rng(n)
    values = rng.standard_normal((n, 2, 3))
    values[0, 1] = np.nan
    return xr.Dataset(
        {
            "error": (("time", "design", "component"), values, {"units": "m", "long_name": "Fehler in °"}),
            "count": ("design", np.array([3, 4]), {"most": 5, "range": [1.0, 2.0]}),
            "used": (("time", "design"), rng.random((n, 2)) > 0.5),
            "label": ("design", ["a", "b ü"]),
            "seed": ((), 7),
            "single": ("time", rng.random(n).astype(np.float32)),
        },
        {
            "time": np.datetime64("2026-01-01", "ns") + np.arange(n) * np.timedelta64(1, "s"),
            "design": ["first", "second"],
            "second": ("time", np.arange(n) / 2.0),
        },
        {"title": "a text", "numbers": [1, 2, 3], "empty": ""},
    )


def test_what_is_written_is_what_xarray_writes(tmp_path: Path) -> None:
    own, theirs = tmp_path / "own.nc", tmp_path / "theirs.nc"
    groups = {"": labelled(5), "runs": labelled(3)}
    write_netcdf(own, groups)
    for name, data in groups.items():
        data.to_netcdf(theirs, engine="h5netcdf", group=name or None, mode="a" if name else "w")
    for name, data in groups.items():
        found, peer = (xr.load_dataset(file, engine="h5netcdf", group=name or None) for file in (own, theirs))
        xr.testing.assert_identical(found, peer)
        assert list(found.variables) == list(peer.variables)
        assert all(found[k].dtype == peer[k].dtype for k in peer.variables)
        np.testing.assert_array_equal(found["error"], data["error"])
