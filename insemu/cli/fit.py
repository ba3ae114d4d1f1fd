"""``insemu fit``: a noise model from a static log."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, get_args

from rich.console import Console

from insemu import units
from insemu.cli.logs import LEAST, column_names, hertz, read_static
from insemu.cli.options import DRAWS, argument, option
from insemu.cli.printing import counting, print_boxed, print_json, print_table, print_text
from insemu.errors import InputError, nearest

if TYPE_CHECKING:
    from insemu.fit import FitResult
    from insemu.noise import NoiseModel
    from insemu.records import Series
    from insemu.variance import WaveletVariance


def command(
    log: str = argument("LOG"),
    model: str = option("--model", ...),
    method: str = option(
        "--method",
        "gmwm",
        "gmwm, indirect, em, mli, slopes (of the Allan variance), psd-slopes, hadamard-slopes, total-slopes, "
        "autocorrelation or burg.",
    ),
    columns: list[str] | None = option("--columns", None),
    rate: str = option("--rate", ""),
    skip: str = option("--skip", "0 s"),
    robust: bool = option("--robust", False, "Use the wavelet variance that outliers cannot move (gmwm)."),
    pooled: bool = option("--pooled", False),
    wavelet: str = option("--wavelet", "haar"),
    weighting: str = option("--weighting", "auto"),
    start: str = option("--start", ""),
    tau_from: str = option("--tau-from", ""),
    tau_to: str = option("--tau-to", ""),
    denoise: str = option(
        "--denoise",
        "",
        "Of burg and autocorrelation: rule and octaves that are de-noised first, sure:6, universal:6, packets:6 or "
        "approximation:7,accel_y=6 (axes that differ).",
    ),
    pattern: str = option("--pattern", "uniform"),
    bootstrap: int = option("--bootstrap", 0, min=0, max=DRAWS),
    seed: int = option("--seed", 0, "Seed of bootstrap and draws."),
    workers: int = option("--workers", None),
    cluster: str = option(
        "--cluster", "", "Simulate and refit for --bootstrap on a Dask cluster: local, or tcp://HOST:PORT."
    ),
    out: str = option("--output", "", "Write the models as YAML that a scenario reads."),
    page: str = option("--page", ""),
    as_json: bool = option("--json", False),
) -> None:
    """Fit a noise model to every axis of a log at rest.

    Several runs of one sensor: insemu fit-runs. Levels that follow a covariate: insemu fit-covariate. With regressors: insemu fit-regressors. A
    model in another program's words: insemu export.
    """
    import numpy as np

    from insemu.cli.announce import announce
    from insemu.fit import check_bootstrap

    if bootstrap:
        check_bootstrap(method, bootstrap)
    announce(log, hertz(rate))
    options = options_of(method, wavelet, weighting, seed, pattern, scales(tau_from, tau_to))
    pieces = (method == "mli" and pattern == "uniform") or (method == "gmwm" and wavelet == "haar" and not robust)
    streamed = (
        fit_streamed(log, rate, columns, skip, model, start, method, options)
        if pieces and not pooled and not page
        else None
    )
    series = [] if streamed else read_static(log, rate, columns, skip)
    own = denoising(denoise, method, [s.name for s in series]) if denoise else {}
    with counting(Console(stderr=True), f"fitting by {method}", len(series)) as finished:
        if streamed:
            results = streamed
        elif pooled:
            results = fit_pooled(series, model, method, start, robust, options)
        else:
            results = fit_axes(series, model, method, start, robust, options, workers, progress=finished, own=own)
    if bootstrap:
        from insemu.cluster import cluster as dask_cluster
        from insemu.work import run_items

        children = np.random.default_rng(seed).spawn(len(results))
        asked = {axis: (r, bootstrap, child) for (axis, r), child in zip(results.items(), children, strict=True)}
        with dask_cluster(cluster, min(workers, len(asked))) as pool:
            results = run_items(asked, bootstrapped, pool=pool)
    console = Console(stderr=as_json)
    if as_json:
        print_json({"axes": {axis: r.to_json() for axis, r in results.items()}}, allow_nan=False)
    else:
        from insemu.report.fit import fits_answer

        console.print(fits_answer(results), highlight=False, style="bold")
        show(console, results)
        show_shared(console, results)
    write(results, out, console)
    if page:
        from insemu.report.fit import render_fits

        console.print(f"page: {render_fits(results, page, series=series, rng=np.random.default_rng(seed), source=log)}")


def scales(tau_from: str, tau_to: str) -> tuple[float, float]:
    """Shortest and longest scale to use, s; all where nothing is given."""
    import math

    return units.parse(tau_from, "s") if tau_from else 0.0, units.parse(tau_to, "s") if tau_to else math.inf


def options_of(
    method: str, wavelet: str, weighting: str, seed: int, pattern: str, tau: tuple[float, float]
) -> dict[str, Any]:
    """Options of an estimator.

    Parameters
    ----------
    method, wavelet, weighting : str
    seed : int
        Of bootstrap and draws.
    pattern : str
        Of mli.
    tau : (float, float)
        Scales to use, s.
    """
    import numpy as np

    options: dict[str, Any] = {"wavelet": wavelet}
    if method == "gmwm":
        options |= {"weighting": weighting, "tau_from": tau[0], "tau_to": tau[1]}
    elif method == "mli":
        options["pattern"] = pattern
    return options | ({"rng": np.random.default_rng(seed)} if method in ("gmwm", "indirect") else {})


def fit_streamed(
    file: str,
    rate: str,
    columns: list[str] | None,
    skip: str,
    model: str,
    start: str,
    method: str,
    options: Mapping[str, Any],
) -> dict[str, FitResult] | None:
    """Fits of a long ``.npy`` or ``.npz`` log, which is read in pieces and never held; None for any other, and where samples are missing.

    Parameters
    ----------
    file, rate, columns, skip, model, start
        As of the command.
    method : {"gmwm", "mli"}
    options : mapping
        Of gmwm.
    """
    from pathlib import Path

    from insemu import formats
    from insemu.fit import LARGE, fit, fit_mli_pieces
    from insemu.logs import LONG
    from insemu.noise import NoiseModel
    from insemu.variance import stream_wavelet_variance

    if Path(file).suffix not in (".npy", ".npz") or formats.holds_recording(Path(file)):
        return None
    log = formats.read_log(file, rate_hz=hertz(rate), columns=column_names(columns))
    first = round(units.parse(skip, "s") * log.rate_hz)
    least = LARGE if method == "mli" else LONG
    if len(log) <= least or not 0 <= first <= len(log) - LEAST or log.gaps():
        return None
    out: dict[str, FitResult] = {}
    children = options["rng"].spawn(len(log.names)) if "rng" in options else [None] * len(log.names)
    for k, (column, unit) in enumerate(zip(log.names, log.units, strict=True)):
        name = formats.AXIS_OF_COLUMN.get(column, column)
        try:
            asked = NoiseModel.parse(model, unit)
            begin = NoiseModel.parse(start, unit) if start else None
            pieces = log.chunks(k, first=first)
            if method == "mli":
                out[name] = fit_mli_pieces(
                    pieces, len(log) - first, log.rate_hz, asked, start=begin, unit=unit, name=name
                )
                continue
            if any(p.shared for p in asked):
                return None
            try:
                curve = stream_wavelet_variance(pieces, log.rate_hz)
            except InputError:  # samples are missing
                return None
            given = {key: value for key, value in options.items() if key != "wavelet"} | {"rng": children[k]}
            out[name] = fit(curve, asked, unit=unit, name=name, start=begin, **given)
        except InputError as error:
            raise InputError(error.message, where=f"{file}: {name}") from None
    return out


def fit_axes(
    series: list[Series],
    model: str,
    method: str,
    start: str,
    robust: bool,
    options: Mapping[str, Any],
    workers: int,
    progress: Callable[[str], None] | None = None,
    own: Mapping[str, Mapping[str, Any]] | None = None,
) -> dict[str, FitResult]:
    """Fit every axis; the name of the axis goes in front of what is wrong with it.

    Parameters
    ----------
    series : list of Series
    model, start : str
        Structure, and a model to start from or nothing.
    method : str
    robust : bool
    options : mapping
        Of the method.
    workers : int
        Axes at a time.
    progress : callable, optional
        Told the name of an axis when it is finished.
    own : mapping of axis to mapping, optional
        Options of one axis.
    """
    from concurrent.futures import ThreadPoolExecutor

    from insemu.fit import fit
    from insemu.noise import NoiseModel

    asked = parsed(model, series)
    if any(p.shared for m in asked.values() for p in m):
        return _fit_shared(series, asked, method, start, robust, options)
    # every axis its own child, whatever the order in which threads come to it
    children = options["rng"].spawn(len(series)) if "rng" in options else [None] * len(series)

    def one(item: tuple[Series, Any]) -> FitResult:
        s, child = item
        given = {**options, **(own or {}).get(s.name, {})}
        if child is not None:
            given["rng"] = child
        try:
            if start:
                given["start"] = NoiseModel.parse(start, s.unit)
            result = fit(s, asked[s.unit], method, robust=robust, **given)  # type: ignore[arg-type]
        except InputError as error:
            known = error.where or error.message.startswith(s.name)
            raise InputError(error.message, where=error.where if known else s.name) from None
        if progress is not None:
            progress(s.name)
        return result

    with ThreadPoolExecutor(max_workers=min(workers, len(series))) as pool:
        return {s.name: r for s, r in zip(series, pool.map(one, zip(series, children, strict=True)), strict=True)}


def bootstrapped(item: tuple[FitResult, int, Any]) -> FitResult:
    """A fit with intervals and criterion from simulated signals: (fit, number of signals, generator)."""
    from insemu.fit import bootstrap_intervals, wic

    result, count, rng = item
    return replace(bootstrap_intervals(result, count, rng), criterion=wic(result, bootstrap=count, rng=rng))


def denoising(text: str, method: str, names: list[str]) -> dict[str, dict[str, Any]]:
    """Options of Burg's method or of the autocorrelation by axis, from ``RULE:LEVELS`` and ``AXIS=LEVELS`` after commas.

    Parameters
    ----------
    text : str
        What ``--denoise`` was given.
    method : str
    names : list of str
        Axes of the log.
    """
    from insemu.denoise import Rule

    if method not in ("burg", "autocorrelation"):
        raise InputError(f"de-noising belongs to burg and autocorrelation, not to '{method}'", where="--denoise")
    rule, _, rest = text.partition(":")
    first, *others = rest.split(",")
    if rule not in get_args(Rule) or not rest:
        expected = ", ".join(f"{r}:6" for r in get_args(Rule))
        raise InputError(f"found '{text}', expected a rule and octaves, one of: {expected}", where="--denoise")
    levels = dict.fromkeys(names, first)
    for item in others:
        axis, _, value = item.strip().partition("=")
        if axis not in levels:
            raise InputError(f"unknown axis '{axis}'" + nearest(axis, names), where="--denoise")
        levels[axis] = value
    for value in levels.values():
        if not value.strip().isdecimal():
            raise InputError(f"found '{value}' octaves, expected a whole number", where="--denoise")
    return {axis: {"denoise_levels": int(value), "denoise_rule": rule} for axis, value in levels.items()}


def _fit_shared(
    series: list[Series],
    asked: Mapping[str, NoiseModel],
    method: str,
    start: str,
    robust: bool,
    options: Mapping[str, Any],
) -> dict[str, FitResult]:
    """Axes whose model has shared processes, together."""
    from insemu.fit import fit_together

    if method != "gmwm" or robust or start or options["wavelet"] != "haar":
        raise InputError(
            "a model with shared processes is fitted by gmwm with the Haar filter, without --robust and --start",
            where="--model",
        )
    scales = {key: options[key] for key in ("tau_from", "tau_to")}
    return fit_together(series, {s.name: asked[s.unit] for s in series}, **scales)


def parsed(model: str, series: list[Series]) -> dict[str, NoiseModel]:
    """The structure by unit of the axes; what is wrong with it is no axis's fault."""
    from insemu.noise import NoiseModel

    try:
        return {s.unit: NoiseModel.parse(model, s.unit) for s in series}
    except InputError as error:
        raise InputError(error.message, where="--model") from None


def fit_pooled(
    series: list[Series], model: str, method: str, start: str, robust: bool, options: Mapping[str, Any]
) -> dict[str, FitResult]:
    """One model per unit and rate: the mean of the axes' curves, with as many times the information as there are axes."""
    import numpy as np

    from insemu.fit import cleaned_curve, fit
    from insemu.noise import NoiseModel
    from insemu.variance import wavelet_variance

    if method != "gmwm":
        raise InputError(f"--pooled belongs to gmwm, not to '{method}'")
    asked = parsed(model, series)
    groups: dict[tuple[str, float, int], list[Series]] = {}
    for s in series:
        groups.setdefault((s.unit, s.rate_hz, len(s)), []).append(s)
    out: dict[str, FitResult] = {}
    for (unit, rate, _), members in groups.items():
        curves: list[WaveletVariance] = [
            cleaned_curve(s, asked[unit]).curve
            if robust
            else wavelet_variance(s.complete("a pooled fit").values, rate, filter=options["wavelet"])
            for s in members
        ]
        count = len(curves)
        value = np.mean([c.value for c in curves], axis=0)
        spread = np.sqrt(1.0 / count)
        pooled = replace(
            curves[0],
            value=value,
            low=value - (value - np.mean([c.low for c in curves], axis=0)) * spread,
            high=value + (np.mean([c.high for c in curves], axis=0) - value) * spread,
        )
        efficiency = count * float(np.mean([getattr(c, "efficiency", 1.0) for c in curves]))
        name = {"rad/s": "gyro", "m/s^2": "accel"}.get(unit, "+".join(s.name for s in members))
        given = {**options, **({"start": NoiseModel.parse(start, unit)} if start else {})}
        out[name] = fit(pooled, asked[unit], unit=unit, name=name, **{"efficiency": efficiency, **given})
    return out


def show(console: Console, results: Mapping[str, FitResult]) -> None:
    """One table of all axes, then for each the test of fit and what to beware of."""
    first = next(iter(results.values()))
    title = f"{first.method}, {first.n_samples} samples at {first.rate_hz:g} Hz"
    heads = ("axis", "parameter", "estimate ± standard error", "95 % interval", "SI and discrete")
    body = [[axis if not k else "", *row] for axis, r in results.items() for k, row in enumerate(r.rows())]
    print_table(console, title, heads, body, left=5, fit=True, groups=True)
    for axis, r in results.items():
        said = f"{axis}: {r.structure}: {r.verdict}"
        if r.test is not None:
            said += f"; test of fit: chi-square {r.test.statistic:.2f} on {r.test.dof} degrees of freedom"
        if r.criterion is not None:
            said += f"; criterion: {r.criterion.value:.1f} ± {r.criterion.standard_error:.1f}"
        if "trace" in r.details:
            state = "the stopping rule was met" if r.converged else "not converged"
            said += f"; log-likelihood {-r.objective:.3f} after {len(r.details['trace'])} iterations: {state}"
        print_text(console, said)
        for warning in r.warnings:
            console.print(f"[yellow]beware[/yellow]: {warning}", highlight=False, soft_wrap=True)


def show_shared(console: Console, results: Mapping[str, FitResult]) -> None:
    """The mixing vector of every shared process, and the correlation of each pair of axes by scale."""
    from insemu.noise import shared_processes

    for name, members in shared_processes({axis: r.model for axis, r in results.items()}).items():
        said = ", ".join(f"{seen.axis} {seen.weight:.4g} {results[seen.axis].unit}" for seen in members)
        console.print(f"shared process {name}: {members[0].process.symbol}, seen by {said}", highlight=False)
    pairs = next(iter(results.values())).details.get("cross", {})
    if pairs:
        curves = list(pairs.values())
        rows = [
            (
                f"{tau:.4g}",
                *(f"{c.correlation[k]:.2f} ({c.correlation_low[k]:.2f} … {c.correlation_high[k]:.2f})" for c in curves),
            )
            for k, tau in enumerate(curves[0].tau_s)
        ]
        heads = ("scale, s", *(f"{a} {b}" for a, b in pairs))
        print_boxed(console, "correlation of the axes by scale (95 % interval)", heads, rows)


def write(results: Mapping[str, FitResult], out: str, console: Console) -> None:
    """Write the model file where asked for."""
    from insemu.fit import save

    if out:
        save(results, out)
        console.print(f"models: {out}")
