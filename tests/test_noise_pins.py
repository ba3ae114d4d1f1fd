"""Processes, their grids, draws and refusals as they are."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from insemu.errors import InputError
from insemu.fit.structure import Structure
from insemu.noise import GM, WN, NoiseModel, Process
from insemu.noise.compiled import curves
from insemu.noise.follow import Follows
from tests.pins import differences, kept, plain
from tests.test_noise_derived import DT, FITTED, RATE, ROWS

M = 2.0 ** np.arange(8)


def _or_refused(call: Callable[[], Any]) -> Any:
    try:
        return plain(call())
    except (InputError, ValueError, NotImplementedError) as error:
        return f"{type(error).__name__}: {error}"


def _process(p: Process) -> dict[str, Any]:
    """Everything that a process says of itself."""
    calls: dict[str, Callable[[], Any]] = {
        "block": lambda: p.block(DT),
        "roots": lambda: p.block(DT).roots(),
        "memory": lambda: p.block(DT).memory,
        "allan": lambda: p.allan_variance([1, 2, 5, 40, 900], DT),
        "wavelet": lambda: p.wavelet_variance([2, 4, 64], DT),
        "psd": lambda: p.psd([0.01, 1.0, 9.0, 40.0], DT),
        "autocovariance": lambda: p.autocovariance([0, 1, 2, 5, 30, -5], DT),
        "differences": lambda: [p.difference_covariance(m, DT, count) for m, count in ((1, 1), (7, 2), (40, 6))],
        "mean": lambda: [p.mean_variance(m, DT) for m in (1, 9, 200)],
        "wandering": lambda: [p.wandering(m, DT) for m in (1, 9, 200)],
        "time": lambda: p.correlation_time(DT),
        "remembers": lambda: [p.remembers(DT, time) for time in (0.0, 0.5, 100.0)],
        "parts": lambda: p.markov_parts(DT),
        "moving": lambda: p.moving(),
        "per sample": lambda: p.per_sample(DT),
        "white and walk": lambda: p.as_white_and_walk(DT),
        "scaled": lambda: str(p.scaled(3.0)),
        "coordinates": lambda: p.coordinates(DT),
        "slopes": lambda: p.coordinate_slopes(DT),
        "bounds": lambda: [p.shape_bounds(n) for n in (1000, 50_000)],
        "grid": lambda: [
            np.array(p.shape_grid(n, alike, np.random.default_rng(3)))
            for n, alike in ((1000, 1), (1000, 2), (5000, 3), (5000, 4), (5000, 7))
        ],
        "draw": lambda: p.simulate(600, DT, np.random.default_rng(4)),
        "text": lambda: [str(p), p.to_mapping("rad/s"), p.to_mapping("m/s^2"), p.to_mapping("")],
        "refused": lambda: [_or_refused(lambda method=method: p.refuse(method)) for method in ("gmwm", "mli", "em")],
        "meta": lambda: [
            (q.name, q.unit_for("rad/s"), q.unit_for("m/s^2"), q.unit_for(""), q.power, q.sample_power, q.positive)
            for q in p.parameters_meta()
        ],
        "one parameter": lambda: [
            (q.shape(v, DT, "X"), q.slope(v, DT), q.of_shape(0.3, DT), q.bounds(1000), q.grid(1000, 2))
            for q in p.parameters_meta()
            if (v := p.parameters[q.name]) > 0.0
        ],
        "out of domain": lambda: [
            _or_refused(lambda q=q, v=v: q.check(v, "X"))
            for q in p.parameters_meta()
            for v in (-2.0, -1.0, 0.0, 1.0, float("inf"), float("nan"))
        ],
    }
    return {name: _or_refused(call) for name, call in calls.items()}


def _curve(p: Process) -> Any:
    """The compiled wavelet variance with coefficient 1, and its derivatives by the shapes."""
    structure = Structure.of(NoiseModel((p.with_parameters(dict.fromkeys(p.given)),)), RATE)
    s = structure.internal(NoiseModel((p,)))[1]
    out = []
    for moved in (0.0, 0.7, -1.5):
        shapes = np.array(s, dtype=np.float64) + moved
        b, db = np.empty(M.size), np.zeros((M.size, shapes.size))
        address, _held = p.curve_address(DT)
        curves.evaluate(address, M, shapes, p.order, b, db)
        out.append((b, db))
    return out


def _follows() -> dict[str, Callable[[], Any]]:
    laws = {
        "exp": Follows("temperature", 0.02, at=25.0),
        "own column": Follows("load", -0.3),
        "speed": Follows("speed", 0.1),
        "power": Follows("temperature", 0.5, law="power", at=30.0, above=10.0),
        "free": Follows("temperature"),
    }
    given = {"temperature": np.array([5.0, 10.0, 25.0, 40.0, 1e5]), "load": 2.0, "speed": np.array([0.0, 20.0])}
    return {
        f"follows {name}": lambda law=law: {
            "gain": _or_refused(lambda: law.gain(law.of(given, "GM"))),
            "stretched": _or_refused(lambda: law.stretched(law.of(given, "GM"))),
            "said": [law.unit, law.slope_unit, law.arguments(), law.to_mapping(), law.origin],
            "specified": [GM(1.0, 2.0, follows=law).specified, WN(follows=law).specified],
            "missing": _or_refused(lambda: law.of({"heat": 1.0}, "GM")),
            "nothing": _or_refused(lambda: law.of(None, "GM")),
            "lost": _or_refused(lambda: law.gain(np.array([np.nan]))),
        }
        for name, law in laws.items()
    }


def _models() -> dict[str, Callable[[], Any]]:
    texts = (
        "WN(N=1, follows=temperature, slope=0.02 1/K, at=25)", "WN(N=1, slope=2)", "WN(N=1, follows=temperature, law=cubic)",
        "WN(N=1, follows=1)", "GM(sigma=1, Tc=1 s, shared=3)", "GM(sigma=1, Tc=1 s, shared=-warmth)", "101*WN()", "64*WN() + 64*RW()",
        "AR(0)", "AR(2, 2)", "AR(101)", "ARMA(2)", "ARMA(p=2, q=x)", "AR1(phi=1, sigma2=1)", "AR1(phi=-3, sigma2=1)", "GM()", "WN() +",
        "AR(ar=[0.5, nan], sigma2=1)", "AR1(phi=0.5, sigma2=-1, rate_hz=0)", "PWC(sigma=1, T=0)", "SIN(alpha=1, f=-1 Hz)", "WN()WN()",
    )  # fmt: skip
    counts: tuple[Any, ...] = (0, 1, 2, True, 1.5, 64, 65)
    items: tuple[Any, ...] = (3, [3], [{"process": "GX"}], [{"process": "WN"}] * 65, [])
    return {
        "texts": lambda: {t: _or_refused(lambda t=t: str(NoiseModel.parse(t, "rad/s"))) for t in texts},
        "counts": lambda: [_or_refused(lambda c=c: len(c * NoiseModel((WN(),)))) for c in counts],
        "lists": lambda: [_or_refused(lambda i=i: str(NoiseModel.from_list(i, "rad/s"))) for i in items],
        "sum": lambda: NoiseModel(tuple(p for p in ROWS.values() if p.symbol != "RC")).block(DT),
        "sum drawn": lambda: NoiseModel(tuple(ROWS.values())).simulate(300, DT, np.random.default_rng(5)),
    }


CASES: dict[str, Callable[[], Any]] = {
    **{f"process {name}": lambda p=p: _process(p) for name, p in ROWS.items()},
    **{f"curve {name}": lambda p=p: _curve(p) for name, p in FITTED.items() if name != "DR"},
    **_follows(),
    **_models(),
}
KEPT = kept("noise")


@pytest.mark.parametrize("name", CASES)
def test_a_process_is_as_it_was(name: str) -> None:
    assert not differences(plain(CASES[name]()), KEPT.get(name))
