"""Long statistical runs: matched truth and belief over many flights, and covariance matrices over a day."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from insemu import earth, rotation, strapdown
from insemu.evaluate.consistency import nees, nees_test, nis_test
from insemu.filters import FilterOptions, InitialSigma, LooselyCoupledEKF
from insemu.noise import AR, AR1, GM, WN
from insemu.records import GnssRecord, ImuRecord
from insemu.strapdown import NavState
from tests import filter_cases as cases
from tests.consistency_of_runs import pooled_coverage
from tests.filter_cases import DT, MODEL_15, MODEL_24, MODEL_27, START_SIGMA

OUTAGES = ((420.0, 480.0), (660.0, 720.0), (900.0, 960.0))
#: Twenty epochs, the ends of the outages among them.
AT = (1, 10, 60, 120, 180, 240, 300, 360, 420, 450, 480, 540, 600, 660, 720, 780, 900, 960, 1080, 1200)


def halved(model):
    """The same structure with half of every noise."""
    scale = {WN: lambda p: WN(N=p.N / 2), GM: lambda p: GM(sigma=p.sigma / 2, beta=p.beta)}
    scale[AR] = lambda p: AR(p.ar, sigma2=p.sigma2 / 4, rate_hz=p.rate_hz)
    scale[AR1] = lambda p: AR1(p.phi, p.sigma2 / 4, rate_hz=p.rate_hz)
    return {axis: type(m)(tuple(scale[type(p)](p) for p in m)) for axis, m in model.items()}


def fly(road, truth, beliefs, runs):
    """Errors of all states, covariances and fix tables of every belief, at the twenty epochs."""
    filters = [LooselyCoupledEKF(b, DT, options=FilterOptions(output_every=100, covariance_at=AT)) for b in beliefs]
    rows = np.array(AT) * 100

    def one(i):
        rng = np.random.default_rng(5_000 + i)
        imu, states = cases.corrupt_with_states(road.imu, truth, rng)
        gnss, start = cases.fixes(road, rng, outages=OUTAGES), cases.start(road, rng)
        out = []
        for ekf in filters:
            r = ekf.run(imu, gnss, start, START_SIGMA)
            at = np.array(AT)
            navigation = strapdown.navigation_errors(r.nav[at], road.nav[rows])
            out.append((np.hstack([navigation, r.imu_states[at] - states[rows]]), r.covariance, r.fixes))
        return out

    with ThreadPoolExecutor(2) as pool:
        flown = list(pool.map(one, range(runs)))
    return [
        (np.stack([f[b][0] for f in flown]), np.stack([f[b][1] for f in flown]), [f[b][2] for f in flown])
        for b in range(len(beliefs))
    ]


@pytest.mark.slow(reason="hours of flight or many realizations")
@pytest.mark.parametrize("model", [MODEL_15, MODEL_24, MODEL_27], ids=["15AV", "24GMWM", "27AR"])
def test_two_hundred_matched_flights(model):
    """NEES of position, velocity, attitude and all IMU states at 20 epochs in family-wise 99 % bounds; half the noise believed fails."""
    road = cases.drive(1200.0)
    (errors, covariance, fixes), (twin_errors, twin_covariance, _) = fly(road, model, [model, halved(model)], 200)
    n = errors.shape[-1]
    groups = {
        "position": slice(0, 3),
        "velocity": slice(3, 6),
        "attitude": slice(6, 9),
        "gyroscope states": slice(9, 9 + (n - 9) * (2 if n == 24 else 1) // (5 if n == 24 else 2)),
    }
    groups["accelerometer states"] = slice(groups["gyroscope states"].stop, n)
    groups["IMU states"] = slice(9, n)

    def verdicts(e, P):
        confidence = 1 - 0.01 / len(groups)
        return {
            name: nees_test(nees(e[..., s], P[..., s, s]), s.stop - s.start, subject=name, at=AT, confidence=confidence)
            for name, s in groups.items()
        }

    found, twin = verdicts(errors, covariance), verdicts(twin_errors, twin_covariance)
    sigma = np.sqrt(np.einsum("rtii->rti", covariance))
    share, low, high = pooled_coverage(errors[..., :9], sigma[..., :9], confidence=0.99, rng=np.random.default_rng(0))
    nis = nis_test(fixes)
    print()
    for name, family in found.items():
        values, wrong = [v.value for v in family], [v.value for v in twin[name]]
        print(
            f"{name}: NEES/dof {min(values):.3f} to {max(values):.3f}, expected {family[0].low:.3f} to {family[0].high:.3f}; "
            f"half the noise believed: {min(wrong):.2f} to {max(wrong):.2f}"
        )
    print(f"{nis}\n3-sigma coverage {share:.5f} ({low:.5f}, {high:.5f})")
    flat = [v for family in found.values() for v in family]
    assert all(v.passed for v in flat), [str(v) for v in flat if not v.passed]
    assert low <= 0.9973 <= high
    assert nis.passed, str(nis)
    # between outages fixes alone keep position and velocity honest; the states of the sensors and the sum of all tell
    wrong = [v.word == "overconfident" for family in twin.values() for v in family]
    assert sum(wrong) > len(wrong) / 2
    assert all(v.word == "overconfident" for v in twin["IMU states"])


def resting(seconds, rate):
    """Ideal increments of a vehicle at rest."""
    start = NavState(np.array([0.8, 0.1, 200.0]), np.zeros(3), np.array([0.01, -0.02, 1.0]))
    C = rotation.dcm_from_rpy(start.rpy)
    n = round(seconds * rate) + 1
    w, f = C.T @ earth.earth_rate(0.8), C.T @ [0.0, 0.0, -float(earth.gravity(0.8, 200.0))]
    return start, ImuRecord(np.arange(n) / rate, np.tile(w / rate, (n, 1)), np.tile(f / rate, (n, 1)), kind="increment")


@pytest.mark.slow(reason="hours of flight or many realizations")
def test_a_day_at_rest_keeps_the_covariance_positive():
    """24 h at 100 Hz: every update checks the matrix; the end is symmetric, positive definite, and the error is within it."""
    start, ideal = resting(86_400.0, 100.0)
    rng = np.random.default_rng(4)
    imu = cases.corrupt(ideal, MODEL_24, rng)
    del ideal
    t = np.arange(1.0, 86_400.0, 1.0)
    llh = earth.move(np.tile(start.llh, (t.size, 1)), rng.standard_normal((t.size, 3)) * 0.05)
    gnss = GnssRecord(
        t, llh, rng.standard_normal((t.size, 3)) * 0.03, np.full((t.size, 3), 0.05), np.full((t.size, 3), 0.03)
    )
    at = np.arange(3600.0, 86_400.0, 3600.0)
    ekf = LooselyCoupledEKF(MODEL_24, DT, options=FilterOptions(output_every=36_000, covariance_at=tuple(at)))
    r = ekf.run(imu, gnss, start, InitialSigma(0.5, 0.1, (0.01, 0.01, 0.05)))
    P = r.final_covariance
    sd = np.sqrt(np.diag(P))
    assert (P == P.T).all()
    smallest = np.linalg.eigvalsh(P / np.outer(sd, sd)).min()
    print(f"\n24 h: smallest eigenvalue of the correlation {smallest:.2e}, NIS/dof {r.fixes.nis.mean() / 6:.4f}")
    assert smallest > 0
    assert nis_test(r.fixes, confidence=0.999).passed
    truth = start.to_array()
    rows = np.searchsorted(r.t, at - 1e-6)
    e = strapdown.navigation_errors(r.nav[rows], np.tile(truth, (at.size, 1)))
    # a start drawn exactly at the truth and one run: pooled over 23 hours, correlated in heading, so the bounds are wide
    pooled = nees(e[:, :6], r.covariance[:, :6, :6]).mean() / 6
    assert 0.6 < pooled < 1.5


@pytest.mark.slow(reason="hours of flight or many realizations")
def test_three_hours_of_driving_keep_the_covariance_positive():
    road = cases.drive(10_800.0)
    rng = np.random.default_rng(6)
    imu, start = cases.corrupt(road.imu, MODEL_24, rng), cases.start(road, rng)
    gnss = cases.fixes(road, rng, outages=tuple((900.0 * k, 900.0 * k + 60.0) for k in range(1, 12)))
    at = np.arange(300.0, 10_800.0, 300.0)
    r = LooselyCoupledEKF(MODEL_24, DT, options=FilterOptions(output_every=100, covariance_at=tuple(at))).run(
        imu, gnss, start, START_SIGMA
    )
    P = r.final_covariance
    sd = np.sqrt(np.diag(P))
    assert (P == P.T).all() and np.linalg.eigvalsh(P / np.outer(sd, sd)).min() > 0
    e = strapdown.navigation_errors(r.nav[at.astype(int)], road.nav[at.astype(int) * 100])
    value = nees(e, r.covariance[:, :9, :9]).mean() / 9
    print(f"\n3 h: NEES/dof {value:.3f}, NIS/dof {r.fixes.nis.mean() / 6:.4f}")
    assert 0.6 < value < 1.5
    assert nis_test(r.fixes, confidence=0.999).passed
