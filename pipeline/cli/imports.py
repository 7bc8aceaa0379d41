"""Commands that turn other people's files into recordings or tables."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pipeline.cli.grouping import Commands, ExplainedGroup
from pipeline.cli.shared import this_project
from pipeline.terminal import say

commands = Commands(cls=ExplainedGroup, no_args_is_help=True, help="Take in data that others publish.")


@commands.command("ferl")
def import_ferl(
    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="A pickle of the FERL or jaco_learning repository, or a folder.")
    ],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder that the recordings go into.")],
    joints: Annotated[
        str,
        typer.Option(help="What the columns are called, separated by commas: j2s7s300_joint_1,j2s7s300_joint_2,..."),
    ],
    topic: Annotated[str, typer.Option(help="Topic of the recordings.")] = "/joint_states",
    rate_hz: Annotated[float, typer.Option("--rate-hz", help="Nominal rate where the file has no times.")] = 10.0,
    names: Annotated[
        str, typer.Option(metavar="PATTERN", help="What the pickles of a folder are called.")
    ] = "demo_{participant}_{condition}.p",
) -> None:
    """Turn Python 2 pickles of joint arrays into recordings, one per demonstration. Nothing in them is executed.

    Of a folder, each condition gets a folder in OUT, with one recording for each participant.

    Example for the JACO 2: `lessbench import ferl FERL_demos.p mine --topic /j2s7s300_driver/out/joint_state
    --joints
    j2s7s300_joint_1,j2s7s300_joint_2,j2s7s300_joint_3,j2s7s300_joint_4,j2s7s300_joint_5,j2s7s300_joint_6,j2s7s300_joint_7`
    """
    from pipeline.formats.ferl.importer import import_ferl

    written = import_ferl(source, out, [name.strip() for name in joints.split(",")], topic, rate_hz, names)
    for path in written:
        say(str(path))


@commands.command("trips")
def import_trips(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder with the four files of the trips.")],
) -> None:
    """Read a road network and trips in it (sparse text matrices of RecursiveLogit.Classical.V2) into tables.

    Then `lessbench study trips` compares models of choice on them. Example: `lessbench import trips Input`
    """
    from pipeline.commands.import_trips import run

    run(this_project(), folder)
