"""Write docs/licences.md from requirements.lock and what the installed packages say of themselves.

`python docs/make_licences.py`
"""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "licences.md"
HEAD = """# Licences of what this is built on

Made from `requirements.lock` by `python docs/make_licences.py`; run it in the project's environment after the lock changes.
Every package is pinned to one version by the hashes of its files. *Direct* are those that the project's own code uses, with
what for; the others come with them. A package that only another system needs is not installed here, and so says nothing.

pingouin is under the GPL 3: the project's own code stays under the MIT licence and may be used without it, but a copy that
brings pingouin along (an image, a bundled environment) is to be passed on under the terms of the GPL.

"""
USED_FOR = {
    "numpy": "arrays", "scipy": "special functions, k-d tree, optimisation", "finufft": "density of large sets",
    "polars": "tables in memory", "pyarrow": "Parquet", "duckdb": "the catalog and SQL", "mujoco": "kinematics",
    "mcap": "recordings", "zstandard": "compressed recordings, unpacked within bounds",
    "lz4": "compressed recordings, unpacked within bounds", "rerun-sdk": "recordings for the viewer",
    "dvc": "what to run again", "pydantic": "params.yaml checked", "ruamel-yaml": "params.yaml read and edited",
    "prompt-toolkit": "the prompt of lessbench sql", "pygments": "SQL in colours at that prompt", "typer": "the command line", "rich": "tables and progress on a terminal", "matplotlib": "figures",
    "pandas": "what pingouin and statsmodels take and give", "pingouin": "repeated-measures analysis of variance",
    "statsmodels": "logistic regression with clustered errors",
    "dask": "folds over many machines", "distributed": "folds over many machines", "pytest": "tests",
    "pytest-timeout": "tests", "hypothesis": "tests", "ruff": "lint and format", "mypy": "types",
    "import-linter": "layers", "scikit-learn": "tests and benchmarks: the peer",
    "mcap-ros2-support": "tests and benchmarks: the peer", "scipy-stubs": "types", "pandas-stubs": "types",
    "setuptools": "installation",
}  # fmt: skip


def locked() -> dict[str, str]:
    """Version of every package of requirements.lock."""
    text = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    return {_normal(name): version for name, version in re.findall(r"(?m)^([\w.-]+)==([\w.+!-]+)", text)}


def direct() -> set[str]:
    """What pyproject.toml asks for, extras included."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    asked = [*project["dependencies"], *(one for extra in project["optional-dependencies"].values() for one in extra)]
    return {_normal(re.split(r"[^\w.-]", one, maxsplit=1)[0]) for one in asked}


def page() -> str:
    """The text of docs/licences.md."""
    wanted = direct()
    rows = [
        f"| {name} | {version} | {licence(name)} | {USED_FOR[name] if name in wanted else ''} |"
        for name, version in sorted(locked().items())
    ]
    return HEAD + "\n".join(["| package | version | licence | direct: for what |", "|---|---|---|---|", *rows]) + "\n"


def licence(name: str) -> str:
    """What the package says: its SPDX expression, else its classifiers, else the first line of its licence field."""
    try:
        about = metadata(name)
    except PackageNotFoundError:
        return "(of another system)"
    classifiers = [line.split(" :: ")[-1] for line in about.get_all("Classifier", []) if line.startswith("License :: ")]
    stated = about.get("License-Expression") or ", ".join(sorted(set(classifiers) - {"OSI Approved"}))
    first = (about.get("License") or "").strip().splitlines()
    return (stated or (first[0] if first else "not stated")).replace("|", "/")


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
