"""`lessbench`: run a stage for a task, look at what came out, ask it questions."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from pipeline.cli import imports, results, setup, shared, stages
from pipeline.errors import WorkbenchError

app = typer.Typer(
    name="lessbench",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="What did this person want, and how sure can we be? Inference from demonstrations under competing models of "
    "choice.\n\n`dvc repro` runs all stages that are out of date; the commands below run one stage, or look at results.\n\n"
    "Example: `lessbench sql`, for a prompt that answers questions; `lessbench infer --help` explains a command; "
    "`lessbench --install-completion` makes Tab complete commands and tasks.",
)
app.add_typer(stages.commands)
app.add_typer(results.commands)
app.add_typer(setup.commands)
app.add_typer(imports.commands, name="import", rich_help_panel=shared.SETUP)


@app.callback()
def options(
    overlay: Annotated[
        Path | None, typer.Option(metavar="FILE", help="YAML with the parameters that are different from params.yaml.")
    ] = None,
) -> None:
    """Keep what is said before the command."""
    shared.overlay.set(overlay)


def main() -> None:
    """Run the command line; a user's mistake ends in one sentence and exit status 1."""
    try:
        app()
    except WorkbenchError as error:
        print(f"lessbench: {error}", file=sys.stderr)  # noqa: T201
        sys.exit(1)
    except BrokenPipeError:
        sys.exit(1)
    except OSError as error:
        if error.filename is None:
            raise
        print(f"lessbench: {error.filename}: {(error.strerror or str(error)).lower()}", file=sys.stderr)  # noqa: T201
        sys.exit(1)
