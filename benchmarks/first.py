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


def installed(python: str, folder: Path) -> str:
    """Megabytes of what was installed beside pip, and of the bytecode that pip made of all its modules; the largest packages."""
    code = (
        "import importlib.metadata as m\n"
        "for d in m.distributions():\n"
        "    print(d.metadata['Name'], *(d.locate_file(f) for f in d.files or ()), sep='\\t')"
    )
    said = subprocess.run([python, "-c", code], cwd=folder, check=True, capture_output=True, text=True).stdout
    own, compiled = {}, 0
    for name, *files in (line.split("\t") for line in said.splitlines()):
        sizes = {f: Path(f).stat().st_size for f in files if Path(f).is_file()}
        if name not in ("pip", "setuptools"):
            bytecode = sum(n for f, n in sizes.items() if f.endswith(".pyc"))
            compiled += bytecode
            own[name] = sum(sizes.values()) - bytecode
    largest = ", ".join(f"{k} {v / 1e6:.0f}" for k, v in sorted(own.items(), key=lambda item: -item[1])[:6])
    return f"installed {sum(own.values()) / 1e6:.0f} MB and {compiled / 1e6:.0f} MB of bytecode (--no-compile leaves it out); {largest}"


def main(wheel: Path) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        subprocess.run([sys.executable, "-m", "venv", str(folder / "venv")], check=True)
        python, insemu = str(folder / "venv" / "bin" / "python"), str(folder / "venv" / "bin" / "insemu")
        limits = ["--constraint", str(ROOT / "constraints.txt")]
        quiet = ["--quiet", "--disable-pip-version-check"]
        subprocess.run([python, "-m", "pip", "install", *quiet, *limits, str(wheel)], check=True)
        print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB; {installed(python, folder)}")
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
