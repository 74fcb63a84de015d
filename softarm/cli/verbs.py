"""Click group that suggests the nearest name for a misspelt verb."""

import click

from softarm.common.words import nearest


class Verbs(click.Group):
    """Group of verbs below a verb."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the verb, or suggest the nearest name."""
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError:
            near = nearest(args[0], self.list_commands(ctx))
            hint = f"did you mean '{near}'?" if near else f"`{ctx.command_path} --help` lists the verbs."
            raise click.UsageError(f"no verb '{args[0]}'; {hint}", ctx) from None
