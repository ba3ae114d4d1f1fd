"""Two releases of GTSAM, from before and after repairs of the covariance of its IMU factor, told apart by what ``insemu referee`` says of them.

Run: .venv/bin/python -m benchmarks.gtsam_releases [--realizations N] [--worlds NAMES]
Each release gets an environment of its own in a temporary folder (the older one needs numpy 1), so pip must reach a package index.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
#: Release from before the repairs, and from after them, with the numpy that it was built for.
RELEASES = {"4.2": "numpy<2", "4.3.0": "numpy>=2"}


def environment(release: str, folder: Path) -> Path:
    """Python of a new environment with a release of GTSAM and what insemu needs."""
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    python = folder / "bin" / "python"
    needed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    others = [n for n in needed if re.match(r"[\w.-]+", n)[0] != "numpy"]  # type: ignore[index]
    wanted = [RELEASES[release], f"gtsam=={release}", "matplotlib>=3.9", *others]
    subprocess.run([str(python), "-m", "pip", "install", "--quiet", *wanted], check=True)
    return python


def judged(python: Path, worlds: str, realizations: int, folder: Path) -> dict[str, Any]:
    """What the referee says of the ``gtsam`` of an environment."""
    settings = {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(folder / "kernels"), "OMP_NUM_THREADS": "1"}
    given = [
        "--worlds",
        worlds,
        "--realizations",
        str(realizations),
        "--workers",
        "1",
        "--output",
        str(folder),
        "--json",
    ]
    done = subprocess.run(
        [str(python), "-m", "insemu", "referee", "gtsam", *given], env={**os.environ, **settings}, stdout=subprocess.PIPE, check=False
    )  # fmt: skip
    if done.returncode not in (0, 1):
        raise SystemExit(f"the referee ended with {done.returncode}")
    found: dict[str, Any] = json.loads(done.stdout)[0]
    return found


def main() -> int:
    """Judge both without their names, say which is the older one, and look."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--realizations", type=int, default=16)
    parser.add_argument("--worlds", default="rest,turns,straight")
    given = parser.parse_args()
    order = list(RELEASES)
    random.SystemRandom().shuffle(order)
    accused: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        for label, release in zip("AB", order, strict=True):
            at = Path(folder) / label
            found = judged(environment(release, at / "python"), given.worlds, given.realizations, at)
            first = {w["world"]: w["first_inconsistency"] for w in found["worlds"] if w["first_inconsistency"]}
            for world, what in first.items():
                print(
                    f"  {label}, {world}: {what['component']} after {what['t']:g} s, {what['factor']:.3g} times the stated sigma"
                )
            print(
                f"{label}: {len(first)} of {len(found['worlds'])} worlds in which a component is not what is stated",
                flush=True,
            )
            accused += [label] * bool(first)
    right = len(accused) == 1 and order["AB".index(accused[0])] == next(iter(RELEASES))
    said = f"{accused[0]} is the release from before the repairs" if len(accused) == 1 else f"accused: {accused}"
    print(f"{'met ' if right else 'OPEN'} two releases told apart: {said} (A is {order[0]}, B is {order[1]})")
    return int(not right)


if __name__ == "__main__":
    sys.exit(main())
