"""The dialogue of `calib measure`: it shows the next pose, takes readings and commands, and says what follows."""

from __future__ import annotations

import os
import queue
import sys
import threading
from typing import Literal

import typer

from calib.cli.terminal import say_lines
from calib.errors import CalibError, DeviceError, MeasurementError
from calib.show.lines import fill
from calib.verbs.measure.station import Station
from calib.verbs.measure.stop import Row
from calib.verbs.measure.text import (
    BAD,
    DIM,
    LOOK,
    advice_text,
    answer_lines,
    commands,
    help_lines,
    hint_line,
    late_line,
    pose_lines,
    prompt,
    reached_lines,
    state_lines,
    waiting_line,
)

#: Time between two looks at what is typed [s].
_LOOK = 0.1

#: Bytes that are taken at once.
_PIECE = 65_536

#: Begins a row that is typed: a number, or a header with a unit.
_NUMBER = tuple("0123456789+-.,")

#: How a pose ends: it is measured, another one is shown, the session ends, or it is left.
_End = Literal["measured", "shown again", "done", "left"]


class Keyboard:
    """Lines of standard input, as they are typed or piped."""

    def __init__(self) -> None:
        """Begin to read."""
        self._lines: queue.Queue[str | None] = queue.Queue()
        #: False when standard input has ended, or is none: nobody types any more.
        self.is_open = False
        self.is_terminal = False
        try:
            # A read of Python's own buffer would hold its lock when the program ends.
            descriptor = sys.stdin.fileno()
            self.is_terminal = sys.stdin.isatty()
        except (AttributeError, OSError, ValueError):
            return
        self.is_open = True
        threading.Thread(target=self._pump, args=(descriptor,), daemon=True).start()

    def _pump(self, descriptor: int) -> None:
        """Pass on the lines, and None at the end; in a thread, for Windows cannot wait for a pipe."""
        rest, piece = b"", b"?"
        while piece:
            try:
                piece = os.read(descriptor, _PIECE)
            except OSError:
                piece = b""
            *lines, rest = (rest + piece).replace(b"\r\n", b"\n").split(b"\n")
            for line in lines:
                self._lines.put(line.decode("utf-8", "replace"))
        if rest.strip():
            self._lines.put(rest.decode("utf-8", "replace"))
        self._lines.put(None)

    def line(self, seconds: float) -> str | None:
        """Return the next line; None if there is none within so many seconds, or ever (`is_open`)."""
        if not self.is_open:
            return None
        try:
            line = self._lines.get(timeout=seconds) if seconds else self._lines.get_nowait()
        except queue.Empty:
            return None
        self.is_open = line is not None
        return line


class Dialogue:
    """A session in a terminal, or in a script that pipes rows and commands."""

    def __init__(self, station: Station, source: str, *, stops_at_aim: bool) -> None:
        """Make a dialogue.

        Args:
            station: The session with its devices.
            source: The instrument, as ``--reader`` names it.
            stops_at_aim: Whether the session ends by itself when its aim is reached.
        """
        self._station, self._session = station, station.session
        self._source = source
        self._keyboard = Keyboard()
        #: An instrument that measures by itself goes on by itself, unless a person watches it.
        self._is_watched = self._keyboard.is_terminal
        self._stops_at_aim = stops_at_aim or (station.is_told and not self._is_watched)
        #: True while such an instrument waits for that person.
        self._waits = False
        #: Advice that was given already.
        self._advised = {"second_target"}
        self._has_said_reached = False
        self._fault = ""

    def run(self) -> bool:
        """Measure pose by pose.

        Returns:
            True if the session is done; False if it is left, and goes on later.
        """
        if self._keyboard.is_terminal:
            say_lines([hint_line(has_instrument=self._station.has_instrument)])
        end: _End = "measured"
        while end not in ("done", "left"):
            state = self._session.state
            if state.reached and not self._has_said_reached:
                can_go_on = self._can_type and not self._stops_at_aim
                say_lines(reached_lines(can_type=can_go_on))
                self._has_said_reached = True
            if state.reached and (self._stops_at_aim or not self._can_type):
                return True
            pose = self._station.propose()
            if pose is None:
                say_lines([("No pose is left that could be measured: the session ends.", LOOK)])
                return True
            say_lines(pose_lines(self._session, pose, state))
            if self._station.late:
                say_lines([late_line(self._station.late)])
            end = self._measure()
        return end == "done"

    @property
    def _can_type(self) -> bool:
        """True as long as somebody can type."""
        return self._keyboard.is_open

    def _measure(self) -> _End:
        """Wait at a pose for its readings, and do what is typed."""
        self._waits = self._station.is_told and self._is_watched
        self._ask()
        while True:
            # Rows are typed for one pose after the other: what is piped waits.
            is_read = self._station.has_instrument and not self._waits
            line = self._keyboard.line(0.0 if is_read else _LOOK)
            if line is not None:
                end = self._do(line.strip())
                if end is not None:
                    return end
            elif not self._can_type and not self._station.has_instrument:
                row = self._station.enough()
                if row is not None:
                    self._add(row)
                return "done"
            if self._waits and self._can_type:
                if line:
                    self._ask()
                continue
            try:
                row = self._station.read(_LOOK if self._station.has_instrument else 0.0)
            except (MeasurementError, DeviceError) as error:
                self._say_fault(error)
                if not self._station.has_instrument or self._station.is_asked:
                    self._ask()
                continue
            except CalibError as error:
                self._say_fault(error)
                if self._station.is_told:
                    self._session.skip(str(error))
                    return "shown again"
                continue
            if row is not None:
                end = self._add(row)
                if end is not None:
                    return end
            elif line is not None:
                self._ask()

    def _add(self, row: Row) -> _End | None:
        """Add a row and say the answer; None if the session does not take it."""
        try:
            answer = self._session.add(row)
        except CalibError as error:
            self._say_fault(error)
            return None
        self._station.added()
        self._fault = ""
        state = self._session.state
        say_lines(answer_lines(self._session.robot, answer, state))
        for advice in state.advice if answer.outcome == "good" else ():
            if advice.code not in self._advised:
                self._advised.add(advice.code)
                say_lines([(fill(f"Hint: {advice_text(advice)}", "  "), DIM)])
        return "measured"

    def _do(self, line: str) -> _End | None:
        """Do what was typed; None if the same pose is still to be measured."""
        word, _, rest = line.partition(" ")
        word = word.casefold()
        try:
            match word:
                case "":
                    self._station.go()
                    self._waits = False
                case "done":
                    return "done"
                case "quit" | "exit":
                    return "left"
                case "help" | "?":
                    say_lines(help_lines(self._commands))
                case "state":
                    say_lines(state_lines(self._session.robot, self._session.state))
                case "note" if rest.strip():
                    self._session.note(rest.strip())
                    say_lines([("  Noted.", DIM)])
                case "note":
                    say_lines([("  Write the remark after the word: note the fan was on", LOOK)])
                case "skip":
                    self._session.skip(rest.strip())
                    say_lines([("  Left out; another pose instead:", DIM)])
                    return "shown again"
                case "undo" | "again":
                    return self._take_back(is_repeated=word == "again")
                case "at":
                    self._station.stands_at(rest)
                    say_lines([("  The robot stands there; now the reading.", DIM)])
                case "enough":
                    row = self._station.enough()
                    if row is not None:
                        return self._add(row)
                    say_lines([("  Nothing was measured at this pose yet.", LOOK)])
                case _ if line.startswith(_NUMBER) or "[" in line:
                    self._station.enter(line)
                case _:
                    known = ", ".join(command.split()[0] for command in self._commands)
                    text = (
                        f"  '{word}' is neither a command nor a row of numbers. Commands: {known}."
                    )
                    say_lines([(text, LOOK)])
        except CalibError as error:
            self._say_fault(error)
        return None

    @property
    def _commands(self) -> dict[str, str]:
        """The commands that there are."""
        several = len(self._station.context.targets) > 1
        return commands(several=several, has_robot=self._station.has_robot)

    def _take_back(self, *, is_repeated: bool) -> _End | None:
        """Take the last stop back, and show its pose again or the next one."""
        number = self._station.again() if is_repeated else self._session.undo()
        if number is None:
            say_lines([("  There is no stop to take back yet.", LOOK)])
            return None
        self._has_said_reached = False
        say_lines([(f"  Stop {number} is taken back.", DIM)])
        return "shown again"

    def _ask(self) -> None:
        """Say what is waited for."""
        station = self._station
        several = len(station.missing) > 1 or len(station.context.targets) > 1
        if station.has_instrument:
            missing = station.missing if several else ()
            waits = self._waits or (station.waits_for_go and not station.has_robot)
            say_lines([waiting_line(self._source, missing, waits_for_go=waits)])
        elif self._keyboard.is_terminal:
            target = station.missing[0] if several and station.missing else ""
            typer.echo(prompt(station.headers, target), nl=False)
            sys.stdout.flush()

    def _say_fault(self, error: CalibError) -> None:
        """Say what is wrong, once as long as it stays the same."""
        if str(error) != self._fault or not self._station.has_instrument:
            say_lines([(fill(str(error), "  "), BAD)])
        self._fault = str(error)
