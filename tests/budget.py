"""One budget of false alarms for the tests that judge random draws: all of them together reject right code in one run of a thousand.

``@statistical(share, cells, power)`` states of a test the chance that right code fails it (``share``; every case of a parametrised test has
it), over how many bounds it is divided (each then has the size ``share / cells``), and the chance that what the test is there for is seen
(``power``, from :func:`chi_square_power` or :func:`binomial_power` of the stated alternative). Bounds come from :func:`chi_square` and
:func:`binomial`. ``tests/test_budget.py`` adds the shares up.

Seeds are fixed, so a run repeats. ``python -m tests.budget --seeds 20`` draws anew 20 times, prints how often each test rejected beside what its
share expects, and fails where there are more than one set of seeds in a thousand would give.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar
from xml.etree import ElementTree

import numpy as np
from scipy import stats

ROOT = Path(__file__).resolve().parents[1]
#: Chance that a run of all statistical tests on right code fails.
BUDGET = 1e-3
FRESH, STATED = "INSEMU_FRESH_SEED", "INSEMU_STATED"
F = TypeVar("F", bound=Callable[..., Any])


@dataclass(frozen=True)
class Stated:
    """What a statistical test says of itself."""

    share: float
    cells: int
    power: float


def chi_square(dof: float, share: float, cells: int = 1) -> tuple[float, float]:
    """Two-sided bounds of a chi-square over its degrees of freedom, at the size ``share / cells``."""
    tail = 0.5 * share / cells
    return float(stats.chi2.ppf(tail, dof) / dof), float(stats.chi2.isf(tail, dof) / dof)


def chi_square_power(dof: float, share: float, cells: int, ratio: float) -> float:
    """Chance that one bound of :func:`chi_square` is passed where the mean square is ``ratio`` times what is stated."""
    low, high = chi_square(dof, share, cells)
    return float(stats.chi2.cdf(low * dof / ratio, dof) + stats.chi2.sf(high * dof / ratio, dof))


def binomial(n: int, p: float, share: float, cells: int = 1) -> tuple[int, int]:
    """Least and largest number of n trials that a share p of successes leaves, two-sided at the size ``share / cells``."""
    tail = 0.5 * share / cells
    return int(stats.binom.ppf(tail, n, p)), int(stats.binom.isf(tail, n, p))


def binomial_power(n: int, p: float, share: float, cells: int, actual: float) -> float:
    """Chance that one bound of :func:`binomial` is passed where the share is ``actual``."""
    low, high = binomial(n, p, share, cells)
    return float(stats.binom.cdf(low - 1, n, actual) + stats.binom.sf(high, n, actual))


def statistical(share: float, cells: int = 1, *, power: float) -> Callable[[F], F]:
    """State share, number of bounds and power of a test; under ``INSEMU_FRESH_SEED`` every generator that it seeds draws anew."""

    def mark(test: F) -> F:
        @functools.wraps(test)
        def run(*args: Any, **kwargs: Any) -> Any:
            offset = int(os.environ.get(FRESH, "0"))
            if not offset:
                return test(*args, **kwargs)
            with _anew(offset, test.__globals__):
                return test(*args, **kwargs)

        run.stated = Stated(share, cells, power)  # type: ignore[attr-defined]
        return run  # type: ignore[return-value]

    return mark


class _anew:
    """``numpy.random.default_rng`` and ``SeedSequence`` with an offset to every seed, here and where a test module has them by another name."""

    def __init__(self, offset: int, names: dict[str, Any]) -> None:
        self.offset, self.names = offset, names

    def __enter__(self) -> None:
        rng, sequence, offset = np.random.default_rng, np.random.SeedSequence, self.offset

        def fresh_sequence(entropy: Any = None, **rest: Any) -> Any:
            return sequence([int(entropy), offset] if isinstance(entropy, int | np.integer) else entropy, **rest)

        def fresh_rng(seed: Any = None) -> np.random.Generator:
            return rng(fresh_sequence(seed) if isinstance(seed, int | np.integer) else seed)

        aliases = {name: fresh_rng for name, value in self.names.items() if value is rng}
        self.held = rng, sequence, {name: self.names[name] for name in aliases}
        np.random.default_rng, np.random.SeedSequence = fresh_rng, fresh_sequence  # type: ignore[assignment, misc]
        self.names.update(aliases)

    def __exit__(self, *_: object) -> None:
        np.random.default_rng, np.random.SeedSequence, aliases = self.held  # type: ignore[misc]
        self.names.update(aliases)


def files() -> list[str]:
    """Test files with statistical tests."""
    paths = sorted((ROOT / "tests").glob("test_*.py"))
    found = [p for p in paths if re.search(r"^@statistical\(", p.read_text(encoding="utf-8"), re.MULTILINE)]
    return [path.relative_to(ROOT).as_posix() for path in found]


def collected(slow: bool = True) -> dict[str, Stated]:
    """Every case of every statistical test by its name, and what it states."""
    words = ["--collect-only", "-q", "-p", "no:cacheprovider", "-p", "tests.budget_only"]
    words += [] if slow else ["-m", "not slow"]
    env = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}
    with tempfile.TemporaryDirectory() as folder:
        env[STATED] = str(Path(folder) / "stated.json")
        subprocess.run(
            [sys.executable, "-m", "pytest", *words, *files()], cwd=ROOT, env=env, capture_output=True, check=True
        )
        found = json.loads(Path(env[STATED]).read_text(encoding="utf-8"))
    return {name: Stated(*values) for name, values in found.items()}


def rerun(seeds: int, only: str, slow: bool) -> tuple[Counter[str], int]:
    """Rejections by test over fresh seeds, and the number of tests."""
    rejected: Counter[str] = Counter()
    count = 0
    for k in range(1, seeds + 1):
        with tempfile.TemporaryDirectory() as folder:
            note = Path(folder) / "results.xml"
            words = ["-q", "-p", "no:cacheprovider", "-p", "tests.budget_only", f"--junitxml={note}", *files()]
            words += ["-k", only] if only else []
            words += [] if slow else ["-m", "not slow"]
            env = {**os.environ, FRESH: str(k), "PYTHONPATH": f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}
            subprocess.run(
                [sys.executable, "-m", "pytest", *words], cwd=ROOT, env=env, capture_output=True, check=False
            )
            cases = list(ElementTree.parse(note).iter("testcase"))
            count = len(cases)
            for case in cases:
                if case.find("failure") is not None or case.find("error") is not None:
                    rejected[f"{case.get('classname')}.{case.get('name')}"] += 1
        print(f"seeds {k} of {seeds}: {sum(rejected.values())} rejections among {k * count} tests so far", flush=True)
    return rejected, count


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.budget", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seeds", type=int, default=0, help="run all at so many fresh seeds")
    parser.add_argument("--only", default="", metavar="TEXT", help="tests that pytest's -k takes")
    parser.add_argument("--slow", action="store_true", help="the long ones, too")
    given = parser.parse_args()
    stated = collected(slow=True)
    for name, s in stated.items():
        print(f"{s.share:8.1e}  {s.cells:3d} bounds of {s.share / s.cells:.1e}  power {s.power:.4f}  {name}")
    total = sum(s.share for s in stated.values())
    print(f"{len(stated)} tests, together {total:.2e} of a budget of {BUDGET:.0e}")
    if not given.seeds:
        return int(total > BUDGET)
    rejected, count = rerun(given.seeds, given.only, given.slow)
    expected = given.seeds * sum(s.share for s in stated.values()) * count / len(stated)
    for name, times in rejected.most_common():
        print(f"rejected {times} of {given.seeds}: {name}")
    found = sum(rejected.values())
    chance = float(stats.poisson.sf(found - 1, expected))
    print(
        f"{found} rejections in {given.seeds * count} tests, expected {expected:.3f}; so many by chance: {chance:.2g}"
    )
    return int(total > BUDGET or chance < 1e-3)


if __name__ == "__main__":
    sys.exit(main())
