"""Simulation-based calibration in full, and what n demonstrations tell: `python -m benchmarks.calibration
[REPETITIONS]`.
"""

from __future__ import annotations

import sys

import numpy as np

from benchmarks.explained import explain
from benchmarks.measuring import clustered, show, timed
from pipeline.answers.calibration import calibrate
from pipeline.answers.flatness import flatness
from pipeline.answers.group_calibration import calibrate_group
from pipeline.choice import LESS, Boltzmann

MODELS = {"boltzmann": Boltzmann(), "less": LESS(0.1)}


def main() -> None:
    repetitions = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    rows = clustered(150)
    flat, told = [], []
    for n in (1, 3, 12):
        took, found = timed(calibrate, np.random.default_rng(n), MODELS, rows, n, repetitions)
        for label, other in (("boltzmann", "less"), ("less", "boltzmann")):
            own, between = found.recoveries[label, label], found.comparison(label, other)
            for name, places in (
                ("each weight", own.place.T), ("beta", [own.beta_place]), ("direction", [own.direction_place]),
            ):  # fmt: skip
                flat.append(_row(f"{label}, {n} demonstrations", name, places, own.pareto_k))
            told.append(
                (
                    label, str(n), f"{between.favoured:.2f}", f"{between.told():.2f}", f"{between.misled():.3f}",
                    f"{np.nanmean(between.held_out) if n > 1 else np.nan:+.3f}",
                    f"{np.degrees(np.median(own.angle)):.0f}",
                    f"{np.degrees(np.median(own.cap)):.0f}", f"{own.coverage():.2f}",
                    f"{found.recoveries[label, other].coverage():.2f}", f"{took / repetitions / 4 * 1e3:.0f} ms",
                )
            )  # fmt: skip
    for label, model in MODELS.items():
        group = calibrate_group(np.random.default_rng(0), model, rows[:80], 6, 2, repetitions // 3)
        for name, places in (
            ("the group's weights", group.group_place.T), ("spread", [group.spread_place]),
            ("each person's weights", group.person_place.reshape(len(group.person_place), -1).T),
            ("someone new", group.next_place.T),
        ):  # fmt: skip
            flat.append(_row(f"group of 6, {label}", name, places, group.pareto_k))
    show(
        "Places of the truth in its posterior, ten bins each",
        ("inference", "of", "histograms flat", "least p", "k > 0.7"),
        flat,
    )
    columns = (
        "chosen by", "n", "right model favoured", "by 10 to 1", "misled 10 to 1", "held-out lead", "angle (deg)",
        "said 0.9 (deg)",
        "coverage of 0.9", "by the wrong model", "an inference",
    )  # fmt: skip
    show(f"What n demonstrations tell, {repetitions} repetitions", columns, told)


def _row(inference: str, name: str, places, k: np.ndarray) -> tuple[str, ...]:
    found = [flatness(column) for column in places]
    flat = sum(one.flat for one in found)
    return (
        inference,
        name,
        f"{flat} of {len(found)}",
        f"{min(one.p_value for one in found):.3f}",
        f"{(k > 0.7).mean():.2f}",
    )


if __name__ == "__main__":
    explain(__doc__)
    main()
