"""Plugins: Python files and modules of users, whose registrations extend calib.

A plugin registers families of joint errors, kinds of measurement, solvers, parameter sets, formats, readers of
instruments and controllers of robots when it is imported. The registries, in higher layers, are watched from here
(`watch`), so that what each plugin registered is the difference between their names after and before. What is loaded
belongs to the process; this module alone holds it.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.metadata
import importlib.util
import platform
import sys
import threading
import traceback
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType
from typing import Any

from calib.basics.files import read_bytes
from calib.errors import CalibError, FileError, PluginError, choices, did_you_mean

#: Group of entry points by which an installed distribution names its plugins.
GROUP = "calib.plugins"

#: Word for an entry of each registry, for messages; by the name of the attribute of `Plugin`.
WORDS: Mapping[str, str] = {
    "families": "family of errors",
    "kinds": "kind of measurement",
    "solvers": "solver",
    "models": "parameter set",
    "formats": "format",
    "readers": "reader of an instrument",
    "controllers": "controller of a robot",
}

#: Registries whose names must be there for a result to be read. A solver and a parameter set are not: the file has
#: their outcome.
_NEEDED_TO_READ = ("families", "kinds")


@dataclass(frozen=True, slots=True)
class Plugin:
    """A plugin that is loaded, and the names that it registered."""

    #: Its name as given: a file or a module
    name: str
    #: Absolute path of the file, or name of the module
    source: str
    #: SHA-256 of its source code, 64 hexadecimal digits; of a package, of all its Python files
    sha256: str
    #: Families of joint errors
    families: tuple[str, ...] = ()
    #: Kinds of measurement
    kinds: tuple[str, ...] = ()
    #: Solvers
    solvers: tuple[str, ...] = ()
    #: Parameter sets
    models: tuple[str, ...] = ()
    #: Output formats
    formats: tuple[str, ...] = ()
    #: Readers of instruments
    readers: tuple[str, ...] = ()
    #: Controllers of robots
    controllers: tuple[str, ...] = ()


#: End of a message on a name that is not registered.
HINT = (
    "One of your own comes from a plugin: load it with --plugin FILE, in Python with "
    'calib.plugins.load("FILE").'
)

#: The registries that plugins add names to, by the keys of `WORDS`.
_REGISTRIES: dict[str, dict[str, Any]] = {}
#: Copies of them with calib's own entries.
_OWN: dict[str, Mapping[str, Any]] = {}
_LOADED: list[Plugin] = []
#: Workers of Dask are threads, which may begin their first jobs at once.
_LOCK = threading.RLock()


def watch(what: str, entries: dict[str, Any]) -> None:
    """Watch a registry, which has calib's own entries: what is added from here on is a plugin's or the program's.

    Args:
        what: What the entries are, one of `WORDS`.
        entries: The registry itself, not a copy.
    """
    _REGISTRIES[what] = entries
    _OWN[what] = dict(entries)


def loaded() -> tuple[Plugin, ...]:
    """Return the plugins of this process, in the order in which they were loaded."""
    return tuple(_LOADED)


def load(name: str | Path) -> Plugin:
    """Load a plugin, unless this process has it: the same file or module is loaded once.

    If it fails, nothing of it stays registered.

    Args:
        name: A Python file, whose name ends in ``.py``, or a module that can be imported.

    Returns:
        The plugin, with the names that it registered.

    Raises:
        PluginError: It does not exist, raises an exception, or registers a name that is taken.
    """
    given = str(name)
    is_file = given.endswith(".py")
    if not is_file and ("/" in given or given.startswith(".")):
        raise PluginError(f"Plugin '{given}' is a path; the name of a file ends in .py.")
    source = str(Path(given).expanduser().resolve()) if is_file else given
    return _load(given, source)


def load_installed() -> tuple[Plugin, ...]:
    """Load the plugins that installed distributions name as entry points of the group ``calib.plugins``.

    Returns:
        The plugins, in the order of the entry points' names.

    Raises:
        PluginError: One cannot be loaded; the message names the distribution and the entry point.
    """
    entries = importlib.metadata.entry_points(group=GROUP)
    plugins = []
    for entry in sorted(entries, key=lambda entry: entry.name):
        distribution = entry.dist.name if entry.dist else ""
        where = f"Entry point '{entry.name}' of the installed distribution '{distribution}'"
        if entry.attr:
            raise PluginError(
                f"{where} names '{entry.attr}' in the module '{entry.module}'; it must name the module alone, which "
                "calls register() when it is imported."
            )
        try:
            plugins.append(load(entry.module))
        except PluginError as error:
            raise PluginError(
                f"{where}: {error} To go on without it, uninstall the distribution."
            ) from error
    return tuple(plugins)


def load_sent(plugins: Sequence[Plugin]) -> None:
    """Load in a worker the plugins of the process that sends the jobs, which `loaded` returned there.

    Raises:
        PluginError: One cannot be loaded, or differs from the one sent.
    """
    where = f"A worker on '{platform.node()}'"
    for plugin in plugins:
        try:
            here = _load(plugin.name, plugin.source)
        except PluginError as error:
            raise PluginError(f"{where}: {error}") from error
        if here.sha256 != plugin.sha256:
            raise PluginError(
                f"{where} has other contents of the plugin '{plugin.source}'. Give all machines the same file, and "
                "restart the workers."
            )


# Names


def unknown(what: str, name: str, allowed: Iterable[str], *, plugin: str = "") -> str:
    """Return the message for a name that is not registered.

    Args:
        what: What it would be, one of `WORDS`.
        name: The name.
        allowed: The names that are registered.
        plugin: The plugin that has it, as it was given; empty if it is not known.
    """
    if plugin:
        return (
            f"The {WORDS[what]} '{name}' comes from the plugin '{plugin}', which is not loaded. Load it with --plugin "
            f'{plugin}, in Python with calib.plugins.load("{plugin}").'
        )
    names = list(allowed)
    hint = did_you_mean(name, names)
    return f"There is no {WORDS[what]} '{name}'{hint}; there are {choices(names, 60)}. {HINT}"


def plugin_tables(uses: Mapping[str, Collection[str]]) -> list[dict[str, Any]]:
    """Return the plugins that registered names which a result uses, as tables for its file.

    Args:
        uses: The names used, by the keys of `WORDS`.

    Returns:
        For each such plugin ``"name"``, as given, ``"sha256"``, and by the keys of ``uses`` the names that are used.
    """
    tables = []
    for plugin in _LOADED:
        used = {
            what: [name for name in getattr(plugin, what) if name in names]
            for what, names in uses.items()
        }
        if any(used.values()):
            tables.append({"name": plugin.name, "sha256": plugin.sha256, **used})
    return tables


def check_registered(
    uses: Mapping[str, Collection[str]], tables: Iterable[Mapping[str, Any]]
) -> None:
    """Check that the families and kinds which a result uses are registered.

    Args:
        uses: The names used, by the keys of `WORDS`.
        tables: The plugins of the result, as `plugin_tables` returned them.

    Raises:
        PluginError: One is not; the message names the plugin that registered it.
    """
    for what in _NEEDED_TO_READ:
        entries = _REGISTRIES[what]
        for name in uses[what]:
            if name not in entries:
                suppliers = [str(table["name"]) for table in tables if name in table[what]]
                plugin = suppliers[0] if suppliers else ""
                raise PluginError(unknown(what, name, entries, plugin=plugin))


# Loading


def _load(given: str, source: str) -> Plugin:
    """Load the plugin with a source (see `Plugin`) and the name ``given``, or return it if it is loaded.

    Raises `PluginError` if it cannot be loaded; then the registries and the list of plugins are as before.
    """
    with _LOCK:
        for plugin in _LOADED:
            if plugin.source == source:
                return plugin
        count = len(_LOADED)
        before = {what: dict(entries) for what, entries in _REGISTRIES.items()}
        try:
            sha256 = _import_plugin(given, source)
            names = _registered_names(given, before, _LOADED[count:])
        except BaseException:
            _restore(before, count)
            raise
        plugin = Plugin(given, source, sha256, **names)
        _LOADED.append(plugin)
        return plugin


def _restore(before: Mapping[str, Mapping[str, Any]], count: int) -> None:
    """Give the registries their entries ``before`` again, and keep the first ``count`` plugins.

    A registry that was imported since then is left with calib's own entries.
    """
    for what, entries in _REGISTRIES.items():
        entries.clear()
        entries.update(before.get(what, _OWN[what]))
    del _LOADED[count:]


def _import_plugin(given: str, source: str) -> str:
    """Import a plugin, and return the SHA-256 of its source code; of a package, of all its Python files.

    ``source`` is the absolute path of a ``.py`` file or the name of a module, ``given`` is the name for messages.
    Raises `PluginError` for whatever fails.
    """
    is_file = source.endswith(".py")
    if is_file:
        try:
            content = read_bytes(source, f"Plugin '{given}': the file")
        except FileError as error:
            raise PluginError(str(error)) from error
    try:
        if is_file:
            _import_file(source)
        else:
            module = importlib.import_module(source)
            files = [Path(module.__file__)] if module.__file__ else []
            for folder in getattr(module, "__path__", ()):
                files += sorted(Path(folder).rglob("*.py"))
            content = b"".join(file.read_bytes() for file in files)
        return hashlib.sha256(content).hexdigest()
    except ModuleNotFoundError as error:
        # The plugin itself is missing, not a module that it imports.
        if error.name is not None and f"{source}.".startswith(f"{error.name}."):
            is_beside = Path(f"{source}.py").is_file()
            hint = f" (did you mean the file '{source}.py'?)" if is_beside else ""
            raise PluginError(
                f"Plugin '{given}': there is no module of this name{hint}. Give a Python file, whose name ends in .py, "
                "or a module that can be imported."
            ) from error
        raise PluginError(_failure(given, error)) from error
    except (Exception, SystemExit) as error:
        raise PluginError(_failure(given, error)) from error


class _Loader(SourceFileLoader):
    """Loads a file as it is now, and leaves no compiled code beside it."""

    def get_code(self, fullname: str) -> CodeType:  # noqa: ARG002  as the base class has it
        """Return the code of the file as it is now, compiled, without reading or writing a cache."""
        return self.source_to_code(self.get_data(self.path), self.path)


def _import_file(path: str) -> None:
    """Import a file under a name that follows from its path, so that workers find its functions by the same name."""
    place = hashlib.sha256(path.encode("utf-8", "surrogateescape")).hexdigest()[:12]
    name = f"calib_plugin_{place}"
    loader = _Loader(name, path)
    spec = importlib.util.spec_from_loader(name, loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise


def _failure(given: str, error: BaseException) -> str:
    """Return the message for a plugin that failed: the cause, and the line of its file."""
    cause = f"{type(error).__name__}: {error}"
    if isinstance(error, CalibError):
        cause = str(error)
    place = ""
    # After the frames of this module and of Python's import the first one is the plugin's.
    imports = (__file__, importlib.__file__)
    frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if frame.filename not in imports and not frame.filename.startswith("<frozen ")
    ]
    if isinstance(error, SyntaxError) and error.filename is not None:
        cause = f"{type(error).__name__}: {error.msg}"
        place = f" (line {error.lineno} of {Path(error.filename).name})"
    elif frames:
        file = frames[0].filename
        line = [frame.lineno for frame in frames if frame.filename == file][-1]
        place = f" (line {line} of {Path(file).name})"
    cause = " ".join(cause.split()).rstrip(".")
    return f"Plugin '{given}' cannot be loaded: {cause}{place}. Correct it, or leave it out."


def _registered_names(
    given: str,
    before: Mapping[str, Mapping[str, Any]],
    nested: Sequence[Plugin],
) -> dict[str, tuple[str, ...]]:
    """Return by registry the names that a plugin added since ``before``, without those of ``nested`` plugins it loaded.

    Raises `PluginError` if it replaced an entry, or neither added a name nor loaded a plugin.
    """
    names = {}
    for what, entries in _REGISTRIES.items():
        earlier = before.get(what, _OWN[what])  # a registry that the plugin imported was not there
        replaced = [name for name, entry in earlier.items() if entries.get(name) is not entry]
        if replaced:
            raise PluginError(
                f"Plugin '{given}' replaces the {WORDS[what]} {choices(replaced)}. Give yours a name of its own."
            )
        others = {name for plugin in nested for name in getattr(plugin, what)}
        names[what] = tuple(n for n in entries if n not in earlier and n not in others)
    if not nested and not any(names.values()):
        # Results could not name it.
        raise PluginError(
            f"Plugin '{given}' registers nothing. It must call a register() when it is imported; if this program has "
            "imported it already, leave that to calib.plugins.load."
        )
    return names
