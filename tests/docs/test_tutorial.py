"""The tutorial's blocks are those of CI, and its quick ones print here what the page shows."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
README = runpy.run_path(str(ROOT / ".ci" / "readme.py"))
PAGE = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")


def test_every_block_is_followed_by_ci() -> None:
    blocks = re.findall(r"(?m)^```(\w+)$", PAGE)
    followed = README["BLOCK"].findall(PAGE)
    assert len(followed) == blocks.count("sh") + blocks.count("console") > 10
    assert set(blocks) == {"sh", "console", "yaml"}


def test_what_comes_before_computing_is_as_shown() -> None:
    assert README["followed"](PAGE, lambda block: "run mug" not in block) == PAGE


def test_another_answer_is_found() -> None:
    wrong = PAGE.replace("25 Hz", "26 Hz", 1)
    assert README["followed"](wrong, lambda block: "run mug" not in block) == PAGE
