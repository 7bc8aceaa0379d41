"""The report's page: nothing in it runs, is fetched or is taken for markup; the same again from the same."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from pipeline.views.report.html import (
    Folded,
    Picture,
    Points,
    Report,
    Section,
    Table,
    Text,
    Verbatim,
    Words,
    render,
    write_report,
)

EVIL = '<script>alert("1")</script>&amp;\'"><img src=http://example.org/x onerror=a()>'
SMALL = b'<svg width="240pt" height="90pt"><script>a()</script></svg>'
WIDE = b'<svg xmlns="x" width="504pt" height="180.5pt"></svg>'


def report(text: str = "plain") -> Report:
    return Report(
        text,
        text,
        [
            Section(text, [Text(text), Points([text]), Table(text, (text, "n"), [[text, 0.123456], [None, 3]])]),
            Section("pictures", [Picture(SMALL, text), Picture(WIDE, "wide"), Verbatim(text)], opens=True),
        ],
    )


class Elements(HTMLParser):
    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.mark.parametrize("text", ["plain", EVIL])
def test_what_is_written_is_text_and_only_text(text: str) -> None:
    page = Elements(render(report(text)))
    tags = [tag for tag, _ in page.tags]
    assert tags == [tag for tag, _ in Elements(render(report())).tags]
    assert "script" not in tags
    assert not [name for _, attributes in page.tags for name in attributes if name.startswith("on")]
    assert page.text.count(text) >= 7


def test_it_fetches_nothing() -> None:
    page = Elements(render(report(EVIL)))
    sources = [value for _, attributes in page.tags for name, value in attributes.items() if name in ("src", "href")]
    assert sources
    assert all(value and value.startswith(("#", "data:image/svg+xml;base64,")) for value in sources)
    policy = next(a["content"] for _, a in page.tags if a.get("http-equiv") == "Content-Security-Policy")
    assert policy is not None
    assert "default-src 'none'" in policy


def test_links_lead_to_their_sections_and_numbers_are_short() -> None:
    page = render(report())
    ids = re.findall(r'<section id="([^"]+)"', page)
    assert re.findall(r'href="#([^"]+)"', page) == ids == ["part-1", "part-2"]
    assert ">0.123<" in page
    assert '<td data-label="plain"><span></span></td>' in page


def test_pictures_keep_their_size_and_shape() -> None:
    page = render(report())
    assert '<figure class="small"><div class="scroll"><img width="320" height="120"' in page
    assert '<figure><div class="scroll"><img width="672" height="241"' in page


def test_the_same_report_gives_the_same_bytes(tmp_path: Path) -> None:
    sizes = [write_report(tmp_path / name, report()) for name in ("a.html", "b.html")]
    first, second = ((tmp_path / name).read_bytes() for name in ("a.html", "b.html"))
    assert first == second
    assert sizes == [len(first)] * 2


def test_words_lead_to_their_meaning_where_they_stand_first() -> None:
    sections = [
        Section(
            "LESS", [Text("less of it; LESS and LESS"), Points(["a held-out score", "unheld-out"]), Verbatim("LESS")]
        ),
        Section("again", [Table("LESS <b>", ("theta", "n"), [["theta", 1]])]),
        Section("Words", [Words({"LESS": "a model", "held-out": "not LESS", "theta": EVIL})], folded=True),
    ]
    page = render(Report("LESS", "LESS", sections))
    first, second, last = page.split("<section")[1:]
    assert 'less of it; <a class="word" href="#word-less">LESS</a> and LESS' in first
    assert first.count('href="#word-less"') == 1
    assert first.count('href="#word-held-out"') == 1
    assert "unheld-out" in first
    assert second.count('href="#word-less"') == second.count('href="#word-theta"') == 1
    assert "LESS</a> &lt;b&gt;" in second
    assert 'data-label="theta"' in second
    targets = re.findall(r'<dt id="([^"]+)"', last)
    assert targets == ["word-less", "word-held-out", "word-theta"]
    assert "script" not in [tag for tag, _ in Elements(page).tags]


def test_folded_words_are_found() -> None:
    words = Folded("more", [Words({"nat": "a unit"})])
    assert 'href="#word-nat"' in render(Report("r", "r", [Section("s", [Text("one nat"), words])]))
