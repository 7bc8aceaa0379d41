"""What all tests share: the real recordings, the small project of a gantry, property tests that repeat."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

from tests.support.gantry_project import make_project, parameters

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.kills import Undisturbed

ROOT = Path(__file__).resolve().parents[1]

__all__ = ["make_project", "parameters"]  # fixtures

# The same examples in every run; a noisy machine is no failure.
settings.register_profile("repeatable", derandomize=True, deadline=None, database=None)
settings.load_profile("repeatable")


@pytest.fixture(autouse=True)
def process_as_it_was() -> Iterator[None]:
    """The environment and the exception hook, which `main` sets for its whole process, as they were before the test."""
    environment, hook = dict(os.environ), sys.excepthook
    yield
    if dict(os.environ) != environment:
        os.environ.clear()
        os.environ.update(environment)
    sys.excepthook = hook


@pytest.fixture(scope="session")
def shared() -> Path:
    """The directory with the real recordings, which lies beside the repository and is not part of it."""
    path = ROOT.parent / "shared"
    if not path.is_dir():
        pytest.skip(f"the real recordings are not here: {path} does not exist")
    return path


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Undisturbed:
    """One run of a small project that nobody disturbs, for all tests that do."""
    from tests.support.kills import Undisturbed

    return Undisturbed(tmp_path_factory.mktemp("small") / "project")
