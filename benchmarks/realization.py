"""CPU seconds of a run of Table III by part: what one more realization takes, and all of ``insemu run`` with its pages and pictures.

Run: python benchmarks/realization.py [--realizations N] [--no-pictures]; with compiled kernels (a second run, after any change of a source file).
The command runs in this process with one worker; processes that draw pictures are its children. A part's seconds are its own, without those of
parts that it calls.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
SCENARIO = Path(__file__).parents[1] / "scenarios" / "table3_synthetic.yaml"
#: Parts, with the functions (module, name) in which they are; those of every realization, then those of the whole run.
EACH: dict[str, list[tuple[str, str]]] = {
    "kernel": [
        *(("insemu.filters", f"LooselyCoupledEKF.{run}") for run in ("run", "run_many")),
        ("insemu.evaluate.experiment", "smooth"),
    ],
    "flight": [("insemu.evaluate.emulated", "EmulatedWorld.realized")],
    "draws": [("insemu.emulate.pieces", "ErrorPieces.piece")],
    "judging": [("insemu.evaluate", "Experiment.side_by_side")],
    "keeping": [("insemu.work", "Files.put")],
}
ONCE: dict[str, list[tuple[str, str]]] = {
    "preparing": [("insemu.cli.run", "prepared"), ("insemu.evaluate.experiment", "Experiment._belief")],
    "covariance": [("insemu.cli.run", "with_budgets")],
    "gathering": [("insemu.evaluate.running", "collected")],
    "writing": [("insemu.evaluate", name) for name in ("write", "write_summary", "finish")],
    "page": [("insemu.report.experiment", "render_experiment")],
    "pictures": [("insemu.report.static", "save")],
    "printing": [("insemu.cli.run", "show")],
}


class Watch:
    """CPU seconds of parts, each without what is inside another one."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys([*EACH, *ONCE], 0.0)
        self._inside: list[str] = []
        self._since = time.process_time()

    def _turn(self) -> None:
        now = time.process_time()
        if self._inside:
            self.seconds[self._inside[-1]] += now - self._since
        self._since = now

    def watched(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, its time taken down."""

        def timed(*args: Any, **kwargs: Any) -> Any:
            self._turn()
            self._inside.append(part)
            try:
                return function(*args, **kwargs)
            finally:
                self._turn()
                self._inside.pop()

        return timed

    def put(self) -> None:
        """Watch every function of the tables."""
        for part, places in (EACH | ONCE).items():
            for module, name in places:
                *holder, last = name.split(".")
                place: Any = importlib.import_module(module)
                for inner in holder:
                    place = getattr(place, inner)
                setattr(place, last, self.watched(part, getattr(place, last)))


def children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--realizations", type=int, default=24)
    parser.add_argument("--no-pictures", action="store_true")
    given = parser.parse_args()
    from insemu.cli import main as insemu

    for module in {module for places in (EACH | ONCE).values() for module, _ in places}:
        importlib.import_module(module)
    imports = time.process_time()
    watch = Watch()
    watch.put()
    said = io.StringIO()
    with tempfile.TemporaryDirectory() as out, contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        sys.argv = ["insemu", "run", str(SCENARIO), "--workers", "1", "--realizations", str(given.realizations)]
        sys.argv += ["--output", out, *(["--no-pictures"] if given.no_pictures else [])]
        with contextlib.suppress(SystemExit):
            insemu()
    if "Page:" not in said.getvalue():
        sys.exit(said.getvalue())
    watch.seconds["pictures"] += children()
    whole = time.process_time() + children()
    each = {part: watch.seconds[part] / given.realizations for part in EACH}
    print(
        f"one more realization: {sum(each.values()):.3f} CPU s: " + ", ".join(f"{k} {v:.3f}" for k, v in each.items())
    )
    flown = sum(watch.seconds[part] for part in EACH)
    once = {part: watch.seconds[part] for part in ONCE}
    rest = whole - imports - flown - sum(once.values())
    parts = {"realizations": flown, "imports": imports, **once, "rest": rest}
    print(
        f"{given.realizations} realizations of Table III: {whole:.1f} CPU s: "
        + ", ".join(f"{k} {v:.2f}" for k, v in parts.items())
    )


if __name__ == "__main__":
    main()
