"""No wrong number in silence: a corrupt recording gives the same demonstration, a remark, or a refusal."""

from __future__ import annotations

from functools import cache

import pytest

from tests.support.corruptions import CORRUPTIONS, DRAWS, Outcome, documented, draw, table


@cache
def outcome(number: int) -> Outcome:
    return draw(number)


def test_there_are_thirty_corruptions_or_more() -> None:
    assert len(CORRUPTIONS) >= 30


@pytest.mark.parametrize("name", CORRUPTIONS)
def test_nothing_is_silent(name: str) -> None:
    first = list(CORRUPTIONS).index(name)
    for number in range(first, DRAWS, len(CORRUPTIONS)):
        found = outcome(number)
        assert found.word != "silent", (number, found)
        if found.word != "same":
            assert found.details
            assert all(len(detail) > 20 for detail in found.details), found


def test_the_table_in_the_promises_is_what_comes_of_them() -> None:
    assert documented() == table([outcome(number) for number in range(DRAWS)])
