"""The tokens, values and statements of RAPID."""

from __future__ import annotations

import pytest

from calib.verbs.compensate.programs.flow import Branch, Loop
from calib.verbs.compensate.programs.rapid_syntax import (
    Aggregate,
    Assignment,
    Call,
    Control,
    Number,
    Other,
    Reference,
    Text,
    read_modules,
    statements,
    tokens_of,
    value_of,
)


def body(text: str) -> tuple[object, ...]:
    (module,) = read_modules(f"MODULE A\nPROC main()\n{text}\nENDPROC\nENDMODULE", 0)
    return module.routines["main"].body


def test_tokens() -> None:
    words = [token.word for token in tokens_of('p10:=[-1.5E-3,9E+09] ! "no\n;"a "" !b" \\WObj')]
    assert words == [
        "p10",
        ":=",
        "[",
        "-",
        "1.5E-3",
        ",",
        "9E+09",
        "]",
        ";",
        '"a "" !b"',
        "\\",
        "wobj",
    ]


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("-1.5", Number),
        ("[1,[2,3]]", Aggregate),
        ("a{2,i}.trans.x", Reference),
        ('"x;y"', Text),
        ("Offs(p,1,2,3)", Other),
        ("a+b", Other),
        ("[1]+[2]", Other),
    ],
)
def test_values(text: str, kind: type) -> None:
    value = value_of(tokens_of(text))
    assert isinstance(value, kind)
    assert (value.start, value.end) == (0, len(text))


def test_parts_of_values() -> None:
    number = value_of(tokens_of("- 1.5"))
    assert isinstance(number, Number)
    assert (number.number.value, number.start, number.end) == (-1.5, 0, 5)
    reference = value_of(tokens_of("A{2,i}.Trans"))
    assert isinstance(reference, Reference)
    assert (reference.name, reference.steps) == ("a", ((2, None), "trans"))
    other = value_of(tokens_of("RelTool(Offs(p,1,2,3),0,0,1)"))
    assert isinstance(other, Other)
    assert other.function == "reltool"
    assert {"offs", "p"} <= other.names


def test_blocks() -> None:
    nodes = body(
        "IF a=1 THEN\nx;\nELSEIF b THEN\ny;\nELSE\nz;\nENDIF\nFOR i FROM 1 TO 3 DO\nx;\nENDFOR\n"
        "TEST a\nCASE 1,2:\nx;\nDEFAULT:\ny;\nENDTEST\nIF a y;\nWHILE TRUE DO\nENDWHILE"
    )
    kinds = [type(node) for node in nodes]
    assert kinds == [Branch, Loop, Branch, Branch, Loop]
    ways = [len(node.ways) for node in nodes if isinstance(node, Branch)]
    assert ways == [3, 2, 2]


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("IF di1=1 MoveL p,v,z,t;", "movel"),
        ("IF NOT a AND (b OR c) Stop;", "stop"),
        ("IF f(x)>2 g x;", "g"),
        ("IF a=TRUE %x%;", ""),
    ],
)
def test_if_with_a_single_statement(text: str, name: str) -> None:
    (statement,) = statements(body(text))
    assert isinstance(statement, Call)
    assert statement.name == name


def test_statements() -> None:
    kinds = [
        type(item)
        for item in statements(body("a:=1;b{1}.x:=2;c;d \\e:=1;here:\nGOTO here;\nRETURN;"))
    ]
    assert kinds == [Assignment, Assignment, Call, Call, Control, Control, Control]
    (call,) = statements(body("MoveL \\Conc, p\\ID:=1, v\\V:=2, z, t\\WObj:=w\\On;"))
    assert isinstance(call, Call)
    assert len(call.arguments) == 4
    assert set(call.options) == {"conc", "id", "v", "wobj", "on"}
    assert call.options["conc"] is None


def test_declarations() -> None:
    (first, second) = read_modules(
        "%%%\nVERSION:1\n%%%\nMODULE 1_A(SYSMODULE)\nLOCAL CONST num a:=1;\nTASK PERS robtarget p{2,3}:=[];\n"
        "VAR num b,c;\n"
        "RECORD r\nnum x;\nstring y;\nENDRECORD\nLOCAL PROC f(num a,\\switch b|switch c,INOUT robtarget d\\num e)\n"
        "VAR num own;\nERROR\nTRYNEXT;\nENDPROC\nFUNC num g()\nRETURN 1;\nENDFUNC\nENDMODULE\nMODULE B\nENDMODULE",
        7,
    )
    assert (first.name, first.file, second.name) == ("1", 7, "b")
    assert {name: (data.is_local, data.dimensions) for name, data in first.data.items()} == {
        "a": (True, 0),
        "p": (False, 2),
        "b": (False, 0),
        "c": (False, 0),
    }
    assert first.records == {"r": (("x", "num"), ("y", "string"))}
    routine = first.routines["f"]
    assert routine.is_local
    assert [(item.name, item.is_optional) for item in routine.parameters] == [
        ("a", False),
        ("b", True),
        ("c", True),
        ("d", False),
        ("e", True),
    ]
    assert set(routine.data) == {"own"}
    assert first.routines["g"].kind == "func"


def test_a_record_without_an_end_ends_where_a_routine_begins() -> None:
    text = "MODULE A\nRECORD r\nnum x;\nPROC main()\nEXIT;\nENDPROC\nENDMODULE"
    (module,) = read_modules(text, 0)
    assert module.records == {"r": (("x", "num"),)}
    assert list(module.routines) == ["main"]
