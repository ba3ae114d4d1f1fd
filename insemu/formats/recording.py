"""Dynamic recordings (IMU, GNSS, reference) as one ``.npz`` or a folder of ``KEY.npy`` and CSV files.

Keys: ``imu_kind`` (increment, mean, sample; default sample), ``imu_sampling`` (interval or instant; -3 dB of the low-pass in Hz or none; start,
middle or end: how the sensor samples, where somebody says so), ``imu_t``, ``imu`` (n, 6), optionally ``imu_columns``, ``imu_units`` and
``temperature``; ``gnss_t``, ``gnss_llh`` (deg, deg, m), optionally ``gnss_vel_ned``, ``gnss_pos_std_ned``, ``gnss_vel_std_ned``;
``ref_t``, ``ref_llh``, ``ref_vel_ned``, ``ref_rpy_deg`` (at ``ref_att_t`` where attitudes have their own times). A key that ends in
``_neu`` is the same with up instead of down. A state to start from may be given: ``initial_t``, ``initial_llh`` (deg, deg, m),
``initial_vel_ned``, ``initial_rpy_deg``, ``initial_sigma`` (nine: m, m/s, deg). Measurements other than the fixes, NAME of docs/filters_aids.md,
"Aids": ``aid_NAME_t`` (n,), ``aid_NAME`` and ``aid_NAME_std`` (n, rows), optionally ``aid_NAME_settings`` and ``aid_NAME_since`` (n,), SI.
What was done to it before: ``prepared_imu_late`` (s), ``prepared_said`` (text), ``prepared_gnss_t``, ... (the fixes as they were recorded).
Times count from ``origin_ns`` (whole ns) of ``origin_clock`` (gps, sow, unix; "" of a clock of the device's own) where a file states them;
otherwise they are of a clock of its own, and where that began longer before than the recording lasts (s of the week, since 1970), the
recording counts from the second of its first IMU row. Other keys are ignored.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError, found_at
from insemu.formats.clocks import CLOCKS
from insemu.formats.columns import split_header
from insemu.formats.decoding import decoding, open_text
from insemu.formats.npz import load_npy, load_npz, numbers, scalar, texts
from insemu.formats.table import Besides
from insemu.formats.text import read_table, write_table
from insemu.records import (
    COLUMNS,
    AidRecord,
    GnssRecord,
    ImuKind,
    ImuRecord,
    InitialState,
    Preparation,
    Recording,
    Sampling,
    Trajectory,
)
from insemu.sample_times import sample_times
from insemu.stamps import OWN, Origin
from insemu.units import parse_unit
from insemu.whole import replacing, replacing_folder

Array = NDArray[np.float64]
_LOGGER = logging.getLogger(__name__)

#: Columns of the CSV files of a folder, by key.
_GROUPS: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "imu": {"imu_t": ("t",), "imu": COLUMNS, "temperature": ("temperature",)},
    "gnss": {
        "gnss_t": ("t",),
        "gnss_llh": ("lat", "lon", "h"),
        "gnss_vel_ned": ("vn", "ve", "vd"),
        "gnss_vel_neu": ("vn", "ve", "vu"),
        "gnss_pos_std_ned": ("pos_std_n", "pos_std_e", "pos_std_d"),
        "gnss_vel_std_ned": ("vel_std_n", "vel_std_e", "vel_std_d"),
    },
    "ref": {
        "ref_t": ("t",),
        "ref_llh": ("lat", "lon", "h"),
        "ref_vel_ned": ("vn", "ve", "vd"),
        "ref_vel_neu": ("vn", "ve", "vu"),
        "ref_rpy_deg": ("roll", "pitch", "heading"),
    },
}
_ALIASES = {
    "time": "t", "latitude": "lat", "longitude": "lon", "height": "h", "alt": "h", "altitude": "h",
    "yaw": "heading", "temp": "temperature", "temp_c": "temperature",
}  # fmt: skip
_CSV_UNITS = {
    "t": "s",
    "lat": "deg",
    "lon": "deg",
    "roll": "deg",
    "pitch": "deg",
    "heading": "deg",
    "temperature": "degC",
    "h": "m",
}


def is_folder_recording(path: Path) -> bool:
    """Whether a folder holds a recording in our own layout (``KEY.npy`` files, or ``imu.csv`` with ``gx``)."""
    if not path.is_dir():
        return False
    if (path / "imu_t.npy").exists() or (path / "imu.npy").exists():
        return True
    file = path / "imu.csv"
    with decoding(file, "text"):
        if not file.is_file():
            return False
        with open_text(file) as lines:
            return "gx" in {split_header(c)[0].lower().removeprefix("imu_") for c in lines.readline().split(",")}


def read_recording(path: Path) -> Recording:
    """Read a recording from ``.npz`` or a folder; see :func:`insemu.formats.read`."""
    arrays = folder_arrays(path) if path.is_dir() else load_npz(path)
    source = str(path)
    imu = _imu(arrays, source)
    clock = sample_times(imu.t)
    imu = imu if clock.t is imu.t else replace(imu, t=clock.t)
    try:
        gnss = _gnss(arrays, source)
        reference = _reference(arrays, source)
        aids = _aids(arrays, source)
    except InputError as error:
        raise error if error.where else InputError(error.message, where=source) from None
    found = Recording(
        imu,
        gnss,
        reference,
        source,
        aids,
        _initial(arrays, source),
        origin_of(arrays, source),
        clock.said,
        _preparation(arrays, source),
    )
    return found if "origin_ns" in arrays else found.from_start()


def _preparation(arrays: Mapping[str, NDArray[Any]], source: str) -> Preparation | None:
    """What was done to a recording before it was written; see the module."""
    if "prepared_imu_late" not in arrays:
        return None
    where = f"{source}: prepared_"
    late = scalar(arrays["prepared_imu_late"], f"{where}imu_late")
    said = (
        tuple(texts(arrays["prepared_said"], f"{where}said"))
        if "prepared_said" in arrays and arrays["prepared_said"].size
        else ()
    )
    fixes = {k.removeprefix("prepared_"): v for k, v in arrays.items() if k.startswith("prepared_gnss_")}
    return Preparation(late, _gnss(fixes, source), said)


def origin_of(arrays: Mapping[str, NDArray[Any]], source: str) -> Origin:
    """The origin that a recording states; that of its own clock where it states none.

    Raises
    ------
    InputError
        No whole number of ns, or a clock that nobody knows.
    """
    if "origin_ns" not in arrays:
        return OWN
    ns = arrays["origin_ns"]
    if ns.dtype.kind not in "iu" or ns.size != 1:
        raise InputError(
            f"has type {ns.dtype} and shape {ns.shape}, expected one whole number", where=f"{source}: origin_ns"
        )
    where = f"{source}: origin_clock"
    clock = texts(arrays["origin_clock"], where)[0] if "origin_clock" in arrays else ""
    if clock not in CLOCKS:
        raise InputError(f"unknown clock '{clock[:40]}', expected one of: gps, sow, unix", where=where)
    return Origin(int(ns.reshape(())), clock)


def besides_of(path: Path) -> Besides:
    """Aids, initial state and preparation of a recording in our own layout; see :func:`read_recording`."""
    arrays, source = folder_arrays(path) if path.is_dir() else load_npz(path), str(path)
    return _aids(arrays, source), _initial(arrays, source), _preparation(arrays, source)


def _aids(arrays: Mapping[str, NDArray[Any]], source: str) -> tuple[AidRecord, ...]:
    """Measurements other than the fixes; see the module. What kinds there are is the filter's to know."""
    out = []
    for name in sorted(k[4:-2] for k in arrays if k.startswith("aid_") and k.endswith("_t")):
        known = {k: numbers(arrays[f"aid_{name}{k}"], f"{source}: aid_{name}{k}")
                 for k in ("_t", "_settings", "_since") if f"aid_{name}{k}" in arrays}  # fmt: skip
        values, std = (
            numbers(_need(arrays, f"aid_{name}{k}", source), f"{source}: aid_{name}{k}") for k in ("", "_std")
        )
        settings = tuple(float(v) for v in known.get("_settings", np.zeros(0)).ravel())
        out.append(AidRecord(name, known["_t"], values, std, settings, known.get("_since")))
    return tuple(out)


_INITIAL_UNITS = np.repeat([1.0, 1.0, np.pi / 180.0], 3)


def _initial(arrays: Mapping[str, NDArray[Any]], source: str) -> InitialState | None:
    """The state that a recording may carry; see the module."""
    if "initial_t" not in arrays:
        return None
    values = {}
    for key, size in (("t", 1), ("llh", 3), ("vel_ned", 3), ("rpy_deg", 3), ("sigma", 9)):
        given = numbers(_need(arrays, f"initial_{key}", source), f"{source}: initial_{key}").ravel()
        if given.size != size:
            raise InputError(f"has {given.size} numbers, expected {size}", where=f"{source}: initial_{key}")
        values[key] = given
    with found_at(source):
        return InitialState(
            float(values["t"][0]),
            values["llh"] * _DEGREES,
            values["vel_ned"],
            np.deg2rad(values["rpy_deg"]),
            values["sigma"] * _INITIAL_UNITS,
        )


def _need(arrays: Mapping[str, NDArray[Any]], key: str, source: str) -> NDArray[Any]:
    if key not in arrays:
        raise InputError(f"has no '{key}'; holds {', '.join(sorted(arrays)) or 'nothing'}", where=source)
    return arrays[key]


def _matrix(arrays: Mapping[str, NDArray[Any]], key: str, rows: int, width: int, source: str) -> Array:
    values = numbers(_need(arrays, key, source), f"{source}: {key}")
    if values.shape != (rows, width):
        raise InputError(f"has shape {values.shape}, expected ({rows}, {width})", where=f"{source}: {key}")
    return values


def _imu(arrays: Mapping[str, NDArray[Any]], source: str) -> ImuRecord:
    t = numbers(_need(arrays, "imu_t", source), f"{source}: imu_t")
    if t.ndim != 1:
        raise InputError(f"has shape {t.shape}, expected (n,)", where=f"{source}: imu_t")
    values = _matrix(arrays, "imu", t.size, 6, source)
    kind: ImuKind = "sample"
    if "imu_kind" in arrays:
        text = texts(arrays["imu_kind"], f"{source}: imu_kind")[0]
        if text not in get_args(ImuKind):
            raise InputError(
                f"is '{text}', expected one of: {', '.join(get_args(ImuKind))}", where=f"{source}: imu_kind"
            )
        kind = text  # type: ignore[assignment]
    units = texts(arrays["imu_units"], f"{source}: imu_units") if "imu_units" in arrays else None
    if "imu_columns" in arrays:
        names = texts(arrays["imu_columns"], f"{source}: imu_columns")
        if sorted(names) != sorted(COLUMNS):
            raise InputError(
                f"is {', '.join(names)}, expected {', '.join(COLUMNS)} in any order", where=f"{source}: imu_columns"
            )
        order = [names.index(c) for c in COLUMNS]
        values = values[:, order]
        units = [units[k] for k in order] if units is not None and len(units) == 6 else units
    if units is not None:
        values = values * _imu_factors(units, kind, f"{source}: imu_units")
    if not np.isfinite(values).all():
        row, column = (int(v) for v in np.argwhere(~np.isfinite(values))[0])
        raise InputError(
            f"{COLUMNS[column]} is {values[row, column]} at row {row} (t = {t[row]:.6g} s); expected finite numbers",
            where=f"{source}: imu",
        )
    if kind != "increment":
        _check_magnitudes(values, f"{source}: imu")
    temperature = None
    if "temperature" in arrays:
        temperature = numbers(arrays["temperature"], f"{source}: temperature")
        if temperature.shape != t.shape:
            raise InputError(f"has shape {temperature.shape}, expected {t.shape}", where=f"{source}: temperature")
    with found_at(source):
        return ImuRecord(t, values[:, :3], values[:, 3:], kind, temperature, _sampling(arrays, source))


def _sampling(arrays: Mapping[str, NDArray[Any]], source: str) -> Sampling | None:
    if "imu_sampling" not in arrays:
        return None
    where, words = f"{source}: imu_sampling", texts(arrays["imu_sampling"], f"{source}: imu_sampling")
    try:
        average, bandwidth, stamp = words
        return Sampling(average, None if bandwidth == "none" else float(bandwidth), stamp)  # type: ignore[arg-type]
    except ValueError:
        raise InputError(
            f"is {' '.join(words)!r:.60}, expected average, bandwidth in Hz or none, stamp: interval none end",
            where=where,
        ) from None
    except InputError as error:
        raise InputError(error.message, where=where) from None


def _imu_factors(units: list[str], kind: ImuKind, where: str) -> Array:
    if len(units) != 6:
        raise InputError(f"has {len(units)} entries, expected 6", where=where)
    wanted = ("rad", "m/s") if kind == "increment" else ("rad/s", "m/s^2")
    factors = []
    for k, unit in enumerate(units):
        target = wanted[k // 3]
        with found_at(where):
            parsed = parse_unit(unit)
        if parsed.dimension != parse_unit(target).dimension:
            raise InputError(
                f"{COLUMNS[k]} has the unit '{unit}', expected one of the dimension of {target} (imu_kind is '{kind}'; "
                "are columns swapped?)",
                where=where,
            )
        factors.append(parsed.factor)
    return np.array(factors)


def _check_magnitudes(values: Array, where: str) -> None:
    """Gravity is in the accelerometers: found in the gyroscopes, columns are swapped; found as 1, the unit is g."""
    gyro, accel = (float(np.median(np.linalg.norm(values[:, k : k + 3], axis=1))) for k in (0, 3))
    if 9.0 < gyro < 10.6 and accel < 5.0:
        raise InputError(
            f"gx, gy, gz have a median magnitude of {gyro:.3g} and ax, ay, az of {accel:.3g}: columns are swapped; expected angular "
            "rates first, then specific forces (or say so in imu_columns)",
            where=where,
        )
    if 0.9 < accel < 1.1:
        raise InputError(
            f"ax, ay, az have a median magnitude of {accel:.3g}, expected about 9.8 m/s^2; in g? (say so in imu_units)",
            where=where,
        )


def _down(arrays: Mapping[str, NDArray[Any]], key: str, rows: int, source: str, *, sign: bool) -> Array | None:
    """A (rows, 3) array of ``KEY_ned``, or of ``KEY_neu`` with the third component turned down (``sign``: not for standard deviations)."""
    if f"{key}_ned" in arrays:
        return _matrix(arrays, f"{key}_ned", rows, 3, source)
    if f"{key}_neu" in arrays:
        return np.asarray(_matrix(arrays, f"{key}_neu", rows, 3, source) * np.array([1.0, 1.0, -1.0 if sign else 1.0]))
    return None


_DEGREES = np.array([np.pi / 180, np.pi / 180, 1.0])


def _gnss(arrays: Mapping[str, NDArray[Any]], source: str) -> GnssRecord | None:
    if "gnss_t" not in arrays and "gnss_llh" not in arrays:
        return None
    t = numbers(_need(arrays, "gnss_t", source), f"{source}: gnss_t")
    n = t.size
    return GnssRecord(
        t,
        _matrix(arrays, "gnss_llh", n, 3, source) * _DEGREES,
        _down(arrays, "gnss_vel", n, source, sign=True),
        _down(arrays, "gnss_pos_std", n, source, sign=False),
        _down(arrays, "gnss_vel_std", n, source, sign=False),
    )


def _reference(arrays: Mapping[str, NDArray[Any]], source: str) -> Trajectory | None:
    if "ref_t" not in arrays:
        return None
    t = numbers(arrays["ref_t"], f"{source}: ref_t")
    velocity = _down(arrays, "ref_vel", t.size, source, sign=True)
    if "ref_llh" not in arrays or velocity is None or "ref_rpy_deg" not in arrays:
        _LOGGER.warning("%s: reference without position, velocity and attitude all three: not used", source)
        return None
    llh = _matrix(arrays, "ref_llh", t.size, 3, source) * _DEGREES
    if "ref_att_t" in arrays:
        at = numbers(arrays["ref_att_t"], f"{source}: ref_att_t")
        angles = np.unwrap(np.deg2rad(_matrix(arrays, "ref_rpy_deg", at.size, 3, source)), axis=0)
        inside = (t >= at[0]) & (t <= at[-1])
        t, llh, velocity = t[inside], llh[inside], velocity[inside]
        rpy = np.column_stack([np.interp(t, at, angles[:, k]) for k in range(3)])
    else:
        rpy = np.deg2rad(_matrix(arrays, "ref_rpy_deg", t.size, 3, source))
    return Trajectory(t, llh, velocity, rpy, "reference")


def folder_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of a folder by key, from its ``.npy`` and CSV files."""
    arrays: dict[str, NDArray[Any]] = {}
    for file in sorted(path.glob("*.npy")):
        arrays[file.stem] = load_npy(file)
    for group, keys in _GROUPS.items():
        file = path / f"{group}.csv"
        if file.exists():
            arrays.update(_group(file, group, keys))
    kind = path / "imu_kind.txt"
    if kind.exists():
        with decoding(kind, "text"):
            arrays["imu_kind"] = np.array(kind.read_text(encoding="utf-8").strip())
    if not arrays:
        raise InputError("is no recording: a folder needs imu_t.npy and imu.npy, or imu.csv", where=str(path))
    return arrays


def _group(file: Path, group: str, keys: Mapping[str, tuple[str, ...]]) -> dict[str, NDArray[Any]]:
    header, read = read_table(file)
    if header is None:
        raise InputError("has no header; expected names of columns, with units in brackets", where=str(file))
    columns: dict[str, Array] = {}
    units: dict[str, str] = {}
    for k, cell in enumerate(header):
        name, unit = split_header(cell)
        name = name.lower().removeprefix(f"{group}_")
        name = _ALIASES.get(name, name)
        if name in columns:
            raise InputError(f"column '{name}' appears more than once", where=str(file))
        columns[name] = read[k]
        if name in COLUMNS:
            units[name] = unit
        elif unit:
            wanted = _CSV_UNITS.get(name, "m/s" if name.startswith(("v", "vel")) else "m")
            one, two = parse_unit(unit), parse_unit(wanted)
            if one.dimension != two.dimension:
                raise InputError(f"has the unit '{unit}', expected one like '{wanted}'", where=f"{file}: {name}")
            if one != two:
                columns[name] = columns[name] * (one.factor / two.factor)
    out: dict[str, NDArray[Any]] = {}
    for key, names in keys.items():
        present = [n for n in names if n in columns]
        if len(present) == len(names):
            block_of_key = np.column_stack([columns[n] for n in names])
            out[key] = block_of_key[:, 0] if len(names) == 1 else block_of_key
        elif present and not (key.endswith(("_ned", "_neu")) and set(present) <= {"vn", "ve"}):
            missing = next(n for n in names if n not in columns)
            raise InputError(f"has no column '{missing}' next to {', '.join(present)}", where=str(file))
    if "imu" in out and any(units.values()):
        out["imu_units"] = np.array([units[c] or ("rad/s" if c[0] == "g" else "m/s^2") for c in COLUMNS])
    return out


def write_recording(path: Path, data: Recording) -> None:
    """Write a recording as ``.npz``, or as a folder of CSV files where the path has no suffix."""
    imu, gnss, ref = data.imu, data.gnss, data.reference
    arrays: dict[str, NDArray[Any]] = {
        "imu_kind": np.array(imu.kind),
        "imu_t": imu.t,
        "imu": np.hstack([imu.gyro, imu.accel]),
    }
    if (how := imu.sampling) is not None:
        arrays["imu_sampling"] = np.array(
            [how.average, "none" if how.bandwidth is None else repr(how.bandwidth), how.stamp]
        )
    if imu.temperature is not None:
        arrays["temperature"] = imu.temperature
    arrays |= _of_fixes(gnss)
    if (done := data.preparation) is not None:
        arrays |= {"prepared_imu_late": np.array(done.imu_late), "prepared_said": np.array(done.said, dtype=str)}
        arrays |= {f"prepared_{k}": v for k, v in _of_fixes(done.gnss).items()}
    if ref is not None:
        arrays |= {
            "ref_t": ref.t,
            "ref_llh": ref.llh / _DEGREES,
            "ref_vel_ned": ref.vel_ned,
            "ref_rpy_deg": np.rad2deg(ref.rpy),
        }
    if (first := data.initial) is not None:
        arrays |= {
            "initial_t": np.array([first.t]),
            "initial_llh": first.llh / _DEGREES,
            "initial_vel_ned": first.vel_ned,
            "initial_rpy_deg": np.rad2deg(first.rpy),
            "initial_sigma": first.sigma / _INITIAL_UNITS,
        }
    for aid in data.aids:
        parts = {"_t": aid.t, "": aid.values, "_std": aid.std, "_settings": np.array(aid.settings), "_since": aid.since}
        arrays |= {f"aid_{aid.kind}{k}": v for k, v in parts.items() if v is not None and v.size}
    if data.origin != OWN or data.from_start() is not data:
        arrays |= {"origin_ns": np.array(data.origin.ns), "origin_clock": np.array(data.origin.clock)}
    if path.suffix == ".npz":
        with replacing(path) as partial:
            np.savez(partial, **arrays)  # type: ignore[arg-type]
        return
    groups = tuple(f"{group}.csv" for group in _GROUPS)
    with replacing_folder(
        path,
        "imu.csv",
        (*groups, "imu_kind.txt", "initial_*.npy", "aid_*.npy", "origin_*.npy", "prepared_*.npy", "imu_sampling.npy"),
    ) as partial:
        (partial / "imu_kind.txt").write_text(imu.kind + "\n", encoding="utf-8")
        for group, keys in _GROUPS.items():
            present = {k: names for k, names in keys.items() if k in arrays and not k.endswith("_neu")}
            if present:
                header = [_with_unit(n, imu.kind) for names in present.values() for n in names]
                write_table(partial / f"{group}.csv", header, np.column_stack([arrays[k] for k in present]))
        for key in (k for k in arrays if k.startswith(("initial_", "aid_", "origin_", "prepared_", "imu_sampling"))):
            np.save(partial / f"{key}.npy", arrays[key])


def _of_fixes(gnss: GnssRecord | None) -> dict[str, NDArray[Any]]:
    """Fixes as arrays of a file."""
    if gnss is None:
        return {}
    stated = {f"gnss_{k}": getattr(gnss, k) for k in ("vel_ned", "pos_std_ned", "vel_std_ned")}
    return {"gnss_t": gnss.t, "gnss_llh": gnss.llh / _DEGREES, **{k: v for k, v in stated.items() if v is not None}}


def _with_unit(name: str, kind: ImuKind) -> str:
    if name in COLUMNS:
        rate, increment = ("rad/s", "rad") if name[0] == "g" else ("m/s^2", "m/s")
        return f"{name} [{increment if kind == 'increment' else rate}]"
    return f"{name} [{_CSV_UNITS.get(name, 'm' if name.startswith('pos') else 'm/s')}]"
