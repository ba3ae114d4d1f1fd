"""``insemu serve``: the pages of a folder in a browser."""

from __future__ import annotations

import typer

from insemu.cli.options import argument, option


def command(
    folder: str = argument("FOLDER", default="results"),
    port: int = option("--port", 8000, min=0, max=65535),
    browse: bool = option("--browser", True),
) -> None:
    """Show all runs of a folder in a browser, any two of them side by side.

    Listens on this computer only and reads only pages, pictures, tables and YAML files of that folder. Ctrl-C ends it.
    """
    import webbrowser

    from insemu.report.serve import server

    with server(folder, port) as running:
        address = f"http://{running.server_address[0]!s}:{running.server_address[1]}/"
        typer.echo(f"{folder}: {address} (Ctrl-C ends)")
        if browse:
            webbrowser.open(address)
        try:
            running.serve_forever()
        except KeyboardInterrupt:
            typer.echo("ended")
