"""``insemu fit``: a noise model from a static log."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console

    from insemu.fit import FitResult
    from insemu.records import Series


def command(
    file: str = typer.Argument(..., metavar="FILE", help="Static log: .npz, .csv or .npy (columns with units)."),
    model: str = typer.Option(
        ..., "--model", "-m", help='Structure, for example "2*GM() + WN()"; values given are held.'
    ),
    method: str = typer.Option("gmwm", "--method", help="Estimator: gmwm."),
    columns: list[str] | None = typer.Option(  # noqa: B008
        None, "--column", "-c", help="Fit only this column (gx or gyro_x); may be repeated."
    ),
    rate: float | None = typer.Option(None, "--rate", help="Sampling rate in Hz of a log that does not say it."),
    weighting: str = typer.Option(
        "intervals",
        "--weighting",
        help="Weights of the gmwm: intervals, asymptotic or bootstrap (covariance under the model).",
    ),
    seed: int = typer.Option(0, "--seed", min=0, help="Seed of the bootstrap."),
    out: str = typer.Option("", "--out", "-o", help="Write the models as YAML that a scenario reads."),
    kalibr: str = typer.Option("", "--kalibr", help="Write a Kalibr / OpenVINS imu.yaml."),
    as_json: bool = typer.Option(False, "--json", help="Print JSON on standard output instead of tables."),
) -> None:
    """Fit a noise model to every axis of a static log."""
    import json

    from rich.console import Console

    from insemu import formats
    from insemu.errors import InputError

    series = formats.read(file, rate_hz=rate, columns=columns or None)
    if not isinstance(series, list):
        raise InputError("is a dynamic recording; expected a static log (sensor at rest)", where=file)
    results = fit_axes(series, model, method, _options(method, weighting, seed))
    console = Console(stderr=as_json)
    if as_json:
        typer.echo(json.dumps({"axes": {axis: r.to_json() for axis, r in results.items()}}, indent=1, allow_nan=False))
    else:
        for axis, r in results.items():
            show(console, axis, r)
    write(results, out, kalibr, console)


def _options(method: str, weighting: str, seed: int) -> dict[str, Any]:
    import numpy as np

    if method == "gmwm":
        return {"weighting": weighting, "rng": np.random.default_rng(seed)}
    return {}


def fit_axes(series: list[Series], model: str, method: str, options: dict[str, Any]) -> dict[str, FitResult]:
    """Fit every axis; the name of the axis goes in front of what is wrong with it."""
    from insemu.errors import InputError
    from insemu.fit import fit

    out: dict[str, FitResult] = {}
    for s in series:
        try:
            out[s.name] = fit(s, model, method, **options)  # type: ignore[arg-type]
        except InputError as error:
            raise InputError(error.message, where=error.where or (s.name if len(series) > 1 else None)) from None
    return out


def show(console: Console, axis: str, result: FitResult) -> None:
    """One table per axis, then the test of fit and what to beware of."""
    from rich.table import Table

    table = Table(
        title=f"{axis}: {result.structure}  ({result.method}, {result.n_samples} samples at {result.rate_hz:g} Hz)",
        title_justify="left",
    )
    for heading in ("parameter", "estimate ± standard error", "95 % interval", "datasheet and discrete"):
        table.add_column(heading, no_wrap=heading == "parameter")
    for row in result.rows():
        table.add_row(*row)
    console.print(table)
    if result.test is not None:
        verdict = (
            "the model is compatible with the data" if result.test.p_value >= 0.05 else "the data contradict the model"
        )
        console.print(
            f"test of fit: chi-square {result.test.statistic:.2f} on {result.test.dof} degrees of freedom, p = {result.test.p_value:.3g}: {verdict}"
        )
    for warning in result.warnings:
        console.print(f"[yellow]beware[/yellow]: {warning}", highlight=False)


def write(results: dict[str, FitResult], out: str, kalibr_path: str, console: Console) -> None:
    """Write the model file and the Kalibr file where asked for."""
    from pathlib import Path

    from insemu.fit import kalibr, save

    if out:
        target: Path = Path(out)
        target.parent.mkdir(parents=True, exist_ok=True)
        save(results, target)
        console.print(f"models: {target}")
    if kalibr_path:
        text, warnings = kalibr(results)
        target = Path(kalibr_path)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text, encoding="utf-8")
        for warning in warnings:
            console.print(f"[yellow]beware[/yellow]: {warning}", highlight=False)
        console.print(f"imu.yaml: {target}")
