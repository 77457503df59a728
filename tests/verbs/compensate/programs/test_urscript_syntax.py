"""The functions, statements and expressions of URScript."""

from __future__ import annotations

import numpy as np
import pytest

from calib.verbs.compensate.programs.flow import Branch, Loop
from calib.verbs.compensate.programs.urscript_syntax import (
    Call,
    Expression,
    Name,
    Numbers,
    Other,
    all_functions,
    calls_in,
    names_in,
    read_functions,
    statements,
)


def expression(text: str) -> Expression:
    (statement,) = statements(read_functions(f"x = {text}").body)
    assert statement.value is not None
    return statement.value


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("p[1,2,3,4,5,6]", Numbers),
        ("[1,-2.5,+3e-1]", Numbers),
        ("(p[1,2,3,4,5,6])", Numbers),
        ("p", Name),
        ("p1", Name),
        ("f(a, b=1)", Call),
        ("p1[2]", Other),
        ("a + f(b)", Other),
        ("True", Other),
    ],
)
def test_expressions(text: str, kind: type) -> None:
    assert isinstance(expression(text), kind)


def test_numbers() -> None:
    pose = expression("p[-.5, d2r(90), d2r(-1.5), 1.0E-2, +0, 2]")
    assert isinstance(pose, Numbers)
    assert pose.is_pose
    assert pose.numbers is not None
    assert [number.value for number in pose.numbers] == [-0.5, 90, -1.5, 0.01, 0, 2]
    np.testing.assert_allclose(pose.scales, [1, np.pi / 180, np.pi / 180, 1, 1, 1])
    for text in ("p[1,2,3,4,5,6*2]", "[-d2r(1)]", "[a]", "[3.14/2]", "[d2r(a)]"):
        value = expression(text)
        assert isinstance(value, Numbers)
        assert value.numbers is None


def test_calls_and_names() -> None:
    value = expression("f(g(a), k=h(b)) + c[i]")
    assert [call.name for call in calls_in(value)] == ["g", "h", "f"]
    assert names_in(value) == {"a", "b", "c", "i"}


def test_functions() -> None:
    top = read_functions(
        "def a(x, y=1):\n  thread b():\n    sync()\n  end\n  sec c():\n  end\n  sec = 1\nend\nz = 1\nend\nw = 2\n"
    )
    found = [(item.kind, item.name, item.parameters) for item in all_functions(top)]
    assert found == [
        ("file", "", ()),
        ("def", "a", ("x", "y")),
        ("thread", "b", ()),
        ("sec", "c", ()),
    ]
    assert [item.name for item in statements(top.body)] == ["z", "w"]


def test_blocks_and_lines() -> None:
    top = read_functions(
        '$ 1 "movel(p[0])"\n# no\nif a: b() elif c: d() else: e() end\nwhile (True):\n  f([1,\n 2])\n  break\nend\n'
        "global g = 1; local h = 2\ng[0] = 3\nreturn g\n"
    )
    kinds = [type(node) for node in top.body if isinstance(node, (Branch, Loop))]
    assert kinds == [Branch, Loop]
    found = [
        (item.kind, item.name, item.where) for item in statements(top.body) if item.kind != "call"
    ]
    assert found == [
        ("break", "", ""),
        ("assignment", "g", "global"),
        ("assignment", "h", "local"),
        ("part", "g", ""),
        ("return", "", ""),
    ]
    names = [call.name for item in statements(top.body) for call in calls_in(item.value)]
    assert names == ["b", "d", "e", "f"]
