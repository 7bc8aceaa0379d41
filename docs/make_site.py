"""Build the documentation as a site in build/site, without the network: `python docs/make_site.py`.

The pages are those that a repository's browser shows, at the same places, so that every link works in both. Whatever a
page links to is copied as well. The page of Python docstrings is made here alone.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "build" / "site-source"
HOME = "README.md"
PAGES = (HOME, "CONTRIBUTING.md", "ARCHITECTURE.md", "CHANGELOG.md", "CODE_OF_CONDUCT.md")
PYTHON = """# Python from the docstrings

What `import pipeline.choice` offers; [examples](api.md) show how it is used.

::: pipeline.choice
"""
LINK = re.compile(r"(\]\()([^)#:\s]+)((?:#[^)\s]*)?\))")


def main() -> None:
    """Copy the pages and build; the exit status is that of the build."""
    shutil.rmtree(SOURCE, ignore_errors=True)
    for page in [*map(ROOT.joinpath, PAGES), *(ROOT / "docs").glob("*.md")]:
        _copy(page)
    (SOURCE / "docs" / "python.md").write_text(PYTHON, encoding="utf-8")
    config = shutil.copy(ROOT / "docs" / "site.toml", SOURCE.parent)
    done = subprocess.run([sys.executable, "-m", "zensical", "build", "--strict", "--clean", "--config-file", config])
    sys.exit(done.returncode)


def _copy(page: Path) -> None:
    """Copy a page with the files that it links to; the first page of a site is called index."""
    text = page.read_text(encoding="utf-8")
    for _, target, _ in LINK.findall(text):
        linked = (page.parent / target).resolve()
        if linked.is_file() and not _is_page(linked):
            _place(linked).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(linked, _place(linked))

    def place(link: re.Match[str]) -> str:
        if (page.parent / link[2]).resolve() == ROOT / HOME:
            return f"{link[1]}{link[2].removesuffix(HOME)}index.md{link[3]}"
        return link[0]

    _place(page).parent.mkdir(parents=True, exist_ok=True)
    _place(page).write_text(LINK.sub(place, text), encoding="utf-8")


def _is_page(path: Path) -> bool:
    return path in {ROOT / page for page in PAGES} or (path.parent, path.suffix) == (ROOT / "docs", ".md")


def _place(path: Path) -> Path:
    return SOURCE / ("index.md" if path == ROOT / HOME else path.relative_to(ROOT))


if __name__ == "__main__":
    main()
