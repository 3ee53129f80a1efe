"""A group of commands that takes anything else for the argument of its first command."""

from typing import Any

from typer.core import TyperGroup

DEFAULT = "record"


class RecordFirst(TyperGroup):
    """`orbitfb diagnose FILE` is `orbitfb diagnose record FILE`; a file named plan is ./plan."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the name of the first command before what is no command."""
        if args and args[0] not in self.commands and args[0] not in ctx.help_option_names:
            args = [DEFAULT, *args]
        return super().parse_args(ctx, args)
