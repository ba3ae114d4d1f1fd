"""First answers from a wheel in an empty environment: size on disk, CPU seconds of commands and imports, kernels that had to be compiled.

``python benchmarks/first.py [WHEEL]`` (the newest of ``dist/``, which ``make wheel`` fills) makes an environment under the folder for temporary
files. CPU seconds are those of the command and its processes on one BLAS thread, of the first call and the best of three more.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
SAMPLES, RATE = 1_000_000, 100.0


def cpu(command: list[str], folder: Path) -> float:
    """CPU seconds of a command, which must succeed."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    environment |= {"OPENBLAS_NUM_THREADS": "1", "NUMBA_CACHE_DIR": str(folder / "compiled")}
    subprocess.run(command, cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL)
    now = resource.getrusage(resource.RUSAGE_CHILDREN)
    return now.ru_utime + now.ru_stime - before.ru_utime - before.ru_stime


def size(folder: Path) -> float:
    """Megabytes of all files below a folder."""
    return sum(p.stat().st_size for p in folder.rglob("*") if p.is_file() and not p.is_symlink()) / 1e6


def main(wheel: Path) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        subprocess.run([sys.executable, "-m", "venv", str(folder / "venv")], check=True)
        python, insemu = str(folder / "venv" / "bin" / "python"), str(folder / "venv" / "bin" / "insemu")
        empty = size(folder / "venv")
        limits = ["--constraint", str(ROOT / "constraints.txt")]
        quiet = ["--quiet", "--disable-pip-version-check"]
        subprocess.run([python, "-m", "pip", "install", *quiet, *limits, str(wheel)], check=True)
        print(
            f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB; installed, with all it needs: {size(folder / 'venv') - empty:.0f} MB"
        )
        rng = np.random.default_rng(3)
        walk = np.cumsum(rng.standard_normal((SAMPLES, 6)), axis=0)
        for axes, file in ((1, "one.npz"), (6, "six.npz")):
            data = 1e-3 * rng.standard_normal((SAMPLES, axes)) + 1e-7 * walk[:, :axes]
            columns = ["gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"][:axes]
            units = (["rad/s"] * 3 + ["m/s^2"] * 3)[:axes]
            np.savez(folder / file, data=data, fs=RATE, columns=columns, units=units)
        print(f"{'CPU seconds':<60} {'first':>6} {'best of 3':>9}")
        for command in (
            [insemu, "--help"],
            [insemu, "--version"],
            [insemu, "designs"],
            [python, "-c", "import insemu"],
            [python, "-c", "import insemu.evaluate"],
            [insemu, "fit", "one.npz", "--model", "2*GM() + WN()"],
            [insemu, "fit", "six.npz", "--model", "2*GM() + WN()"],
            [insemu, "run", "table3_synthetic", "--realizations", "2", "--output", "table3"],
        ):
            first, *later = (cpu(command, folder) for _ in range(4 if len(command) < 4 else 1))
            best = f"{min(later):>9.2f}" if later else f"{'':>9}"
            print(f"{' '.join([Path(command[0]).name, *command[1:]]):<60} {first:>6.2f} {best}", flush=True)
        print(f"kernels compiled by all of these: {len(list((folder / 'compiled').rglob('*.nbc')))}")


if __name__ == "__main__":
    wheels = sys.argv[1:2] or sorted((ROOT / "dist").glob("*.whl"), key=lambda p: p.stat().st_mtime)
    main(Path(wheels[-1]).resolve()) if wheels else print("no wheel in dist/: make wheel")
