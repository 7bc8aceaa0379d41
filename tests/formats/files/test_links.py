"""A project that somebody else made may hold links; what is written stays in the project."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.errors import StageError
from pipeline.formats.files.atomic import folder_written_whole, written_whole
from pipeline.formats.files.links import require_inside
from pipeline.workspace.project import Project


@pytest.fixture
def project(tmp_path: Path) -> Project:
    """A project with links in its datasets: out of it, within it, and to nowhere."""
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "mine").write_text("mine")
    root = tmp_path / "project"
    (root / "datasets" / "real").mkdir(parents=True)
    (root / "datasets" / "away").symlink_to(tmp_path / "outside")
    (root / "datasets" / "within").symlink_to(root / "datasets" / "real")
    (root / "datasets" / "around").symlink_to(root / "datasets" / "around")
    return Project(root)


@pytest.mark.parametrize("folder", ["away", "away/deeper", "around"])
def test_nothing_is_written_through_a_link_out_of_the_project(project: Project, folder: str, tmp_path: Path) -> None:
    path = project.datasets / folder / "mine"
    with pytest.raises(StageError, match="a link leads from here out of the project"), written_whole(path) as stream:
        stream.write(b"theirs")
    with pytest.raises(StageError, match="a link leads from here out of the project"), folder_written_whole(path):
        pass
    assert [file.name for file in (tmp_path / "outside").iterdir()] == ["mine"]
    assert (tmp_path / "outside" / "mine").read_text() == "mine"


def test_links_within_the_project_are_followed_and_other_folders_are_nobodys_business(
    project: Project, tmp_path: Path
) -> None:
    for path in (project.datasets / "within" / "a", tmp_path / "outside" / "a"):
        with written_whole(path) as stream:
            stream.write(b"x")
    assert (project.datasets / "real" / "a").read_bytes() == b"x"


def test_a_file_that_is_replaced_may_be_a_link_and_one_that_is_opened_not(project: Project, tmp_path: Path) -> None:
    link = project.datasets / "link"
    link.symlink_to(tmp_path / "outside" / "mine")
    with pytest.raises(StageError, match="nothing was written"):
        require_inside(link, opened=True)
    with written_whole(link) as stream:
        stream.write(b"theirs")
    assert not link.is_symlink()
    assert (tmp_path / "outside" / "mine").read_text() == "mine"


@pytest.mark.parametrize("left", [".figures.former", ".figures.partial"])
def test_what_looks_left_over_is_not_followed(project: Project, tmp_path: Path, left: str) -> None:
    (project.datasets / "figures").mkdir()
    (project.datasets / left).symlink_to(tmp_path / "outside")
    with folder_written_whole(project.datasets / "figures") as folder:
        (folder / "a").write_text("x")
    assert (project.datasets / "figures" / "a").read_text() == "x"
    assert not (project.datasets / left).is_symlink()
    assert (tmp_path / "outside" / "mine").read_text() == "mine"


def test_a_project_reached_through_a_link_is_a_project(project: Project, tmp_path: Path) -> None:
    (tmp_path / "shortcut").symlink_to(project.root)
    with written_whole(Project(tmp_path / "shortcut").datasets / "a") as stream:
        stream.write(b"x")
    assert (project.datasets / "a").read_bytes() == b"x"
