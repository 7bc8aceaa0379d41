"""Progress and a last line on a terminal, silence in a pipe or when the user wants quiet."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, TypeVar

from pipeline.terminal import cell, plain, quiet

if TYPE_CHECKING:
    from rich.progress import Progress

Item = TypeVar("Item")


def tracked(items: Sequence[Item], what: str) -> Iterable[Item]:
    """The items, with a bar on standard error that shows rate and time left while they are gone through."""
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal or quiet.get():
        yield from items
        return
    with _bar() as progress:
        yield from progress.track(items, description=plain(what))


def say_done(what: str, produced: str, seconds: float) -> None:
    """What stays on a terminal when a stage is through."""
    from rich.console import Console
    from rich.text import Text

    console = Console(stderr=True)
    if console.is_terminal and not quiet.get():
        console.print(Text.assemble(cell(what, "bold green"), cell(f": {produced}, took {seconds:.1f} s")))


def _bar() -> Progress:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn
    from rich.progress import TimeRemainingColumn as TimeLeft
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Task) -> Text:
            speed = task.finished_speed or task.speed
            return Text("" if not speed else f"{speed:.1f}/s" if speed >= 1 else f"{1 / speed:.1f} s each")

    return Progress(
        TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), Rate(), TimeLeft(),
        TextColumn("left"),
        console=Console(stderr=True), transient=True,
    )  # fmt: skip
