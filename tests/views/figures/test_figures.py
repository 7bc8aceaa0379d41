"""Figures from small tables of known content: what is drawn, that nothing overlaps, that bytes repeat."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.text import Text

from pipeline.params import FigureSettings
from pipeline.studies.grid_world.trials import HIDDEN_MODELS, INFERENCE_MODELS, SAMPLING_MODELS, THETAS
from pipeline.studies.human_choice import analyse_choices
from pipeline.views import palette
from pipeline.views.figures.grid_world import density_figure, overall_figure, sets_figure, true_posterior_figure
from pipeline.views.figures.held_out import held_out_figure
from pipeline.views.figures.human_choice import choices_figure
from pipeline.views.figures.style import color, printed, styled, write_figure
from pipeline.views.figures.task import densities_figure, map_figure, posterior_figure
from pipeline.views.intervals import compare_models, differences, with_mean_intervals, with_share_intervals
from pipeline.views.task_summary import density_curve, density_map
from pipeline.vocabulary import MODELS

CHOICES = Path(__file__).resolve().parents[3] / "datasets" / "studies" / "human_choice" / "choices.csv"
SIZE = 5


def human_choice() -> Figure:
    return choices_figure(with_share_intervals(analyse_choices(pl.read_csv(CHOICES)).predictions))


def summary() -> pl.DataFrame:
    rng = np.random.default_rng(1)
    rows = [
        (people, robot, theta, 150, rng.random(), 0.02, 0.5)
        for people in (*SAMPLING_MODELS, *HIDDEN_MODELS)
        for robot in INFERENCE_MODELS
        for theta in (None, *range(8))
    ]
    columns = [
        "sampling_model",
        "inference_model",
        "theta_id",
        "sets",
        "true_posterior",
        "standard_error",
        "true_match",
    ]
    table = pl.DataFrame(rows, schema=columns, orient="row")
    return with_mean_intervals(table)


def paths() -> pl.DataFrame:
    """Three paths per set: right along the bottom and up, twice, and up along the left and right."""
    right, up = [0, 1, 2, 3, 4, 4, 4, 4, 4], [0, 0, 0, 0, 0, 1, 2, 3, 4]
    rows = [
        {"set": name, "sampling_model": people, "x": x, "y": y, "phi_1": 0.2 + 0.2 * k, "phi_2": 0.9 - 0.2 * k}
        for name, people in (("Xi_L", "boltzmann"), ("Xi_B", "less"))
        for k, (x, y) in enumerate([(right, up), (right, up), (up, right)])
    ]
    return pl.DataFrame(rows, schema_overrides={"x": pl.Array(pl.Int64, 9), "y": pl.Array(pl.Int64, 9)})


def sets() -> Figure:
    rows = [
        (name, model, k, *theta, 0.93 if k == 7 else 0.01, k == 7)
        for name in ("Xi_L", "Xi_B")
        for model in ("boltzmann", "less")
        for k, theta in enumerate(THETAS.tolist())
    ]
    columns = ["set", "inference_model", "theta_id", "theta_1", "theta_2", "posterior", "is_true"]
    posteriors = pl.DataFrame(rows, schema=columns, orient="row")
    return sets_figure(paths(), posteriors, [(1, 3), (3, 1)], SIZE)


def densities() -> Figure:
    edges = np.linspace(0, 1, 11)
    raw = np.exp(-((edges[:-1] - 0.5) ** 2) * 20)
    one = [
        pl.DataFrame({"feature": f, "low": edges[:-1], "high": edges[1:], "raw": raw, "adjusted": np.full(10, 0.7)})
        for f in (1, 2)
    ]
    i, j = (index.ravel() for index in np.indices((10, 10)))
    two = pl.DataFrame(
        {
            "phi_1_low": edges[i], "phi_1_high": edges[i + 1], "phi_2_low": edges[j], "phi_2_high": edges[j + 1],
            "raw": np.where(i + j == 9, 1.0 + i, 0.0), "adjusted": np.ones(100),
        }
    )  # fmt: skip
    return density_figure(paths(), pl.concat(one), two)


def held_out_table() -> pl.DataFrame:
    rows = [
        (f"d{i}", model, 1000, "working", -5.0 + 0.1 * i + lead * (1 + i % 2))
        for model, lead in (("boltzmann", 0.0), ("less", 0.2), ("attribute-rule", -0.1))
        for i in range(6)
    ]
    columns = ["demonstration_id", "model", "set_size", "set_id", "log_predictive"]
    return pl.DataFrame(rows, schema=columns, orient="row")


def held_out() -> Figure:
    table = held_out_table()
    return held_out_figure(table, compare_models(table), differences(table))


def task_densities() -> Figure:
    rng = np.random.default_rng(2)
    curves = [
        density_curve(name, "rad^2", rng.normal(size=50), rng.normal(size=4), 0.3, rng.normal(size=50))
        for name in ("effort", "height", "laptop", "human")
    ]
    return densities_figure(curves)


def task_map() -> Figure:
    rng = np.random.default_rng(3)
    alternatives, demonstrations = rng.normal(size=(50, 2)), rng.normal(size=(4, 2))
    return map_figure(density_map(("effort", "height"), ("", "m"), alternatives, demonstrations, np.full(2, 0.3)))


def task_posterior() -> Figure:
    p = np.full(30, 0.01)
    p[:2] = 0.5, 0.22
    return posterior_figure({"boltzmann": p, "less": p[::-1]}, [f"½ efficiency + {k}" for k in range(30)], "weights")


FIGURES: dict[str, Callable[[], Figure]] = {
    "human_choice": human_choice,
    "true_posterior": lambda: true_posterior_figure(summary()),
    "overall": lambda: overall_figure(summary()),
    "sets": sets,
    "densities": densities,
    "held_out": held_out,
    "task_densities": task_densities,
    "task_map": task_map,
    "task_posterior": task_posterior,
}


def texts(figure: Figure) -> list[Text]:
    """All text that drawing the figure puts on the page, such as ticks within their axis and not those beyond."""
    drawn: list[Text] = []
    draw = Text.draw

    def noted(self: Text, renderer: object, *args: object, **kwargs: object) -> None:
        drawn.append(self)
        draw(self, renderer, *args, **kwargs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Text, "draw", noted)
        with styled():
            figure.canvas.draw()
    return [text for text in dict.fromkeys(drawn) if text.get_visible() and text.get_text().strip()]


def shown(figure: Figure) -> list[str]:
    return [text.get_text() for text in texts(figure)]


@pytest.mark.parametrize("name", FIGURES)
def test_the_same_data_give_the_same_bytes(name: str, tmp_path: Path) -> None:
    for folder in ("a", "b"):
        write_figure(tmp_path / folder, name, FIGURES[name]())
    for kind in ("svg", "png", "pdf"):
        first, second = ((tmp_path / folder / f"{name}.{kind}").read_bytes() for folder in ("a", "b"))
        assert first == second, kind
    assert sorted(file.name for file in (tmp_path / "a").iterdir()) == [
        f"{name}.{kind}" for kind in ("pdf", "png", "svg")
    ]
    svg = (tmp_path / "a" / f"{name}.svg").read_text()
    assert "<dc:date>" not in svg
    width = imread(tmp_path / "a" / f"{name}.png").shape[1]
    usual = FigureSettings()
    assert width in (int(300 * usual.column_in), int(300 * usual.text_in))


def test_text_is_text_in_svg_and_pdf(tmp_path: Path) -> None:
    write_figure(tmp_path, "x", held_out(), "What it shows.")
    svg = (tmp_path / "x.svg").read_text()
    assert "6 held-out demonstrations; mean ± standard error</text>" in svg
    assert "'DejaVu Sans', sans-serif" in svg, "who lacks the font sees another"
    assert b"/FontFile2" in (tmp_path / "x.pdf").read_bytes()
    assert (tmp_path / "x.txt").read_text() == "What it shows.\n"


def test_sizes_and_formats_are_those_of_the_parameters(tmp_path: Path) -> None:
    with printed(FigureSettings(column_in=4.0, font_pt=9.0, formats=("pdf",))):
        figure = held_out()
        write_figure(tmp_path, "x", figure)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["x.pdf", "x.svg"]
    assert re.search(r'<svg[^>]*width="288pt"', (tmp_path / "x.svg").read_text())
    assert figure.get_size_inches()[1] == pytest.approx(9 / 7.5 * held_out().get_size_inches()[1])
    assert sorted({round(text.get_fontsize(), 6) for text in texts(figure)}) == [8.4, 9.0, 9.6]
    assert held_out().get_size_inches()[0] == 3.33, "the settings end with their context"


def test_models_differ_without_colour() -> None:
    for figure, panel in ((human_choice(), 0), (true_posterior_figure(summary()), 0), (overall_figure(summary()), 0)):
        handles, labels = figure.axes[panel].get_legend_handles_labels()
        looks = [handle.patches[0].get_hatch() for handle in handles]
        assert len(set(looks[-2:])) == 2, labels
        assert len({*looks} - {None, ""}) >= len(looks) - 2, (labels, looks)


@pytest.mark.parametrize("name", FIGURES)
def test_no_text_is_small_or_clipped_or_over_another(name: str) -> None:
    figure = FIGURES[name]()
    drawn = texts(figure)
    page = figure.bbox
    boxes = []
    for text in drawn:
        assert text.get_fontsize() >= 7, text
        box = text.get_window_extent()
        assert box.x0 > page.x0 - 1, text
        assert box.x1 < page.x1 + 1, text
        assert box.y0 > page.y0 - 1, text
        assert box.y1 < page.y1 + 1, text
        boxes.append((text, box))
    for i, (text, box) in enumerate(boxes):
        for other, other_box in boxes[i + 1 :]:
            over_x = min(box.x1, other_box.x1) - max(box.x0, other_box.x0)
            over_y = min(box.y1, other_box.y1) - max(box.y0, other_box.y0)
            assert over_x < 1 or over_y < 1, (text, other)


def bars(figure: Figure, panel: int) -> dict[str, list[float]]:
    """Bar heights by label."""
    from matplotlib.container import BarContainer

    containers = [c for c in figure.axes[panel].containers if isinstance(c, BarContainer)]
    return {str(c.get_label()): [bar.get_height() for bar in c] for c in containers}


def test_the_bars_of_human_choice_are_its_shares() -> None:
    figure = human_choice()
    left_right, within = bars(figure, 0), bars(figure, 1)
    assert left_right["Boltzmann"] == pytest.approx([19 / 82, 63 / 82])
    assert left_right["LESS"] == pytest.approx([0.475, 0.525])
    assert left_right["observed, 95 % binomial interval"] == pytest.approx([15 / 37, 22 / 37])
    assert within["observed, 95 % binomial interval"] == pytest.approx([5 / 22, 12 / 22, 5 / 22])
    assert within["LESS"] == pytest.approx([1 / 3] * 3)
    assert {"left", "right", "R1", "R2", "R3", "all choices, n = 37", "choices of right, n = 22"} <= set(shown(figure))


def test_true_posterior_has_a_bar_per_theta_and_model() -> None:
    table = summary()
    figure = true_posterior_figure(table)
    for panel, people in ((0, "less"), (2, "boltzmann")):
        by_model = bars(figure, panel)
        assert list(by_model) == ["Boltzmann", "LESS", "attribute rule", "path-size logit"]
        rows = table.filter(pl.col("theta_id").is_not_null(), sampling_model=people, inference_model="path-size")
        assert by_model["path-size logit"] == rows["true_posterior"].to_list()
        whole = table.filter(pl.col("theta_id").is_null(), sampling_model=people, inference_model="less")
        assert bars(figure, panel + 1)["LESS"] == whole["true_posterior"].to_list()
    words = shown(figure)
    assert {"near A\nnear B", "far from A\nnear B", "far from B", "all"} <= set(words)
    assert "people choose by LESS: mean of 150 sets, 95 % interval" in words


def test_a_model_has_the_same_color_everywhere() -> None:
    for figure, panel in ((human_choice(), 0), (true_posterior_figure(summary()), 0), (overall_figure(summary()), 0)):
        handles, labels = figure.axes[panel].get_legend_handles_labels()
        for handle, label in zip(handles, labels, strict=True):
            for model, name in MODELS.items():
                if label == name:
                    assert handle.patches[0].get_facecolor()[:3] == pytest.approx(color(palette.MODELS[model]))


def test_paths_that_share_a_step_lie_side_by_side() -> None:
    figure = sets()
    lines = [line for line in figure.axes[0].lines if len(line.get_xdata()) == 2 * SIZE - 1]
    assert len(lines) == 3
    x = [np.asarray(line.get_xdata(), dtype=float) for line in lines]
    y = [np.asarray(line.get_ydata(), dtype=float) for line in lines]
    # the first two are one path: shifted against each other by the same in both directions
    np.testing.assert_allclose(x[1] - x[0], 0.17)
    np.testing.assert_allclose(y[1] - y[0], -0.17)
    assert shown(figure).count("true") == 2
    assert "far from A, far from B" in shown(figure)


def test_densities_and_points_are_those_of_the_tables() -> None:
    figure = densities()
    stairs = {patch.get_label(): patch.get_data() for patch in figure.axes[0].patches}
    np.testing.assert_allclose(stairs["adjusted by LESS"].values, 0.7)
    np.testing.assert_allclose(stairs["every path alike"].edges, np.linspace(0, 1, 11))
    image = figure.axes[2].images[0].get_array()
    assert image.shape == (10, 10)
    # phi_1 across, phi_2 up: the cell in the lower right corner has the largest value, most cells have none
    assert image[0, 9] == 10.0
    assert np.ma.count(image) == 10
    points = {line.get_label(): line.get_xydata() for line in figure.axes[2].lines}
    np.testing.assert_allclose(points["$\\Xi_B$"], [[0.2, 0.9], [0.4, 0.7], [0.6, 0.5]])


def test_held_out_shows_every_demonstration_and_the_mean() -> None:
    figure = held_out()
    comparison = compare_models(held_out_table())
    left, right = figure.axes
    dots = [line for line in left.lines if len(line.get_xdata()) == 6]
    assert len(dots) == 3
    means = [float(line.get_xdata()[0]) for line in right.lines if line.get_marker() == "D"]
    assert means == pytest.approx([0.3, -0.15])
    assert comparison["difference"].to_list() == [0.0, pytest.approx(0.3), pytest.approx(-0.15)]
    # sample deviation of 0.2, 0.4, 0.2, 0.4, 0.2, 0.4 is 0.1 sqrt(6/5)
    assert comparison["difference_standard_error"][1] == pytest.approx(0.1 * np.sqrt(6 / 5) / np.sqrt(6))


def test_without_boltzmann_there_is_nothing_to_lead() -> None:
    table = held_out_table().filter(pl.col("model") != "boltzmann")
    comparison = compare_models(table)
    assert comparison["difference"].null_count() == 2
    assert len(held_out_figure(table, comparison, differences(table)).axes) == 1


def test_an_interrupted_write_leaves_the_old_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "x.svg").write_text("an older one")
    figure = held_out()

    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(figure, "savefig", stop)
    with pytest.raises(KeyboardInterrupt):
        write_figure(tmp_path, "x", figure)
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("x.svg", "an older one")]


def test_the_readers_own_settings_do_not_matter(tmp_path: Path) -> None:
    import matplotlib as mpl

    write_figure(tmp_path, "a", held_out())
    with mpl.rc_context({"font.size": 20, "axes.facecolor": "black", "svg.fonttype": "none", "savefig.dpi": 50}):
        write_figure(tmp_path, "b", held_out())
    for kind in ("svg", "png"):
        assert (tmp_path / f"a.{kind}").read_bytes() == (tmp_path / f"b.{kind}").read_bytes()
    assert not re.search(r"20\d\d-\d\d-\d\d", (tmp_path / "a.svg").read_text())
