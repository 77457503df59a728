"""A verb of the command line: plugins, options from groups, help from the registries, errors as an exit status."""

from __future__ import annotations

import inspect
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, fields, is_dataclass
from types import MappingProxyType
from typing import Any, TypeAlias, get_type_hints

import typer
from typer.core import TyperCommand

from calib.cli.exit_status import ExitStatus
from calib.cli.options import Debug, Plugins
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
            args: Its words, behind the verb's name.

        Returns:
            The words that were not parsed.
        """
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
            _load_plugins(given.get("plugin", ()))
        return super().parse_args(ctx, args)

    def format_help(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401  typer's own class
        """Write the help; ``{families}``, ``{kinds}`` and so on become the names that are registered.

        Args:
            ctx: The context of the call.
            formatter: Writes the help.
        """
        registered = _REGISTERED | getattr(self.callback, "registered", {})
        for option in self.get_params(ctx):
            help_text = getattr(option, "help", None) or ""
            for placeholder, names in registered.items():
                if placeholder in help_text:
                    help_text = help_text.replace(placeholder, ", ".join(names()))
                    option.help = help_text  # type: ignore[attr-defined]
        super().format_help(ctx, formatter)


def _load_plugins(names: Iterable[str]) -> None:
    """Load the installed plugins and those of ``--plugin``; raises `PluginError`."""
    import calib.basics.plugins as plugins

    plugins.load_installed()
    for name in names:
        plugins.load(name)


def _families() -> tuple[str, ...]:
    """Return the names of the families of joint errors, which no URDF holds."""
    from calib.model.families import joint_families

    return joint_families()


def _kinds() -> tuple[str, ...]:
    """Return the names of the kinds of measurement."""
    from calib.data.kinds import names

    return names()


def _models() -> tuple[str, ...]:
    """Return the names of the parameter sets."""
    from calib.model.error_model import MODELS

    return tuple(MODELS)


def _solvers() -> tuple[str, ...]:
    """Return the names of the solvers."""
    from calib.numerics.solvers import SOLVERS

    return tuple(SOLVERS)


def _brands() -> tuple[str, ...]:
    """Return the names of the brands whose columns are known."""
    from calib.data.forms.brands import BRANDS

    return tuple(BRANDS)


def _conventions() -> tuple[str, ...]:
    """Return the names of the conventions of orientations."""
    from calib.data.forms.orientations import CONVENTIONS

    return tuple(CONVENTIONS)


#: What a placeholder in a help text stands for. The registries import NumPy, so they are read when help is printed.
_REGISTERED: dict[str, Names] = {
    "{brands}": _brands,
    "{conventions}": _conventions,
    "{families}": _families,
    "{kinds}": _kinds,
    "{models}": _models,
    "{solvers}": _solvers,
}


def verb(
    help_text: str, registered: Mapping[str, Names] = NONE
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a verb of the command line of a function.

    A parameter whose type is a dataclass is a group: its fields become options, and the function gets the group. Every
    verb has ``--plugin`` and ``--debug`` besides, and reports errors as `reporting` does.

    Args:
        help_text: The text of ``--help``.
        registered: What a placeholder in the help of this verb's options stands for, besides those of every verb.

    Returns:
        A decorator; what it returns has the signature from which typer makes the options.
    """

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        types = get_type_hints(function, include_extras=True)
        groups = {name: kind for name, kind in types.items() if is_dataclass(kind)}

        def run(**values: Any) -> None:  # noqa: ANN401  options of any type
            values.pop("plugin")  # loaded by `Verb.parse_args`
            with reporting(debug=values.pop("debug")):
                for name, group in groups.items():
                    members = {f.name: values.pop(f.name) for f in fields(group)}
                    values[name] = group(**members)  # type: ignore[operator]
                function(**values)

        run.__name__ = function.__name__
        run.__doc__ = help_text
        run.registered = registered  # type: ignore[attr-defined]
        run.__annotations__ = {}
        of_every_verb = (_option("plugin", Plugins, None), _option("debug", Debug, False))
        signature = inspect.Signature([*_options(function, types), *of_every_verb])
        run.__signature__ = signature  # type: ignore[attr-defined]
        return run

    return decorate


def _options(function: Callable[..., None], types: dict[str, Any]) -> Iterator[inspect.Parameter]:
    """Yield the options of a function in order, with each group replaced by its fields.

    Args:
        function: Takes options and groups.
        types: The type of each of its parameters.
    """
    for parameter in inspect.signature(function).parameters.values():
        kind = types[parameter.name]
        if not is_dataclass(kind):
            yield _option(parameter.name, kind, parameter.default)
            continue
        member_types = get_type_hints(kind, include_extras=True)
        for field in fields(kind):
            is_required = field.default is MISSING
            default = inspect.Parameter.empty if is_required else field.default
            yield _option(field.name, member_types[field.name], default)


def _option(name: str, kind: Any, default: Any) -> inspect.Parameter:  # noqa: ANN401  any type
    """Return a keyword parameter, of which typer makes an option or an argument."""
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind)


@contextmanager
def reporting(*, debug: bool) -> Iterator[None]:
    """Report an error of the block as one line on stderr, and end the program with its exit status.

    The text of a `KeyboardInterrupt` says what is kept of the work.

    Args:
        debug: Whether the trace is printed before the line.

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
    except KeyboardInterrupt as error:
        message = f"interrupted; no file was left half written. {error}".rstrip()
        typer.echo(f"calib: {message}", err=True)
        raise typer.Exit(ExitStatus.INTERRUPTED) from error
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
            f"calib: a fault of calib itself: {type(error).__name__}: {error}. "
            "Report it with what --debug shows.",
            err=True,
        )
        raise typer.Exit(ExitStatus.REFUSED) from error
