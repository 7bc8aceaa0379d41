"""`lessbench`: run a stage for a task, look at what came out, ask it questions."""

from __future__ import annotations

import os
import sys
import traceback
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer.exceptions import TyperException

from pipeline import terminal
from pipeline.cli import imports, results, setup, shared, stages, survey
from pipeline.cli.grouping import ASK, BRING, HELP_NAMES, ExplainedGroup
from pipeline.errors import OutputError, WorkbenchError
from pipeline.vocabulary import SCHEDULER

if TYPE_CHECKING:
    from types import TracebackType

app = typer.Typer(
    name="lessbench",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": HELP_NAMES},
    cls=ExplainedGroup,
    help="What did this person want, and how sure can we be? Inference from demonstrations under competing models of "
    "choice.\n\n`dvc repro` computes all that is out of date; the commands below bring data in, look at results and "
    "ask questions. `lessbench COMMAND -h` explains one.\n\nExit status: 0 done; 1 it could not be done, or what was "
    "checked is not sound, with one sentence why; 2 the command line is wrong.\n\n"
    "Example: `lessbench --install-completion` makes Tab complete commands and tasks.",
)
COMPUTING = {command.callback.__name__ for command in stages.commands.registered_commands if command.callback} | {
    "run", "verify", "watch"
}  # fmt: skip
app.add_typer(setup.commands)
app.add_typer(imports.commands, name="import", rich_help_panel=BRING)
app.add_typer(survey.commands, name="survey", rich_help_panel=ASK)
app.add_typer(results.commands)
app.add_typer(stages.commands)


def _say_version(asked: bool) -> None:
    if asked:
        terminal.say(f"lessbench {version('lessbench')}")
        raise typer.Exit


@app.callback()
def options(
    context: typer.Context,
    overlay: Annotated[
        Path | None, typer.Option(metavar="FILE", help="YAML with the parameters that are different from params.yaml.")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Compute on the Dask cluster of this scheduler, tcp://HOST:PORT or tls://HOST:PORT; whoever runs it "
            f"can run code here. For `dvc repro` set {SCHEDULER}.",
        ),
    ] = None,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Print no progress and no notes; answers and errors only.")
    ] = False,
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_say_version, is_eager=True)
    ] = False,
) -> None:
    """Keep what is said before the command."""
    shared.overlay.set(overlay)
    terminal.quiet.set(quiet)
    if scheduler is not None:
        os.environ[SCHEDULER] = scheduler
    if context.invoked_subcommand in COMPUTING:
        shared.require_memory()


def main() -> None:
    """Run the command line; a user's mistake ends in one sentence and exit status 1."""
    os.environ["PYTHONSAFEPATH"] = "1"  # Pythons that libraries start import nothing from the folder we stand in
    terminal.prepare()
    sys.excepthook = _say_traceback
    try:
        status = _run()
        terminal.finish()
    except BrokenPipeError:
        terminal.abandon()
        status = 1
    except OutputError as error:
        terminal.abandon()
        status = _fail(str(error))
    except WorkbenchError as error:
        status = _fail(str(error))
    except MemoryError:
        status = _fail(
            "there is too little memory; end other programs, or raise the limit (`ulimit -v`), and run it again"
        )
    except OSError as error:
        if error.filename is None:
            raise
        status = _fail(f"{error.filename}: {(error.strerror or str(error)).lower()}")
    sys.exit(status)


def _run() -> int:
    """Run what is asked for; the exit status."""
    try:
        status = typer.main.get_command(app).main(standalone_mode=False)
    except typer.Abort:
        return 1
    except TyperException as error:  # the command line is wrong
        from typer.rich_utils import rich_format_error

        error.message = terminal.plain(error.message)
        rich_format_error(error)  # type: ignore[arg-type]
        return error.exit_code
    return status if isinstance(status, int) else 0


def _fail(sentence: str) -> int:
    terminal.say(f"lessbench: {terminal.plain(sentence, terminal.LONGEST_MESSAGE)}", error=True)
    return 1


def _say_traceback(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Show a mistake of this program as Python does, without what a terminal would obey."""
    for line in "".join(traceback.format_exception(kind, error, trace)).splitlines():
        terminal.say(line, error=True)
