"""Speed of the variances against peers in the same run, and of the one-pass reader on a long file.

    python benchmarks/variance.py                 # a minute; the long file has 20 million samples
    python benchmarks/variance.py --long 150e6    # 100 h at 400 Hz: writes and deletes a 600 MB file

One core: run with OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from insemu.variance import allan_variance, robust_wavelet_variance, stream_wavelet_variance, wavelet_variance


def alternate(functions: dict[str, Callable[[], object]], rounds: int = 15) -> dict[str, np.ndarray]:
    """Seconds on the processor of every function in every round: one warm call each, then all in turn, so that they share what the machine does.

    Other programs' turns do not count, but their use of the caches does: ratios within a round are steadier than times.
    """
    for function in functions.values():
        function()
    times: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(rounds):
        for name, function in functions.items():
            start = time.process_time()
            function()
            times[name].append(time.process_time() - start)
    return {name: np.array(seconds) for name, seconds in times.items()}


def in_memory(rounds: int) -> None:
    import warnings

    import allantools

    x = np.random.default_rng(1).standard_normal(1_000_000)
    dirty = x.copy()
    dirty[::100] += 10.0
    peer = "allantools.oadev over octaves"
    limits = {
        "Haar wavelet variance, 19 octaves, intervals": (0.040, 0.28),
        "overlapping Allan variance, octaves, intervals": (None, None),
        "robust, clean record": (0.5, 2.5),
        "robust, 1 % outliers": (0.5, 2.5),
    }
    wavelet, allan, clean, contaminated = limits
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        quick = alternate(
            {
                peer: lambda: allantools.oadev(x, rate=1.0, data_type="freq", taus="octave"),
                wavelet: lambda: wavelet_variance(x),
                allan: lambda: allan_variance(x),
            },
            rounds,
        )
    slow = alternate(
        {clean: lambda: robust_wavelet_variance(x), contaminated: lambda: robust_wavelet_variance(dirty)}, 5
    )
    theirs = quick.pop(peer)
    print(
        f"1e6 samples, {rounds} rounds in turn; {peer}: best {1e3 * theirs.min():.1f} ms, median {1e3 * np.median(theirs):.1f} ms"
    )
    print(
        f"{'':50s} {'best ms':>8s} {'median':>7s} {'limit':>6s} {'peer/ours, best':>16s} {'median':>7s} {'R wv/ours':>10s}"
    )
    for name, seconds in (quick | slow).items():
        limit, r = limits[name]
        against = ""
        if name in quick:
            against = f"{theirs.min() / seconds.min():16.1f} {np.median(theirs / seconds):7.1f}"
        limit_text = "" if limit is None else f"{1e3 * limit:.0f}"
        r_text = "" if r is None else f"{r / seconds.min():.0f}"
        print(
            f"{name:50s} {1e3 * seconds.min():8.2f} {1e3 * np.median(seconds):7.2f} {limit_text:>6s} {against:>24s} {r_text:>10s}"
        )
    print("(R wv: 0.28 s and 2.5 s, measured when the project was planned, another machine of this kind)")


def write_noise(path: Path, n: int) -> None:
    """White noise in pieces, float32."""
    out = np.lib.format.open_memmap(path, mode="w+", dtype=np.float32, shape=(n,))
    rng = np.random.default_rng(2)
    for start in range(0, n, 1 << 22):
        stop = min(n, start + (1 << 22))
        out[start:stop] = rng.standard_normal(stop - start, dtype=np.float32)
    out.flush()


def stream_once(path: str) -> None:
    """Child process: one pass over a file; prints samples, octaves, seconds and its peak memory."""
    stream_wavelet_variance(iter([np.zeros(5000)]))  # compile
    x = np.load(path, mmap_mode="r")
    start = time.process_time()
    curve = stream_wavelet_variance(x[k : k + (1 << 18)] for k in range(0, x.size, 1 << 18))
    seconds = time.process_time() - start
    print(x.size, len(curve), seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0, file_backed())


def file_backed() -> float:
    """Pages of mapped files that count as resident, MB (the kernel may drop them at any time)."""
    for line in (
        Path("/proc/self/status").read_text(encoding="ascii").splitlines() if Path("/proc/self/status").exists() else []
    ):
        if line.startswith("RssFile"):
            return float(line.split()[1]) / 1024.0
    return float("nan")


def long_file(n: int) -> None:
    print("\none pass over a memory-mapped file (float32), all octaves")
    print(f"{'samples':>12s} {'octaves':>8s} {'s':>7s} {'ns/sample/octave':>17s} {'peak MB':>8s}")
    cost = []
    for size in (10_000_000, n):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "noise.npy"
            write_noise(path, size)
            runs = []
            for _ in range(3 if size == 10_000_000 else 1):
                done = subprocess.run(
                    [sys.executable, __file__, "--stream", str(path)], check=True, capture_output=True, text=True
                )
                _, octaves, seconds, peak, backed = done.stdout.split()
                runs.append((float(seconds), float(peak), float(backed)))
            seconds_best, peak_mb, backed_mb = min(runs)
        cost.append(1e9 * seconds_best / size / int(octaves))
        print(
            f"{size:12d} {octaves:>8s} {seconds_best:7.2f} {cost[-1]:17.3f} {peak_mb:8.0f}  (of these {backed_mb:.0f} MB are pages of the file)"
        )
    print(f"cost per sample and octave, long over short: {cost[1] / cost[0]:.2f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--long", type=float, default=20e6, help="samples of the long file")
    parser.add_argument("--rounds", type=int, default=25, help="times that our functions and the peer take turns")
    parser.add_argument("--stream", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.stream:
        stream_once(arguments.stream)
    else:
        in_memory(arguments.rounds)
        long_file(int(arguments.long))
