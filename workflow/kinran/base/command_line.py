"""Command line of a stage, made from the types of its `main`.

A stage is ``main(inputs, out, options)``: frozen dataclasses of what it reads and how, and paths of what it writes.
A program calls it with values, and this module makes the same call from a command line. Each field or parameter is
annotated with its help: ``Annotated[Path, "label map (.exr)"]`` is ``--name``, and ``Annotated[Path, "OUT", "material
(.exr)"]`` is the positional argument ``OUT``; ``"--crop X,Y,W,H"`` in that place is an option whose value has a name.
A function among the annotations parses the value and raises `InputError` for a bad one. An option of several values
takes them after one ``--name``, or each after its own.
"""

import argparse
import dataclasses
import types
import typing
from collections.abc import Callable, Iterator
from inspect import signature
from typing import Annotated, Any, Literal

Main = Callable[..., None]
REQUIRED = object()
"""Default that marks an argument as required."""


@dataclasses.dataclass(frozen=True)
class Argument:
    """One argument of a stage.

    Attributes
    ----------
    name
        Name of the field or the parameter.
    kind
        Type of the value, without annotations.
    help
        Help text.
    word
        Word of the usage: ``OUT`` for a positional argument, ``--name VALUE`` or None for an option.
    parse
        Function from a word to the value; None for the type itself.
    default
        Default value; `REQUIRED` where the argument must be given.
    group
        Parameter of `main` that the field belongs to: it keeps a material of `inputs` apart from one of `out`.
    """

    name: str
    kind: Any
    help: str
    word: str | None = None
    parse: Callable[[str], Any] | None = None
    default: Any = REQUIRED
    group: str = ""

    @property
    def dest(self) -> str:
        """Name of the argument in the parsed namespace."""
        return f"{self.group}.{self.name}"

    def add_to(self, parser: argparse.ArgumentParser) -> None:
        """Add the argument to a parser."""
        kind, several = _element(self.kind)
        required = self.default is REQUIRED
        settings: dict[str, Any] = {"help": self.help.replace("%", "%%")}
        if kind is bool:
            settings["action"] = argparse.BooleanOptionalAction if self.default else "store_true"
        elif typing.get_origin(kind) is Literal:
            settings["choices"] = typing.get_args(kind)
            settings["type"] = type(typing.get_args(kind)[0])
        else:
            settings["type"] = self.parse or kind
        if several:
            settings["nargs"] = "+" if required else "*"
        if self.word is not None and not self.word.startswith("--"):
            if not required and not several:
                settings["nargs"] = "?"
            parser.add_argument(self.dest, metavar=self.word, **settings)
            return
        flag, _, value = (self.word or "--" + self.name.replace("_", "-")).partition(" ")
        if "type" in settings and "choices" not in settings:
            settings["metavar"] = value or self.name.upper()
        if several:
            settings["action"] = "extend"
        parser.add_argument(flag, dest=self.dest, required=required, default=None, **settings)

    def value(self, args: argparse.Namespace) -> Any:
        """Return the parsed value, a tuple where the argument takes several, or the default where none was given."""
        value = getattr(args, self.dest)
        if value is None or value == []:
            return None if self.default is REQUIRED else self.default
        return tuple(value) if isinstance(value, list) else value


def add_arguments(parser: argparse.ArgumentParser, main: Main) -> None:
    """Add the arguments of a stage's `main` to a parser, positional ones in the order of its parameters."""
    for _, _, arguments in _parameters(main):
        for argument in arguments:
            argument.add_to(parser)


def call(main: Main, args: argparse.Namespace) -> None:
    """Call a stage's `main` with the values that were parsed from its command line."""
    given = {}
    for name, group, arguments in _parameters(main):
        values = {argument.name: argument.value(args) for argument in arguments}
        given[name] = values[name] if group is None else group(**values)
    main(**given)


def _parameters(main: Main) -> Iterator[tuple[str, Any, list[Argument]]]:
    """Yield the name of each parameter of `main`, its dataclass (None if it has none), and its arguments."""
    hints = typing.get_type_hints(main, include_extras=True)
    for name, parameter in signature(main).parameters.items():
        hint = hints[name]
        if dataclasses.is_dataclass(hint):
            fields = typing.get_type_hints(hint, include_extras=True)
            yield name, hint, [_argument(f.name, fields[f.name], _default(f), name) for f in dataclasses.fields(hint)]
        else:
            default = REQUIRED if parameter.default is parameter.empty else parameter.default
            yield name, None, [_argument(name, hint, default)]


def _default(field: "dataclasses.Field[Any]") -> Any:
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return REQUIRED if field.default is dataclasses.MISSING else field.default


def _argument(name: str, hint: Any, default: Any, group: str = "") -> Argument:
    if typing.get_origin(hint) is not Annotated:
        raise TypeError(f"{name}: is not annotated with its help")
    kind, *notes = typing.get_args(hint)
    words = [note for note in notes if isinstance(note, str)]
    parse = next((note for note in notes if callable(note)), None)
    return Argument(name, kind, words[-1], words[0] if len(words) > 1 else None, parse, default, group)


def _element(kind: Any) -> tuple[Any, bool]:
    """Return the type of one value, and whether the argument takes several."""
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        (kind,) = (k for k in typing.get_args(kind) if k is not types.NoneType)
    if typing.get_origin(kind) is tuple and typing.get_args(kind)[-1] is Ellipsis:
        return typing.get_args(kind)[0], True
    return kind, False
