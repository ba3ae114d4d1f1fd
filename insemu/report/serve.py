"""The pages of a folder in a browser: a list of all runs, any page, and two of them side by side. Local only, read only."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, quote, unquote, urlsplit

from markupsafe import Markup

from insemu.errors import InputError
from insemu.report.page import Block, Card, Form, Page, Section, Table, Text

#: What a page says about itself; the head of a file is enough to find it.
_ABOUT = re.compile(r'<script type="application/json" id="about">(.*?)</script>', re.S)
_HEAD = 200_000
#: The only host that is listened on.
LOOPBACK = "127.0.0.1"
#: What is handed out, by suffix.
KINDS = {
    ".html": "text/html; charset=utf-8",
    ".png": "image/png",
    ".svg": "image/svg+xml",
    ".json": "application/json",
    ".yaml": "text/plain; charset=utf-8",
    ".csv": "text/csv; charset=utf-8",
}
#: Two pages side by side.
_SIDE = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Two runs side by side</title>
<style>body{{margin:0;display:flex;flex-wrap:wrap;height:100vh;font:16px system-ui}}p{{width:100%;margin:.4rem .8rem}}
iframe{{flex:1 1 24rem;height:calc(100vh - 2.4rem);border:0;border-left:1px solid #ccc;min-width:0}}</style></head>
<body><p><a href="/">All runs</a></p><iframe title="{left}" src="{left}"></iframe><iframe title="{right}" src="{right}"></iframe></body></html>
"""


@dataclass(frozen=True)
class Found:
    """A page of the folder: its path there, and what it says about itself."""

    path: str
    about: dict[str, Any]


@dataclass(frozen=True)
class Shelf:
    """A folder of results.

    Parameters
    ----------
    folder : Path
        Nothing outside it is handed out, nor what its name hides with a dot.
    """

    folder: Path

    @cached_property
    def root(self) -> Path:
        """The folder without links."""
        root = self.folder.resolve()
        if not root.is_dir():
            raise InputError("is no folder", where=str(self.folder))
        return root

    def file(self, address: str) -> Path | None:
        """The file behind the path of an address; None where there is none that may be handed out."""
        wanted = unquote(address).lstrip("/")
        if "\0" in wanted or "\\" in wanted or any(part.startswith(".") for part in wanted.split("/")):
            return None
        path = (self.root / wanted).resolve()  # a link out of the folder leads nowhere
        inside = path.is_relative_to(self.root)
        return path if inside and path.suffix in KINDS and path.is_file() else None

    def pages(self) -> list[Found]:
        """Every page that insemu wrote, the newest first."""
        out = []
        for path in sorted(self.root.rglob("*.html"), key=lambda p: p.stat().st_mtime, reverse=True):
            name = path.relative_to(self.root).as_posix()
            if self.file(quote(name)) is None:
                continue
            with path.open(encoding="utf-8", errors="replace") as handle:
                said = _ABOUT.search(handle.read(_HEAD))
            try:
                about = json.loads(said[1]) if said else {}
            except json.JSONDecodeError:
                continue
            if isinstance(about, dict) and "kind" in about and all(len(c) == 4 for c in about.get("cards", ())):
                out.append(Found(name, about))
        return out

    def index(self) -> str:
        """The list of all pages."""
        pages = self.pages()
        rows: list[Sequence[str | Markup]] = []
        for k, page in enumerate(pages):
            rows.append(
                [
                    _link(page.path, page.about.get("title", page.path)),
                    str(page.about.get("kind", "")),
                    str(page.about.get("answer", "")),
                    str(page.about.get("made", "")),
                    Markup('<input type="radio" name="left" value="{0}" aria-label="left: {0}"{1}>').format(
                        page.path, _checked(k == 0)
                    ),
                    Markup('<input type="radio" name="right" value="{0}" aria-label="right: {0}"{1}>').format(
                        page.path, _checked(k == 1)
                    ),
                ]
            )
        if not pages:
            blocks: list[Block] = [Text("There is no page here yet; insemu run, gap and the others write them.")]
        else:
            table = Table(("page", "command", "answer", "date", "left", "right"), rows, left=4, wrap=True)
            blocks = [Form("/side", "Side by side", [table])]
        firsts = [(p.about.get("title", p.path), *c) for p in pages[:3] for c in p.about.get("cards", ())[:1]]
        cards = [Card(str(t), str(value), str(verdict), str(tone), [str(n)]) for t, n, value, verdict, tone in firsts]
        answer = f"{len(pages)} page{'s' * (len(pages) != 1)} in {self.root.name}."
        return Page(
            f"Results in {self.root.name}", [Section("Runs", blocks)], kind="serve", answer=answer, cards=cards
        ).html(forms=True)

    def side(self, query: str) -> str | None:
        """Two pages side by side; None where one of them is none of this folder."""
        asked = parse_qs(query)
        names = [asked.get(key, [""])[0] for key in ("left", "right")]
        if any(self.file(quote(name)) is None or not name.endswith(".html") for name in names):
            return None
        left, right = (html.escape("/" + quote(name)) for name in names)
        return _SIDE.format(left=left, right=right)


def _link(path: str, text: str) -> Markup:
    return Markup('<a href="/{0}">{1}</a>').format(quote(path), text)


def _checked(yes: bool) -> Markup:
    return Markup(" checked") if yes else Markup("")


def server(folder: str | Path, port: int = 0) -> ThreadingHTTPServer:
    """A server of the pages of a folder on this computer's own address, not yet running.

    Parameters
    ----------
    folder : path
    port : int
        0 takes any that is free.

    Raises
    ------
    InputError
        No such folder; a port that is taken.
    """
    shelf = Shelf(Path(folder))
    assert shelf.root

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            address = urlsplit(self.path)
            host = (self.headers.get("Host") or "").rsplit(":", 1)[0]
            if host not in (LOOPBACK, "localhost"):  # a page elsewhere that gave its name this address reads nothing
                self._answer(403, b"not this host", "text/plain")
            elif address.path == "/":
                self._answer(200, shelf.index().encode(), KINDS[".html"])
            elif address.path == "/side" and (both := shelf.side(address.query)):
                self._answer(200, both.encode(), KINDS[".html"])
            elif path := shelf.file(address.path):
                self._answer(200, path.read_bytes(), KINDS[path.suffix])
            elif address.path == "/favicon.ico":  # every browser asks for one
                self._answer(204, b"", "image/x-icon")
            else:
                self._answer(404, b"there is no such page", "text/plain")

        def _answer(self, status: int, body: bytes, kind: str) -> None:
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("X-Content-Type-Options", "nosniff")
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: Any) -> None:  # the terminal stays quiet
            pass

    try:
        return ThreadingHTTPServer((LOOPBACK, port), Handler)
    except OSError as error:
        raise InputError(
            f"port {port} cannot be used ({error.strerror}), expected another one", where="--port"
        ) from None
