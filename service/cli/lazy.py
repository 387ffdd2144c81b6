"""Commands that are imported when they are called, so that a help text or a completion costs no mathematics."""

from collections.abc import Iterator, Mapping
from importlib.metadata import EntryPoint
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from service import BadInput

Places = Mapping[str, str]
"""Where a command is, as ``module:function`` or ``module:Typer``, by its name: one word, or two for one in a group."""


class Commands(TyperGroup):
    """A group of commands. Two words together name a command as well, so `export` and `export sheet` both are."""

    def __init__(
        self,
        *,
        places: Places,
        groups: Mapping[str, str] | None = None,
        former: Mapping[str, str] | None = None,
        **settings: Any,
    ) -> None:
        """`groups`: what the commands of a group are for, by its word, of words that are no command themselves.

        `former`: the present names of commands by those that they had.
        """
        loaded: Any = _Loaded(places, groups or {})  # a mapping, of which TyperGroup only reads
        super().__init__(commands=loaded, no_args_is_help=True, rich_markup_mode=None, **settings)
        self._places, self.former = places, former or {}

    def list_commands(self, ctx: Any) -> list[str]:
        return list(self.commands)

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        two = " ".join(args[:2])
        if len(args) > 1 and two in self._places:
            return two, load(two, self._places[two]), args[2:]
        former = next((name for name in (two, args[0]) if name in self.former), None)
        if former is not None and not ctx.resilient_parsing:
            raise BadInput(former, f"is now `sweepid {self.former[former]}`")
        name, command, rest = super().resolve_command(ctx, args)
        if ctx.resilient_parsing and not rest and isinstance(command, _Command) and command.members is not None:
            return name, command.members, rest  # a shell asks what may follow: a member, or an option of the command
        return name, command, rest

    def every(self) -> Iterator[tuple[str, TyperCommand]]:
        """All commands by name, those of `typer.Typer` groups included."""
        for name, place in self._places.items():
            yield from _each(name, load(name, place))


class _Loaded(Mapping[str, TyperCommand | TyperGroup]):
    """Commands and groups by their first word, each imported when it is asked for."""

    def __init__(self, places: Places, groups: Mapping[str, str]) -> None:
        self._places, self._groups = places, groups
        self._words = tuple(dict.fromkeys(name.partition(" ")[0] for name in places))

    def __iter__(self) -> Iterator[str]:
        return iter(self._words)

    def __len__(self) -> int:
        return len(self._words)

    def __getitem__(self, word: str) -> TyperCommand | TyperGroup:
        members = {
            name.removeprefix(f"{word} "): at for name, at in self._places.items() if name.startswith(f"{word} ")
        }
        if word in self._places:
            command = load(word, self._places[word])
            if isinstance(command, _Command):
                options = [one for one in command.params if one.param_type_name == "option"]
                command.members = Commands(name=word, places=members, params=options) if members else None
            return command
        if not members:
            raise KeyError(word)
        return Commands(name=word, places=members, help=self._groups.get(word))


class _Command(TyperCommand):
    """A command; if it is also the first word of others, its help names them, and completions offer them."""

    members: Commands | None = None

    def format_options(self, ctx: Any, formatter: Any) -> None:
        super().format_options(ctx, formatter)
        if self.members is not None:
            self.members.format_commands(ctx, formatter)


def load(name: str, place: str) -> TyperCommand | TyperGroup:
    """Import the command at a place."""
    found: Any = EntryPoint(name, place, "").load()
    if isinstance(found, typer.Typer):
        application = found
    else:
        application = typer.Typer(add_completion=False, rich_markup_mode=None)
        application.command(name, cls=_Command)(found)
    command: Any = typer.main.get_command(application)
    command.name = name
    return command


def _each(name: str, command: TyperCommand | TyperGroup) -> Iterator[tuple[str, TyperCommand]]:
    if isinstance(command, TyperCommand):
        yield name, command
        return
    for word, member in command.commands.items():
        yield from _each(f"{name} {word}", member)  # pyright: ignore[reportArgumentType]
