"""``insemu merge``: the results of a run that was flown in shards."""

from __future__ import annotations

from insemu.cli.options import argument, option


def command(
    folder: str = argument("FOLDER", "Folder that insemu run --shard wrote to."),
    scenario: str = option("--scenario", "", "Scenario file, where it lies elsewhere than the shards saw it."),
    as_json: bool = option("--json", False),
    overwrite: bool = option("--overwrite", False),
) -> None:
    """Make the results of all shards of a run: the same files, to the bit, as those of the run in one piece.

    Shards may have been flown in any order, more than once, and cut differently. A missing one is named, and nothing is written.
    """
    from pathlib import Path

    from rich.console import Console

    from insemu.cli.run import prepared, run_all, say_all
    from insemu.errors import InputError
    from insemu.evaluate import CACHE, Resources, check_complete, noted

    stderr, where = Console(stderr=True), Path(folder)
    run, count = noted(where)
    experiments = prepared(scenario or run["scenario"], run["overrides"], with_variants=run["variants"], console=stderr)
    if experiments[""].digest != run["digest"]:
        raise InputError(
            "scenario, data or program are not those of the shards; fly them again, or take the version that they were flown with",
            where=str(where),
        )
    check_complete(experiments, where, where / CACHE, count)
    results, failed = run_all(experiments, where, Resources(), stderr, overwrite=overwrite)
    say_all(results, failed, where, as_json=as_json)
