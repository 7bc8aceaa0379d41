"""The figure of a scene: paths where they are, dotted where something hides them, names that do not overlap."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pipeline.replay.picture import Camera, Picture
from pipeline.views.figures.scene import scene_figure
from pipeline.views.figures.style import write_figure
from tests.support.drawn_text import drawn, unreadable

HEIGHT, WIDTH = 60, 105


def picture() -> Picture:
    """Nothing but a wall two metres away on the right half; the camera at the origin looks along y."""
    distances, bodies = np.full((HEIGHT, WIDTH), np.inf), np.full((HEIGHT, WIDTH), -1)
    distances[:, WIDTH // 2 :], bodies[:, WIDTH // 2 :] = 2.0, 4
    bodies[:3, 60:64], bodies[30:34, 0:2] = 5, 6
    camera = Camera(np.zeros(3), np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), np.pi / 2)
    return Picture(camera, np.full((HEIGHT, WIDTH, 3), 200, dtype=np.uint8), distances, bodies)


def figure() -> Figure:
    across = np.linspace(-1.0, 1.0, 11)
    path = np.stack([across, np.full(11, 3.0), np.zeros(11)], axis=1)
    return scene_figure(
        picture(), np.stack([path, path + np.array([0, 0, 0.1])]), {4: "wall $x", 5: "lamp", 6: "cup", 7: "unseen"}
    )


def test_paths_are_dotted_behind_things() -> None:
    shown, hidden = figure().axes[0].collections
    middle = WIDTH / 2
    assert len(shown.get_segments()) + len(hidden.get_segments()) == 20
    assert all(segment[:, 0].max() <= middle for segment in shown.get_segments())
    assert all(segment[:, 0].max() >= middle for segment in hidden.get_segments())
    # 90 degrees up and down: a slope of 1 / 3 is 10 of 30 lines from the middle
    first = shown.get_segments()[0]
    np.testing.assert_allclose(first[0], [middle - 10, 30])


def test_what_is_seen_is_named_and_can_be_read() -> None:
    one = figure()
    words = {text.get_text() for text in drawn(one)}
    assert {"start", "goal", "wall $x", "lamp", "cup"} <= words
    assert "unseen" not in words
    assert unreadable(one) == []


def test_the_same_bytes(tmp_path: Path) -> None:
    for name in "ab":
        write_figure(tmp_path, name, figure())
    for kind in ("svg", "png", "pdf"):
        assert (tmp_path / f"a.{kind}").read_bytes() == (tmp_path / f"b.{kind}").read_bytes()
