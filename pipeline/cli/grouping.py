"""How commands are grouped and explained: by what a person wants, with `-h`, and without a type beside a switch."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import typer
from typer._click import Context, Parameter
from typer.core import TyperCommand, TyperGroup, TyperOption

# what a person wants, in the order in which `lessbench --help` lists it
BRING, COMPUTE, LOOK, ASK = "Bring your own", "Compute", "Look at results", "Ask"
TRUST, STAGES = "Trust", "Single stages (`dvc repro` runs those that are out of date)"
PANELS = (BRING, COMPUTE, LOOK, ASK, TRUST, STAGES)
HELP_NAMES = ["-h", "--help"]
Function = TypeVar("Function", bound=Callable[..., Any])


class _Explained(TyperCommand):
    """A command whose switches are listed without the word `<bool>`."""

    def get_params(self, ctx: Context) -> list[Parameter]:
        return _without_types(super().get_params(ctx))

    def get_help_option_names(self, ctx: Context) -> list[str]:
        return _in_order(super().get_help_option_names(ctx))


class ExplainedGroup(TyperGroup):
    """The same for a group of commands."""

    def get_params(self, ctx: Context) -> list[Parameter]:
        return _without_types(super().get_params(ctx))

    def get_help_option_names(self, ctx: Context) -> list[str]:
        return _in_order(super().get_help_option_names(ctx))

    def list_commands(self, ctx: Context) -> list[str]:
        def panel(name: str) -> int:
            group = getattr(self.commands[name], "rich_help_panel", None)
            return PANELS.index(group) if group in PANELS else len(PANELS)

        return sorted(super().list_commands(ctx), key=panel)


class Commands(typer.Typer):
    """Commands that are explained alike."""

    def command(self, name: str | None = None, **settings: Any) -> Callable[[Function], Function]:
        """As `typer.Typer.command`."""
        return super().command(name, **({"cls": _Explained} | settings))


def _without_types(parameters: list[Parameter]) -> list[Parameter]:
    for parameter in parameters:
        if isinstance(parameter, TyperOption) and parameter.is_flag:
            parameter.metavar = ""
    return parameters


def _in_order(names: list[str]) -> list[str]:
    """The library gives them in the order of a set, which is another one in every run."""
    return sorted(names, key=len)
