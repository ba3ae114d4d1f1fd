"""What the documentation says of scenario keys is whole and true, and its links lead somewhere."""

from __future__ import annotations

import importlib
import inspect
import re
import sys
from pathlib import Path

import pytest

from insemu.scenario import load, schema

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "docs"))
from reference_pages import ROOMS, _type, effects, examples, limits, sections, standards  # noqa: E402

LINK = re.compile(r"\]\(([^)\s]+)\)")
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]


def test_every_scenario_key_has_type_default_example_and_meaning() -> None:
    whole = schema()
    shown = examples(whole)
    lacking = []
    for name, section in sections(whole).items():
        for key, p in section["properties"].items():
            if not p.get("description") or "a quantity with its unit" in p["description"]:
                lacking.append(f"{name}.{key}: no meaning")
            if (name, key) not in shown:
                lacking.append(f"{name}.{key}: no example")
            if _type(p) in ("", "value"):
                lacking.append(f"{name}.{key}: no type")
            if (
                key not in section.get("required", ()) and "default" not in p and p.get("type") != "object"
            ):  # else: empty
                lacking.append(f"{name}.{key}: no default")
    assert lacking == []


@pytest.mark.parametrize("file", sorted((ROOT / "docs" / "scenario_examples").glob("*.yaml")), ids=lambda f: f.stem)
def test_examples_are_scenarios(file: Path) -> None:
    assert load(file).designs


def anchors(page: Path) -> set[str]:
    """Anchors of the headings of a page, as the site and GitHub make them."""
    heads = re.findall(r"^#{1,6} (.+)$", page.read_text(encoding="utf-8"), re.M)
    return {re.sub(r"[^\w\- ]", "", re.sub(r"\[(.*?)\]\(.*?\)", r"\1", h).lower()).replace(" ", "-") for h in heads}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_inside_the_project_lead_somewhere(page: Path) -> None:
    dead = []
    for target in LINK.findall(re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.S | re.M)):
        if re.match(r"[a-z]+:", target):
            assert target.startswith(("https://", "mailto:")), target
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        made = ROOT / "docs" / "reference" in file.parents  # written when the site is built, which checks it
        if not made and (not file.exists() or (anchor and file.suffix == ".md" and anchor not in anchors(file))):
            dead.append(target)
    assert dead == []


def test_every_public_name_is_documented() -> None:
    silent = []
    for room in ROOMS:
        module = importlib.import_module(f"insemu.{room}")
        own = [n for n, v in vars(module).items() if getattr(v, "__module__", "") == module.__name__]
        for name in getattr(module, "__all__", own):
            value = getattr(module, name)
            named = not name.startswith("_") and (inspect.isclass(value) or inspect.isfunction(value))
            if named and (
                not (value.__doc__ or "").strip() or value.__doc__.startswith(f"{name}(")
            ):  # a dataclass writes its own
                silent.append(f"{room}.{name}")
    assert silent == []


def test_the_page_of_sizes_says_what_the_code_refuses() -> None:
    from insemu.errors import InputError
    from insemu.yamlfile import MAX_DEPTH, parse

    page = "\n".join(limits())
    assert f"| levels of nesting in it | {MAX_DEPTH} |" in page and page.count("`insemu.") >= 15
    parse("[" * MAX_DEPTH + "]" * MAX_DEPTH, "a.yaml")
    with pytest.raises(InputError):
        parse("[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1), "a.yaml")


def test_clauses_of_standards_are_those_of_effects_that_exist() -> None:
    from insemu.effects import EFFECTS

    clauses, page = standards(), "\n".join(effects())
    assert len(clauses) >= 20 and set(clauses) <= set(EFFECTS)
    assert all(f"): {text}." in page for text in clauses.values())
