"""Verdicts on simulated set-ups against their truth: `python -m benchmarks.verdicts [SEEDS] [FIRST] [KINDS]`.

SEEDS set-ups of each kind are made, 10 unless told, from the seeds FIRST and up. KINDS is what a kind's name begins
with, such as explored; without it, all kinds are judged.
"""

from __future__ import annotations

import sys
from collections import Counter

import numpy as np

from benchmarks.explained import explain
from benchmarks.measuring import show, timed
from pipeline.answers.assessment import assess
from pipeline.answers.simulated_setups import KINDS, make
from pipeline.answers.verdict import Trust


def main() -> None:
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    first = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    wanted = sys.argv[3] if len(sys.argv) > 3 else ""
    rows, total, reasons, took = [], Counter[tuple[Trust, bool]](), Counter[str](), 0.0
    for kind in (kind for kind in KINDS if kind.startswith(wanted)):
        found: Counter[tuple[Trust, bool]] = Counter()
        for seed in range(first, first + seeds):
            setup = make(kind, seed)
            seconds, answer = timed(assess, np.random.default_rng([seed, 1]), setup.case)
            verdict, missed = answer.verdict, setup.missed(answer)
            found[verdict.trust, missed] += 1
            took += seconds
            if kind.startswith("sound"):
                reasons.update(line.name for line in verdict.reasons)
            if verdict.trust is Trust.TRUST and missed:
                print("TRUSTED AND MISSED", kind, seed, answer.numbers)
        total += found
        rows.append((kind, *(cell(found, trust) for trust in Trust)))
    rows.append(("all", *(cell(total, trust) for trust in Trust)))
    columns = ("set-up", *(f"{trust.value} (missed)" for trust in Trust))
    show(f"{total.total()} simulated set-ups, {took / total.total():.1f} s each", columns, rows)
    print("kept sound set-ups from trust:", dict(reasons.most_common()))


def cell(found: Counter[tuple[Trust, bool]], trust: Trust) -> str:
    return f"{found[trust, False] + found[trust, True]} ({found[trust, True]})"


if __name__ == "__main__":
    explain(__doc__)
    main()
