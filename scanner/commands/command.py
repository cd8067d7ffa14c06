"""A command: a dataclass whose fields are its options, and whose docstring says what it does."""

from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator
from dataclasses import MISSING, Field, dataclass, field, fields
from importlib import import_module
from pathlib import Path
from types import ModuleType, NoneType
from typing import TYPE_CHECKING, Any, ClassVar, Self, get_args, get_type_hints

from scanner.errors import InputError
from scanner.viewing import DEFAULT_PORT, LOCAL

if TYPE_CHECKING:
    from scanner.configuration import Config

NO_FILE = "cannot be read: no such file"
REQUIRED_GRADES = ("good", "fair")  # the best first


def is_enough(grade: str | None, required: str | None) -> bool:
    """Whether a grade, None for none, is at least what is required, if anything is."""
    return required is None or grade in REQUIRED_GRADES[: 1 + REQUIRED_GRADES.index(required)]


def argument(metavar: str, text: str, *, nargs: str | None = None, existing: str | None = None) -> Any:
    """A field that is given by its place; `existing`: a path, and what is said of it where there is nothing."""
    words = {"words": (), "metavar": metavar, "help": text, **({"nargs": nargs} if nargs else {})}
    return field(metadata=words | ({"existing": existing} if existing else {}))


def option(
    text: str,
    metavar: str | tuple[str, ...] | None = None,
    *,
    default: Any = None,
    flag: str | None = None,
    **more: Any,
) -> Any:
    """A field that is given by its name, or by another `flag`; `more`: of `ArgumentParser.add_argument`, and `existing`
    as of `argument`.
    """
    words = {"words": (flag,) if flag else None, "help": text, **({"metavar": metavar} if metavar else {}), **more}
    if more.get("required"):
        return field(metadata=words)
    return field(default_factory=list, metadata=words) if default == [] else field(default=default, metadata=words)


def switch(text: str) -> Any:
    """A field that is False unless its name is given."""
    return option(text, default=False, action="store_true")


def required_grade(otherwise: str) -> Any:
    """A field with the grade that is required."""
    return option(f"exit code 4 if {otherwise}", "|".join(REQUIRED_GRADES), choices=REQUIRED_GRADES)


def declared(declare: Callable[[ArgumentParser], None]) -> Any:
    """A field that several options make, which `declare` adds."""
    return field(default=None, metadata={"declare": declare})


def count(text: str, *, default: int | None = None, flag: str | None = None) -> Any:
    """A field with a whole number, which the text's default is."""
    described = text if default is None else f"{text} (default: {default})"
    return option(described, "N", default=default, flag=flag)


class Options:
    """Options that belong together: the fields of a dataclass, of a command or of a part of several."""

    @classmethod
    def part(cls, **changed: dict[str, Any]) -> Any:
        """A field that holds these options; `changed`: what differs, by the name of the option."""
        return field(metadata={"part": cls, "changed": changed})

    @classmethod
    def declare(cls, parser: ArgumentParser, changed: dict[str, dict[str, Any]] | None = None) -> None:
        """Add the fields to a parser, in their order."""
        hints = get_type_hints(cls)
        for option_field in fields(cls):  # type: ignore[arg-type]
            words = {**option_field.metadata}
            if part := words.get("part"):
                part.declare(parser, words["changed"])
            elif declare := words.get("declare"):
                declare(parser)
            else:
                _declare(
                    parser, option_field, hints[option_field.name], words | (changed or {}).get(option_field.name, {})
                )

    def refuse_missing(self) -> None:
        """Raise InputError for a path at which there should be something and is nothing: before what the work needs is
        imported, which takes a second.
        """
        for said in self._missing():
            raise InputError(said)

    def _missing(self) -> Iterator[str]:
        for option_field in fields(self):  # type: ignore[arg-type]
            value = getattr(self, option_field.name)
            if option_field.metadata.get("part"):
                yield from value._missing()
            elif said := option_field.metadata.get("existing"):
                paths = value if isinstance(value, list) else [value]
                yield from (f"{path}: {said}" for path in paths if isinstance(path, Path) and not _is_there(path))

    def refuse_wrong_settings(self) -> None:
        """Raise InputError for a configuration that is wrong, likewise before what the work needs is imported."""
        for option_field in fields(self):  # type: ignore[arg-type]
            if option_field.metadata.get("part"):
                getattr(self, option_field.name).refuse_wrong_settings()

    @classmethod
    def of(cls, args: Namespace) -> Self:
        """The options that a parser has found."""
        parts = {option_field.name: option_field.metadata.get("part") for option_field in fields(cls)}  # type: ignore[arg-type]
        return cls(**{name: part.of(args) if part else getattr(args, name) for name, part in parts.items()})


def _is_there(path: Path) -> bool:
    """Whether there is something, or may be."""
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    except (OSError, ValueError):
        return True  # whoever reads it says why that cannot be done
    return True


def _declare(parser: ArgumentParser, of: "Field[Any]", hint: Any, words: dict[str, Any]) -> None:
    """Add an option with the type and the default of a field."""
    flags = words.pop("words")
    words.pop("existing", None)
    if flags == ():
        flags = (of.name,)
    else:
        flags = flags or (f"--{of.name.replace('_', '-')}",)
        words["dest"] = of.name
        default = of.default_factory() if of.default_factory is not MISSING else of.default
        words["default"] = None if default is MISSING else default
    if (kind := _kind(hint)) in (int, float, Path):
        words.setdefault("type", kind)
    parser.add_argument(*flags, **words)


def _kind(hint: Any) -> Any:
    """What a word on the command line becomes, for a field of that type: Path of `Path | None` and of `list[Path]`."""
    inner = [kind for kind in get_args(hint) if kind is not NoneType]
    return _kind(inner[0]) if inner else hint


class Command(Options):
    """A command: a dataclass of its options.

    The module of its name, here, has `run(args)`, which does the work: what that needs is imported only then.
    """

    more: ClassVar[str] = ""
    """What its help says after the docstring."""

    @classmethod
    def name(cls) -> str:
        """What it is called on the command line."""
        return cls.__name__.removesuffix("Command").lower()

    @classmethod
    def declared_in(cls, module: ModuleType) -> dict[str, type["Command"]]:
        """The commands of a module by their names."""
        kinds = [kind for kind in vars(module).values() if isinstance(kind, type) and issubclass(kind, cls)]
        return {kind.name(): kind for kind in kinds if kind is not cls}

    @classmethod
    def about(cls) -> str:
        """What it does, in one line: its docstring."""
        return " ".join((cls.__doc__ or "").split())

    @classmethod
    def module(cls) -> Any:
        """Import where its work is done; no module can be called `import`."""
        return import_module(f"scanner.commands.{cls.name()}{'_' if cls.name() == 'import' else ''}")

    def run(self) -> int | None:
        """Do the work; returns the exit code, if it is not 0. Raises InputError, StorageError, DeviceError,
        RefusalError, GradeError.
        """
        code: int | None = self.module().run(self)
        return code


@dataclass(frozen=True, kw_only=True)
class ConfigOptions(Options):
    """The configuration: a file, and keys that override it."""

    config: Path | None = option("configuration (YAML)", "FILE", existing=NO_FILE)
    set: list[str] = option("override a key, as in camera.width=640", "KEY=VALUE", default=[], action="append")

    @property
    def file(self) -> Path:
        """The file, of a command that requires one."""
        if self.config is None:
            raise ValueError("there is no configuration")
        return self.config

    def refuse_wrong_settings(self) -> None:
        """Raise InputError if the file or a key is wrong."""
        if self.config is not None:
            self.load()

    def load(self) -> "Config":
        """The configuration. Raises InputError."""
        from scanner.configuration import load_config

        return load_config(self.config, self.set)


@dataclass(frozen=True, kw_only=True)
class Output(Options):
    """Where a new result goes."""

    out: Path | None = option("folder to make", "DIR")
    overwrite: bool = switch("replace an earlier result of that name")
    require: str | None = required_grade("the result, which is kept, has a lower grade")
    quiet: bool = switch("print nothing but errors")

    def place(self, stem: str | None = None) -> Path:
        """`--out`, or a folder of the default's name; of a command without a default, `--out` is always given."""
        from scanner.results import default_out

        if self.out is None and stem is None:
            raise ValueError("there is no default for --out")
        return self.out or default_out(str(stem), overwrite=self.overwrite)


@dataclass(frozen=True, kw_only=True)
class Address(Options):
    """Where a page is served."""

    host: str = option(f"address to serve the page at (default: {LOCAL}, this computer)", "ADDRESS", default=LOCAL)
    port: int | None = option(f"port to serve it at (default: {DEFAULT_PORT}, or the next that is free)", "N")
    no_browser: bool = switch("only print the address, open no browser")


def with_settings(*, required: bool = False) -> Any:
    """The field of a command's configuration."""
    return ConfigOptions.part(config={"required": required})


def with_output(default: str | None = None) -> Any:
    """The field of a command's output; without a default, it has to be given."""
    return Output.part(out={"required": True} if default is None else {"help": f"folder to make (default: {default})"})
