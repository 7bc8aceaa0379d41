"""The documentation as a site: built strictly and offline, every page in its place, every link and word right."""

from __future__ import annotations

import re
import runpy
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
SITE = runpy.run_path(str(DOCS / "make_site.py"))
REFERENCE = runpy.run_path(str(DOCS / "make_reference.py"))
PAGES = [*map(ROOT.joinpath, SITE["PAGES"]), *sorted(DOCS.glob("*.md"))]
ENGLISH = ["README.md", "CONTRIBUTING.md", "ARCHITECTURE.md", "CHANGELOG.md", "examples", "pipeline", "schemas"]


def in_navigation(entries: list[dict[str, object]]) -> Iterator[str]:
    for entry in entries:
        for target in entry.values():
            if isinstance(target, list):
                yield from in_navigation(target)
            else:
                yield str(target)


def anchors(page: Path) -> set[str]:
    """The anchors that GitHub gives the titles of a page."""
    text = re.sub(r"(?ms)^```.*?^```", "", page.read_text(encoding="utf-8"))
    found: dict[str, int] = {}
    names = set()
    for title in re.findall(r"(?m)^#+ (.+)$", text):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title)
        name = re.sub(r"[^\w\- ]", "", plain.lower()).replace(" ", "-")
        names.add(name if name not in found else f"{name}-{found[name]}")
        found[name] = found.get(name, 0) + 1
    return names


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built from a copy of the pages."""
    root = tmp_path_factory.mktemp("site") / "project"
    shutil.copytree(DOCS, root / "docs", ignore=shutil.ignore_patterns("__pycache__"))
    for name in [*SITE["PAGES"], "LICENSE", "datasets/studies/human_choice/README.md"]:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, root / name)
    shutil.copytree(ROOT / "pipeline", root / "pipeline", ignore=shutil.ignore_patterns("__pycache__"))
    done = subprocess.run(
        [sys.executable, "docs/make_site.py"], cwd=root, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "No issues found" in done.stdout + done.stderr
    return root / "build" / "site"


def test_it_has_every_page(site: Path) -> None:
    listed = list(in_navigation(tomllib.loads((DOCS / "site.toml").read_text(encoding="utf-8"))["project"]["nav"]))
    assert len(set(listed)) == len(listed)
    pages = {"index.md" if page.name == "README.md" else str(page.relative_to(ROOT)) for page in PAGES}
    assert set(listed) == pages | {"docs/python.md"}
    for page in listed:
        assert (site / page).with_suffix(".html").is_file()


def test_the_page_of_docstrings_has_every_name(site: Path) -> None:
    import pipeline.choice

    page = (site / "docs" / "python.html").read_text(encoding="utf-8")
    for name in pipeline.choice.__all__:
        assert f'id="pipeline.choice.{name}"' in page, name


def test_it_loads_nothing_from_elsewhere(site: Path) -> None:
    loads = re.compile(
        r"<(?:script|img|iframe)[^>]+src=\"(?:https?:)?//|<link[^>]+href=\"(?:https?:)?//[^\"]+\.css|@import"
    )
    for page in site.rglob("*.html"):
        assert not loads.search(page.read_text(encoding="utf-8")), page


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_a_title_that_is_there(page: Path) -> None:
    for target, anchor in re.findall(r"\]\(([^)#:\s]*)(?:#([^)\s]*))?\)", page.read_text(encoding="utf-8")):
        linked = (page.parent / target).resolve() if target else page
        assert linked.exists(), target
        if anchor:
            assert anchor in anchors(linked), f"{target}#{anchor}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_picture_says_in_words_what_it_shows(page: Path) -> None:
    for words, picture in re.findall(r"!\[([^\]]*)\]\(([^)]*)\)", page.read_text(encoding="utf-8")):
        assert len(words.split()) >= 7, picture


@pytest.mark.parametrize("name", ["command_line", "parameters"])
def test_the_reference_is_up_to_date(name: str) -> None:
    written = (DOCS / f"{name}.md").read_text(encoding="utf-8")
    assert written == REFERENCE[name](), f"docs/{name}.md is out of date: run `python docs/make_reference.py`"


def test_words_are_spelt_right() -> None:
    words = [*ENGLISH, *map(str, [*DOCS.glob("*.md"), *DOCS.glob("*.py")])]
    done = subprocess.run(
        [sys.executable, "-m", "codespell_lib", *words], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (0, ""), done.stdout + done.stderr


def test_a_misspelt_word_is_found(tmp_path: Path) -> None:
    (tmp_path / "page.md").write_text("An exmaple.\n")
    done = subprocess.run([sys.executable, "-m", "codespell_lib", str(tmp_path)], capture_output=True, text=True)
    assert done.returncode != 0
    assert "example" in done.stdout
