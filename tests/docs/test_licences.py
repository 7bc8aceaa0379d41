"""docs/licences.md is that of the locks, and every direct dependency says what it is for and its licence."""

from __future__ import annotations

import ast
import re
import runpy
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MAKE = runpy.run_path(str(ROOT / "docs" / "make_licences.py"))
NAMES = ["run", "cluster", "dev"]
COPYLEFT = {"grandalf", "pygit2"}  # docs/licences.md says what they are


def rows(name: str) -> dict[str, tuple[str, str, str]]:
    """Version, licence and purpose of each package of a section of the page."""
    sections = MAKE["PAGE"].read_text(encoding="utf-8").split("\n## ")
    (section,) = [text for text in sections if f"(`{MAKE['LOCKS'][name][0]}`)" in text.splitlines()[0]]
    cells = re.findall(r"(?m)^\| ([\w.-]+) \| ([^|]+) \| ([^|]+) \| [^|]*\| ([^|]*) \|$", section)
    return {package: (version, licence, use) for package, version, licence, use in cells if package != "package"}


@pytest.mark.parametrize("name", NAMES)
def test_the_page_is_that_of_the_lock(name: str) -> None:
    stated = rows(name)
    assert {package: version for package, (version, _, _) in stated.items()} == MAKE["locked"](name)
    assert {package for package, (_, _, use) in stated.items() if use} == MAKE["direct"](name)
    for package in MAKE["direct"](name):
        assert stated[package][1] == MAKE["licence"](package), f"{package}: run `python docs/make_licences.py`"
        assert stated[package][1] != "not stated"


def test_running_needs_no_package_under_the_gpl_but_those_that_dvc_brings() -> None:
    gpl = {
        package
        for name in ("run", "cluster")
        for package, (_, licence, _) in rows(name).items()
        if re.search(r"GPL|General Public", licence) and " OR " not in licence
    }
    assert gpl == COPYLEFT
    assert rows("dev")["pingouin"][1].startswith("GPL")


def test_no_package_is_in_two_locks() -> None:
    packages = [package for name in NAMES for package in MAKE["locked"](name)]
    assert len(packages) == len(set(packages))


@pytest.mark.parametrize("name", NAMES)
def test_every_file_of_the_lock_is_pinned_by_its_hash(name: str) -> None:
    text = (ROOT / MAKE["LOCKS"][name][0]).read_text(encoding="utf-8")
    pins = re.split(r"(?m)^(?=[\w.-]+==)", text)
    assert not pins[0]  # no line names a place to install from
    assert len(pins) > 1
    for pin in pins[1:]:
        assert re.fullmatch(r"\S+==\S+( ; [^\\]+)? \\\n(    --hash=sha256:[0-9a-f]{64}( \\)?\n)+", pin), pin[:80]


def imported_modules() -> set[str]:
    """The modules of others that the project's code imports, anywhere in it."""
    names = set()
    for file in (file for folder in ("pipeline", "schemas") for file in (ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
                names.add(node.module.partition(".")[0])
    return names - sys.stdlib_module_names - {"pipeline", "schemas"}


def test_what_is_asked_for_is_what_the_code_imports() -> None:
    asked = MAKE["direct"]("run") | MAKE["direct"]("cluster")
    packages = packages_distributions()
    used = set()
    for module in imported_modules():
        holders = {MAKE["_normal"](package) for package in packages[module]}
        wanted = {package for package in asked if holders & ({package} | MAKE["PARTS"].get(package, set()))}
        assert wanted, f"{module} is imported and no package that holds it is in pyproject.toml"
        used |= wanted
    # setuptools installs the project, and dask is what `distributed` computes for
    assert used == asked - {"setuptools", "dask"}
