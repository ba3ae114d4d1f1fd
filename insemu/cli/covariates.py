"""What ``insemu fit-covariate`` and ``fit-regressors`` share: a log opened with its other columns, every axis fitted, results handed out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from rich.console import Console

from insemu.cli.fit import show, write
from insemu.cli.logs import LogArguments, ScaleArguments, hertz
from insemu.cli.options import Arguments, argument, option
from insemu.cli.printing import print_json
from insemu.errors import InputError, nearest

if TYPE_CHECKING:
    from insemu.fit import FitResult
    from insemu.records import Array, Series


class _Fit(Protocol):
    """A fit that stands on a noise model."""

    @property
    def result(self) -> FitResult: ...

    def to_json(self) -> dict[str, Any]: ...


F = TypeVar("F", bound=_Fit)


class CovariateArguments(Arguments):
    """A log, a structure and where the results go."""

    log: str = argument("LOG", "Log at rest or drive, with what the signals follow next to them.")
    model: str = option("--model", ...)
    read: LogArguments
    scales: ScaleArguments
    out: str = option("--output", "", "Write the models as YAML that a scenario reads.")
    page: str = option("--page", "")
    as_json: bool = option("--json", False)

    def opened(self) -> tuple[list[Series], Mapping[str, Array]]:
        """The axes that are asked for, all where none is, and what else the log has."""
        from insemu import units
        from insemu.cli.logs import column_names
        from insemu.formats import AXIS_OF_COLUMN
        from insemu.logs import open_with_covariates

        rate = hertz(self.read.rate)
        series, there = open_with_covariates(self.log, rate, units.parse(self.read.skip, "s"))
        wanted = column_names(self.read.columns)
        if wanted is None:
            return series, there
        names = [AXIS_OF_COLUMN.get(w, w) for w in wanted]
        unknown = [w for w in names if w not in [s.name for s in series]]
        if unknown:
            message = f"has no column '{unknown[0]}'" + nearest(unknown[0], [s.name for s in series])
            raise InputError(message, where=self.log)
        return [s for s in series if s.name in names], there

    def fitted(self, series: list[Series], fit: Callable[[Series], F]) -> dict[str, F]:
        """Axis to fit, with a bar of progress; an error names its axis."""
        from insemu.cli.printing import counting

        results = {}
        with counting(Console(stderr=True), "fitting", len(series)) as finished:
            for s in series:
                try:
                    results[s.name] = fit(s)
                except InputError as error:
                    raise InputError(error.message, where=error.where or s.name) from None
                finished(s.name)
        return results

    def give(
        self, results: dict[str, F], detail: Callable[[Console, str, F], None], render: Callable[..., Path]
    ) -> None:
        """Print the results, write models and page.

        Parameters
        ----------
        results : mapping
            Axis to fit.
        detail : callable
            Prints what a fit has next to its noise model.
        render : callable
            Writes the page.
        """
        console = Console(stderr=self.as_json)
        if self.as_json:
            plain = {"axes": {axis: f.to_json() for axis, f in results.items()}}
            print_json(plain, allow_nan=False)
        else:
            for axis, found in results.items():
                show(console, {axis: found.result})
                detail(console, axis, found)
        write({axis: f.result for axis, f in results.items()}, self.out, console)
        if self.page:
            console.print(f"page: {render(results, self.page, source=self.log)}")
