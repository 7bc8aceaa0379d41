"""A task's recording, served to viewers on this machine once its stage has saved it."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

from pipeline.stages.inspect import inspection
from pipeline.stages.inspect_studies import study_tables
from pipeline.terminal import say
from pipeline.views.rerun.layout import layout
from pipeline.views.rerun.recording import log_inspection
from pipeline.views.rerun.server import LOOPBACK, PORT, Address, claim, open_beside, served
from pipeline.views.rerun.studies import log_studies, studies_layout
from pipeline.vocabulary import STUDIES
from pipeline.workspace.project import Project
from pipeline.workspace.scenes import load_task_scene


@dataclass(frozen=True)
class Live:
    """How a recording is served.

    Attributes:
        bind: an IP address of this machine.
        port: 0 for any that is free.
        stay: whether to serve until interrupted; None means on a terminal, where somebody can interrupt.
    """

    bind: str = LOOPBACK
    port: int = PORT
    stay: bool | None = None

    @property
    def stays(self) -> bool:
        """Whether to serve until interrupted."""
        return sys.stdout.isatty() if self.stay is None else self.stay


def claimed(live: Live) -> Address:
    """The address, asked for before any work is done, with a warning if others than this machine can reach it.

    Raises:
        StageError: it cannot be had.
    """
    address = claim(live.bind, live.port)
    if not address.local:
        say(
            f"warning: {address.bind} can be reached from other machines, and whoever reaches it can see the recording "
            f"and send data into it; {LOOPBACK} is for this machine only",
            error=True,
        )
    return address


def run_and_serve(project: Project, name: str, live: Live, *stages: Callable[[Project, str], None]) -> None:
    """Run stages of a task, or of the studies, then serve the recording.

    Raises:
        StageError: the address cannot be had; nothing is run then.
    """
    if name != STUDIES:
        project.params.task(name)
    address = claimed(live)
    for stage in stages:
        stage(project, name)
    serve(project, name, address, stay=live.stays)


def serve(project: Project, name: str, address: Address, *, stay: bool) -> None:
    """Serve the recording of a task, or of the studies, from its tables.

    Raises:
        StageError: the address cannot be served.
        TableError: a table is missing or not what it should be.
    """
    if name == STUDIES:
        tables = study_tables(project)
        views, log = studies_layout(tables), partial(log_studies, tables=tables)
    else:
        task = project.params.task(name)
        shown = inspection(project, name, task, load_task_scene(project, task))
        views, log = layout(shown), partial(log_inspection, inspection=shown)
    with interrupted() as stop, served(name, views, address) as recording:
        log(recording)
        recording.flush(timeout_sec=30)
        announce(address, f"the recording of {name}", stay=stay)
        if stay:
            stop.wait()


def announce(address: Address, what: str, *, stay: bool) -> None:
    """Say where viewers connect, and open one if there is a display and somebody to look at it."""
    say(f"serving {what} at {address.uri}")
    say("every user of this machine can look at it and write into it, as Rerun asks nobody who they are")
    without = open_beside(address) if stay else "nobody is at a terminal here"
    if without is None:
        say("opened in the Rerun viewer; Ctrl-C ends serving")
        return
    say(f"no viewer was opened: {without}; connect one with: rerun {address.uri}")
    if stay:
        say(
            f"from another machine first: ssh -L {address.port}:{address.bind}:{address.port} this-machine; Ctrl-C "
            "ends serving"
        )
    else:
        say("ending now; --stay keeps serving")


@contextmanager
def interrupted() -> Iterator[threading.Event]:
    """An event that Ctrl-C or SIGTERM sets, instead of ending the program, until the block is left."""
    stop = threading.Event()
    before = {number: signal.signal(number, lambda *_: stop.set()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
