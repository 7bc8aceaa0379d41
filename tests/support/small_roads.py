"""A small network with a cycle and trips in it, as the four files that `lessbench import trips` reads."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.formats.trips.importer import ANGLES, STEPS, TIMES, TRIPS
from pipeline.trajectories.network_walks import END, Network

MOVES = [(1, 2), (1, 3), (2, 3), (2, 4), (3, 2), (3, 4), (3, 5), (4, 5), (4, 6)]
TIMES_MIN = [1.0, 1.5, 0.5, 1.0, 0.5, 0.3, 0.0, 0.0, 0.0]
ANGLES_RAD = [-1.0, 0.5, 3.14159, 0.2, 3.14159, -1.2, 0.0, 0.0, 0.0]


def write_small_roads(folder: Path, trips: int = 40) -> Path:
    """Write the files; half of the trips go to 5 and half to 6."""
    folder.mkdir(exist_ok=True)
    _write(folder / STEPS, [(*move, 1) for move in MOVES])
    _write(folder / TIMES, [(*move, time) for move, time in zip(MOVES, TIMES_MIN, strict=True) if time])
    _write(folder / ANGLES, [(*move, angle) for move, angle in zip(MOVES, ANGLES_RAD, strict=True) if angle])
    network = Network(*np.array(MOVES).T)
    rng, rows = np.random.default_rng(2), list[tuple[int, int, float]]()
    for trip in range(1, trips + 1):
        end = 5 + trip % 2
        log_p = network.log_step_probabilities(np.array(TIMES_MIN), end, 1.0)
        steps = network.walk(log_p, np.array([1]), end, rng).steps[0]
        path = [1, *(MOVES[step][1] for step in steps[steps != END])]
        rows += [(trip, place, link) for place, link in enumerate([end, *path], start=1)]
    _write(folder / TRIPS, rows)
    return folder


def _write(file: Path, rows: list[tuple[int, int, float]]) -> None:
    file.write_text("".join(f"   {row:.7e}   {column:.7e}   {value:.16e}\n" for row, column, value in rows))
