"""The Python examples in docs/*.md print what the pages say they print."""

from __future__ import annotations

import doctest
import importlib
import re
from pathlib import Path

import pytest

import pipeline.choice

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGES = sorted(DOCS.glob("*.md"))
FENCE = re.compile(r"^```(?P<language>\w*)$")


def examples(page: str) -> str:
    """The page with all but its ```python blocks blanked, so that a failure names the page's own line."""
    kept, language = [], None
    for line in page.splitlines():
        fence = FENCE.match(line)
        if fence:
            language = fence["language"] if language is None else None
        kept.append("" if fence or language != "python" else line)
    assert language is None, "a block is not closed"
    return "\n".join(kept) + "\n"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_examples_print_what_the_page_says(page: Path) -> None:
    source = examples(page.read_text(encoding="utf-8"))
    for block in re.split(r"\n{2,}", source.strip()):
        assert not block or block.startswith(">>> "), f"python without a prompt does not run: {block[:80]!r}"
    test = doctest.DocTestParser().get_doctest(source, {"__name__": "__main__"}, page.name, str(page), 0)
    failures: list[str] = []
    doctest.DocTestRunner().run(test, out=failures.append)
    assert not failures, "".join(failures)


def test_the_interface_page_has_examples_and_shows_every_name() -> None:
    page = (DOCS / "api.md").read_text(encoding="utf-8")
    shown = set(re.findall(r"\w+", page))
    assert sorted(set(pipeline.choice.__all__) - shown) == []
    assert len(doctest.DocTestParser().get_examples(examples(page))) > 40


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_a_page_points_to_is_there(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", text):
        assert (DOCS / target).exists(), target
    for module in re.findall(r"`((?:pipeline|schemas)/[\w/]+\.\w+)`", text):
        assert (DOCS.parent / module).is_file(), module


def test_the_method_page_names_functions_that_are_there() -> None:
    table = (DOCS / "method.md").read_text(encoding="utf-8").split("## 1.")[0]
    places = re.findall(r"((?:`\w+`(?:, | and )?)+) in `(?:pipeline/choice/)?([\w/]+)\.py`", table)
    assert len(places) == 14
    for functions, module in places:
        loaded = importlib.import_module(f"pipeline.choice.{module.replace('/', '.')}")
        assert [name for name in re.findall(r"\w+", functions) if name != "and" and not hasattr(loaded, name)] == []


def test_a_wrong_output_fails() -> None:
    source = examples("text\n```python\n>>> 1 + 1\n3\n```\n```py\n>>> 1 + 1\n5\n```\n")
    test = doctest.DocTestParser().get_doctest(source, {}, "page", "page", 0)
    failures: list[str] = []
    assert doctest.DocTestRunner().run(test, out=failures.append) == (1, 1)
    assert "line 3" in failures[0]
