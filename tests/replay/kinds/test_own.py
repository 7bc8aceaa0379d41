"""Kinds of installed packages, and kinds that fail."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import ParameterError, StageError
from pipeline.replay import Scene, bind_features
from pipeline.replay.kinds.register import KINDS, feature

PACKAGE = """
from pipeline.replay import feature


@feature("turns", unit="rad", direction="cost")
def turns(motion):
    return abs(motion.waypoints[..., 1]).sum(axis=1)
"""


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    """No kinds that stay."""
    before = dict(KINDS)
    yield
    KINDS.clear()
    KINDS.update(before)


def install(folder: Path, module: str, code: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package as installers leave it, with the kind `turns` in its entry points."""
    (folder / f"{module}.py").write_text(code)
    about = folder / f"{module}-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[lessbench.features]\nturns = {module}:turns\n")
    monkeypatch.syspath_prepend(str(folder))


def test_an_installed_kind_is_found_when_it_is_named(
    gantry: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "lab_kinds_a", PACKAGE, monkeypatch)
    with pytest.raises(ParameterError, match=r"allowed are .*turns"):
        bind_features(gantry, {"f": {"kind": "haste"}})
    assert "lab_kinds_a" not in sys.modules  # naming another kind imports nothing
    waypoints = np.random.default_rng(0).uniform(-1, 1, (3, 5, 3))
    found = bind_features(gantry, {"f": {"kind": "turns"}}).evaluate(waypoints)
    assert found[:, 0].tolist() == abs(waypoints[..., 1]).sum(axis=1).tolist()


def test_a_package_that_cannot_be_imported_is_said(
    gantry: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "lab_kinds_b", "import nowhere_to_be_found", monkeypatch)
    message = r"'turns' is promised by 'lab_kinds_b:turns' .* cannot be imported \(ModuleNotFoundError"
    with pytest.raises(ParameterError, match=message):
        bind_features(gantry, {"f": {"kind": "turns"}})


def test_a_kind_that_fails_is_one_sentence(gantry: Scene) -> None:
    feature("broken", unit="m")(lambda motion: {}["x"])
    with pytest.raises(StageError, match=r"feature 'f' cannot be computed, as its kind fails with KeyError: 'x'; mend"):
        bind_features(gantry, {"f": {"kind": "broken"}})
