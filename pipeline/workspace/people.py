"""Which names mean the same person."""

from __future__ import annotations

import unicodedata
from collections import Counter
from collections.abc import Sequence


def identity(name: str) -> str:
    """What names of one person have in common: Unicode form, case and blanks do not count."""
    return " ".join(unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", name).casefold()).split())


def one_spelling(names: Sequence[str]) -> list[str]:
    """The names with one spelling for each person: the most frequent, of equally frequent ones the first in order."""
    counts: dict[str, Counter[str]] = {}
    for name in names:
        counts.setdefault(identity(name), Counter())[name] += 1
    chosen = {key: min(counted.items(), key=lambda one: (-one[1], one[0]))[0] for key, counted in counts.items()}
    return [chosen[identity(name)] for name in names]
