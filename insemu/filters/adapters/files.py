"""Any program that reads and writes tables (KF-GINS, OpenVINS, a firmware on the desk): its input is written, its estimate is read.

Each record gets a folder of its own, named by its content: ``imu.csv`` (mean rates and forces over the interval before the stamp), ``gnss.csv``
(with the standard deviations that may be believed), ``start.csv`` and ``noise.txt``. The program writes ``estimate.csv`` next to them, at
least at the times of ``times.csv``. Its columns are those of ``start.csv``: where it was, and standard deviations; correlations are not stated.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu import rotation
from insemu.errors import InputError
from insemu.filters.options import FilterOptions, InitialSigma
from insemu.filters.protocol import NotYet
from insemu.filters.results import FilterResult
from insemu.noise import NoiseModel
from insemu.records import GnssRecord, ImuRecord, Trajectory
from insemu.strapdown import NavState
from insemu.whole import put

Array = NDArray[np.float64]
_STATE = ["t_s", "lat_deg", "lon_deg", "height_m", "vn_m_s", "ve_m_s", "vd_m_s", "roll_deg", "pitch_deg", "heading_deg"]
_AXES = ("n", "e", "d")
#: Standard deviations: attitude about the axes north, east, down.
_SIGMA = [
    f"sigma_{what}_{axis}_{unit}" for what, unit in (("pos", "m"), ("vel", "m_s"), ("att", "deg")) for axis in _AXES
]
COLUMNS = (*_STATE, *_SIGMA)
_DEGREES = [k for k, name in enumerate(COLUMNS) if name.endswith("_deg")]


def _table(header: Sequence[str], rows: ArrayLike) -> str:
    return "\n".join([",".join(header), *(",".join(map(repr, row)) for row in np.asarray(rows).tolist())]) + "\n"


class Adapter:
    """The estimates of a program that is run by hand between two calls; see :mod:`insemu.filters.adapters.files`.

    Parameters
    ----------
    belief, dt, lever_arm, gravity, gnss_sigma, options
        As :class:`~insemu.filters.protocol.NavigationFilter` says.
    folder : path
        Of all records.
    """

    correlated = False

    def __init__(
        self, belief: Mapping[str, NoiseModel], dt: float, *, lever_arm: ArrayLike, gravity: str, gnss_sigma: tuple[Array, Array],
        options: FilterOptions, folder: str,
    ) -> None:  # fmt: skip
        self.belief, self.lever_arm, self.gnss_sigma = belief, np.asarray(lever_arm, dtype=np.float64), gnss_sigma
        self.options, self.folder = options, Path(folder)

    def run(
        self, imu: ImuRecord, gnss: GnssRecord | None, initial: NavState | Trajectory, initial_sigma: InitialSigma | ArrayLike, **_: Any
    ) -> FilterResult:  # fmt: skip
        """Read the estimate of a record, or write the record.

        Raises
        ------
        NotYet
            There is no estimate.
        InputError
            One that lacks columns, times or positive standard deviations.
        """
        assert gnss is not None and isinstance(initial_sigma, InitialSigma)
        start = NavState.of(initial) if isinstance(initial, Trajectory) else initial
        whole = imu.as_increments()
        rates = np.column_stack([whole.t, np.hstack([whole.gyro, whole.accel]) / whole.widths(0.0)])
        sigma = np.broadcast_to(np.concatenate(self.gnss_sigma), (len(gnss), 6))
        velocity = np.full((len(gnss), 3), np.nan) if gnss.vel_ned is None else gnss.vel_ned
        degrees = np.column_stack([np.rad2deg(gnss.llh[:, :2]), gnss.llh[:, 2]])
        fixes = np.column_stack([gnss.t, degrees, velocity, sigma])[np.isfinite(gnss.llh).all(axis=1)]
        first = np.concatenate([[whole.t[0]], start.llh, start.vel_ned, start.rpy, initial_sigma.to_array()])
        first[_DEGREES] = np.rad2deg(first[_DEGREES])
        noise = "\n".join(f"{axis}: {model}" for axis, model in self.belief.items())
        files = {
            "imu.csv": _table(
                ["t_s", *(f"gyro_{a}_rad_s" for a in "xyz"), *(f"accel_{a}_m_s2" for a in "xyz")], rates[1:]
            ),
            "gnss.csv": _table([*COLUMNS[:7], *COLUMNS[10:16]], fixes),
            "start.csv": _table(COLUMNS, first[None]),
            "times.csv": _table(["t_s"], np.asarray(self.options.covariance_at)[:, None]),
            "noise.txt": f"{noise}\nlever_arm_m: {self.lever_arm.tolist()}\n",
        }
        place = self.folder / hashlib.sha256("".join(files.values()).encode()).hexdigest()[:16]
        if not (place / "estimate.csv").is_file():
            for name, text in files.items():
                put(place / name, text)
            raise NotYet("there is no estimate.csv", where=str(place))
        return self._read(place / "estimate.csv", len(imu) - 1)

    def _read(self, path: Path, epochs: int) -> FilterResult:
        try:
            table: Any = np.atleast_1d(np.genfromtxt(path, delimiter=",", names=True, dtype=np.float64))
            values = np.column_stack([table[name] for name in COLUMNS])
        except ValueError as error:
            raise InputError(f"found {error}, expected the columns {', '.join(COLUMNS)}", where=str(path)) from None
        values[:, _DEGREES] = np.deg2rad(values[:, _DEGREES])
        if not (np.isfinite(values).all() and (values[:, 10:] > 0.0).all() and (np.diff(values[:, 0]) > 0.0).all()):
            raise InputError(
                "expected increasing times, finite numbers and positive standard deviations", where=str(path)
            )
        nav = np.column_stack([values[:, 1:7], [rotation.quaternion_from_rpy(rpy) for rpy in values[:, 7:10]]])
        covariance = values[:, 10:, None] ** 2 * np.eye(9)
        return FilterResult.stated(values[:, 0], nav, covariance, self.options.covariance_at, epochs=epochs)
