"""Mutation fuzzing: valid files made wrong in a reproducible way, and readers that must not be upset by them.

A `Reader` is a function of bytes with files that it reads. Case ``i`` of seed ``s`` is always the same bytes, see
`mutated`. Each case runs in a process of its own group with limits on time and memory; what comes out is one of
`ACCEPTED`, `REFUSED` (a `CalibError` with a usable message) or `FINDING`.
"""

from __future__ import annotations

import codecs
import contextlib
import multiprocessing
import os
import random
import re
import resource
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from calib.errors import CalibError

#: Most processor time [s] and memory above that of the program itself [bytes] that a case may take.
TIME, MEMORY = 2.0, 500_000_000

#: A case that has said nothing for so long is ended [s].
_HANGS = 30.0

#: Cases that a process does before another takes its place, so that nothing gathers in it.
_CHUNK = 250

#: Longest message that a person would read [characters].
_MESSAGE = 5000

#: Longest file that a mutation makes longer [bytes].
_LARGEST = 4_000_000

ACCEPTED, REFUSED, FINDING = "accepted", "refused", "finding"


@dataclass(frozen=True)
class Reader:
    """What is fuzzed.

    Attributes:
        name: As on the command line.
        read: Reads the bytes of a file; a `CalibError` is an answer, any other exception a finding.
        files: Gives valid files; called once, in the first process.
        tokens: Words of the format that are put in the place of others.
    """

    name: str
    read: Callable[[bytes], object]
    files: Callable[[], Sequence[bytes]]
    tokens: tuple[bytes, ...] = ()

    @cached_property
    def seeds(self) -> tuple[bytes, ...]:
        """The valid files."""
        found = tuple(self.files())
        if not found:
            message = f"{self.name} has no valid files to begin with"
            raise ValueError(message)
        return found


@dataclass
class Tally:
    """What became of the cases of a reader.

    Attributes:
        cases: Number of cases.
        accepted: Of those, read without complaint.
        refused: Refused by a `CalibError`.
        findings: Index of the case and what happened, for all others.
        slowest: Longest processor time [s], and the case.
        memory: Most memory above that at the start of a process [bytes].
        printed: Cases in which something was written to standard output or error.
    """

    cases: int = 0
    accepted: int = 0
    refused: int = 0
    findings: dict[int, str] = field(default_factory=dict)
    slowest: tuple[float, int] = (0.0, 0)
    memory: int = 0
    printed: list[int] = field(default_factory=list)


@contextlib.contextmanager
def as_file(data: bytes, name: str) -> Iterator[Path]:
    """A file of that name, in a folder of its own, with these bytes."""
    with tempfile.TemporaryDirectory(prefix="calib-fuzz-") as folder:
        path = Path(folder) / name
        path.write_bytes(data)
        yield path


# Mutations

_NUMBERS = (
    *(b"nan", b"NaN", b"inf", b"-inf", b"Infinity", b"1e999", b"-1e999", b"1e308", b"1e-320"),
    *(b"-0", b"0", b"0.0", b"1", b"-1", b"1e6", b"1e7", b"1e-9", b"4294967296", b"-2147483649"),
    *(
        b"9" * 30,
        b"9" * 5000,
        b"0x1F",
        b"1_000",
        b"1,5",
        b"1d3",
        b"+-1",
        b"1e",
        b".",
        b"1e+",
        b"--",
    ),
    *("\u0661\u0662".encode(), "\uff11".encode(), "\u22121".encode(), b"true", b"null", b"1/0"),
)
_WORDS = (
    *(b"", b" ", b"\t", b"\0", b"\r", b"\n", b"\r\n", b"\x0b", b"\x0c", b"\x1b[31m", b"\x7f"),
    *(b"\xef\xbb\xbf", b"\xff\xfe", b"\xfe\xff", b"\xff", b"\x80", b"\xed\xa0\x80", b"\xc0\x80"),
    *(
        b"\xf4\x90\x80\x80",
        "\u2028".encode(),
        "\u0085".encode(),
        "\u202e".encode(),
        "\ufeff".encode(),
    ),
    *(
        "\xe9".encode(),
        "\U0001f916".encode(),
        b"&amp;",
        b"&lt;",
        b"&x;",
        b"&#0;",
        b"&#xD800;",
        b"&#10;",
    ),
    *(
        b"%s",
        b"{}",
        b"{0}",
        b"${1}",
        b"$(arg x)",
        b"[/red]",
        b"[bold]",
        b"../../etc/passwd",
        b"/dev/zero",
    ),
    *(b"file:///etc/passwd", b"http://127.0.0.1:9/", b"__class__", b"\\ud800", b"\\u0000", b"\\"),
    *(
        b'"',
        b"'",
        b"#",
        b";",
        b",",
        b":",
        b"=",
        b"<",
        b">",
        b"]]>",
        b"<![CDATA[",
        b"<!--",
        b"-->",
        b"<?x?>",
    ),
    *(
        b"!!python/object/apply:os.system [id]",
        b"&a [*a]",
        b"*a",
        b"<<: {}",
        b"? ",
        b"- ",
        b"|",
        b">",
    ),
)
_OPENS = (
    *((b"<a>", b"</a>"), (b"[", b"]"), (b"{", b"}"), (b'{"a":', b"}"), (b"(", b")"), (b"- ", b"")),
    *((b"<!--", b"-->"), (b"${", b"}"), (b"a: {", b"}"), (b"? ", b"")),
)
_TOKEN = re.compile(rb"[+-]?[0-9][0-9.eE+-]*|[A-Za-z_][\w.:/-]*|\"[^\"\n]{0,300}\"|'[^'\n]{0,300}'")
_NUMERAL = re.compile(rb"[+-]?[0-9][0-9.eE+-]*")


def mutated(reader: Reader, seed: int, index: int) -> bytes:
    """Case ``index`` of ``seed``: one of the reader's files with one or more mutations, always the same."""
    rng = random.Random(f"{reader.name}:{seed}:{index}")
    data = rng.choice(reader.seeds)
    while True:
        data = rng.choice(_MUTATIONS)(data, rng, reader)
        if rng.random() < 0.45 or len(data) > _LARGEST:
            return data


def _place(data: bytes, rng: random.Random) -> int:
    """A position in the data, its end among them."""
    return rng.randint(0, len(data))


def _span(data: bytes, rng: random.Random) -> tuple[int, int]:
    """A short stretch, or now and then a long one."""
    start = _place(data, rng)
    length = int(rng.expovariate(1.0 / rng.choice((2, 20, 500))))
    return start, min(len(data), start + length)


def _flip(data: bytes, rng: random.Random, _: Reader) -> bytes:
    """Bits turned over."""
    changed = bytearray(data)
    for _k in range(rng.choice((1, 1, 3, 30)) if data else 0):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _insert(data: bytes, rng: random.Random, _: Reader) -> bytes:
    """Bytes put in."""
    at = _place(data, rng)
    return data[:at] + rng.randbytes(rng.choice((1, 1, 2, 8, 100))) + data[at:]


def _delete(data: bytes, rng: random.Random, _: Reader) -> bytes:
    """A stretch left out."""
    start, end = _span(data, rng)
    return data[:start] + data[end:]


def _repeat(data: bytes, rng: random.Random, _: Reader) -> bytes:
    """A stretch said twice or many times."""
    start, end = _span(data, rng)
    times = rng.choice((1, 1, 2, 10, 1000))
    return data[:end] + data[start:end] * min(times, 1 + _LARGEST // (end - start + 1)) + data[end:]


def _truncate(data: bytes, rng: random.Random, _: Reader) -> bytes:
    """The end or the beginning cut off."""
    at = _place(data, rng)
    return data[:at] if rng.random() < 0.8 else data[at:]


def _splice(data: bytes, rng: random.Random, reader: Reader) -> bytes:
    """The beginning of one file and the end of another."""
    other = rng.choice(reader.seeds)
    return data[: _place(data, rng)] + other[_place(other, rng) :]


def _replace_token(data: bytes, rng: random.Random, reader: Reader) -> bytes:
    """A number or a word, once or everywhere, replaced by another."""
    found = _TOKEN.search(data, _place(data, rng)) or _TOKEN.search(data)
    if found is None:
        return data
    numeral = _NUMERAL.fullmatch(found[0])
    choices = _NUMBERS if numeral and rng.random() < 0.8 else (*_WORDS, *_NUMBERS, *reader.tokens)
    new = rng.choice(choices)
    kind = rng.random()
    if kind < 0.1:
        times = rng.choice((100, 10_000, 300_000))
        new = ((new or b"A") * min(times, 1 + _LARGEST // max(1, len(new))))[:_LARGEST]
    elif kind < 0.3:  # another word of the same file
        again = _TOKEN.search(data, _place(data, rng))
        new = again[0] if again else new
    if found[0][:1] in b"\"'" and rng.random() < 0.8:
        new = found[0][:1] + new + found[0][:1]
    if kind > 0.95 and len(found[0]) > 1:
        return data.replace(found[0], new, 200)[: 2 * _LARGEST]
    return data[: found.start()] + new + data[found.end() :]


def _nasty(data: bytes, rng: random.Random, reader: Reader) -> bytes:
    """A word put in anywhere."""
    at = _place(data, rng)
    return data[:at] + rng.choice((*_WORDS, *_NUMBERS, *reader.tokens)) + data[at:]


def _nest(data: bytes, rng: random.Random, _: Reader) -> bytes:
    """Brackets or elements, very deep; closed or not, around a stretch."""
    opens, closes = rng.choice(_OPENS)
    deep = rng.choice((10, 100, 1000, 3000, 100_000))
    start, end = _span(data, rng)
    tail = closes * deep if rng.random() < 0.7 else b""
    return data[:start] + opens * deep + data[start:end] + tail + data[end:]


def _lines(data: bytes, rng: random.Random, _: Reader) -> bytes:
    """Lines said twice, swapped or left out."""
    lines = data.split(b"\n")
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    kind = rng.randrange(4)
    if kind == 0:
        lines.insert(j, lines[i])
    elif kind == 1:
        lines[i], lines[j] = lines[j], lines[i]
    elif kind == 2:
        del lines[i]
    else:
        lines[i:i] = lines[i : i + 20] * rng.choice((1, 5, 50))
    return b"\n".join(lines)


def _encode(data: bytes, rng: random.Random, _: Reader) -> bytes:
    """Another encoding, another line end, a mark at the beginning."""
    text = data.decode("utf-8", "replace")
    kind = rng.randrange(7)
    if kind == 0:
        return codecs.BOM_UTF8 + data
    if kind == 1:
        return text.encode("utf-16", "replace")
    if kind == 2:
        return text.encode("utf-32", "replace")
    if kind == 3:
        return text.encode("latin-1", "replace") + b"\xe9"
    ends = (b"\r\n", b"\r", b"\n\r")
    return data.replace(b"\r\n", b"\n").replace(b"\n", ends[kind - 4])


_MUTATIONS: tuple[Callable[[bytes, random.Random, Reader], bytes], ...] = (
    *(_flip, _insert, _delete, _repeat, _truncate, _splice, _nasty, _nasty, _nest, _encode),
    *(
        _lines,
        _lines,
        _replace_token,
        _replace_token,
        _replace_token,
        _replace_token,
        _replace_token,
    ),
)


# Running


def judged(reader: Reader, data: bytes) -> tuple[str, str]:
    """What a reader makes of the data, one of `ACCEPTED`, `REFUSED` or `FINDING`, and the text that belongs to it."""
    try:
        reader.read(data)
    except CalibError as error:
        text = str(error)
        wrong = _wrong_message(text)
        return (FINDING, f"{wrong}: {text[:500]!r}") if wrong else (REFUSED, text)
    except BaseException:  # noqa: BLE001  anything else is what is looked for
        return FINDING, traceback.format_exc(limit=-12)
    return ACCEPTED, ""


def _wrong_message(text: str) -> str:
    """What is wrong with a message; empty if nothing is."""
    if not text.strip():
        return "empty message"
    if len(text) > _MESSAGE:
        return f"message of {len(text)} characters"
    try:
        text.encode()
    except UnicodeEncodeError:
        return "message that no terminal can print"
    return ""


def fuzzed(
    reader: Reader,
    indices: range,
    seed: int = 0,
    workers: int = 2,
    progress: Callable[[Tally], None] = lambda _: None,
) -> Tally:
    """Run the cases of a reader, each within the limits.

    Args:
        reader: What to run.
        indices: Which cases.
        seed: Of the mutations.
        workers: Processes at a time.
        progress: Called now and then.
    """
    tally = Tally()
    _ = reader.seeds  # read before the processes part
    pending = [
        indices[start : start + _CHUNK] for start in reversed(range(0, len(indices), _CHUNK))
    ]
    running: list[_Worker] = []
    while pending or running:
        while pending and len(running) < workers:
            running.append(_Worker(reader, seed, pending.pop()))
        wait([worker.pipe for worker in running], timeout=1.0)
        for worker in list(running):
            rest = worker.gather(tally)
            if rest is None:
                continue
            running.remove(worker)
            if rest:
                pending.append(rest)
        progress(tally)
    return tally


class _Worker:
    """A process that does some cases and says what became of each."""

    def __init__(self, reader: Reader, seed: int, indices: range) -> None:
        context = multiprocessing.get_context("fork")
        self.pipe, theirs = context.Pipe(duplex=False)
        self.indices, self.done = indices, 0
        self.last = time.monotonic()
        self.process = context.Process(target=_work, args=(theirs, reader, seed, indices))
        self.process.start()
        theirs.close()

    def gather(self, tally: Tally) -> range | None:
        """Note what was said; the cases that are left once the process has ended, else None."""
        try:
            while self.pipe.poll():
                self._note(tally, *self.pipe.recv())
        except EOFError:
            self.process.join()
        hangs = time.monotonic() - self.last > _HANGS
        if self.process.is_alive() and not hangs:
            return None
        if hangs:
            self.process.kill()
        self.process.join()
        self.pipe.close()
        if self.done < len(self.indices):
            how = "hung" if hangs else f"died, exit code {self.process.exitcode}"
            tally.cases += 1
            tally.findings[self.indices[self.done]] = f"the process {how}"
            self.done += 1
        return self.indices[self.done :]

    def _note(
        self, tally: Tally, kind: str, text: str, seconds: float, memory: int, printed: bool
    ) -> None:
        """Count one case."""
        index = self.indices[self.done]
        self.done += 1
        self.last = time.monotonic()
        tally.cases += 1
        tally.accepted += kind == ACCEPTED
        tally.refused += kind == REFUSED
        if kind == FINDING:
            tally.findings[index] = text
        elif seconds > TIME:
            tally.findings[index] = f"took {seconds:.2f} s"
        elif memory > MEMORY:
            tally.findings[index] = f"took {memory / 1e6:.0f} MB"
        tally.slowest = max(tally.slowest, (seconds, index))
        tally.memory = max(tally.memory, memory)
        if printed:
            tally.printed.append(index)


def _work(pipe: Connection, reader: Reader, seed: int, indices: range) -> None:
    """In the process: the cases one by one."""
    with tempfile.TemporaryFile() as said:
        for stream in (1, 2):
            os.dup2(said.fileno(), stream)
        _limit_memory()
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", DeprecationWarning)
        for index in indices:
            data = mutated(reader, seed, index)
            before, length = _highest(), os.fstat(said.fileno()).st_size
            start = time.process_time()
            kind, text = judged(reader, data)
            seconds = time.process_time() - start
            sys.stdout.flush()
            sys.stderr.flush()
            printed = os.fstat(said.fileno()).st_size > length
            pipe.send((kind, text, seconds, _highest() - before, printed))
    pipe.close()
    os._exit(0)


def _highest() -> int:
    """The most memory that this process has had [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _limit_memory() -> None:
    """No more address space than now and twice `MEMORY`: libraries that are loaded later need some."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + 2 * MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def saved(reader: Reader, seed: int, tally: Tally, folder: Path) -> None:
    """Write the bytes and the text of every finding into a folder."""
    for index, text in tally.findings.items():
        name: Any = folder / f"{reader.name}-{seed}-{index}"
        folder.mkdir(parents=True, exist_ok=True)
        Path(f"{name}.bin").write_bytes(mutated(reader, seed, index))
        Path(f"{name}.txt").write_text(text, "utf-8", "backslashreplace")
