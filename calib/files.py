"""Files in and out: read with a message that says what is wrong, written whole or not at all.

JSON files of calib's own say by their ``schema`` what they are. A `JsonLayout` makes them of dataclasses and back: an
attribute's type says how it is written, its key is its name unless the table of keys has another path. Dots separate
nested tables; an empty path, or one that ends in a dot, puts the attribute's own keys beside the others.
"""

from __future__ import annotations

import contextlib
import csv
import enum
import io
import json
import math
import os
import secrets
import stat
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from pathlib import Path
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from calib.errors import CalibError, FileError

#: What pipes gave, by device and inode: they cannot be read twice, and a command looks at a table more than once.
_PIPED: dict[tuple[int, int], bytes] = {}


def read_bytes(path: str | os.PathLike[str], what: str) -> bytes:
    """Read a whole file, or a pipe to its end: standard input as ``-``, a shell's ``<(zcat table.csv.gz)``.

    ``what`` the file should be (``"URDF"``) begins the message of a FileError.
    """
    name = "/dev/stdin" if os.fspath(path) == "-" else path
    try:
        found = os.stat(name)  # noqa: PTH116  a name as it is
        pipe = (found.st_dev, found.st_ino)
        if not stat.S_ISFIFO(found.st_mode):
            return Path(name).read_bytes()
        if pipe not in _PIPED:
            _PIPED[pipe] = Path(name).read_bytes()
        return _PIPED[pipe]
    except FileNotFoundError as error:
        message = f"{what} '{path}' does not exist; check the name and the folder."
        if ":=" in str(path):
            message += " Arguments of a xacro stand behind its name, with it in one pair of quotes."
        raise FileError(message) from error
    except IsADirectoryError as error:
        raise FileError(f"{what} '{path}' is a folder; name the file inside it.") from error
    except (OSError, ValueError) as error:
        raise FileError(f"{what} '{path}' cannot be read: {_reason(error)}.") from error


def write_atomically(path: str | os.PathLike[str], data: bytes, *, overwrite: bool) -> Path:
    """Write a file so that it holds all of ``data`` or stays as it was; FileError where it cannot be written.

    The bytes go into a file beside it, which then takes its name. A symbolic link is followed and stays one. A file
    that is overwritten keeps its permissions.
    """
    check_writable(path, overwrite=overwrite)
    target = Path(path).resolve()
    temporary = target.with_name(f".calib-{secrets.token_hex(8)}.tmp")
    try:
        temporary.write_bytes(data)
        if target.exists():
            temporary.chmod(stat.S_IMODE(target.stat().st_mode))
        temporary.replace(target)
    except OSError as error:
        raise FileError(
            f"'{path}' cannot be written: {_reason(error)}; choose another folder."
        ) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()
    return Path(path)


def csv_bytes(rows: Iterable[Iterable[object]]) -> bytes:
    """A CSV table in UTF-8, its header first; floats are written as their repr."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()


def check_writable(path: str | os.PathLike[str], *, overwrite: bool = True) -> None:
    """Refuse, before the work is done, a place where `write_atomically` cannot write; raises as that does."""
    try:
        target = Path(path).resolve()
        is_there, is_file = target.exists(), target.is_file()
    except (OSError, ValueError, RuntimeError) as error:  # too long, no name, links in a circle
        message = f"'{path}' cannot be written: {_reason(error)}; choose another name."
        raise FileError(message) from error
    folder = target.parent
    if is_there and not is_file:
        fault = f"is a {'folder; name a file inside it' if target.is_dir() else 'device'}"
    elif is_there and not overwrite:
        fault = "exists already; overwrite it (--force, in Python overwrite=True) or choose another name"
    elif not folder.is_dir():
        fault = f"cannot be written: the folder '{folder}' does not exist; create it"
    elif not os.access(folder, os.W_OK):
        fault = "cannot be written: the folder takes no files; choose another folder"
    else:
        return
    raise FileError(f"'{path}' {fault}.")


def check_no_xacro(path: str | os.PathLike[str]) -> None:
    """Refuse the name of a xacro for what is written: it is a URDF, with macros and arguments expanded."""
    if Path(path).name.lower().endswith(".xacro"):
        raise FileError(
            f"'{path}' is the name of a xacro, and what is written is a URDF; name it .urdf. A xacro stays one if it "
            "takes the origins of its joints from a file: see calib convert --to origins."
        )


def make_folder(path: str | os.PathLike[str]) -> Path:
    """Make a folder and those above it, if it does not exist; FileError if it cannot be made."""
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise FileError(
            f"{path}: this folder cannot be made: {_reason(error)}. Choose another name."
        ) from error
    return Path(path)


def remove(path: str | os.PathLike[str]) -> None:
    """Remove a file, if there is one; FileError where that cannot be."""
    try:
        Path(path).unlink(missing_ok=True)
    except OSError as error:
        raise FileError(f"'{path}' cannot be removed: {_reason(error)}; remove it.") from error


def _reason(error: Exception) -> str:
    """What the system says, without the name of the temporary file."""
    return str(getattr(error, "strerror", None) or error)


#: A list of more entries than that has one of them a line.
_LONG = 500


def read_json(
    path: str | os.PathLike[str], what: str, schema: object, expected: str
) -> dict[str, Any]:
    """Read a table whose ``schema`` is the one wanted; ``what`` and ``expected`` say in the message what file to give.

    Raises:
        FileError: It cannot be read, is no JSON, or of another schema.
    """
    try:
        table = json.loads(read_bytes(path, what), parse_constant=_refused)
    except (ValueError, RecursionError) as error:
        raise FileError(
            f"{path}: this is not a JSON file: {error}. Wanted is a {what} with its 'schema'; {expected}"
        ) from error
    found = table.get("schema") if isinstance(table, dict) else None
    if not isinstance(table, dict) or found != schema:
        raise FileError(f"{path}: its 'schema' is {found!r}; {expected}")
    return table


def _refused(name: str) -> float:
    """JSON has no NaN or Infinity, and calib writes null."""
    raise ValueError(f"it holds {name}; write the number, or null where there is none")


def damage(error: Exception) -> str:
    """What reading a file's nested tables stumbled over, in words."""
    if isinstance(error, KeyError):
        return f"'{error.args[0]}' is missing"
    if isinstance(error, (ValueError, CalibError)):
        return str(error).rstrip(".")
    return f"a value is of another kind: {error}"


def json_bytes(table: Mapping[str, Any]) -> bytes:
    """A table as JSON, UTF-8, one value a line, of a long list one entry a line; see `plain`."""
    lines = []
    for key, value in table.items():
        entry = plain(value)
        if isinstance(entry, list) and len(entry) > _LONG:
            rows = ",\n  ".join(json.dumps(row, ensure_ascii=False) for row in entry)
            text = f"[\n  {rows}\n ]"
        else:
            text = json.dumps(entry, indent=1, ensure_ascii=False).replace("\n", "\n ")
        lines.append(f" {json.dumps(key)}: {text}")
    # What UTF-8 lacks, such as a byte of a file's name that is no letter, stands as JSON's own escape.
    return ("{\n" + ",\n".join(lines) + "\n}\n").encode("utf-8", "backslashreplace")


def plain(value: Any) -> Any:  # noqa: ANN401
    """Nested tables as JSON has them: arrays as lists, numbers that do not exist as None."""
    if isinstance(value, Mapping):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


Json = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Key:
    """Path of an attribute, and what writes and reads it where its type does not say."""

    path: str
    write: Callable[[Any], Any] | None = None
    read: Callable[[Any], Any] | None = None


@dataclass(frozen=True, slots=True)
class JsonLayout:
    """Writes and reads dataclasses by the keys of their attributes; None: an attribute that is not in the file.

    ``types`` has what writes and reads values of a type in another way; None for one of both: as usual.
    """

    keys: Mapping[type, Mapping[str, Key | str | None]]
    types: Mapping[type, tuple[Callable[[Any], Any] | None, Callable[[Any], Any] | None]]

    def table(self, value: Any) -> dict[str, Any]:  # noqa: ANN401  a dataclass
        """A dataclass as nested tables."""
        return nested(
            {
                key.path: (key.write or self._write)(getattr(value, n))
                for n, key in self._of(type(value))
            }
        )

    def values(self, kind: type, found: Json, without: Collection[str] = ()) -> dict[str, Any]:
        """The attributes of a dataclass by name, from its table; those that it lacks have their defaults."""
        hints, result = get_type_hints(kind), {}
        defaults = {f.name for f in fields(kind) if f.default is not MISSING}
        for name, key in self._of(kind):
            place: Any = found
            *folders, last = key.path.split(".")
            for folder in folders:
                place = place[folder]
            if name not in without and not (name in defaults and last not in place):
                entry = place[last] if last else place
                result[name] = key.read(entry) if key.read else self.read(hints[name], entry)
        return result

    def read(self, hint: Any, found: Any) -> Any:  # noqa: ANN401  any type, any JSON
        """A value of a type; a missing number is NaN."""
        origin, args = get_origin(hint), get_args(hint)
        own = self.types.get(hint, (None, None))[1] if isinstance(hint, type) else None
        if own is not None:
            return own(found)
        if hint is float:
            return float("nan") if found is None else float(found)
        if hint in (int, bool, str):
            return hint(found)
        if origin in (Union, UnionType):
            return None if found is None else self.read(args[0], found)
        if origin is np.ndarray:
            array = np.array(found, dtype=get_args(args[1])[0])
            array.setflags(write=False)
            return array
        if origin is tuple:
            return tuple(self.read(args[0], one) for one in found)
        if origin in (dict, Mapping):
            return {str(name): self.read(args[1], one) for name, one in found.items()}
        if isinstance(hint, enum.EnumMeta):
            return hint[found.upper()]
        if isinstance(hint, type) and is_dataclass(hint):
            return hint(**self.values(hint, found))
        return found

    def _write(self, value: Any) -> Any:  # noqa: ANN401
        """A value as JSON has it; arrays and numbers stay what they are."""
        own = self.types.get(type(value), (None, None))[0]
        if own is not None:
            return own(value)
        if isinstance(value, enum.Enum):
            return value.name.lower()
        if isinstance(value, Mapping):
            return {name: self._write(one) for name, one in value.items()}
        if isinstance(value, tuple | list):
            return [self._write(one) for one in value]
        return self.table(value) if is_dataclass(value) else value

    def _of(self, kind: type) -> list[tuple[str, Key]]:
        """The attributes that are in the file, with their keys; a class has those of its bases."""
        own = {
            n: key for base in reversed(kind.__mro__) for n, key in self.keys.get(base, {}).items()
        }
        found = [(f.name, own.get(f.name, f.name)) for f in fields(kind)]
        return [
            (n, Key(key) if isinstance(key, str) else key) for n, key in found if key is not None
        ]


def nested(flat: Mapping[str, Any]) -> dict[str, Any]:
    """Tables from values by their paths."""
    result: dict[str, Any] = {}
    for path, value in flat.items():
        *folders, last = path.split(".")
        place = result
        for folder in folders:
            place = place.setdefault(folder, {})
        place.update({last: value} if last else value)
    return result
