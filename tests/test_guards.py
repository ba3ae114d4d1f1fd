"""One guard on every record and process: whatever is given, there is a result or an InputError, and no overflow on the way."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import insemu as ins
from insemu import noise
from insemu.cli import main
from insemu.errors import InputError
from insemu.filters import start
from insemu.formats import read_recording
from insemu.noise import PROCESSES
from insemu.records import AidRecord, GnssRecord, ImuRecord, InitialState, Sampling, Series, Trajectory
from tests.file_samples import drive

#: Few: every example makes every record.
FEW = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
NUMBERS = st.one_of(
    st.floats(),
    st.sampled_from([0.0, -0.0, 1e-320, 1e-200, 1e20, 1e150, 1e200, -1e308, np.inf, -np.inf, np.nan, 90.0, np.pi / 2]),
)
ROWS = 3


def arrays(columns: int | None) -> st.SearchStrategy[np.ndarray]:
    """Mostly zeros of the right shape with some numbers put in; sometimes another shape or type."""
    shape = (ROWS,) if columns is None else (ROWS, columns)
    right = st.lists(st.tuples(st.integers(0, int(np.prod(shape)) - 1), NUMBERS), max_size=2).map(
        lambda places: _put(np.zeros(shape), places)
    )
    wrong = st.sampled_from([np.zeros(0), np.zeros((0, 3)), np.array(["x"]), np.array(1.0), np.zeros((2, 2, 2))])
    return st.integers(0, 9).flatmap(lambda k: wrong if k == 0 else right)


def _put(array: np.ndarray, places: list[tuple[int, float]]) -> np.ndarray:
    for at, value in places:
        array.flat[at] = value
    return array


TIMES = st.one_of(st.just(np.arange(ROWS) * 0.01), arrays(None))
TEXT = st.sampled_from(["sample", "mean", "increment", "", "mena", None, 3])
MAYBE = st.one_of(st.none(), arrays(3))
RECORDS: dict[type, dict[str, st.SearchStrategy[Any]]] = {
    ImuRecord: {"t": TIMES, "gyro": arrays(3), "accel": arrays(3), "kind": TEXT, "temperature": st.one_of(st.none(), arrays(None))},
    GnssRecord: {"t": TIMES, "llh": arrays(3), "vel_ned": MAYBE, "pos_std_ned": MAYBE, "vel_std_ned": MAYBE},
    Trajectory: {"t": TIMES, "llh": arrays(3), "vel_ned": arrays(3), "rpy": arrays(3)},
    AidRecord: {"kind": st.just("odometer"), "t": TIMES, "values": arrays(1), "std": arrays(1), "since": st.one_of(st.none(), arrays(None))},
    InitialState: {
        "t": NUMBERS, "llh": arrays(None), "vel_ned": arrays(None), "rpy": arrays(None),
        "sigma": st.one_of(st.just(np.ones(9)), NUMBERS.map(lambda v: np.full(9, v))),
    },
    Series: {"values": arrays(None), "rate_hz": st.one_of(NUMBERS, TEXT)},
    Sampling: {"average": TEXT, "bandwidth": st.one_of(NUMBERS, TEXT), "stamp": TEXT},
}  # fmt: skip


def used(record: object) -> None:
    """What every user of a record asks first."""
    repr(record)
    if isinstance(record, ImuRecord):
        record.as_increments().rates()
        record.gaps(1.0)
    if isinstance(record, GnssRecord):
        record.with_sigma(1.0, 0.1).rows(np.isfinite(record.llh).all(axis=1) | True)
    if isinstance(record, Series):
        assert record.dt > 0.0


@pytest.mark.parametrize("record", RECORDS, ids=lambda r: r.__name__)
def test_nothing_but_an_input_error_comes_of_a_record(record: type) -> None:
    @FEW
    @given(st.fixed_dictionaries(RECORDS[record]))
    def every(fields: dict[str, Any]) -> None:
        try:
            made = record(**fields)
        except InputError:
            return
        used(made)

    every()


@pytest.mark.parametrize("symbol", PROCESSES)
def test_nothing_but_an_input_error_comes_of_a_process(symbol: str) -> None:
    process = PROCESSES[symbol]
    names = [p.name for p in process.PARAMETERS]

    @FEW
    @given(st.fixed_dictionaries({name: st.one_of(NUMBERS, st.text(max_size=4)) for name in names}))
    def every(values: dict[str, Any]) -> None:
        try:
            made = process(**values)
            if made.specified:
                made.coordinates(0.01)
                str(made)
        except InputError:
            return

    every()


@pytest.mark.parametrize("make", [lambda: ins.WN(N=1e200), lambda: ins.GM(sigma=1.0, beta=1e-300)])
def test_parameters_whose_square_is_no_number_are_refused(make: Any) -> None:
    with pytest.raises(InputError, match=r"expected a size from (0|1e-100) to 1e\+100"):
        make()


def test_fixes_are_finite_or_missing() -> None:
    t, zero = np.arange(3.0), np.zeros((3, 3))
    for name in ("llh", "vel_ned"):
        with pytest.raises(InputError, match=f"gnss_{name} row 1 is infinite"):
            GnssRecord(**{"t": t, "llh": zero, name: _put(np.zeros((3, 3)), [(4, np.inf)])})
    with pytest.raises(InputError, match="gnss_vel_std_ned row 2 is negative"):
        GnssRecord(t, zero, zero, None, _put(np.ones((3, 3)), [(8, -1.0)]))
    GnssRecord(t, _put(np.zeros((3, 3)), [(0, np.nan)]))
    with pytest.raises(InputError, match="trajectory llh row 0 has a latitude"):
        Trajectory(t, _put(np.zeros((3, 3)), [(0, 45.0)]), zero, zero)


def test_an_empty_kind_is_named(tmp_path: Path) -> None:
    data = drive()
    np.savez(
        tmp_path / "r.npz", imu_kind=np.array([], dtype="U1"), imu_t=data.imu.t, imu=np.hstack([data.imu.gyro, data.imu.accel])
    )  # fmt: skip
    for read in (read_recording, ins.read):
        with pytest.raises(InputError, match="imu_kind: is empty"):
            read(tmp_path / "r.npz")


def test_a_slow_imu_does_not_navigate() -> None:
    data = drive()
    with pytest.raises(InputError, match="a sample every 10 s, expected one every 1 s"):
        start(data.imu.rows(slice(None, None, 500)), data.gnss)


UTILS = """%YAML:1.0
---
type: IMU
name: demo
Gyr:
   unit: "{unit}"
   avg-axis:
      gyr_n: 1.9e-03
      gyr_w: 7.3e-06
Acc:
   unit: " m/s^2"
   avg-axis:
      acc_n: 1.0e-02
      acc_w: 1.8e-04
{more}
"""


def test_imu_utils_is_a_model_where_its_rate_is_known(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "imu_utils.yaml"
    path.write_text(UTILS.format(unit=" rad/s", more=""))
    with pytest.raises(InputError, match="add the line 'update_rate"):
        noise.load(path)
    with pytest.raises(SystemExit):
        main(["open", str(path)])
    assert "holds noise models (imu_utils) and no recording" in capsys.readouterr().err
    path.write_text(UTILS.format(unit=" rad/s", more="update_rate: 100"))
    models = noise.load(path)
    assert set(models) == {f"{s}_{a}" for s in ("gyro", "accel") for a in "xyz"}
    # a sample of white noise has the standard deviation that is written, and the slow part its smallest Allan deviation
    white, slow = models["gyro_x"]
    np.testing.assert_allclose(white.simulate(100_000, 0.01, np.random.default_rng(1)).std(), 1.9e-3, rtol=0.02)
    np.testing.assert_allclose(slow.allan_variance(np.array([100]), 0.01), 7.3e-6**2, rtol=1e-9)


def test_kalibr_is_a_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "imu.yaml"
    path.write_text(
        "imu0:\n  gyroscope_noise_density: 1e-3\n  gyroscope_random_walk: 2.0e-05\n  accelerometer_noise_density: 0.01\n"
        "  accelerometer_random_walk: 2e-4\n  update_rate: 200.0\n"
    )
    assert noise.load(path)["gyro_y"] == ins.WN(N=1e-3) + ins.RW(K=2e-5)
    path.write_text("gyroscope_noise_density: 1e-3\n")
    with pytest.raises(InputError, match="gyroscope_random_walk: is None"):
        noise.load(path)
