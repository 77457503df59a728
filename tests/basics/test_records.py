"""Records: a field says once how it is written; files, checks, options and the documentation follow from it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest

from calib.basics.arrays import Array
from calib.basics.records import (
    Key,
    Option,
    add_entries,
    changes,
    keep_checked,
    key,
    key_rows,
    keys,
    options,
    read_record,
    read_values,
    table_of,
    tables_of,
    toml_lines,
)
from calib.basics.value_forms import (
    JOINT_VALUE,
    MM,
    NAMES,
    POINT_MM,
    TRUTH,
    Check,
    form,
    named,
    number,
    one_of,
    text,
)
from calib.basics.values import ReadOnlyMapping
from calib.errors import ArgumentError, CalibError

#: A registry that names keys: one more entry is one more key.
WEIGHTS = ["left"]


@dataclass(frozen=True)
class Plate:
    size: float = key("size_mm", MM, "Edge of the plate.")
    flat: bool = key("flat", TRUTH, "Whether it is flat.", default=True)

    def __post_init__(self) -> None:
        keep_checked(self, "plate")


def weight_keys() -> list[Key]:
    return [Key(f"weight_{name}", number(), f"Weight {name}.", part=name) for name in WEIGHTS]


def positive(weights: dict[str, float]) -> ReadOnlyMapping[str, float] | None:
    return ReadOnlyMapping(weights) if all(value > 0 for value in weights.values()) else None


@dataclass(frozen=True)
class Bench:
    base: str | None = key(
        "base",
        text("the name of a link"),
        "Link that it stands on.",
        default=None,
        absent="the root",
        option=(Option("--base"), Option("--stands-on", help="The same as --base.")),
    )
    height: float = key(
        "height_mm",
        MM,
        "Height of the bench.",
        default=0.75,
        option=Option("--height", parse=lambda typed, _: float(typed)),
    )
    corner: Array | None = key("corner_mm", POINT_MM, "A corner.", default=None)
    side: int = key("side", one_of({"left": 1, "right": -1}), "Its side.", default=1)
    marks: tuple[str, ...] = key(
        "marks",
        NAMES,
        "Marks on it.",
        default=(),
        option=Option("--mark", group="marks", type=list[str], merge=add_entries),
    )
    known: bool = key(
        "state",
        form("'known' or a list", lambda value: value == "known"),
        "Whether its place is known.",
        default=True,
        option=Option("--state"),
    )
    directions: tuple[str, ...] = key(
        "state",
        form("", lambda value: ("x", "y") if value == "known" else tuple(value)),
        "",
        default=("x",),
    )
    weights: Mapping[str, float] = keys(
        weight_keys,
        dict,
        default_factory=dict,
        check=Check("weights above 0", positive),
    )
    held: Mapping[str, float] = key(
        "held",
        named(JOINT_VALUE),
        "Held joints.",
        default_factory=dict,
        each=Check("small", lambda value: value if value < 9 else None),
    )
    plate: Plate | None = key("plate", table_of(Plate), "Its plate.", default=None)
    plates: tuple[Plate, ...] = key(
        "plates", tables_of(Plate, "plates"), "More plates.", default=()
    )

    def __post_init__(self) -> None:
        keep_checked(self, "bench")


def test_a_table_is_read_into_si_units():
    bench = read_record(
        Bench,
        {
            "height_mm": 900,
            "corner_mm": [1, 2, -3.5],
            "side": "right",
            "marks": ["a"],
            "state": ["y"],
            "weight_left": 2,
            "held": {"lift": "0.3 m"},
            "plate": {"size_mm": 20},
            "plates": [{"size_mm": 10, "flat": False}],
        },
    )
    assert (bench.height, bench.side, bench.marks) == (0.9, -1, ("a",))
    np.testing.assert_array_equal(bench.corner, [1e-3, 2e-3, -3.5e-3])
    assert (bench.known, bench.directions) == (False, ("y",))
    assert (bench.weights, bench.held) == ({"left": 2.0}, {"lift": 0.3})
    assert (bench.plate, bench.plates) == (Plate(0.02), (Plate(0.01, flat=False),))


def test_a_registry_that_grows_adds_keys(monkeypatch):
    monkeypatch.setattr("tests.basics.test_records.WEIGHTS", ["left", "right"])
    assert read_values(Bench, {"weight_right": 1}) == {"weights": {"right": 1.0}}


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"heigth_mm": 1}, "'heigth_mm': unknown key (did you mean 'height_mm'?). It may be one of 'base', "),
        ({"height_mm": "1"}, "'height_mm' is '1'; it must be a number [mm]."),
        ({"height_mm": True}, "'height_mm' is True; it must be a number [mm]."),
        ({"corner_mm": [1, 2]}, "'corner_mm' is [1, 2]; it must be three numbers [mm]."),
        ({"corner_mm": 3}, "'corner_mm' is 3; it must be three numbers [mm]."),
        ({"base": 3}, "'base' is 3; it must be the name of a link in quotes."),
        ({"side": "top"}, "'side' is 'top'; it must be one of 'left', 'right'."),
        ({"side": ["left"]}, "'side' is ['left']; it must be one of 'left', 'right'."),
        ({"marks": ["a", 3]}, "entry 2 of 'marks' is 3; it must be a name in quotes."),
        ({"plate": 3}, "'plate' is 3; it must be a table."),
        ({"plate": {}}, "[plate] lacks 'size_mm'."),
        ({"plate": {"size_mm": "a"}}, "'size_mm' in [plate] is 'a'; it must be a number [mm]."),
        ({"plate": {"size": 1}}, "'size' in [plate]: unknown key (did you mean 'size_mm'?). It may be one of 'size_mm"),
        ({"plate": {"base": "a"}}, "'base' in [plate]: this key is not of that table; write it at the top of the file"),
        ({"plates": [{"size_mm": 1}, {}]}, "[[plates]] number 2 lacks 'size_mm'."),
        ({"plates": {}}, "'plates' is {}; it must be a list of tables, each headed [[plates]]."),
        ({"held": {"lift": 0.3}}, "'lift' in [held] is 0.3; a joint's value needs a unit"),
        ({"weight_left": -1}, "A bench's weights is {'left': -1.0}; it must be weights above 0."),
    ],
)  # fmt: skip
def test_messages_say_what_was_given_where_and_what_is_allowed(table, said):
    with pytest.raises(CalibError, match=re.escape(said)):
        read_record(Bench, table)


@pytest.mark.parametrize(
    ("given", "kind", "said"),
    [
        ({"base": 3}, ArgumentError, "'base' is of the type int (3); it must be the name of a link, or None."),
        ({"plate": 3}, ArgumentError, "'plate' is of the type int (3); it must be of the class Plate, or None."),
        ({"plates": 3}, ArgumentError, "is of the type int (3); it must be a sequence, each entry of the class Plate."),
        ({"plates": (3,)}, ArgumentError, "it must be a sequence, each entry of the class Plate."),
        ({"marks": "ab"}, ArgumentError, "it must be a sequence, each entry a text."),
        ({"held": [1]}, ArgumentError, "it must be a mapping from names"),
        ({"held": {"a": 10.0}}, CalibError, "'a' in a bench's held is 10.0; it must be small."),
        ({"known": "yes"}, ArgumentError, "it must be True or False."),
    ],
)  # fmt: skip
def test_values_in_memory_are_checked_by_their_types(given, kind, said):
    with pytest.raises(kind, match=re.escape(said)):
        Bench(**given)


def test_values_in_memory_are_kept_read_only():
    bench = Bench(marks=["a"], held={"lift": 0.1})
    assert bench.marks == ("a",)
    with pytest.raises(TypeError):
        bench.held["lift"] = 2.0  # type: ignore[index]


def test_options_change_what_a_file_says():
    bench = Bench(base="a", marks=("m",), height=0.5)
    assert changes(bench, {}) == {}
    assert changes(bench, {"stands_on": "b", "mark": ["n"]}) == {"base": "b", "marks": ("m", "n")}
    assert changes(bench, {"height": "2"}) == {"height": 2.0}
    assert changes(bench, {"state": "known"}) == {"known": True, "directions": ("x", "y")}
    assert changes(bench, {"base": "b", "stands_on": "b"}) == {"base": "b"}
    with pytest.raises(
        CalibError, match=r"--base is 'b' and --stands-on is 'c': they mean the same\."
    ):
        changes(bench, {"base": "b", "stands_on": "c"})
    assert replace(bench, **changes(bench, {"base": "b"})).base == "b"


def test_options_have_the_help_of_the_key():
    found = {option.name: option.help for option in options(Bench)}
    assert found == {
        "base": "Link that it stands on. Default: the root.",
        "stands_on": "The same as --base.",
        "height": "Height of the bench.",
        "state": "Whether its place is known.",
    }
    of_group = {option.name: option.help for option in options(Bench, ("marks",))}
    assert of_group.keys() - found.keys() == {"mark"}
    assert of_group["mark"] == "Marks on it. Can be repeated."


def test_rows_of_the_documentation():
    rows = {name: rest for name, *rest in key_rows(Bench)}
    assert rows["height_mm"] == ["a number [mm]", "750.0", "Height of the bench. (`--height`)"]
    assert rows["base"] == [
        "the name of a link in quotes",
        "the root",
        "Link that it stands on. (`--base`, `--stands-on`)",
    ]
    assert rows["side"] == ["one of 'left', 'right'", '"left"', "Its side."]
    assert rows["weight_left"] == ["a number", "none", "Weight left."]
    assert key_rows(Plate)[0] == ("size_mm", "a number [mm]", "needed", "Edge of the plate.")


def test_a_record_is_written_as_it_is_read():
    bench = Bench(
        base='a "b" é', height=0.1 + 0.2, corner=np.array([0.1, -2e-3, 1e-7]), marks=("m",)
    )
    lines = toml_lines(bench, without=("state", "held", "plates"))
    assert lines == [
        "# Link that it stands on.", 'base = "a \\"b\\" é"', "# Height of the bench.", "height_mm = 300.0",
        "# A corner.", "corner_mm = [100.0, -2.0, 0.0001]", "# Its side.", 'side = "left"',
        "# Marks on it.", 'marks = ["m"]',
    ]  # fmt: skip
