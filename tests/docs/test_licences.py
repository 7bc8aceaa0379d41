"""docs/licences.md is that of requirements.lock, and every direct dependency says what it is for and its licence."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_the_page_is_that_of_the_lock() -> None:
    make = runpy.run_path(str(ROOT / "docs" / "make_licences.py"))
    rows = re.findall(
        r"(?m)^\| ([\w.-]+) \| ([\w.+!-]+) \| (.+?) \| (.*?) \|$", make["PAGE"].read_text(encoding="utf-8")
    )
    rows = rows[1:]  # after the head of the table
    assert {name: version for name, version, _, _ in rows} == make["locked"]()
    stated = {name: (licence, use) for name, _, licence, use in rows}
    assert {name for name, (_, use) in stated.items() if use} == make["direct"]()
    for name in make["direct"]():
        assert stated[name][0] == make["licence"](name), f"{name}: run `python docs/make_licences.py`"
        assert stated[name][0] != "not stated"


def test_every_file_of_the_lock_is_pinned_by_its_hash() -> None:
    text = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    pins = re.split(r"(?m)^(?=[\w.-]+==)", text)[1:]
    assert pins
    for pin in pins:
        assert "--hash=sha256:" in pin, pin.splitlines()[0]
