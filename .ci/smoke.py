"""Run every scenario with as few realizations as it allows; skip, saying so, those whose data is absent.

python .ci/smoke.py FOLDER [WORKERS]      scenarios beside each other, one unless given
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import yaml

#: Of a scenario that does not say it itself.
DEFAULT = ["run", "--realizations", "2"]
#: What a command answers where data that is not in the repository, or an optional package, is absent.
ABSENT = ("shared data", "need the package")


def insemu(*arguments: str) -> subprocess.CompletedProcess[str]:
    """A command of the program as a process of its own."""
    return subprocess.run([sys.executable, "-m", "insemu", *arguments], capture_output=True, text=True, check=False)


def smoke(path: Path, command: list[str], out: Path) -> tuple[str, str]:
    """Run a scenario: passed, FAILED or skipped, and what was printed where it did not pass."""
    run = insemu(command[0], str(path), *command[1:], "--output", str(out / path.stem), "--json")
    if run.returncode == 2 and any(words in run.stderr for words in ABSENT):
        return "skipped", run.stderr.strip()
    if run.returncode == 0:
        json.loads(run.stdout)
        if command[0] == "gap":  # what was found is a scenario that runs
            refined = str(out / path.stem / "refined.yaml")
            run = insemu(
                "run", refined, "--realizations", "1", "--no-pictures", "--output", str(out / f"{path.stem}_run")
            )
    return ("FAILED", f"{run.stdout[-2000:]}\n{run.stderr[-4000:]}") if run.returncode else ("passed", "")


def chains(documents: dict[Path, Any], out: Path) -> list[list[tuple[Path, list[str]]]]:
    """Scenarios with their commands, those behind each other of which one reads what another wrote."""
    found: dict[str, list[tuple[Path, list[str]]]] = {}
    for path, document in documents.items():
        command = document.get("smoke", DEFAULT)
        reads = next((part.removeprefix("{out}/") for part in command if part.startswith("{out}/")), path.stem)
        found.setdefault(reads, []).append((path, [part.replace("{out}", str(out)) for part in command]))
    return list(found.values())


def main(out: Path, workers: int) -> str:
    """Run all; the names of those that failed."""
    failed = []

    def follow(chain: list[tuple[Path, list[str]]]) -> None:
        for path, command in chain:
            started = time.monotonic()
            word, why = smoke(path, command, out)
            print(f"smoke {path}: {word}, {time.monotonic() - started:.0f} s {why}".rstrip(), flush=True)
            if word == "FAILED":
                failed.append(path.name)

    # a scenario that writes what another one reads stands before it in the alphabet: hidden truths before nominal models
    documents = {p: yaml.safe_load(p.read_text(encoding="utf-8")) for p in sorted(Path("scenarios").glob("*.yaml"))}
    with ThreadPoolExecutor(max_workers=workers) as pool:
        list(pool.map(follow, chains(documents, out)))
    return ", ".join(failed)


if __name__ == "__main__":
    names = main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 1)
    sys.exit(f"smoke runs failed: {names}" if names else 0)
