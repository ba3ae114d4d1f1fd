"""What a solution leaves behind: summary, NetCDF, CSV, the recording with the smoothed trajectory, tracks, the models that were taken."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from insemu import formats, noise, rotation
from insemu.errors import InputError
from insemu.evaluate import write_netcdf
from insemu.formats import Way, utc_of, write_table, write_way
from insemu.shown import finite
from insemu.solve.against import Comparison
from insemu.solve.outages import Outages
from insemu.solve.solution import Solution
from insemu.stamps import Origin
from insemu.strapdown import trajectory_of
from insemu.whole import replacing

if TYPE_CHECKING:
    import xarray as xr


#: The file that holds filter, smoother and outages.
SOLUTION = "solution.nc"
#: Outages that are coloured in a track.
COLOURED = 5


def summary(solution: Solution, compared: Comparison | None = None) -> dict[str, Any]:
    """The solution, and its comparison with a scenario, as plain data; SI and radians unless a key says otherwise."""
    d, m = solution.drive, solution.mounting
    late, late_sigma = solution.clock
    document = {
        "source": d.source,
        "intake": solution.card.to_json(),
        "said": list(d.remarks),
        "reference": "the fixes after each outage, at the antenna; their own scatter is taken off the metres",
        "start_s": d.aligned.t,
        "end_s": float(d.imu.t[-1]),
        "unsolved_share": d.unsolved,
        "taken": solution.taken.figures(),
        "tried": [s.figures() for s in solution.tried],
        "knows_its_error": solution.taken.factor == 1.0,
        "error_over_stated": solution.taken.factor,
        "suspects": solution.suspects,
        "gaps": [asdict(g) for g in solution.gaps],
        "scatter_over_sigma": list(d.scatter),
        "biases": {
            a: {"value": value, "sigma": sigma, "taken_off_before": off}
            for a, (value, sigma, off) in solution.biases.items()
        },
        "consistency": [{**asdict(v), "passed": v.passed} for v in solution.verdicts],
        "imu_late_s": late,
        "imu_late_sigma_s": late_sigma,
        "mounting_deg": None if m is None else np.rad2deg(m.rpy).tolist(),
        "mounting_sigma_deg": None if m is None else np.rad2deg(m.sigma).tolist(),
        "lever_arm_given_m": d.lever_arm.tolist(),
        "states": [{"name": n, "estimate": v, "sigma": s, "sigma_before": b} for n, v, s, b in solution.estimated],
    }
    if compared is not None:
        rows = {"solved": compared.solved, **compared.designs}
        document["against"] = {
            name: [
                entry | {"rms_over_solved": list(one.ratio(compared.solved, k))}
                for k, entry in enumerate(one.figures())
            ]
            for name, one in rows.items()
        }
    return dict(finite(document))


def dataset(solution: Solution) -> xr.Dataset:
    """Filter and smoother at the nodes, and every outage."""
    import xarray as xr

    nodes, s = solution.taken.run.nodes, solution.smoothed
    assert nodes is not None
    rpy = rotation.rpy_from_quaternion
    filtered = np.sqrt(np.maximum(np.einsum("kii->ki", nodes.P_after), 0.0))
    o = solution.taken.outages
    red = [(start, start + seconds) for start, seconds, _ in worst_outages(o, COLOURED)]
    found = xr.Dataset(
        {
            "llh": (("t", "axis"), s.nav[:, :3], {"unit": "rad, rad, m"}),
            "vel_ned": (("t", "axis"), s.nav[:, 3:6], {"unit": "m/s"}),
            "rpy": (("t", "axis"), rpy(s.nav[:, 6:10]), {"unit": "rad"}),
            "sigma": (("t", "state"), s.sigma),
            "imu_states": (("t", "imu_state"), s.imu_states),
            "filter_llh": (("t", "axis"), nodes.nav[:, :3], {"unit": "rad, rad, m"}),
            "filter_vel_ned": (("t", "axis"), nodes.nav[:, 3:6], {"unit": "m/s"}),
            "filter_rpy": (("t", "axis"), rpy(nodes.nav[:, 6:10]), {"unit": "rad"}),
            "filter_sigma": (("t", "state"), filtered),
            "filter_imu_states": (("t", "imu_state"), nodes.states),
            "outage_error": (("outage", "horizon", "north_east"), o.error, {"unit": "m"}),
            "worst_outages": (("worst", "ends"), np.array(red).reshape(-1, 2), {"unit": "s"}),
            "outage_covariance": (("outage", "horizon", "north_east", "north_east_2"), o.covariance, {"unit": "m^2"}),
        },
        coords={
            "t": s.t,
            "state": list(s.layout.names),
            "imu_state": list(s.layout.names[9:]),
            "outage": o.start,
            "horizon": o.horizons,
        },
        attrs={
            "source": solution.drive.source,
            "design": solution.taken.candidate.name,
            "origin_ns": solution.drive.origin.ns,
            "origin_clock": solution.drive.origin.clock,
        },
    )
    if (track := solution.track) is not None:  # at a rate of its own
        found = found.assign_coords(track_t=track.t).assign(
            track_llh=(("track_t", "axis"), track.nav[:, :3], {"unit": "rad, rad, m"}),
            track_vel_ned=(("track_t", "axis"), track.nav[:, 3:6], {"unit": "m/s"}),
            track_rpy=(("track_t", "axis"), rpy(track.nav[:, 6:10]), {"unit": "rad"}),
            track_sigma=(("track_t", "state"), track.sigma),
        )
    return found


def way_of_solution(folder: Path) -> Way:
    """The smoothed track of a folder that :func:`write` made, with standard deviations and its worst outages, which are coloured.

    Raises
    ------
    InputError
        No such folder.
    """
    if not (folder / SOLUTION).is_file():
        raise InputError(f"holds no {SOLUTION}, expected a folder of `insemu solve`", where=str(folder))
    import xarray as xr

    with xr.open_dataset(folder / SOLUTION, engine="h5netcdf") as held:
        at_rate, names = "track_" * ("track_t" in held.coords), ("t", "llh", "vel_ned", "rpy", "sigma")
        of = {name: np.asarray(held[at_rate + name].values, dtype=np.float64) for name in names}
        spans = [(float(a), float(b)) for a, b in held["worst_outages"].values]
        name = Path(str(held.attrs["source"]).split(",")[0]).stem
        origin = Origin(int(held.attrs["origin_ns"]), str(held.attrs["origin_clock"]))
    return Way(of["t"], of["llh"], of["vel_ned"], of["rpy"], of["sigma"][:, :3], name, spans, origin)


def worst_outages(o: Outages, count: int) -> list[tuple[float, float, float]]:
    """Outages with the largest errors that do not overlap: start and length in s, error in m.

    Parameters
    ----------
    o : Outages
    count : int
        How many at most; of 30 s, or the longest that the recording has room for.
    """
    size = np.hypot(o.error[:, :, 0], o.error[:, :, 1])
    k = max((k for k in range(o.horizons.size) if o.horizons[k] <= 30.0 and np.isfinite(size[:, k]).any()), default=0)
    seconds = float(o.horizons[k])
    out: list[tuple[float, float, float]] = []
    for i in np.argsort(-np.nan_to_num(size[:, k], nan=-1.0)):
        start = float(o.start[i])
        if np.isfinite(size[i, k]) and all(abs(start - other) > seconds for other, _, _ in out):
            out.append((start, seconds, float(size[i, k])))
        if len(out) == count:
            break
    return sorted(out)


def write(solution: Solution, folder: Path) -> list[Path]:
    """Write all files but the page: ``solution.nc``, ``trajectory.csv``, ``.tum`` with covariances, tracks with dates where there are dates,
    ``solved.npz`` (the recording with the smoothed trajectory as reference), ``outages.csv`` and ``models.yaml``.

    Parameters
    ----------
    solution : Solution
    folder : path
        Made where it does not exist.
    """
    folder.mkdir(parents=True, exist_ok=True)
    d = solution.drive
    out: list[Path] = []
    with replacing(folder / SOLUTION) as partial:
        write_netcdf(partial, {"": dataset(solution)})
    out.append(folder / SOLUTION)
    way = way_of_solution(folder)
    dated = (".kml", ".gpx", ".pos") if utc_of(way.origin) is not None else ()
    out += [write_way(way, folder / f"trajectory{end}") for end in (".csv", ".tum", *dated)]
    # on the clock of the fixes, so that the solution, the fixes and the IMU agree
    track = solution.track or solution.smoothed
    way_solved = trajectory_of(track.t, track.nav, "solution")
    out.append(formats.write(folder / "solved.npz", d.recording(way_solved)))
    noise.save(dict(solution.taken.candidate.belief), folder / "models.yaml")
    o = solution.taken.outages
    header = ["start [s]"] + [
        f"{what} after {h:g} s [m]" for h in o.horizons for what in ("error north", "error east", "stated sigma")
    ]
    sigma = np.sqrt(np.einsum("khii->kh", o.covariance))
    rows = [np.column_stack([o.error[:, k], sigma[:, k]]) for k in range(o.horizons.size)]
    write_table(folder / "outages.csv", header, np.hstack([o.start[:, None], *rows]))
    return [*out, folder / "models.yaml", folder / "outages.csv"]
