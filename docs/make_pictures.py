"""Bring the figures that the pages show to the resolution of a screen.

    python docs/make_pictures.py

reads what `dvc repro` drew into datasets/*/figures and writes docs/pictures.
"""

from __future__ import annotations

from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
PICTURES = {
    "human_choice.png": "studies/figures/human_choice.png",
    "grid_world_true_posterior.png": "studies/figures/grid_world_true_posterior.png",
    "grid_world_overall.png": "studies/figures/grid_world_overall.png",
    "grid_world_sets.png": "studies/figures/grid_world_sets.png",
    "grid_world_density.png": "studies/figures/grid_world_density.png",
    "table_held_out.png": "table/figures/held_out.png",
} | {
    f"{task}_{name}.png": f"{task}/figures/{name}.png"
    for task in ("table", "laptop", "human")
    for name in ("robustness", "two_posteriors", "accuracy", "importance", "duplicates", "sensitivity")
}


def main() -> None:
    """Write every picture at half the resolution of print, 150 dpi."""
    for name, source in PICTURES.items():
        with Image.open(ROOT / "datasets" / source) as figure:
            figure.convert("RGB").reduce(2).save(ROOT / "docs" / "pictures" / name, optimize=True)


if __name__ == "__main__":
    main()
