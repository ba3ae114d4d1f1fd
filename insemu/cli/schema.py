"""``insemu schema``: the JSON schema of scenario files, for editors."""

from __future__ import annotations

import typer


def command(out: str = typer.Option("", "--out", help="Write to this file instead of the terminal.")) -> None:
    """Print the JSON schema of scenario files (point your editor's YAML support at it)."""
    import json
    from pathlib import Path

    from insemu import scenario

    text = json.dumps(scenario.schema(), indent=2)
    if out:
        Path(out).write_text(text + "\n", encoding="utf-8")
    else:
        typer.echo(text)
