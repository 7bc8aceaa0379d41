from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from pipeline.choice import theta_grid
from pipeline.errors import ArgumentError

DOCS = Path(__file__).resolve().parents[2] / "docs"


def test_nineteen_cost_directions_of_three_features() -> None:
    thetas = theta_grid([[0, 0.5, 1]] * 3)
    assert thetas.shape == (19, 3)
    np.testing.assert_allclose(np.linalg.norm(thetas, axis=1), 1, rtol=1e-15)
    assert np.all(thetas <= 0)
    assert len(np.unique(thetas.round(9), axis=0)) == 19
    np.testing.assert_array_equal(thetas[0], [0, 0, -1])
    assert not np.signbit(thetas[0, 0])


@pytest.mark.parametrize("features", range(1, 9))
def test_the_default_grid_has_as_many_directions_as_the_docs_say(features: int) -> None:
    count = len(theta_grid([[0, 0.5, 1]] * features))
    assert count == 3**features - 2**features
    (listed,) = re.findall(r"That is ([\d, and]+) for one to eight features", (DOCS / "method.md").read_text())
    assert int(re.split(r", | and ", listed)[features - 1].replace(",", "")) == count
    for row in re.findall(r"(?m)^\| (\d) \| ([\d,]+) \| ([\d,]+) \| ", (DOCS / "scale.md").read_text()):
        number, thetas, rows = (int(cell.replace(",", "")) for cell in row)
        if number == features:
            assert thetas == count
            assert rows == count * 9 * 51 * 2 * 21  # betas, sets, models, 20 demonstrations and all together


def test_grid_world_directions_and_rewards() -> None:
    thetas = theta_grid([[-1, 0, 1]] * 2, sign=1)
    assert len(thetas) == 8
    np.testing.assert_allclose(thetas[0], [-math.sqrt(0.5)] * 2, rtol=1e-15)
    np.testing.assert_array_equal(theta_grid([[-1, 0, 1]] * 2), -thetas)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"per_feature_values": []}, "per_feature_values is empty"),
        ({"per_feature_values": [[0, 1], []]}, r"per_feature_values\[1\] has shape"),
        ({"per_feature_values": [[math.nan]]}, r"per_feature_values\[0\] contains nan"),
        ({"per_feature_values": [[0], [0]]}, "holds only zeros"),
        ({"per_feature_values": [[1]], "sign": 0}, "sign is 0"),
    ],
)
def test_refusals(arguments: dict, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        theta_grid(**arguments)
