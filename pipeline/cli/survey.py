"""Commands for a browser study of choices."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pipeline.cli.grouping import Commands, ExplainedGroup
from pipeline.cli.shared import tasks, this_project

commands = Commands(cls=ExplainedGroup, invoke_without_command=True)


@commands.callback()
def survey(
    context: typer.Context,
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
        typer.Option(
            metavar="ADDRESS", help="Address to serve on. Any other than the default lets other machines reach it."
        ),
    ] = "127.0.0.1",
) -> None:
    """Serve a browser study that collects choices, until Ctrl-C; design one; weigh models by its choices.

    Example: `lessbench survey`, then `lessbench study human-choice --choices choices.csv`.
    """
    if context.invoked_subcommand is not None:
        return
    from pipeline.commands.survey import serve_survey

    serve_survey(study, choices, words, bind, port)


@commands.command("design")
def survey_design(
    task: Annotated[
        str | None,
        typer.Argument(
            metavar="[TASK]", help="A task of params.yaml; without one, paths in a grid.", autocompletion=tasks
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="YAML file to write the study into. It must not exist yet.")
    ] = Path("study.yaml"),
    options: Annotated[int, typer.Option(min=2, max=12, help="How many options each person chooses from.")] = 4,
    trials: Annotated[
        int, typer.Option(min=1, max=12, help="With TASK: how many sets each person is asked about.")
    ] = 4,
    candidates: Annotated[int, typer.Option(min=1, max=20_000, help="With TASK: how many sets to pick from.")] = 500,
    theta_share: Annotated[
        float,
        typer.Option(
            min=0.0, max=1.0, help="With TASK: weight of information about theta; the rest is about the model."
        ),
    ] = 0.0,
) -> None:
    """Pick the sets on which the models disagree most, and say how many people would decide between them.

    Examples: `lessbench survey design table --out table.yaml`, `lessbench survey design --options 6`
    """
    from pipeline.commands.survey_design import design_grid, design_task

    if task is None:
        design_grid(this_project(), options=options, out=out)
    else:
        design_task(
            this_project(), task, trials=trials, options=options, candidates=candidates, theta_share=theta_share,
            out=out,
        )  # fmt: skip


@commands.command("weigh")
def survey_weigh(
    study: Annotated[Path, typer.Argument(metavar="STUDY", help="YAML file of a study of a task's motions.")],
    choices: Annotated[Path, typer.Argument(metavar="CHOICES", help="CSV file that `lessbench survey` wrote.")],
) -> None:
    """Say how probable each model is, given people's choices among motions of a task.

    Example: `lessbench survey weigh table.yaml choices.csv`
    """
    from pipeline.commands.survey_design import weigh

    weigh(this_project(), study, choices)
