import numpy as np
import pytest

from pipeline.errors import ArgumentError
from pipeline.trajectories.random_streams import child_rng


def test_a_stream_is_fixed_by_seed_and_labels() -> None:
    first = child_rng(7, "table", "deformation", 10, 3).random(5)
    assert np.array_equal(first, child_rng(7, "table", "deformation", 10, 3).random(5))
    # The stream is part of every stored result: this number may not change with a release.
    assert child_rng(0, "table", 10, 1).random() == 0.7558846727510414


def test_streams_of_different_labels_differ() -> None:
    labels = [(), ("a",), ("a", 1), ("a", "1"), ("a1",), ("a", 1, 0), (1, "a"), ("ab", "c"), ("a", "bc")]
    streams = [child_rng(seed, *names).integers(2**63) for seed in (0, 1) for names in labels]
    assert len(set(streams)) == len(streams)


def test_streams_of_neighbouring_sets_are_uncorrelated() -> None:
    draws = np.stack([child_rng(0, "table", i).standard_normal(4000) for i in range(20)])
    off_diagonal = np.corrcoef(draws)[np.triu_indices(20, 1)]
    assert np.abs(off_diagonal).max() < 4.5 / np.sqrt(4000)  # 190 pairs, P(beyond 4.5 sigma) = 0.001


@pytest.mark.parametrize(("seed", "label"), [(-1, "a"), (0, 1.5)])
def test_what_is_no_seed_or_label_is_refused(seed: int, label: object) -> None:
    with pytest.raises(ArgumentError, match="must be"):
        child_rng(seed, label)  # type: ignore[arg-type]
