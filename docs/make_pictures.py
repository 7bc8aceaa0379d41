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

from PIL import Image
from take_pictures import take_picture

from pipeline.commands.watch import Until, run
from pipeline.workspace.project import Project

ROOT = Path(__file__).resolve().parents[1]
PICTURES = {
    "human_choice.png": "studies/figures/human_choice.png",
    "grid_world_true_posterior.png": "studies/figures/grid_world_true_posterior.png",
    "grid_world_overall.png": "studies/figures/grid_world_overall.png",
    "grid_world_sets.png": "studies/figures/grid_world_sets.png",
    "grid_world_density.png": "studies/figures/grid_world_density.png",
    "table_held_out.png": "table/figures/held_out.png",
    "table_regions.png": "table/figures/regions.png",
    "table_ten_posteriors.png": "table/figures/ten_posteriors.png",
} | {
    f"{task}_{name}.png": f"{task}/figures/{name}.png"
    for task in ("table", "laptop", "human")
    for name in ("robustness", "two_posteriors", "accuracy", "importance", "duplicates", "sensitivity")
}


VIEWS = {  # and the second of the replay, where it is not the one that it opens with
    "table.png": ("table/inspect.rrd", 47.0),
    "studies.png": ("studies/inspect.rrd", None),
    "watch.png": ("table/watch/inspect.rrd", None),
}
WATCHED = 3  # recordings of the task `table`, for the picture of `lessbench watch`
REPORT, REPORT_SIZE = "report.png", "1100,1500"
TARGET = ROOT / "docs" / "pictures"


def main() -> None:
    """Write every picture that can be made here; exit status 1 if one could not."""
    for name, source in PICTURES.items():
        with Image.open(ROOT / "datasets" / source) as figure:
            figure.convert("RGB").reduce(2).save(TARGET / name, optimize=True)
    run(Project(ROOT), None, "table", Until(demonstrations=WATCHED), None)
    missing = []
    for name, (recording, time_s) in VIEWS.items():
        try:
            take_picture(ROOT / "datasets" / recording, TARGET / name, time_s)
        except RuntimeError as error:
            missing.append(f"{name}: {error}")
    try:
        _take_report(TARGET / REPORT)
    except RuntimeError as error:
        missing.append(f"{REPORT}: {error}")
    if missing:
        sys.exit("\n".join(missing))


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
