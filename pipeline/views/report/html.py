"""A report as one HTML file that opens anywhere: it holds its pictures and style and loads nothing from elsewhere."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from pipeline.formats.files.atomic import written_whole

_POINT_PX = 4 / 3  # pixels per point
_SMALL_PX = 400  # pictures below this width stand side by side
_WITHOUT_LINKS = {"a", "h2", "pre", "summary", "dt", "td"}
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"
_STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #fff; margin: 0 auto; padding: 1.25rem; \
max-width: 62rem; }
h1 { font-size: 1.75rem; line-height: 1.2; margin: 0 0 .25rem; }
h2 { font-size: 1.35rem; margin: 2.75rem 0 .5rem; padding-top: .75rem; border-top: 3px solid #0072b2; }
p { margin: .5rem 0; max-width: 46rem; }
p.lead { color: #555; }
nav { margin: 1rem 0; line-height: 2; }
nav a { color: #0072b2; margin-right: 1.1rem; white-space: nowrap; }
ul { padding-left: 1.2rem; max-width: 46rem; }
li { margin: .3rem 0; }
.answer { border-left: 4px solid #0072b2; padding: .1rem 0 .1rem 1rem; margin: 1rem 0; break-inside: avoid; }
.answer .head { font-weight: 600; }
.answer ul { margin: .2rem 0; }
a.word { color: inherit; text-decoration: underline dotted; }
dt { font-weight: 600; float: left; clear: left; margin-right: .5rem; }
dd { margin: 0 0 .3rem; max-width: 46rem; }
summary { cursor: pointer; color: #0072b2; }
figure, .table { margin: 1.25rem 0; }
figcaption, caption { color: #444; font-size: .9rem; text-align: left; max-width: 46rem; }
figcaption { margin-top: .4rem; }
caption { padding-bottom: .4rem; }
.figures { display: flex; flex-wrap: wrap; gap: 0 2rem; }
.figures figure { flex: 0 1 100%; min-width: 0; }
.figures figure.small { flex-basis: 20rem; }
.scroll { overflow-x: auto; }
img { display: block; max-width: 100%; height: auto; }
table { border-collapse: collapse; font-size: .9rem; }
th, td { text-align: left; vertical-align: top; padding: .3rem .9rem .3rem 0; border-bottom: 1px solid #ddd; }
th { border-bottom: 1.5px solid #222; }
td.number { font-variant-numeric: tabular-nums; }
pre { font: .8rem/1.45 ui-monospace, monospace; background: #f5f5f5; padding: .8rem; white-space: pre-wrap; \
overflow-wrap: anywhere; }
@media screen and (max-width: 40rem) {
  body { padding: .9rem; }
  .figures figure:not(.small) img { max-width: none; width: 42rem; }
  thead { display: none; }
  table, tbody, tr, td, caption { display: block; }
  tr { border-top: 1.5px solid #222; padding: .4rem 0; }
  td { border: 0; padding: .1rem 0; display: flex; gap: .75rem; }
  td::before { content: attr(data-label); color: #666; flex: 0 0 42%; }
  td:first-child { font-weight: 600; }
  td > span { flex: 1; min-width: 0; overflow-wrap: anywhere; }
  td:has(> span:empty) { display: none; }
}
@media print {
  @page { margin: 15mm; }
  body { font-size: 10pt; max-width: none; padding: 0; }
  nav { display: none; }
  h2 { break-after: avoid; }
  section.opens { break-before: page; }
  figure, tr, li { break-inside: avoid; }
  .scroll { overflow: visible; }
  table { font-size: 8pt; }
  th, td { padding-right: .5rem; }
  figcaption, caption { font-size: 9pt; max-width: none; }
  details:not([open]), section:has(> h2 + details:not([open]):last-child) { display: none; }
  h2 { margin-top: 1.2rem; }
  figure, .table { margin: .6rem 0; }
  img { max-height: 8.5cm; width: auto; }
  pre { background: none; padding: 0; }
  .figures { display: block; }
  .figures figure.small { display: inline-block; vertical-align: top; width: 48%; margin-right: 1%; }
}
"""


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    words: str


@dataclass(frozen=True)
class Points:
    """A list of sentences."""

    items: Sequence[str]


@dataclass(frozen=True)
class Table:
    """Rows under a header, with a caption; numbers that are not whole are written with three digits."""

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[object]]


@dataclass(frozen=True)
class Picture:
    """An SVG with a caption."""

    svg: bytes
    caption: str


@dataclass(frozen=True)
class Verbatim:
    """The text of a file, unchanged."""

    words: str


@dataclass(frozen=True)
class Answer:
    """What people wanted, whether to trust it, and the lines below each."""

    head: str
    preferences: Sequence[str]
    trust: str
    reasons: Sequence[str]


@dataclass(frozen=True)
class Words:
    """What words of the report mean. Where one stands first in a section, it leads here."""

    meanings: Mapping[str, str]


@dataclass(frozen=True)
class Folded:
    """Parts that are shown once their summary is clicked at, and not printed otherwise."""

    summary: str
    parts: Sequence[Part]


Part = Text | Points | Table | Picture | Verbatim | Answer | Words | Folded


@dataclass(frozen=True)
class Section:
    """A part of the report with its title.

    Attributes:
        title, parts: of it.
        opens: whether it starts on a new page when printed.
        folded: whether it is shown once it is clicked at, and not printed otherwise.
    """

    title: str
    parts: Sequence[Part]
    opens: bool = False
    folded: bool = False


@dataclass(frozen=True)
class Report:
    """The whole report: its title, a line below it, and its sections."""

    title: str
    lead: str
    sections: Sequence[Section]


def write_report(path: Path, report: Report) -> int:
    """Write the report, whole or not at all, and return its size in bytes. Equal reports give equal bytes."""
    page = render(report).encode()
    with written_whole(path) as stream:
        stream.write(page)
    return len(page)


def render(report: Report) -> str:
    """The page. All text in the report is escaped, and a content policy keeps the page from loading anything."""
    sections = list(enumerate(report.sections, start=1))
    words = [word for section in report.sections for word in _words(section.parts)]
    links = "\n".join(f'<a href="#part-{number}">{escape(section.title)}</a>' for number, section in sections)
    return "\n".join(
        [
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(report.title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>",
            f'<header>\n<h1>{escape(report.title)}</h1>\n<p class="lead">{escape(report.lead)}</p>\n</header>',
            f"<nav>\n{links}\n</nav>\n<main>",
            *(_linked(_section(number, section), words) for number, section in sections),
            "</main>\n</body>\n</html>\n",
        ]
    )


def _words(parts: Sequence[Part]) -> list[str]:
    """The words that a part explains."""
    found: list[str] = []
    for part in parts:
        if isinstance(part, Words):
            found += part.meanings
        elif isinstance(part, Folded):
            found += _words(part.parts)
    return found


def _anchor(word: str) -> str:
    return "word-" + re.sub(r"\W+", "-", word.lower())


def _linked(section: str, words: Sequence[str]) -> str:
    """The section with a link where each word stands first in its text; text is escaped, so that tags are tags."""
    if not words:
        return section
    either = "|".join(re.escape(escape(word)) for word in sorted(words, key=len, reverse=True))
    pattern = re.compile(rf"(?<![\w-])({either})(?![\w-]|s[\w-])")
    known = {escape(word): _anchor(word) for word in words}
    linked: set[str] = set()

    def link(match: re.Match[str]) -> str:
        word = match[1]
        if word in linked:
            return word
        linked.add(word)
        return f'<a class="word" href="#{known[word]}">{word}</a>'

    pieces, inside = re.split(r"(<[^>]*>)", section), 0
    for place, piece in enumerate(pieces):
        if piece.startswith("<"):
            tag = piece.strip("</>").split(" ")[0]
            inside += (tag in _WITHOUT_LINKS) * (-1 if piece.startswith("</") else 1)
        elif not inside:
            pieces[place] = pattern.sub(link, piece)
    return "".join(pieces)


def _section(number: int, section: Section) -> str:
    opens = ' class="opens"' if section.opens else ""
    found = _parts([Folded("show", section.parts)] if section.folded else section.parts)
    return "\n".join(
        [f'<section id="part-{number}"{opens}>', f"<h2>{escape(section.title)}</h2>", *found, "</section>"]
    )


def _parts(parts: Sequence[Part]) -> list[str]:
    lines: list[str] = []
    pictures: list[Picture] = []
    for part in [*parts, None]:
        if isinstance(part, Picture):
            pictures.append(part)
            continue
        if pictures:  # consecutive pictures stand side by side where there is room
            lines.append(f'<div class="figures">\n{"".join(map(_picture, pictures))}</div>')
            pictures = []
        if part is not None:
            lines.append(_part(part))
    return lines


def _part(part: Text | Points | Table | Verbatim | Answer | Words | Folded) -> str:
    match part:
        case Text(words):
            return f"<p>{escape(words)}</p>"
        case Points(items):
            return "<ul>\n" + "".join(f"<li>{escape(item)}</li>\n" for item in items) + "</ul>"
        case Table():
            return _table(part)
        case Verbatim(words):
            return f"<pre>{escape(words)}</pre>"
        case Words(meanings):
            lines = [
                f'<dt id="{_anchor(word)}">{escape(word)}</dt>\n<dd>{escape(meaning)}</dd>\n'
                for word, meaning in meanings.items()
            ]
            return f"<dl>\n{''.join(lines)}</dl>"
        case Folded(summary, inner):
            return "\n".join([f"<details>\n<summary>{escape(summary)}</summary>", *_parts(inner), "</details>"])
        case Answer(head, preferences, trust, reasons):
            found = f'<p class="head">{escape(head)}</p>\n{_part(Points(preferences))}\n'
            found += f'<p class="head">{escape(trust)}</p>\n{_part(Points(reasons)) if reasons else ""}'
            return f'<div class="answer">\n{found}\n</div>'


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in table.header)
    rows = "\n".join(
        "<tr>" + "".join(_cell(name, value) for name, value in zip(table.header, row, strict=True)) + "</tr>"
        for row in table.rows
    )
    return (
        f'<div class="table scroll"><table>\n<caption>{escape(table.caption)}</caption>\n'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{rows}\n</tbody>\n</table></div>"
    )


def _cell(name: str, value: object) -> str:
    number = ' class="number"' if isinstance(value, (int, float)) and not isinstance(value, bool) else ""
    text = "" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)
    return f'<td{number} data-label="{escape(name)}"><span>{escape(text)}</span></td>'


def _picture(picture: Picture) -> str:
    width, height = _size_px(picture.svg)
    kind = ' class="small"' if width < _SMALL_PX else ""
    source = "data:image/svg+xml;base64," + b64encode(picture.svg).decode("ascii")
    caption = escape(picture.caption)
    return (
        f'<figure{kind}><div class="scroll">'
        f'<img width="{width}" height="{height}" alt="{caption}" src="{source}"></div>\n'
        f"<figcaption>{caption}</figcaption></figure>\n"
    )


def _size_px(svg: bytes) -> tuple[int, int]:
    match = re.search(rb'<svg[^>]*\bwidth="([\d.]+)pt"[^>]*\bheight="([\d.]+)pt"', svg)
    if match is None:
        return 640, 480
    return round(float(match[1]) * _POINT_PX), round(float(match[2]) * _POINT_PX)
