"""A verb of the command line: plugins, options from groups, help from the registries, errors as an exit status."""

from __future__ import annotations

import inspect
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, dataclass, fields, is_dataclass
from types import MappingProxyType
from typing import Annotated, Any, TypeAlias, get_type_hints

import typer
from typer.core import TyperCommand

from calib.cli.exit_status import ExitStatus
from calib.errors import CalibError, VerdictError

#: Names that are registered, read when the help is printed.
Names: TypeAlias = Callable[[], tuple[str, ...]]

#: No placeholders besides those of every verb.
NONE: Mapping[str, Names] = MappingProxyType({})


class Verb(TyperCommand):
    """A command that loads plugins first, refuses a single-valued option given twice, and lists what is registered."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401  typer's own class
        """Parse the words of a call, and load its plugins; a wrong call ends the program with exit status 2.

        Of two values of one option the last would win silently, so they are refused. Plugins are loaded here because
        the help, which is printed while the words are parsed, lists what they register.

        Args:
            ctx: The context of the call.
            args: Its words, without the verb.

        Returns:
            The words that were not parsed.
        """
        if (
            ctx.resilient_parsing
        ):  # for a shell that completes words, which no plugin shall slow down
            return super().parse_args(ctx, args)
        given, _, order = self.make_parser(ctx).parse_args(args=[*args])
        for option in self.get_params(ctx):
            # A switch such as --force may come again; --robust beside --no-robust may not.
            is_switch = getattr(option, "is_flag", False) and not option.secondary_opts
            is_list = getattr(option, "multiple", True)
            if option.nargs != 1 or is_switch or is_list:
                continue
            times = order.count(option)
            if times > 1:
                names = "/".join((*option.opts, *option.secondary_opts))
                ctx.fail(f"Option '{names}' is given {times} times. Give it once.")
        with reporting(debug="debug" in given):
            import calib.basics.plugins as plugins

            plugins.load_installed()
            for name in given.get("plugin", ()):
                plugins.load(name)
        return super().parse_args(ctx, args)

    def format_help(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401  typer's own class
        """Write the help; ``{families}``, ``{kinds}`` and so on become the names that are registered.

        Args:
            ctx: The context of the call.
            formatter: Writes the help.
        """
        parameters: list[Any] = self.get_params(ctx)
        listing = [each for each in parameters if "{" in (getattr(each, "help", "") or "")]
        if listing:
            # The registries import NumPy, which other calls of the program do without.
            from calib.data.forms.column_options import BRANDS
            from calib.data.forms.orientations import CONVENTIONS
            from calib.data.kinds import names as kind_names
            from calib.model.families import joint_families
            from calib.model.parameter_sets import MODELS
            from calib.numerics.solvers import SOLVERS

            registered = {
                "{brands}": tuple(BRANDS),
                "{conventions}": tuple(CONVENTIONS),
                "{families}": joint_families(),  # those that no URDF holds
                "{kinds}": kind_names(),
                "{models}": tuple(MODELS),
                "{solvers}": tuple(SOLVERS),
            }
            for placeholder, names in getattr(self.callback, "registered", {}).items():
                registered[placeholder] = names()
            for option in listing:
                for placeholder, names in registered.items():
                    option.help = option.help.replace(placeholder, ", ".join(names))
        super().format_help(ctx, formatter)


def verb(
    help_text: str, registered: Mapping[str, Names] = NONE
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a verb of the command line from a function.

    A parameter whose type is a dataclass is a group: its fields become options, or those of its method ``parameters``
    (`calib.cli.options.CellOptions`), and the function gets the group. Every verb has ``--plugin`` and ``--debug``
    besides, and reports errors as `reporting` does.

    Args:
        help_text: The text of ``--help``.
        registered: By placeholder in the help of this verb's options, such as ``"{formats}"``, the function that gives
            the names it stands for; those that every verb may use need not be given.

    Returns:
        A decorator; what it returns has the signature from which typer makes the options.
    """

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        """Return the verb that calls a function, with the options of its groups as keyword parameters."""
        # `get_type_hints` of Python 3.10 would wrap the type of what defaults to None, which typer does not read.
        parameters = inspect.signature(function, eval_str=True).parameters.values()
        options: list[inspect.Parameter] = []
        groups: dict[str, tuple[Any, list[str]]] = {}
        for parameter in parameters:
            kind = parameter.annotation
            members = _members(kind) if is_dataclass(kind) else [parameter]
            if is_dataclass(kind):
                groups[parameter.name] = (kind, [member.name for member in members])
            options += [member.replace(kind=inspect.Parameter.KEYWORD_ONLY) for member in members]

        def run(**values: Any) -> None:  # noqa: ANN401  options of any type
            values.pop("plugin")  # loaded by `Verb.parse_args`
            with reporting(debug=values.pop("debug")):
                for name, (group, members) in groups.items():
                    typed = {member: values.pop(member) for member in members}
                    make = getattr(group, "of_typed", None)
                    values[name] = group(**typed) if make is None else make(typed)
                function(**values)

        run.__name__ = function.__name__
        run.__doc__ = help_text
        run.registered = registered  # type: ignore[attr-defined]
        run.__annotations__ = {}
        signature = inspect.Signature([*options, *_members(_OfEveryVerb)])
        run.__signature__ = signature  # type: ignore[attr-defined]
        return run

    return decorate


@dataclass(frozen=True, slots=True)
class _OfEveryVerb:
    """Options of every verb."""

    plugin: Annotated[
        list[str] | None,
        typer.Option(
            "--plugin",
            metavar="FILE|MODULE",
            help="Python file (.py) or importable module with your own families of errors, kinds of measurement, "
            "solvers, parameter sets, formats, readers of instruments or controllers of robots; it is loaded before "
            "anything else. Can be repeated.",
        ),
    ] = None
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False


def _members(group: Any) -> list[inspect.Parameter]:  # noqa: ANN401  a dataclass
    """Return the options of a group as keyword parameters: those of its method ``parameters``, or else its fields."""
    if hasattr(group, "parameters"):
        members: list[inspect.Parameter] = group.parameters()
        return members
    types = get_type_hints(group, include_extras=True)
    result = []
    for field in fields(group):
        default = inspect.Parameter.empty if field.default is MISSING else field.default
        annotation = types[field.name]
        result.append(
            inspect.Parameter(
                field.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation
            )
        )
    return result


@contextmanager
def reporting(*, debug: bool) -> Iterator[None]:
    """Report an error of the block as one line on stderr, and end the program with its exit status.

    Ctrl-C and an `OSError` pass: the program reports them.

    Args:
        debug: Whether the traceback is printed before the line.

    Raises:
        typer.Exit: With the exit status of the error.
    """
    try:
        yield
    except typer.Exit:
        raise
    except BrokenPipeError as error:
        # The reader of our output (head, less) has gone: nothing can be reported to it.
        sys.stderr.close()
        raise typer.Exit(ExitStatus.DONE) from error
    except OSError:  # reported by `calib.__main__.main`
        raise
    except CalibError as error:
        if debug:
            traceback.print_exc()
        typer.echo(f"calib: {error}", err=True)
        is_verdict = isinstance(error, VerdictError)
        status = ExitStatus.NOT_ACCEPTED if is_verdict else ExitStatus.REFUSED
        raise typer.Exit(status) from error
    except Exception as error:
        if debug:
            raise
        typer.echo(
            f"calib: an internal error: {type(error).__name__}: {error}. "
            "Report it with what --debug shows.",
            err=True,
        )
        raise typer.Exit(ExitStatus.REFUSED) from error
