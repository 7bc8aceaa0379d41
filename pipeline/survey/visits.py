"""One visit after another: what a participant is shown next, and what is kept of what they send.

Everything that is sent is untrusted. A participant is a code, from the address that a recruiting service links to, or
drawn by the page. Sending the same choice again changes nothing, so reloading and going back lose and double nothing.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime

from pipeline.survey.assignment import Assignment, next_assignment, order
from pipeline.survey.choices_file import ChoicesFile
from pipeline.survey.questionnaire import TURNED, Questionnaire, Trial

CODE = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
MOST_PARTICIPANTS = 100_000
LONGEST_S, LARGEST_SCREEN = 86_400.0, 100_000


class RefusedError(Exception):
    """Something that was sent is not accepted; the message is for whoever sent it."""


@dataclass(frozen=True)
class Visits:
    """The people who take part.

    Attributes:
        questionnaire: what is asked.
        file: what has been chosen, and who was shown what.
        clip: the drawing of an option of a task's trial, by trial and option.
        now: the time, for the file.
    """

    questionnaire: Questionnaire
    file: ChoicesFile
    clip: Callable[[str, str], object]
    now: Callable[[], datetime] = lambda: datetime.now(UTC)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def enter(self, sent: object) -> dict[str, object]:
        """What a participant is to do next; a new one is assigned their trials."""
        code = _text(_fields(sent, {"code"}), "code")
        if not CODE.fullmatch(code):
            raise RefusedError("code has 1 to 64 letters, digits, - and _, and begins with a letter or a digit")
        with self.lock:
            if code not in self.file.assigned:
                if len(self.file.assigned) >= MOST_PARTICIPANTS:
                    raise RefusedError("this study has as many participants as it can have")
                settings = self.questionnaire
                given = next_assignment(
                    self.file.assigned.values(), list(settings.trials), show_all=settings.show == "all",
                    mirror=settings.mirror,
                )  # fmt: skip
                self.file.assign(code, given)
            return self._next(code)

    def choose(self, sent: object) -> dict[str, object]:
        """Keep a choice, and what is to do next."""
        fields = _fields(sent, {"code", "trial", "option", "seconds", "screen"})
        code, trial, option = (_text(fields, name) for name in ("code", "trial", "option"))
        seconds = _number(fields["seconds"], "seconds", LONGEST_S)
        screen = fields["screen"]
        if not isinstance(screen, list) or len(screen) != 2:
            raise RefusedError("screen is [width, height]")
        width, height = (int(_number(side, "screen", LARGEST_SCREEN)) for side in screen)
        with self.lock:
            given = self.file.assigned.get(code)
            if given is None:
                raise RefusedError("this code is not known; begin at the first page")
            offered = self._offered(given, trial)
            if option not in offered:
                raise RefusedError("this option is not on offer")
            if trial not in self.file.chosen.get(code, {}) and trial != self._due(code, given):
                raise RefusedError("another question is due")
            chosen = self.questionnaire.trials[trial].options[option]
            row = {
                "participant": code, "trial": trial, "choice": option, "group": chosen.group or option,
                "counted": "no" if chosen.attention else "yes", "offered": self._in_file(trial, offered),
                "mirrored": "yes" if given.mirrored else "no", "chosen_at": f"{self.now():%Y-%m-%dT%H:%M:%SZ}",
                "seconds": f"{seconds:.3f}", "screen_width": width, "screen_height": height,
            }  # fmt: skip
            self.file.choose(row)
            return self._next(code)

    def _next(self, code: str) -> dict[str, object]:
        given = self.file.assigned[code]
        due = self._due(code, given)
        if due is None:
            return {"code": code, "done": True}
        trial = self.questionnaire.trials[due]
        return {
            "code": code, "done": False, "trial": due, "number": given.trials.index(due) + 1, "of": len(given.trials),
            "grid": self._grid(trial, given.mirrored),
            "options": [self._drawn(due, trial, name, given.mirrored) for name in self._offered(given, due)],
        }  # fmt: skip

    def _due(self, code: str, given: Assignment) -> str | None:
        answered = self.file.chosen.get(code, {})
        return next((name for name in given.trials if name not in answered and name in self.questionnaire.trials), None)

    def _offered(self, given: Assignment, trial: str) -> list[str]:
        if trial not in given.trials or trial not in self.questionnaire.trials:
            raise RefusedError("this question was not asked")
        return order(list(self.questionnaire.trials[trial].options), given.turn)

    def _in_file(self, trial: str, offered: list[str]) -> str:
        """Each option with its group, in the order shown; without one where its choice does not count."""
        options = self.questionnaire.trials[trial].options
        return " ".join(f"{name}={'' if options[name].attention else options[name].group or name}" for name in offered)

    def _grid(self, trial: Trial, mirrored: bool) -> object:
        if trial.grid is None:
            return None
        return (trial.grid.mirrored() if mirrored else trial.grid).model_dump()

    def _drawn(self, due: str, trial: Trial, name: str, mirrored: bool) -> dict[str, object]:
        moves = trial.options[name].moves
        if moves is None:
            return {"name": name, "clip": self.clip(due, name)}
        return {"name": name, "moves": moves.translate(TURNED) if mirrored else moves}


def _fields(sent: object, names: set[str]) -> Mapping[str, object]:
    if not isinstance(sent, dict) or set(sent) != names:
        raise RefusedError(f"what is sent has {', '.join(sorted(names))}, and nothing else")
    return sent


def _text(fields: Mapping[str, object], name: str) -> str:
    value = fields[name]
    if not isinstance(value, str) or len(value) > 200:
        raise RefusedError(f"{name} is a short text")
    return value


def _number(value: object, name: str, most: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= most:
        raise RefusedError(f"{name} is a number from 0 to {most:g}")
    return float(value)
