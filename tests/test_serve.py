"""insemu serve: the list, two pages side by side, and nothing that is not a page of the folder."""

from __future__ import annotations

import http.client
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from insemu.errors import InputError
from insemu.report.page import Card, Page, Section, Text
from insemu.report.serve import server


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "secret.html").write_text("<p>secret</p>", encoding="utf-8")
    root = tmp_path / "results"
    for name in ("one", "two & <b>two</b>"):
        target = root / name.split()[0] / "index.html"
        Page(
            name, [Section("A", [Text("text")])], kind="run", answer=f"Take {name}.", cards=[Card("x", "1 m", "good")]
        ).write(target)
    (root / ".hidden.html").write_text("hidden", encoding="utf-8")
    (root / "run.py").write_text("print()", encoding="utf-8")
    (root / "link.html").symlink_to(tmp_path / "secret.html")
    (root / "other.html").write_text("<p>not of insemu</p>", encoding="utf-8")
    return root


@pytest.fixture
def ask(folder: Path) -> Iterator[object]:
    with server(folder) as running:
        threading.Thread(target=running.serve_forever, daemon=True).start()
        host, port = running.server_address[:2]
        assert host == "127.0.0.1"

        def get(path: str, **headers: str) -> tuple[int, str]:
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
            connection.request("GET", path, headers=headers)
            answer = connection.getresponse()
            return answer.status, answer.read().decode()

        yield get
        running.shutdown()


def test_the_list_names_every_page_with_its_answer(ask) -> None:  # type: ignore[no-untyped-def]
    status, page = ask("/")
    assert status == 200 and "2 pages in results" in page
    assert 'href="/one/index.html"' in page and "Take one." in page
    assert "two &amp; &lt;b&gt;two&lt;/b&gt;" in page and "<b>two" not in page
    assert not any(name in page for name in ("other.html", "link.html", ".hidden.html"))
    assert ask("/one/index.html")[0] == 200


def test_two_pages_stand_side_by_side(ask) -> None:  # type: ignore[no-untyped-def]
    status, page = ask("/side?left=one/index.html&right=two/index.html")
    assert status == 200 and 'src="/one/index.html"' in page and 'src="/two/index.html"' in page
    assert ask("/side?left=one/index.html&right=../secret.html")[0] == 404
    assert ask("/side?left=one/index.html")[0] == 404


@pytest.mark.parametrize(
    "path",
    [
        "/../secret.html",
        "/%2e%2e/secret.html",
        "/one/../../secret.html",
        "/..%2fsecret.html",
        "/link.html",
        "/.hidden.html",
        "/run.py",
        "/one",
        "/one/index.html%00",
        "/one%5c..%5c..%5csecret.html",
        "//etc/passwd",
        "/no.html",
    ],
)
def test_nothing_else_is_handed_out(ask, path: str) -> None:  # type: ignore[no-untyped-def]
    status, text = ask(path)
    assert status == 404 and "secret" not in text


def test_another_host_name_reads_nothing(ask) -> None:  # type: ignore[no-untyped-def]
    assert ask("/", Host="evil.example:80")[0] == 403


def test_a_folder_that_is_none_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no folder"):
        server(tmp_path / "nothing")
