"""Write docs/licences.md from pyproject.toml, the locks and what the installed packages say of themselves.

`python docs/make_licences.py`
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, distribution, metadata
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "licences.md"
LOCKS = {
    "run": ("requirements.lock", "What the pipeline needs"),
    "cluster": ("requirements-cluster.lock", "What computing on many machines needs besides"),
    "dev": ("requirements-dev.lock", "What the tests need besides, and what the extras `ros`, `hdf5` and `docs` bring"),
}
TESTED = ("ros", "hdf5", "docs")
"""Extras that the lock of the tests has, too."""
PARTS = {
    "polars": {"polars-runtime-32"},
    "mujoco": {"mujoco-core", "mujoco-studio"},
    "pydantic": {"pydantic-core"},
}
"""What a package keeps in packages beside it, and asks for in one version only."""
HEAD = """# What this is built on, and its licences

Made from `pyproject.toml` and the locks by `make locks`, or by `python docs/make_licences.py` in the environment of
the tests. Every package is pinned to one version by the hashes of its files. `make repro` installs
`requirements.lock`, `make test` all three locks. *For what* is said of those that the project's own code uses, with
the size of their files in MB as installed on Linux; the others come with them. Where a package has two versions, the
first is for Python 3.11.

The environment of `make repro` takes 1.5 GB (Linux, Python 3.11, after a run of everything). The largest parts are
Rerun with its viewer (0.5 GB), polars, pyarrow, scipy, duckdb, mujoco and numpy (0.65 GB together) and what DVC and
matplotlib bring (0.15 GB). The environment of `make test` takes 0.3 GB more.

The project's own code is under the MIT licence and imports no package under the GPL. DVC, which runs it, brings two:
grandalf (GPL 2) and pygit2 (GPL 2 with an exception for linking). Only the tests use pingouin
(GPL 3, a peer) and codespell (GPL 2). A copy that brings these along (an image, a bundled environment) passes them on
under their terms.
"""
USED_FOR = {
    "numpy": "arrays",
    "scipy": "special functions, k-d tree, optimisation, sparse matrices",
    "finufft": "density of large sets",
    "polars": "tables in memory",
    "pyarrow": "Parquet",
    "duckdb": "the catalog and SQL",
    "mujoco": "kinematics",
    "mcap": "recordings",
    "zstandard": "compressed recordings, unpacked within bounds",
    "lz4": "compressed recordings, unpacked within bounds",
    "rerun-sdk": "recordings for the viewer, and the viewer itself",
    "dvc": "what to run again",
    "pydantic": "params.yaml checked",
    "ruamel-yaml": "params.yaml read and edited",
    "typer": "the command line",
    "click": "the pager of lessbench sql",
    "rich": "tables and progress on a terminal",
    "prompt-toolkit": "the prompt of lessbench sql",
    "pygments": "SQL in colours at that prompt",
    "matplotlib": "figures",
    "filelock": "one process at a time per stage; comes with DVC too",
    "psutil": "whether the run that started a stage still exists; comes with DVC too",
    "voluptuous": "whether dvc.lock is whole, by DVC's own schema; comes with DVC too",
    "setuptools": "installation of the project itself",
    "dask": "parts of a set over many machines",
    "distributed": "parts of a set over many machines",
    "pytest": "tests",
    "pytest-timeout": "tests",
    "pytest-xdist": "runs them on all cores",
    "hypothesis": "tests of properties",
    "ruff": "lint and format",
    "mypy": "types",
    "import-linter": "layers",
    "zensical": "the documentation as a site",
    "mkdocstrings-python": "its page of docstrings",
    "codespell": "spelling",
    "pingouin": "the peer of the analysis of variance",
    "statsmodels": "the peer of the logistic regression",
    "scikit-learn": "the peer of the density, in tests and benchmarks",
    "mcap-ros2-support": "the peer of reading recordings, in tests and benchmarks",
    "mcap-ros1-support": "writes ROS 1 messages in MCAP for the tests",
    "mcap-protobuf-support": "writes Protobuf channels in MCAP for the tests",
    "scipy-stubs": "types",
    "rosbags": "bags of ROS 1, planned motions; writes bags for the tests (extra `ros`)",
    "protobuf": "recordings in Protobuf (extra `ros`)",
    "h5py": "recordings in HDF5 (extra `hdf5`)",
}


def locked(name: str) -> dict[str, str]:
    """Version of every package of a lock, or its versions where they depend on Python's."""
    text = (ROOT / LOCKS[name][0]).read_text(encoding="utf-8")
    versions: dict[str, list[str]] = {}
    for package, version in re.findall(r"(?m)^([\w.-]+)==([\w.+!-]+)", text):
        versions.setdefault(_normal(package), []).append(version)
    return {package: ", ".join(several) for package, several in sorted(versions.items())}


def direct(name: str) -> set[str]:
    """What pyproject.toml asks for: to build and run, or by the name of an extra."""
    asked = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    project = asked["project"]
    if name == "run":
        return _names([*asked["build-system"]["requires"], *project["dependencies"]])
    extras = (name, *TESTED) if name == "dev" else (name,)
    return _names(one for extra in extras for one in project["optional-dependencies"][extra])


def page() -> str:
    """The text of docs/licences.md."""
    return HEAD + "".join(_section(name) for name in LOCKS)


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


def _section(name: str) -> str:
    file, title = LOCKS[name]
    wanted = direct(name)
    lines = [f"\n## {title} (`{file}`)\n", "| package | version | licence | MB | for what |", "|---|---|---|---|---|"]
    packages = locked(name)
    for package in [*sorted(wanted), *(package for package in packages if package not in wanted)]:
        use = (f"{_megabytes(package):.0f}", USED_FOR[package]) if package in wanted else ("", "")
        lines.append(f"| {package} | {packages[package]} | {licence(package)} | {use[0]} | {use[1]} |")
    return "\n".join(lines) + "\n"


def _megabytes(name: str) -> float:
    """Of the files that the package and its parts list, without bytecode."""
    files = (file for part in {name} | PARTS.get(name, set()) for file in distribution(part).files or ())
    return sum(file.size or 0 for file in files) / 1e6


def _names(requirements: Iterable[str]) -> set[str]:
    return {_normal(re.split(r"[^\w.-]", requirement, maxsplit=1)[0]) for requirement in requirements}


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
