"""``insemu fit``: a noise model from a static log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, get_args

from rich.console import Console

from insemu import units
from insemu.cli.logs import LEAST, LogArguments, ScaleArguments, column_names, hertz
from insemu.cli.options import DRAWS, Arguments, argument, option
from insemu.cli.printing import counting, print_boxed, print_json, print_table, print_text
from insemu.errors import InputError, found_at, nearest

if TYPE_CHECKING:
    from insemu.fit import Estimator, FitResult
    from insemu.noise import NoiseModel
    from insemu.records import Series
    from insemu.variance import WaveletVariance


class FitArguments(Arguments):
    """Of ``insemu fit``."""

    log: str = argument("LOG")
    model: str = option("--model", ...)
    method: str = option(
        "--method",
        "gmwm",
        "gmwm, indirect, em, mli, slopes (of the Allan variance), psd-slopes, hadamard-slopes, total-slopes, "
        "autocorrelation or burg.",
    )
    read: LogArguments
    robust: bool = option("--robust", False, "Use the wavelet variance that outliers cannot move (gmwm).")
    pooled: bool = option("--pooled", False)
    wavelet: str = option("--wavelet", "haar")
    weighting: str = option("--weighting", "auto")
    start: str = option("--start", "")
    scales: ScaleArguments
    denoise: str = option(
        "--denoise",
        "",
        "Of burg and autocorrelation: rule and octaves that are de-noised first, sure:6, universal:6, packets:6 or "
        "approximation:7,accel_y=6 (axes that differ).",
    )
    pattern: str = option("--pattern", "uniform")
    bootstrap: int = option("--bootstrap", 0, min=0, max=DRAWS)
    seed: int = option("--seed", 0, "Seed of bootstrap and draws.")
    workers: int = option("--workers", None)
    cluster: str = option(
        "--cluster", "", "Simulate and refit for --bootstrap on a Dask cluster: local, or tcp://HOST:PORT."
    )
    out: str = option("--output", "", "Write the models as YAML that a scenario reads.")
    page: str = option("--page", "")
    as_json: bool = option("--json", False)


def command(args: FitArguments) -> None:
    """Fit a noise model to every axis of a log at rest.

    Several runs of one sensor: insemu fit-runs. Levels that follow a covariate: insemu fit-covariate. With regressors: insemu fit-regressors. A
    model in another program's words: insemu export.
    """
    import numpy as np

    from insemu.cli.announce import announce
    from insemu.fit import Estimator, bootstrapped, check_bootstrap

    if args.bootstrap:
        check_bootstrap(args.method, args.bootstrap)
    announce(args.log, hertz(args.read.rate))
    shared: tuple[Any, ...] = ("method", "robust", "wavelet", "weighting", "pattern", "start", "seed")
    estimator = Estimator(**{name: getattr(args, name) for name in shared}, **args.scales.limits)
    streamed = None if args.pooled or args.page else fit_streamed(args, estimator)
    series = [] if streamed else args.read.read(args.log)
    own = denoising(args.denoise, args.method, [s.name for s in series]) if args.denoise else {}
    with counting(Console(stderr=True), f"fitting by {args.method}", len(series)) as finished:
        if streamed:
            results = streamed
        elif args.pooled:
            results = fit_pooled(series, parsed(args.model, series), estimator)
        else:
            parsed(args.model, series)
            results = estimator.fit(series, args.model, workers=args.workers, progress=finished, own=own)
    if args.bootstrap:
        from insemu.cluster import cluster as dask_cluster
        from insemu.work import run_items

        children = estimator.generators(len(results))
        asked = {axis: (r, args.bootstrap, child) for (axis, r), child in zip(results.items(), children, strict=True)}
        with dask_cluster(args.cluster, min(args.workers, len(asked))) as pool:
            results = run_items(asked, bootstrapped, pool=pool)
    console = Console(stderr=args.as_json)
    if args.as_json:
        print_json({"axes": {axis: r.to_json() for axis, r in results.items()}}, allow_nan=False)
    else:
        from insemu.report.fit import fits_answer

        console.print(fits_answer(results), highlight=False, style="bold")
        show(console, results)
        show_shared(console, results)
    write(results, args.out, console)
    if args.page:
        from insemu.report.fit import render_fits

        console.print(
            f"page: {render_fits(results, args.page, series=series, rng=np.random.default_rng(args.seed), source=args.log)}"
        )


def fit_streamed(args: FitArguments, estimator: Estimator) -> dict[str, FitResult] | None:
    """Fits of a long ``.npy`` or ``.npz`` log, which is read in pieces and never held.

    None for any other log or estimator, and where samples are missing.
    """
    from pathlib import Path

    from insemu import formats
    from insemu.fit import LARGE, Stream, fit, fit_mli_pieces
    from insemu.logs import LONG
    from insemu.noise import NoiseModel
    from insemu.variance import stream_wavelet_variance

    pieces = (args.method == "mli" and args.pattern == "uniform") or (
        args.method == "gmwm" and args.wavelet == "haar" and not args.robust
    )
    file = Path(args.log)
    if not pieces or file.suffix not in (".npy", ".npz") or formats.holds_recording(file):
        return None
    log = formats.read_log(file, rate_hz=hertz(args.read.rate), columns=column_names(args.read.columns))
    first = round(units.parse(args.read.skip, "s") * log.rate_hz)
    least = LARGE if args.method == "mli" else LONG
    if len(log) <= least or not 0 <= first <= len(log) - LEAST or log.gaps():
        return None
    out: dict[str, FitResult] = {}
    children = estimator.generators(len(log.names))
    for k, (column, unit) in enumerate(zip(log.names, log.units, strict=True)):
        name = formats.AXIS_OF_COLUMN.get(column, column)
        with found_at(f"{file}: {name}"):
            asked = NoiseModel.parse(args.model, unit)
            given = estimator.options(unit, children[k])
            chunks = log.chunks(k, first=first)
            if args.method == "mli":
                stream = Stream(chunks, len(log) - first, log.rate_hz, unit, name)
                out[name] = fit_mli_pieces(stream, asked, start=given.get("start"))
                continue
            if any(p.shared for p in asked):
                return None
            try:
                curve = stream_wavelet_variance(chunks, log.rate_hz)
            except InputError:  # samples are missing
                return None
            out[name] = fit(curve, asked, unit=unit, name=name, **given)
    return out


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


def parsed(model: str, series: list[Series]) -> dict[str, NoiseModel]:
    """The structure by unit of the axes; what is wrong with it is no axis's fault."""
    from insemu.noise import NoiseModel

    with found_at("--model"):
        return {s.unit: NoiseModel.parse(model, s.unit) for s in series}


def fit_pooled(series: list[Series], models: Mapping[str, NoiseModel], estimator: Estimator) -> dict[str, FitResult]:
    """One model per unit and rate: the mean of the axes' curves, with as many times the information as there are axes."""
    import numpy as np

    from insemu.fit import cleaned_curve, fit
    from insemu.variance import wavelet_variance

    if estimator.method != "gmwm":
        raise InputError(f"--pooled belongs to gmwm, not to '{estimator.method}'")
    groups: dict[tuple[str, float, int], list[Series]] = {}
    for s in series:
        groups.setdefault((s.unit, s.rate_hz, len(s)), []).append(s)
    out: dict[str, FitResult] = {}
    rng = np.random.default_rng(estimator.seed)
    for (unit, rate, _), members in groups.items():
        curves: list[WaveletVariance] = [
            cleaned_curve(s, models[unit]).curve
            if estimator.robust
            else wavelet_variance(s.complete("a pooled fit").values, rate, filter=estimator.wavelet)
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
        given = {"efficiency": efficiency} | estimator.options(unit, rng)
        out[name] = fit(pooled, models[unit], unit=unit, name=name, **given)
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
