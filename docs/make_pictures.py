"""Make every picture of the pages from what `dvc repro` computed: `make pictures`, or

    python docs/make_pictures.py

Figures come from datasets/*/figures, at the resolution of a screen; views from the recordings in the Rerun viewer,
which needs a Vulkan driver that draws in software; the report from Chromium. On Debian: `apt-get install
mesa-vulkan-drivers chromium`. What is missing is said at the end, and its picture stays as it was.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import polars as pl
from PIL import Image
from take_pictures import take_picture

from pipeline.choice import LESS, Boltzmann, log_density, log_probabilities
from pipeline.commands.watch.session import Until, run
from pipeline.views.palette import MODELS, RGB
from pipeline.vocabulary import BOLTZMANN
from pipeline.vocabulary import LESS as LESS_NAME
from pipeline.workspace.project import Project

ROOT = Path(__file__).resolve().parents[1]
PICTURES = {
    "human_choice.png": "studies/figures/human_choice.png",
    "grid_world_true_posterior.png": "studies/figures/grid_world_true_posterior.png",
    "grid_world_overall.png": "studies/figures/grid_world_overall.png",
    "grid_world_sets.png": "studies/figures/grid_world_sets.png",
    "grid_world_density.png": "studies/figures/grid_world_density.png",
    "table_scene.png": "table/figures/scene.png",
    "table_held_out.png": "table/figures/held_out.png",
    "table_regions.png": "table/figures/regions.png",
    "table_ten_posteriors.png": "table/figures/ten_posteriors.png",
} | {
    f"{task}_{name}.png": f"{task}/figures/{name}.png"
    for task in ("table", "laptop", "human")
    for name in ("robustness", "two_posteriors", "accuracy", "importance", "duplicates", "sensitivity")
}


SIZE, WIDE = "1120x800", "1600x1000"  # of the viewer's window; GitHub shows pictures 830 pixels wide
VIEWS = {  # with the second of the replay, where it is not the one that it opens with
    "table.png": ("table/inspect.rrd", 47.0, SIZE),
    "studies.png": ("studies/inspect.rrd", None, WIDE),
    "watch.png": ("table/watch/inspect.rrd", None, SIZE),
}
MOVING, FRAMES, FRAME_MS = "table.gif", 12, 700
"""The short moving picture of the README: how many moments of the replay of the task `table` it has."""
UPPER = (0, 66, 1120, 487)  # of a window of SIZE: the scene and the posterior
WATCHED = 3  # recordings of the task `table`, for the picture of `lessbench watch`
REPORT, REPORT_SIZE = "report.png", "1100,1500"
TARGET = ROOT / "docs" / "pictures"


def main() -> None:
    """Write every picture that can be made here; exit status 1 if one could not."""
    for name, source in PICTURES.items():
        with Image.open(ROOT / "datasets" / source) as figure:
            figure.convert("RGB").reduce(2).save(TARGET / name, optimize=True)
    draw_less(TARGET / "less.png")
    run(Project(ROOT), None, "table", Until(demonstrations=WATCHED), None)
    missing = []
    for name, (recording, time_s, size) in VIEWS.items():
        try:
            take_picture(ROOT / "datasets" / recording, TARGET / name, time_s, size)
        except RuntimeError as error:
            missing.append(f"{name}: {error}")
    try:
        take_moving(TARGET / MOVING)
    except RuntimeError as error:
        missing.append(f"{MOVING}: {error}")
    try:
        _take_report(TARGET / REPORT)
    except RuntimeError as error:
        missing.append(f"{REPORT}: {error}")
    if missing:
        sys.exit("\n".join(missing))


def take_moving(picture: Path) -> None:
    """Write a few moments of a replay as one GIF: people demonstrate, and the posterior sharpens."""
    durations = pl.read_parquet(ROOT / "datasets/table/tables/demonstrations.parquet")["duration_s"]
    frames = []
    with tempfile.TemporaryDirectory() as folder:
        for moment in np.linspace(1.0, float(durations.sum()) - 0.5, FRAMES):
            take_picture(ROOT / "datasets/table/inspect.rrd", Path(folder) / "frame.png", float(moment), SIZE)
            with Image.open(Path(folder) / "frame.png") as frame:
                frames.append(frame.convert("RGB").crop(UPPER).quantize(96))
    frames[0].save(picture, save_all=True, append_images=frames[1:], duration=FRAME_MS, loop=0, optimize=True)


# Seven ways to carry a mug, as in docs/api.md: how long each is, and how close it passes to a laptop.
WAYS = np.array([[0.0, 1.0], [0.02, 0.99], [0.01, 0.97], [0.03, 1.0], [0.02, 0.96], [0.9, 0.05], [1.0, 0.0]])
PAST, KERNEL = 5, 0.2
"""How many of them lead past the laptop, and the width of the kernel."""


def draw_less(picture: Path) -> None:
    """Draw LESS in one picture: the alternatives, the density around them, and what two models expect of a person."""
    figure, (plane, bars) = plt.subplots(1, 2, figsize=(9.0, 3.6), layout="constrained", width_ratios=(1.1, 1))
    x, y = np.meshgrid(np.linspace(-0.3, 1.3, 120), np.linspace(-0.3, 1.3, 120))
    here = np.stack([x.ravel(), y.ravel()], axis=1)
    distance = np.linalg.norm(here[:, None] - WAYS[None], axis=-1)
    density = np.exp(-(distance**2) / (2 * KERNEL**2)).sum(axis=1).reshape(x.shape)
    plane.contourf(x, y, density, levels=[0.3, 1, 2, 3, 4, 6], cmap="Greys", vmin=-1, vmax=9)
    weights = np.exp(-log_density(WAYS, KERNEL))
    plane.scatter(
        *WAYS.T, s=40 + 90 * weights / weights.max(), color=_rgb(MODELS[LESS_NAME]), edgecolors="black", zorder=3
    )
    plane.annotate("5 nearly equal ways\npast the laptop", (0.02, 0.98), (0.45, 1.0), arrowprops={"arrowstyle": "-"})
    plane.annotate("2 ways around it", (0.95, 0.03), (0.15, -0.1), arrowprops={"arrowstyle": "-"})
    plane.set(xlabel="length of the way (scaled)", ylabel="closeness to the laptop (scaled)")
    plane.set_title("Grey: density of the alternatives", fontsize=10)
    for place, (name, model) in enumerate({BOLTZMANN: Boltzmann(), LESS_NAME: LESS(bandwidth=KERNEL)}.items()):
        around = float(np.exp(log_probabilities(model, WAYS, theta=[0.0, 0.0])[PAST:]).sum())
        shown = bars.bar(
            [place - 0.2, place + 0.2], [1 - around, around], 0.38, color=_rgb(MODELS[name]), edgecolor="black"
        )
        shown[1].set_hatch("//")
        for bar, word in zip(shown, ("past", "around"), strict=True):
            bars.annotate(f"{word}\n{bar.get_height():.2f}", (bar.get_x() + 0.19, bar.get_height() + 0.02), ha="center")
    bars.set(xticks=[0, 1], xticklabels=["Boltzmann counts ways", "LESS counts different ways"], ylim=(0, 0.95))
    bars.set_title("What a person does who cares about neither", fontsize=10)
    bars.set_ylabel("probability")
    figure.savefig(picture, dpi=110)
    plt.close(figure)


def _rgb(color: RGB) -> tuple[float, ...]:
    return tuple(channel / 255 for channel in color)


def _take_report(picture: Path) -> None:
    """Write what a browser shows of the report's beginning."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        raise RuntimeError("there is no Chromium")
    quiet = ("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking")
    with tempfile.TemporaryDirectory() as profile:
        shown = [
            f"--user-data-dir={profile}",
            "--hide-scrollbars",
            f"--window-size={REPORT_SIZE}",
            f"--screenshot={picture}",
        ]
        address = (ROOT / "datasets" / "report.html").as_uri()
        done = subprocess.run([browser, *quiet, *shown, address], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr.strip()[-300:])
    with Image.open(picture) as page:
        page.convert("RGB").quantize(128, dither=Image.Dither.NONE).save(picture, optimize=True)


if __name__ == "__main__":
    main()
