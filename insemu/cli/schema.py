"""``insemu schema``: the JSON schema of scenario files, for editors."""

from __future__ import annotations

import typer

from insemu.cli.options import option


def command(out: str = option("--output", "", "Write to this file instead of the terminal.")) -> None:
    """Print the JSON schema of scenario files (point your editor's YAML support at it)."""
    import json

    from insemu import scenario
    from insemu.whole import put

    text = json.dumps(scenario.schema(), indent=2)
    if out:
        put(out, text + "\n")
    else:
        typer.echo(text)
