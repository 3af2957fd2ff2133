"""Make a page for every command, from its own help."""

import click

from etendue.cli.program import main
from making.markdown import paragraphs, shown, table, toctree


def pages() -> dict[str, str]:
    """Return pages by name: ``commands/index`` and one for each command."""
    above = click.Context(main, info_name="etendue")
    names = main.list_commands(None)
    made = {f"commands/{name}": _page(name, main.get_command(None, name), above) for name in names}
    rows = [(f"[{name}]({name}.md)", shown(main.get_command(None, name).get_short_help_str(200))) for name in names]
    made["commands/index"] = "\n\n".join(
        ["# Commands", paragraphs(main.help or ""), table(("command", ""), rows), toctree(names, ":hidden:")]
    )
    return made


def _page(name: str, command: click.Command, above: click.Context) -> str:
    context = click.Context(command, info_name=name, parent=above)
    usage = " ".join([context.command_path, *command.collect_usage_pieces(context)])
    records = [p.get_help_record(context) for p in command.get_params(context) if isinstance(p, click.Option)]
    rows = [(f"`{names}`", shown(text)) for names, text in filter(None, records)]
    return "\n\n".join(
        [f"# etendue {name}", f"```text\n{usage}\n```", paragraphs(command.help or ""), table(("option", ""), rows)]
    )
