"""How much there is to learn: the commands and their options, which are not to grow."""

from tactable.cli.main import COMMANDS, load_command

MOST_COMMANDS, MOST_OPTIONS = 40, 280


def test_there_are_no_more_commands_and_options_than_a_person_can_learn() -> None:
    entries = [pair for sections in COMMANDS.values() for section in sections.values() for pair in section.items()]
    commands = [load_command(name, entry) for name, entry in entries if entry.target]
    options = [p for command in commands for p in command.params if p.param_type_name == "option" and p.name != "help"]
    assert len(commands) <= MOST_COMMANDS
    assert len(options) <= MOST_OPTIONS
