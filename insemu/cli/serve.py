"""``insemu serve``: the pages of a folder in a browser."""

from __future__ import annotations

import typer


def command(
    folder: str = typer.Argument("results", metavar="FOLDER", help="Folder of results."),
    port: int = typer.Option(8000, "--port", min=0, max=65535, help="Port on this computer; 0 takes any that is free."),
    browse: bool = typer.Option(True, "--browser/--no-browser", help="Open the list in a browser."),
) -> None:
    """Show all runs of a folder in a browser, any two of them side by side.

    Listens on this computer only and reads only pages, pictures, tables and YAML files of that folder. Ctrl-C ends it.
    """
    import webbrowser

    from insemu.report import server

    with server(folder, port) as running:
        address = f"http://{running.server_address[0]!s}:{running.server_address[1]}/"
        typer.echo(f"{folder}: {address} (Ctrl-C ends)")
        if browse:
            webbrowser.open(address)
        try:
            running.serve_forever()
        except KeyboardInterrupt:
            typer.echo("ended")
