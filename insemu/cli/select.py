"""``insemu select``: which noise model the data support."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from rich.console import Console

from insemu.cli.fit import show as show_fit
from insemu.cli.fit import write
from insemu.cli.logs import LogArguments, hertz
from insemu.cli.options import DRAWS, Arguments, argument, option
from insemu.cli.printing import counting, print_boxed, print_json, print_table

if TYPE_CHECKING:
    from insemu.fit import FitResult, Ranking
    from insemu.variance import WaveletVariance


class SelectArguments(Arguments):
    """Of ``insemu select``."""

    file: str = argument("LOG")
    general: str = option("--general", "4*GM() + WN() + RW() + QN()")
    candidates: list[str] | None = option("--candidate", None)
    robust: bool = option("--robust", False)
    read: LogArguments
    held_out: list[str] | None = option(
        "--held-out", None, "Another log of the same sensor: how well the choice predicts it, scale by scale."
    )
    detail: bool = option("--detail", False)
    rows: int = option("--rows", 8, min=1, max=DRAWS)
    workers: int = option("--workers", None)
    cluster: str = option("--cluster", "")
    seed: int = option("--seed", 0, "Seed of the draws on the page.")
    out: str = option("--output", "", "Write the chosen models as YAML that a scenario reads.")
    page: str = option("--page", "")
    as_json: bool = option("--json", False)


def command(args: SelectArguments) -> None:
    """Choose a noise model for every axis among all models nested in a general one."""
    import numpy as np

    from insemu.cli.announce import announce
    from insemu.cluster import cluster as dask_cluster
    from insemu.fit import select_axes
    from insemu.noise import NoiseModel

    announce(args.file, hertz(args.read.rate))
    series = args.read.read(args.file)
    given = [NoiseModel.parse(c) for c in args.candidates] if args.candidates else None
    stderr = Console(stderr=True)
    with dask_cluster(args.cluster, args.workers) as pool, counting(stderr, "choosing", len(series)) as finished:
        rankings = select_axes(
            series,
            NoiseModel.parse(args.general),
            candidates=given,
            robust=args.robust,
            workers=args.workers,
            pool=pool,
            progress=finished,
        )
    console = Console(stderr=args.as_json)
    checks: dict[str, dict[str, dict[str, Any]]] = {axis: {} for axis in rankings}
    for other in args.held_out or []:
        for s in args.read.read(other):
            if s.name in rankings:
                from insemu.variance import wavelet_variance

                checks[s.name][other] = prediction(rankings[s.name], wavelet_variance(s.values, s.rate_hz, gaps=s.gaps))
    results = {axis: r.fit for axis, r in rankings.items()}
    if args.as_json:
        print_json({"axes": {a: as_plain(r, checks[a]) for a, r in rankings.items()}}, allow_nan=False)
    else:
        show_axes(console, results)
        for axis, ranking in rankings.items():
            if args.detail:
                show(console, ranking, args.rows)
            for other, found in checks[axis].items():
                show_prediction(console, axis, other, found)
    write(results, args.out, console)
    if args.page:
        from insemu.report.fit import render_fits

        rng = np.random.default_rng(args.seed)
        written = render_fits(results, args.page, series=series, rankings=rankings, rng=rng, source=args.file)
        console.print(f"page: {written}")


def prediction(ranking: Ranking, curve: WaveletVariance) -> dict[str, Any]:
    """How well the chosen model predicts another record, scale by scale."""
    import numpy as np

    from insemu.fit import RANK_DOF, covariance_of_curve, prediction_distance

    model = ranking.fit.model
    dt = 1.0 / curve.rate_hz
    predicted = model.wavelet_variance(curve.scale_samples, dt)
    spread = np.sqrt(np.diag(covariance_of_curve(model, curve)))
    distance, error = prediction_distance(model, curve)
    steady = 2.0 * (predicted / spread) ** 2 >= RANK_DOF
    ratio = np.sqrt(curve.value / predicted)[steady]
    return {
        "tau_s": curve.tau_s.tolist(),
        "measured": curve.value.tolist(),
        "predicted": predicted.tolist(),
        "standard_deviations": ((curve.value - predicted) / spread).tolist(),
        "mean_square": distance,
        "mean_square_standard_error": error,
        "deviation_ratio": {
            "lowest": float(ratio.min()),
            "highest": float(ratio.max()),
            "root_mean_square": float(np.exp(np.sqrt(np.mean(np.log(ratio) ** 2)))),
            "longest_tau_s": float(curve.tau_s[steady][-1]),
        },
    }


def show_prediction(console: Console, axis: str, other: str, found: dict[str, Any]) -> None:
    """One row per scale."""
    heads = ("scale (s)", "measured (deviation)", "predicted", "measured / predicted", "in standard deviations")
    columns = (found[key] for key in ("tau_s", "measured", "predicted", "standard_deviations"))
    rows = [
        (f"{tau:g}", f"{m**0.5:.4g}", f"{p**0.5:.4g}", f"{(m / p) ** 0.5:.3f}", f"{z:+.1f}")
        for tau, m, p, z in zip(*columns, strict=True)
    ]
    print_boxed(console, f"{axis}: predicted for {other}", heads, rows, left=0)
    ratio = found["deviation_ratio"]
    console.print(
        f"measured over predicted deviation up to {ratio['longest_tau_s']:g} s: {ratio['lowest']:.2f} to {ratio['highest']:.2f}, "
        f"off by a factor of {ratio['root_mean_square']:.2f} root mean square",
        highlight=False,
    )
    console.print(
        f"mean square of the last column over scales with enough degrees of freedom: {found['mean_square']:.3g} "
        f"(a true model has 1 ± {found['mean_square_standard_error']:.2g})",
        highlight=False,
    )


def show_axes(console: Console, results: Mapping[str, FitResult]) -> None:
    """The answer: a sentence, then one row per axis."""
    from insemu.report.fit import fits_answer

    console.print(fits_answer(results), highlight=False, style="bold")
    body = [[axis, r.verdict, str(r.structure)] for axis, r in results.items()]
    print_table(console, "Chosen models", ("axis", "verdict", "model"), body, left=3)
    for axis, r in results.items():
        console.print(f"{axis}: {r.words}", highlight=False, soft_wrap=True)


def show(console: Console, ranking: Ranking, rows: int) -> None:
    """The best candidates and the verdict, then the chosen fit."""
    from insemu.report.fit import ranking_rows

    header, body, chosen = ranking_rows(ranking, rows, unknown="–")
    title = f"{ranking.name}: {len(ranking.candidates)} candidates"
    print_boxed(console, title, header, body, left=1, bold=chosen)
    vanished = sum(c.vanished for c in ranking.candidates)
    if vanished:
        console.print(
            f"{vanished} more had a part without variance, which makes them one of the smaller models", highlight=False
        )
    console.print(ranking.verdict, highlight=False)
    show_fit(console, {ranking.name: ranking.fit})


def as_plain(ranking: Ranking, checks: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """For JSON: the chosen fit in the form of ``insemu fit``, the candidates, and the predictions."""
    out = ranking.fit.to_json()
    out["verdict"] = ranking.verdict
    out["discrepancy"] = ranking.discrepancy
    out["candidates"] = [
        {
            "model": str(c.structure),
            "parameters": c.parameters,
            "criterion": c.criterion.value,
            "criterion_standard_error": c.criterion.standard_error,
            "distance": c.objective,
            "p_value": c.p_value if math.isfinite(c.p_value) else None,
            "vanished": c.vanished,
            "chosen": c is ranking.chosen,
        }
        for c in ranking.candidates
    ]
    if checks:
        out["held_out"] = checks
    return out
