"""What an experiment will cost: filter epochs, time and memory, said before it begins; what does not fit into memory is refused."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from insemu.errors import InputError
from insemu.evaluate.dataset import bytes_per_epoch
from insemu.evaluate.emulated import BYTES_PER_SAMPLE
from insemu.evaluate.experiment import Experiment
from insemu.evaluate.running import FULL, most
from insemu.evaluate.stretched import STRETCH, StretchedWorld
from insemu.lanes import LANES

#: Filter epochs that one core does in a second with every lane taken: 45 to 15 states, see benchmarks/filters.py. Free lanes save nothing.
EPOCHS_PER_SECOND = (1.2e6, 5e6)
#: States behind the navigation that a design is taken to have: no model is fitted yet, and few designs have more.
STATES = 36
#: How often results are held while they are gathered: realization by realization, put together, and written.
HELD = 3


def memory_there() -> float | None:
    """Bytes of memory that can be used; None where the system does not say."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    return next((1024.0 * float(line.split()[1]) for line in lines if line.startswith("MemAvailable:")), None)


def effort(experiments: Sequence[Experiment], workers: int) -> str:
    """How long experiments take and how much memory they want, in words.

    Parameters
    ----------
    experiments : sequence of Experiment
        Flown one after the other.
    workers : int
        Realizations flown at a time.

    Raises
    ------
    InputError
        They want more memory than there is.
    """
    epochs, lanes, flying, kept, gathered = 0.0, 0.0, 0.0, 0.0, 0.0
    for e in experiments:
        at_a_time = min(workers * most(e), e.realizations)
        samples = e.samples
        held = min(samples, float(STRETCH)) if isinstance(e.world, StretchedWorld) else samples
        epochs += samples * e.realizations * len(e.scenario.designs)
        beside = -(-e.realizations // min(workers, e.realizations))
        lanes += samples * e.realizations * len(e.scenario.designs) * LANES / min(most(e), beside)
        kept += (
            held * BYTES_PER_SAMPLE
        )  # the worlds of all experiments are there from the start, their results to the end
        flying = max(flying, held * BYTES_PER_SAMPLE * at_a_time)
        rows = len(e.world.truth_at_outputs) * len(e.scenario.designs) * min(e.realizations, FULL)
        results = float(rows * bytes_per_epoch(states=STATES, smoother=e.scenario.smoother))
        kept += results
        gathered = max(gathered, (HELD - 1) * results)
    wanted = kept + max(flying, gathered)
    there = memory_there()
    if there is not None and wanted > there:
        raise InputError(
            f"wants about {wanted / 2**30:.1f} GiB of memory, and {there / 2**30:.1f} GiB are free; expected fewer workers (--workers), a shorter "
            "flight or a lower rate",
            where=str(experiments[0].file or "scenario"),
        )
    cores = min(workers, max(e.realizations for e in experiments))
    short, long = (lanes / rate / cores for rate in reversed(EPOCHS_PER_SECOND))
    return (
        f"{epochs:.3g} filter epochs: about {_duration(short)} to {_duration(long)} in the filters with {cores} worker(s), "
        f"and {max(wanted / 2**20, 1):.0f} MiB of memory"
    )


def _duration(seconds: float) -> str:
    for size, unit in ((3600.0, "h"), (60.0, "min")):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.2g} {unit}"
    return f"{max(seconds, 0.1):.2g} s"
