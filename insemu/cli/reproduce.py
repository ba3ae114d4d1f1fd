"""``insemu reproduce``: run a result again, and say what differs."""

from __future__ import annotations

import typer

from insemu.cli.options import argument, option
from insemu.cli.printing import print_json, print_text


def command(
    folder: str = argument("FOLDER", "Folder of a result of insemu run."),
    workers: int = option("--workers", None),
    as_json: bool = option("--json", False),
) -> None:
    """Run the scenario of a result again and compare every number; nothing is written.

    Says first what is another than then: code, packages, machine, input files. Exit code 0: every number is the same to the last bit.
    1: what differs is printed.
    """
    import json
    from pathlib import Path

    import xarray as xr
    from rich.console import Console

    from insemu import yamlfile
    from insemu.cli.printing import flying
    from insemu.errors import InputError
    from insemu.evaluate import Experiment, Resources, changed, differences, run_experiment, surroundings
    from insemu.scenario import Scenario, validated

    result = Path(folder)
    for name in ("manifest.json", "resolved.yaml", "errors.nc"):
        if not (result / name).is_file():
            raise InputError(f"holds no {name}; expected the folder of a finished insemu run", where=folder)
    try:
        manifest = json.loads((result / "manifest.json").read_text(encoding="utf-8"))
        file = manifest.get("scenario_file")
        held = {}
        for group in ("", "runs", "statistics"):
            with xr.open_dataset(result / "errors.nc", engine="h5netcdf", group=group or None) as data:
                held[group] = data.load()
    except (ValueError, OSError, KeyError, AttributeError) as error:
        raise InputError(f"is no whole result ({' '.join(str(error).split())[:100]})", where=folder) from None
    scenario = validated(Scenario, yamlfile.read(result / "resolved.yaml"))
    base = file if file and Path(file).exists() else result / "resolved.yaml"
    experiment = Experiment(scenario, base)
    now = surroundings(experiment.world.files)
    other = changed({k: manifest.get(k) for k in now}, now)
    console = Console(stderr=True)
    for line in other:
        print_text(console, f"other than then: {line}")
    with flying(console, "running again", experiment.realizations) as progress:
        again = run_experiment(experiment, resources=Resources(workers=workers, progress=progress))
    made = {"": again.to_dataset(), "runs": again.runs, "statistics": again.statistics}
    found = [
        f"{group}{': ' * bool(group)}{line}" for group, data in held.items() for line in differences(data, made[group])
    ]
    if as_json:
        print_json({"same": not found, "differences": found, "changed": other})
    elif found:
        typer.echo("\n".join(found))
    else:
        typer.echo(
            f"reproduced: {sum(v.size for data in held.values() for v in data.variables.values())} numbers, the same to the last bit"
        )
    if found:
        raise typer.Exit(1)
