"""Fits handed on: the target's own formula with the exported numbers gives the fitted Allan deviation, or nothing is written."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from insemu import noise, units
from insemu.cli import main
from insemu.errors import InputError
from insemu.fit import fit, save
from insemu.formats import PROGRAMS, hand_on, read_fitted
from insemu.noise import GM, RW, WN, NoiseModel
from insemu.records import Series

RATE, SECONDS = 200.0, 1800.0
#: Truths of an axis: a walk, a process that forgets, one that the log is too short for, and one that is lost in the noise.
TRUTHS = (
    WN(N=2e-4) + RW(K=2e-5),
    WN(N=2e-4) + GM(sigma=2e-4, beta=1 / 200.0),
    WN(N=2e-4) + GM(sigma=1e-4, beta=1 / 2000.0) + RW(K=1e-5),
    WN(N=2e-4) + GM(sigma=1e-6, beta=1 / 20.0) + RW(K=2e-5),
    WN(N=2e-4) + RW(K=1e-9),
)
STRUCTURES = ("WN()+RW()", "WN()+GM()", "WN()+GM()+RW()", "WN()+GM()+RW()")


def _number(text: str, key: str) -> float:
    found = re.search(rf"{key}\"?[^0-9.+-]*([0-9.]+(?:e[+-]?[0-9]+)?)", text)
    assert found is not None, (key, text)
    return float(found[1])


def written_deviation(text: str, program: str, tau: np.ndarray) -> np.ndarray:
    """Allan deviation of the gyroscope by the formulas that the programs document, from the text alone: N^2 / tau + K^2 tau / 3, and of a
    Gauss-Markov process of K and T (IEEE Std 952-1997, C.1.5)."""
    root = np.sqrt(RATE)
    if program in ("kalibr", "openvins"):
        n, k, time = _number(text, "gyroscope_noise_density"), _number(text, "gyroscope_random_walk"), np.inf
    elif program == "vins-fusion":
        n, k, time = _number(text, "gyr_n") / root, _number(text, "gyr_w") / root, np.inf
    elif program == "gtsam":
        n, k, time = *(np.sqrt(_number(text, f"set{x}Covariance")) for x in ("Gyroscope", "BiasOmega")), np.inf
    elif program == "matlab":
        line = next(x for x in text.splitlines() if "gyroparams" in x)
        n, k, time = _number(line, "NoiseDensity"), _number(line, "RandomWalk"), np.inf
    elif program == "gazebo":
        part = text.split("<angular_velocity>")[1]
        n, k = _number(part, "<stddev>") / root, _number(part, "<dynamic_bias_stddev>")
        time = _number(part, "<dynamic_bias_correlation_time>")
    elif program in ("rotors", "px4"):
        n, k, time = (_number(text, f"gyroscope{x}") for x in ("NoiseDensity", "RandomWalk", "BiasCorrelationTime"))
    else:
        keys = ("arw", "gbstd", "corrtime:", 3600.0) if program == "kf-gins" else (
            "gyro_arw.: np.full.3,", "gyro_b_stability.: np.full.3,", "gyro_b_corr.: np.full.3,", 1.0
        )  # fmt: skip
        n = units.parse(f"{_number(text, keys[0])} deg/sqrt(h)", "rad/s/sqrt(Hz)")
        time = keys[3] * _number(text, keys[2])
        k = units.parse(f"{_number(text, keys[1])} deg/h", "rad/s") * np.sqrt(2.0 / time)
    slow = k**2 * tau / 3.0
    if np.isfinite(time) and time < 1e3 * tau[-1]:  # beyond, the closed form cancels its digits and is the walk's
        x = tau / time
        slow = (k * time) ** 2 / tau * (1.0 - (3.0 - 4.0 * np.exp(-x) + np.exp(-2.0 * x)) / (2.0 * x))
    return np.sqrt(n**2 / tau + slow)


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Twenty fits of seeded signals."""
    folder, out = tmp_path_factory.mktemp("fits"), []
    for k in range(20):
        truth, structure = TRUTHS[k % len(TRUTHS)], STRUCTURES[k % len(STRUCTURES)]
        signal = truth.simulate(int(RATE * SECONDS), 1.0 / RATE, np.random.default_rng([61, k]))
        result = fit(Series(signal, RATE, "rad/s", "gyro_x"), structure, "gmwm")
        save({"gyro_x": result}, folder / f"{k}.yaml")
        out.append(folder / f"{k}.yaml")
    return out


def test_what_is_written_is_the_fitted_curve_or_nothing_is(fitted: list[Path]) -> None:
    written, refused, left = 0, 0, 0
    for path in fitted:
        (one,) = read_fitted(path).values()
        tau = np.geomspace(1.0, SECONDS / 3.0, 25)
        want = np.sqrt(one.model.allan_variance(np.round(tau * RATE), 1.0 / RATE))
        low, high = (np.exp(np.interp(np.log(tau), np.log(one.tau), np.log(x))) for x in (one.low, one.high))
        left += bool(one.weak)
        for program in PROGRAMS:
            try:
                text, notes = hand_on({"gyro_x": one}, program)
            except InputError as error:
                refused += 1
                assert "times the fitted one at" in error.message
                continue
            written += 1
            assert bool(one.weak) == any("not determined" in n for n in notes)
            found = written_deviation(text, program, tau)
            # a hundredth for reading the interval between its stated times
            inside = (found > 0.99 * np.minimum(0.9 * want, low)) & (found < 1.01 * np.maximum(1.1 * want, high))
            assert inside.all(), (path.name, program, one.model, (found / want).round(3))
            if program in ("kalibr", "openvins", "gazebo"):
                assert _number(text, "update_rate") == RATE
    assert left >= 3 and refused >= 10 and written >= 100, (left, refused, written)


def test_a_process_that_forgets_is_no_walk(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A curve that turns down is refused as a walk, with the range over which it is one, which was tried."""
    model = WN(N=2e-4) + GM(sigma=5e-4, beta=1 / 30.0)
    noise.save({"gyro_x": model}, tmp_path / "m.yaml")
    with pytest.raises(SystemExit) as stop:
        main(
            [
                "export",
                str(tmp_path / "m.yaml"),
                "--to",
                "kalibr",
                "--log-length",
                "1 h",
                "-o",
                str(tmp_path / "k.yaml"),
            ]
        )
    said = capsys.readouterr().err
    assert stop.value.code == 2 and not (tmp_path / "k.yaml").exists()
    length = re.search(r"--log-length '(\d+) s'", said)
    assert length is not None
    hand_on(read_fitted(tmp_path / "m.yaml"), "kalibr", record_s=float(length[1]))
    _, notes = hand_on(read_fitted(tmp_path / "m.yaml"), "kalibr")  # without a log as far as it goes
    assert any("from 1 to" in n and "only" in n for n in notes)
    text, notes = hand_on(read_fitted(tmp_path / "m.yaml"), "gazebo")
    assert "no rate is stated with the models: 100 Hz is assumed" in notes
    assert _number(text, "<dynamic_bias_correlation_time>") == pytest.approx(30.0)


def test_a_part_that_is_not_determined_is_left_out_and_said(tmp_path: Path) -> None:
    model = WN(N=2e-4) + RW(K=2e-5) + GM(sigma=1e-6, beta=1.0)
    noise.save({"gyro_x": model}, tmp_path / "m.yaml")
    document = yaml.safe_load((tmp_path / "m.yaml").read_text())
    document["axes"]["gyro_x"]["fit"] = {"rate_hz": 200.0, "n_samples": 360_000, "not_determined": ["GM1"]}
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(document))
    text, notes = hand_on(read_fitted(tmp_path / "m.yaml"), "kalibr")
    assert _number(text, "gyroscope_random_walk") == pytest.approx(2e-5, rel=1e-6)
    assert notes == ["gyro_x: GM1 left out, not determined (standard error of several times the value)"]
    document["axes"]["gyro_x"]["fit"]["not_determined"] = ["RW1", "GM1"]
    del document["axes"]["gyro_x"]["model"][0]
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(document))
    with pytest.raises(InputError, match="nothing is determined"):
        hand_on(read_fitted(tmp_path / "m.yaml"), "kalibr")


def test_axes_of_a_sensor_are_their_mean_variance() -> None:
    axes = {f"gyro_{a}": NoiseModel((WN(N=n), RW(K=1e-5))) for a, n in zip("xyz", (1e-4, 2e-4, 3e-4), strict=True)}
    text, _ = hand_on({a: _bare(m) for a, m in axes.items()}, "kalibr", rate_hz=100.0)
    assert _number(text, "gyroscope_noise_density") == pytest.approx(1e-4 * np.sqrt(14.0 / 3.0), rel=1e-6)


def _bare(model: NoiseModel):  # type: ignore[no-untyped-def]
    from insemu.formats import Fitted

    return Fitted(model)
