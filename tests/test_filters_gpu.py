"""The filter for a GPU: its kernel compiled as plain C++ and held against the compiled loop, and what it refuses."""

from __future__ import annotations

import ctypes
import json
import shutil
import subprocess
from collections import Counter
from dataclasses import replace
from threading import Lock

import numpy as np
import pytest

from insemu import strapdown
from insemu.errors import InputError
from insemu.filters import Extras, FilterOptions, LooselyCoupledEKF, Standstill, gpu
from insemu.records import GnssRecord
from tests import filter_cases as cases
from tests.filter_cases import DT, MODEL_15, MODEL_24, MODEL_27, MODEL_RW, START_SIGMA
from tests.test_run import SCENARIO, run, write

LEVER = (1.2, -0.4, -0.9)


class Host(gpu.Gpu):
    """The kernel as plain C++ on this processor: one lane, one flight after the other."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._library, self.asked, self.name = library, 0, "this processor"
        self._lock, self._shared, self.left = Lock(), 227 * 1024, Counter()  # those of an H100

    def fly(self, design: gpu.Design, flight: gpu.Flight) -> gpu.Flown:
        return self.fly_all(design, [flight])[0]

    def fly_all(self, design, flights):
        self.asked += len(flights)
        inputs, empty = gpu.arguments(design, flights)
        inputs[gpu.IMU] = np.stack([flight.imu for flight in flights])
        outputs = [np.full(shape, fill, dtype=kind) for shape, fill, kind in empty]
        pool = np.full(design.pool_size + 16, np.nan)
        for k in range(len(flights)):
            self._library.fly(
                ctypes.c_longlong(k), *(ctypes.c_void_p(v.ctypes.data) for v in (pool, *inputs, *outputs))
            )
            assert np.isnan(pool[design.pool_size :]).all()  # the working space is as large as it is said to be
        return gpu.results(flights, outputs)


@pytest.fixture(scope="module")
def host(tmp_path_factory):
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("no C++ compiler (g++, clang++)")
    folder = tmp_path_factory.mktemp("gpu")
    (folder / "flight.cpp").write_text(gpu.source(), encoding="utf-8")
    subprocess.run([compiler, "-O2", "-shared", "-fPIC", "-o", folder / "flight.so", folder / "flight.cpp"], check=True)
    return Host(ctypes.CDLL(str(folder / "flight.so")))


@pytest.fixture(scope="module")
def road():
    return cases.drive(40.0)


def case(road, model, *, lever=(0.0, 0.0, 0.0), earlier=0.0, **changes):
    rng = np.random.default_rng(1)
    imu = replace(cases.corrupt(road.imu, model, rng), temperature=20.0 + 0.3 * road.t)
    fixes = cases.fixes(road, rng, outages=((15.0, 22.0),), lever_arm=lever)
    fixes = replace(fixes, t=fixes.t - earlier)
    ekf = LooselyCoupledEKF(model, DT, lever_arm=lever, options=FilterOptions(covariance_at=(10.0, 40.0), **changes))
    return ekf, imu, fixes, cases.start(road, rng)


@pytest.mark.parametrize(
    ("model", "settings"),
    [
        (MODEL_15, {}),
        (MODEL_24, {"lever": LEVER}),
        (MODEL_27, {"output_every": 7}),
        (MODEL_RW, {"covariance_every": 5, "output_every": 10}),
        (MODEL_27, {"gate": 0.01}),
        (MODEL_15, {"gate": 0.2, "gate_timeout": 1.5}),
        (MODEL_15, {"lever": LEVER, "extras": Extras(gyro_scale=1e-3, accel_misalignment=1e-3, lever_arm=0.1)}),
        (
            MODEL_RW,
            {"extras": Extras(lever_arm=0.3), "earlier": 0.004, "gate": 0.01, "covariance_every": 5, "output_every": 5},
        ),
        (MODEL_15, {"extras": Extras(gyro_scale_temperature=1e-3, accel_scale_temperature=1e-3)}),
    ],
    ids=[
        "15",
        "24, lever arm",
        "27, thinned",
        "walks, five steps at a time",
        "27, gate",
        "15, gate that opens",
        "calibration states",
        "lever arm as a state, fixes between epochs",
        "temperature",
    ],
)
def test_kernel_gives_the_numbers_of_the_compiled_loop(host, road, model, settings):
    ekf, imu, fixes, start = case(road, model, **settings)
    here = ekf.run(imu, fixes, start, START_SIGMA)
    before, ekf.gpu = host.asked, host
    there = ekf.run(imu, fixes, start, START_SIGMA)
    assert host.asked == before + 1
    assert np.abs(strapdown.navigation_errors(there.nav, here.nav)).max() < 1e-9
    sd = np.sqrt(np.einsum("kii->ki", here.covariance))
    assert np.max(np.abs(there.covariance - here.covariance) / (sd[:, :, None] * sd[:, None, :])) < 1e-9
    np.testing.assert_allclose(there.sigma, here.sigma, rtol=1e-9)
    np.testing.assert_allclose(there.imu_states, here.imu_states, rtol=1e-9, atol=1e-9 * here.sigma[:, 9:].max())
    np.testing.assert_array_equal(there.fixes.accepted, here.fixes.accepted)
    np.testing.assert_array_equal(there.fixes.dof, here.fixes.dof)
    np.testing.assert_allclose(there.fixes.nis, here.fixes.nis, rtol=1e-8)
    np.testing.assert_allclose(there.fixes.S, here.fixes.S, rtol=1e-9, atol=1e-12)


def test_flights_of_one_list_have_their_own_fixes(host, road):
    ekf, imu, fixes, start = case(road, MODEL_15, extras=Extras(lever_arm=0.3))
    few = GnssRecord(
        fixes.t[::3] - 0.004, fixes.llh[::3], pos_std_ned=None if fixes.pos_std_ned is None else fixes.pos_std_ned[::3]
    )
    alone = [ekf.run(imu, gnss, start, START_SIGMA).nav for gnss in (fixes, few)]
    kept = []

    class Together(Host):
        def fly(self, design, flight):
            kept.append((design, flight))
            raise InterruptedError

    ekf.gpu = Together(host._library)
    for gnss in (fixes, few):
        with pytest.raises(InterruptedError):
            ekf.run(imu, gnss, start, START_SIGMA)
    assert kept[0][0].key == kept[1][0].key
    for one, expected in zip(host.fly_all(kept[0][0], [flight for _, flight in kept]), alone, strict=True):
        assert np.abs(strapdown.navigation_errors(one.nav, expected)).max() < 1e-9


def test_what_goes_wrong_is_told_as_by_the_loop(host, road):
    ekf, imu, fixes, start = case(road, MODEL_15)
    ekf.gpu = host
    P0 = np.eye(ekf.layout.n)
    P0[3, 4] = P0[4, 3] = 2.0
    with pytest.raises(InputError, match="not positive semidefinite at the state 'vel_e'"):
        ekf.run(imu, fixes, start, P0)
    with pytest.raises(InputError, match="navigation diverged"):
        ekf.run(replace(imu, accel=imu.accel * 1e200), None, start, START_SIGMA)


def test_designs_that_it_cannot_fly_are_flown_here(host, road):
    for changes in ({"store": "fixes"}, {"extras": Extras(latency=0.01)}, {"standstill": Standstill(((1.0, 3.0),))}):
        ekf, imu, fixes, start = case(road, MODEL_15, **changes)
        before, ekf.gpu = host.asked, host
        ekf.run(imu, fixes, start, START_SIGMA)
        assert host.asked == before
    assert set(host.left) == {"a smoother", "the latency as a state", "measurements other than fixes"}


def test_a_design_without_room_on_the_device_is_flown_here(host, road):
    ekf, imu, fixes, start = case(road, MODEL_15)
    small = Host(host._library)
    small._shared = 8 * 1024
    ekf.gpu = small
    ekf.run(imu, fixes, start, START_SIGMA)
    assert small.asked == 0 and any("shared memory" in why for why in small.left)


@pytest.mark.usefixtures("without_pictures")
def test_a_run_on_a_gpu_has_the_figures_of_one_without(host, tmp_path, monkeypatch, capsys):
    host = Host(host._library)
    monkeypatch.setattr("insemu.filters.Gpu", lambda: host)
    path = write(tmp_path, variants={}, fits=None, realizations=2, designs={"full": SCENARIO["designs"]["full"]})
    found = {}
    for name, options in (("here", ()), ("there", ("--gpu",))):
        before = host.asked
        assert run(str(path), *options, "--workers", "2", "--output", str(tmp_path / name)) == 0
        assert host.asked == before + (2 if options else 0)
        found[name] = json.loads((tmp_path / name / "summary.json").read_text())
    assert found["here"]["digest"] != found["there"]["digest"]
    one, other = (f["designs"]["full"]["outages"][0]["planimetric_end_m"]["per_realization"] for f in found.values())
    np.testing.assert_allclose(other, one, rtol=1e-9)
    capsys.readouterr()
    path = write(tmp_path, variants={}, fits=None, smoother=True, designs={"full": SCENARIO["designs"]["full"]})
    assert run(str(path), "--gpu", "--output", str(tmp_path / "smoothed")) == 2
    assert "expected 'smoother: false' with --gpu" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "smoothed").exists()


def test_without_a_gpu_the_way_to_one_is_named():
    try:
        found = gpu.Gpu()
    except InputError as error:
        assert "gpu" in str(error)
    else:
        assert found.name


@pytest.mark.slow(reason="a GPU")
def test_a_gpu_gives_the_numbers_of_the_compiled_loop(road):
    try:
        device = gpu.Gpu()
    except InputError as error:
        pytest.skip(str(error))
    ekf, imu, fixes, start = case(road, MODEL_24, lever=LEVER)
    here = ekf.run(imu, fixes, start, START_SIGMA)
    ekf.gpu = device
    there = ekf.run(imu, fixes, start, START_SIGMA)
    assert np.abs(strapdown.navigation_errors(there.nav, here.nav)).max() < 1e-9
    np.testing.assert_allclose(there.sigma, here.sigma, rtol=1e-9)
