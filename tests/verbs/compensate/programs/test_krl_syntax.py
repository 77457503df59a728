"""Statements, aggregates and ways of KUKA's robot language."""

from __future__ import annotations

from pathlib import Path

from calib.verbs.compensate.programs.flow import Branch, Loop
from calib.verbs.compensate.programs.krl_syntax import (
    Aggregate,
    Parser,
    Reference,
    routines,
    statements,
)
from calib.verbs.compensate.programs.program_file import ProgramText

TEXT = """\
&ACCESS RVP
DEF one (A :IN, B :OUT)
; {X 1}
X={E6POS: X -1.5E2,y .5,T 'B0110',S 'HA',MODE #BASE,NAME[] "a;b",
  Z - 3,A N+1}
IF X.Y==1 THEN
  LIN P[3].Q : {X 1}
ELSE
  LOOP
    PTP P[N]
  ENDLOOP
ENDIF
END
"""


def parsed(text: str):
    return list(statements(ProgramText(Path("t.src"), text), 0))


def test_statements_and_their_lines():
    found = parsed(TEXT)
    assert [s.line for s in found] == [2, 4, 6, 7, 8, 9, 10, 11, 12, 13]
    assert [s.line for s in parsed(TEXT.replace("\n", "\r\n"))] == [s.line for s in found]


def test_an_aggregate():
    value = Parser(parsed(TEXT)[1], 2).expression()
    assert isinstance(value, Aggregate)
    numbers = {name: number.value for name, number in value.numbers.items()}
    assert numbers == {"X": -150.0, "Y": 0.5, "T": 6.0, "S": 10.0, "Z": -3.0}
    assert value.others == {"MODE": "#BASE", "NAME": '"a;b"', "A": "N + 1"}
    x = value.numbers["X"]
    assert TEXT[x.start : x.end] == "-1.5E2"


def test_references():
    linear = parsed(TEXT)[3]
    first, second = Parser(linear, 1).expression()
    assert isinstance(first, Reference)
    assert (first.name, first.index, first.field, first.key) == ("P", "3", "Q", "P[3]")
    assert isinstance(second, Aggregate)
    joint = Parser(parsed(TEXT)[6], 1).expression()
    assert isinstance(joint, Reference)
    assert joint.key is None


def test_the_ways_of_a_routine():
    (routine,) = routines(parsed(TEXT))
    assert (routine.name, routine.parameters) == ("ONE", {"A": True, "B": False})
    _, branch = routine.body
    assert isinstance(branch, Branch)
    assert [len(way) for way in branch.ways] == [1, 1]
    assert isinstance(branch.ways[1][0], Loop)
