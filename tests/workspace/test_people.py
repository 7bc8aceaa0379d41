"""Names of one person."""

from __future__ import annotations

import pytest

from pipeline.workspace.people import identity, one_spelling


@pytest.mark.parametrize("other", ["Zoë K", "zoë k", " Zoë  K ", "Zoe\u0308 K", "ＺＯＥ\u0308 Ｋ", "Zoë\u00a0K"])
def test_unicode_form_case_and_blanks_do_not_make_another_person(other: str) -> None:
    assert identity(other) == identity("Zoë K")


def test_other_letters_do() -> None:
    assert identity("Zoe K") != identity("Zoë K")
    assert identity("ID1") != identity("ID01")


def test_the_most_frequent_spelling_is_taken_whatever_the_order() -> None:
    names = ["Ann", "ann", "ann", "Bo", "BO "]
    assert one_spelling(names) == ["ann", "ann", "ann", "BO ", "BO "]
    assert one_spelling(names[::-1]) == one_spelling(names)[::-1]
