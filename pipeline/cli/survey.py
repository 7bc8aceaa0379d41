"""Commands for a browser study of choices."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pipeline.cli.grouping import ASK, Commands

commands = Commands()


@commands.command(rich_help_panel=ASK)
def survey(
    study: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="YAML file of the study. Default: that of section 3 of the paper."),
    ] = None,
    choices: Annotated[
        Path, typer.Option(metavar="FILE", help="CSV file that grows by a line for each choice.")
    ] = Path("choices.csv"),
    words: Annotated[
        str, typer.Option(metavar="LANGUAGE", help="en, de, or a YAML file with the words of the page.")
    ] = "en",
    port: Annotated[int, typer.Option(help="0 for any that is free.")] = 8080,
    bind: Annotated[
        str,
        typer.Option(metavar="ADDRESS", help="Address to serve on; one of the network lets other machines reach it."),
    ] = "127.0.0.1",
) -> None:
    """Serve a browser study that collects choices, until Ctrl-C.

    Example: `lessbench survey`, then `lessbench study human-choice --choices choices.csv`.
    """
    from pipeline.commands.survey import serve_survey

    serve_survey(study, choices, words, bind, port)
