"""What a xacro's expressions may do, and what they may not."""

from __future__ import annotations

import math
import time
from pathlib import Path

import pytest

from calib.errors import UrdfError
from calib.model.expressions import Budget, Evaluator, Refused
from calib.model.xacro_file import read_xacro

HEAD = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">\n'
BODY = """<link name="a"/><link name="b"/>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 0 0.5"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>
"""


def flattened(folder: Path, text: str) -> str:
    path = folder / "r.urdf.xacro"
    path.write_text(HEAD + text + BODY)
    return read_xacro(path).data.decode()


def value(folder: Path, expression: str) -> str:
    """What an expression becomes in an attribute."""
    quoted = expression.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    text = flattened(folder, f'<gazebo v="{quoted}"/>')
    return text.partition('v="')[2].partition('"')[0]


UNDERSTOOD = {
    "${1 + 2 * 3 ** 2 // 4 % 5 - 1}": "4",
    "${-pi / 2}": str(-math.pi / 2),
    "${math.sin(1) + cos(0) + radians(180) + atan2(1, 2)}": str(
        math.sin(1) + 1 + math.pi + math.atan2(1, 2)
    ),
    "${[x * 2 for x in range(5) if x > 2]}": "[6, 8]",
    "${python.sum([a * b for a, b in python.zip([1, 2], [3, 4])])}": "11",
    "${sorted([3, 1, 2], key=lambda x: -x)[0]}": "3",
    "${dict(a=1, **dict(b=2))['b']}": "2",
    "${list(dict(a=1).items())[0][1]}": "1",
    "${dict(a=1).get('c', 7)}": "7",
    "${','.join(map(str, [1, 2, 3]))}": "1,2,3",
    "${'Left_Arm'.lower().replace('_', '-').split('-')[1]}": "arm",
    "${'%.3f %d' % (1.5, 2)}": "1.500 2",
    "${'%s_20231231123 * 5 %%' % 'arm'}": "arm_20231231123 * 5 %",
    "${min(3, 1) + max([1, 5]) + python.abs(-2) + round(2.4)}": "10",
    "${1 if 'a' in 'cat' and not False or None else 2}": "1",
    "${0 < 1 <= 1 != 2}": "True",
    "${len('abc'[::-1][1:])}": "2",
    "${python.isinstance('a', python.str)}": "True",
    "${xacro.tokenize('a;b, c')}": "['a', 'b', 'c']",
    "${1 << 4 | 3 & ~1 ^ 8}": str(1 << 4 | 3 & ~1 ^ 8),
    "$(eval 1 + 2 * pi)": str(1 + 2 * math.pi),
    "$$(not this)": "$(not this)",
}


@pytest.mark.parametrize(("expression", "expected"), UNDERSTOOD.items(), ids=list(UNDERSTOOD))
def test_what_is_understood(tmp_path: Path, expression: str, expected: str):
    assert value(tmp_path, expression) == expected


REFUSED = {
    "dunder": "${().__class__}",
    "dunder in a comprehension": "${[x.__class__ for x in [()]]}",
    "dunder in a lambda": "${(lambda x: x.__class__)(1)}",
    "underscore": "${xacro._x}",
    "open": "${open('/etc/passwd').read()}",
    "import": "${__import__('os').system('id')}",
    "type's table": "${python.vars(python.type)}",
    "class from type": "${python.type('X', (), dict())}",
    "frame": "${(x for x in [1]).gi_frame}",
    "code": "${(lambda: 1).func_code}",
    "method resolution": "${str.mro()}",
    "a class's method": "${python.list.append([], 1)}",
    "a function's inside": "${xacro.load_yaml.im_func}",
    "walrus": "${[y := 1, y]}",
    "bytes": "${b'x'}",
    "stars": "${(lambda *x: x)(1)}",
    "power": "${9 ** 9 ** 9}",
    "shift": "${1 << 10 ** 9}",
    "text": "${'a' * 10 ** 9}",
    "list": "${[0] * 10 ** 9}",
    "range": "${list(range(10 ** 9))}",
    "factorial": "${math.factorial(10 ** 8)}",
    "digits": "${round(5, -10 ** 9)}",
    "format by %": "${'%1000000000d' % 1}",
    "format by % and star": "${'%*d' % (10 ** 9, 1)}",
    "a large list for each": "${[[0] * 99999 for i in range(9999)]}",
    "a long text for each": "${['a' * 999999 for i in range(9999)]}",
    "precision": "${'%.999999999f' % 1}",
    "rounds": "${[0 for a in range(9999) for b in range(9999)]}",
    "sums": "${python.sum([[0] * 1000] * 99999, [])}",
    "doubling": "${[a.append(a * 2) for a in [[1]] for i in range(99)]}",
    "endless": "${(lambda f: f(f))(lambda f: f(f))}",
    "deep": "${" + "(" * 5000 + ")" * 5000 + "}",
    "minus signs": "${" + "-" * 15_000 + "1}",
    "long": "${" + "1+" * 15_000 + "1}",
    "sharing": "${[b for a in [[0] * 99] for b in [[a] * 99] for c in [[b] * 99] if str(c)]}",
}


@pytest.mark.parametrize("expression", REFUSED.values(), ids=REFUSED)
def test_what_is_refused(tmp_path: Path, expression: str):
    start = time.process_time()
    with pytest.raises(UrdfError):
        value(tmp_path, expression)
    assert time.process_time() - start < 5.0


def test_python_s_eval_is_not_reached_by_the_old_way(tmp_path: Path):
    """$(eval ...) has all of Python in the xacro package: what it is given may have been put together before."""
    for text in ("open('/etc/passwd').read()", "eval('1')", "().__class__"):
        assert "'" not in text or '"' not in text
        words = f'<xacro:property name="e" value="{text}"/><gazebo v="$(eval ${{e}})"/>'
        with pytest.raises(UrdfError):
            flattened(tmp_path, words)


def test_fields_of_a_format_are_plain():
    evaluator = Evaluator(Budget(), {})
    assert evaluator("'{:.2f} {n}'.format(1, n=2)", {}) == "1.00 2"
    assert evaluator("f'{x:>4}{x!r}'", {"x": "a"}) == "   a'a'"
    for text in ("'{0.real}'.format(1)", "'{0[0]}'.format([1])", "'{:999999999}'.format(1)"):
        with pytest.raises(Refused):
            evaluator(text, {})
    with pytest.raises(Refused):
        evaluator("f'{1:999999999}'", {})
    with pytest.raises(NameError, match="name 'y' is not defined"):
        evaluator("y", {"x": 1})


BOMBS = {
    "macros that call macros": "".join(
        f'<xacro:macro name="m{i}">{f"<xacro:m{i - 1}/>" * 10 if i else "<gazebo/>"}</xacro:macro>'
        for i in range(9)
    )
    + "<xacro:m8/>",
    "properties of properties": '<xacro:property name="p0" value="aaaaaaaaaa"/>'
    + "".join(
        f'<xacro:property name="p{i}" value="{f"${{p{i - 1}}}" * 10}"/>' for i in range(1, 10)
    )
    + '<gazebo v="${p9}"/>',
    "a long text": f'<gazebo v="{"a" * 300_000}"/>',
    "a long expression": f'<gazebo v="${{{"a" * 150_000}}}"/>',
    "a long file": "<!-- -->" * 300_000,
    "dollars": f'<gazebo v="{"$a" * 90_000}"/>',
    "deep elements": "<a>" * 50_000 + "</a>" * 50_000,
    "many elements": "<a/>" * 150_000,
}


@pytest.mark.parametrize("text", BOMBS.values(), ids=BOMBS)
def test_bombs_are_refused_in_bounded_time(tmp_path: Path, text: str):
    start = time.process_time()
    with pytest.raises(UrdfError):
        flattened(tmp_path, text)
    assert time.process_time() - start < 10.0


def test_a_default_that_matches_in_many_ways(tmp_path: Path):
    start = time.process_time()
    flattened(tmp_path, f'<xacro:macro name="m" params="x:={"a" * 99}\'b"/>')
    assert time.process_time() - start < 5.0


def test_a_yaml_whose_aliases_grow_is_refused(tmp_path: Path):
    lines = ["a0: &a0 [1, 1]"] + [f"a{i}: &a{i} [{f'*a{i - 1}, ' * 9}]" for i in range(1, 12)]
    (tmp_path / "k.yaml").write_text("\n".join(lines))
    with pytest.raises(UrdfError, match="its aliases stand for more than 200,000 values"):
        value(tmp_path, "${xacro.load_yaml('k.yaml')}")
    (tmp_path / "k.yaml").write_text("a: &a [*a]")
    with pytest.raises(UrdfError, match="or for themselves"):
        value(tmp_path, "${xacro.load_yaml('k.yaml')}")
    (tmp_path / "k.yaml").write_text("a: &a {x: 1}\nb:\n  <<: *a\n  y: !degrees 180\n")
    assert value(tmp_path, "${xacro.load_yaml('k.yaml').b.x}") == "1"
    assert float(value(tmp_path, "${xacro.load_yaml('k.yaml')['b']['y']}")) == math.pi
    (tmp_path / "k.yaml").write_text("a: !!python/object/apply:os.getcwd []")
    with pytest.raises(UrdfError, match="could not determine a constructor"):
        value(tmp_path, "${xacro.load_yaml('k.yaml')}")
