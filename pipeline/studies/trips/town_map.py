"""A map of the network from turn angles and travel times, as the data have no coordinates.

The heading of each link follows from the turn angles: it is the leading eigenvector of the turns written as complex
numbers. The ends of the links follow by least squares, if each link is as long as it takes time, and short links count
more. A link begins in the middle of the ends of those that lead to it. So the map is true in its angles, and stretched
where one drives slowly.

Source: Singer (2011), Angular synchronization by eigenvectors and semidefinite programming.
"""

from __future__ import annotations

import numpy as np
import polars as pl
from scipy import sparse
from scipy.sparse import linalg

SHORTEST_MIN = 0.05  # of a link's time in the weights


def town_map(network: pl.DataFrame) -> pl.DataFrame:
    """Where each link begins and ends, in minutes of driving, for the rows of the table trips_network."""
    steps = network.filter(link=1).sort("from_link", "to_link")
    links = np.unique(np.concatenate([steps["from_link"].to_numpy(), steps["to_link"].to_numpy()]))
    left, entered = (np.searchsorted(links, steps[name].to_numpy()) for name in ("from_link", "to_link"))
    time, count = steps["travel_time"].to_numpy(), len(links)
    turns = sparse.csr_array((np.exp(-1j * steps["turn_angle"].to_numpy()), (entered, left)), shape=(count, count))
    both_ways = turns + turns.conj().T
    scale = sparse.diags_array(1 / np.sqrt(np.asarray(abs(both_ways).sum(axis=1)).ravel()))
    _, vectors = linalg.eigsh(scale @ both_ways @ scale, k=1, which="LA", v0=np.ones(count, dtype=complex))
    heading = vectors[:, 0] / vectors[0, 0]
    heading /= np.abs(heading)
    rows = np.arange(len(left))
    signs = np.concatenate([np.ones(len(left)), -np.ones(len(left))])
    weights = sparse.diags_array(1 / np.maximum(time, SHORTEST_MIN))
    differences = weights @ sparse.csr_array(
        (signs, (np.concatenate([rows, rows]), np.concatenate([entered, left]))), shape=(len(left), count)
    )
    wanted = weights @ (time * heading[entered])
    x, y = (linalg.lsqr(differences, part, atol=1e-8, btol=1e-8)[0] for part in (wanted.real, wanted.imag))
    ends = x + 1j * y
    before = np.bincount(entered, minlength=count)
    with np.errstate(invalid="ignore"):  # a link that none leads to has no such middle
        begin = (np.bincount(entered, x[left], count) + 1j * np.bincount(entered, y[left], count)) / before
    begin = np.where(before > 0, begin, ends - heading * time.mean())
    return pl.DataFrame(
        {"link": links, "start_x": begin.real, "start_y": begin.imag, "end_x": x, "end_y": y}
    ).with_columns(pl.exclude("link").round(4) + 0.0)
