"""One run of a small project that nobody disturbs, for everything that does."""

from __future__ import annotations

from pathlib import Path

import pytest
from kills import Undisturbed


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Undisturbed:
    return Undisturbed(tmp_path_factory.mktemp("small") / "project")


@pytest.fixture
def root(undisturbed: Undisturbed) -> Path:
    return undisturbed.root
