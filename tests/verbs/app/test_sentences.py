"""The tables of sentences: the same keys and placeholders in all languages, and every key that pages use."""

from __future__ import annotations

import re
import string
from typing import get_args

import pytest

from calib.basics.progress import Stage
from calib.data import kinds
from calib.data.cell import SCALE_SIGMAS
from calib.diagnosis.reasons import VERDICTS
from calib.verbs.app.job import Kind
from calib.verbs.app.runs import State
from calib.verbs.app.sentences import DEFAULT, FOLDER, accepted, languages, sentences_for
from calib.verbs.inspect.folder import What
from calib.verbs.measure.state import AdviceCode, Why
from calib.verbs.measure.stop import Code, Outcome

#: A sentence that is asked for by its key.
_CALL = re.compile(r"""\bt\(["'](\w+)["'][,)]""")

TEMPLATES = FOLDER.parent / "templates"


def placeholders(text: str) -> set[str]:
    return {name for _, name, _, _ in string.Formatter().parse(text) if name is not None}


def test_there_are_two_languages_the_default_first():
    assert list(languages()) == ["en", "de"]


@pytest.mark.parametrize("code", sorted(path.stem for path in FOLDER.glob("*.yaml")))
def test_all_languages_have_the_same_keys_and_placeholders(code: str):
    here, there = languages()[code].texts, languages()[DEFAULT].texts
    assert set(here) == set(there)
    assert {key: placeholders(text) for key, text in here.items()} == {
        key: placeholders(text) for key, text in there.items()
    }
    assert all(here.values())


def used_keys() -> set[str]:
    """Keys that stand in templates and modules as they are."""
    keys = set()
    for path in TEMPLATES.glob("*.j2"):
        keys |= set(re.findall(_CALL, path.read_text(encoding="utf-8")))
    for path in FOLDER.parent.glob("*.py"):
        text = path.read_text(encoding="utf-8")
        keys |= set(re.findall(r'"((?:doubt|missing|cause|outcome|done)_\w+)"', text))
        keys |= set(re.findall(_CALL, text))
    return keys


def made_keys() -> set[str]:
    """Keys that are made of codes."""
    keys = {f"state_{state.value}" for state in State} | {f"job_{kind.value}" for kind in Kind}
    keys |= {f"stage_{stage.value}" for stage in Stage}
    keys |= {f"what_{what.value}" for what in What}
    keys |= {f"verdict_{use.replace(' ', '_')}" for use in VERDICTS}
    keys |= {f"option_instrument_{name}" for name in SCALE_SIGMAS}
    keys |= {f"option_kind_{name}" for name in kinds.names() if not name.startswith("test")}
    keys |= {f"run_title_{kind.value}" for kind in Kind}
    keys |= {f"failed_title_{kind.value}" for kind in Kind}
    keys |= {f"outcome_{code}" for code in ("nothing", "moved", "undecided", "row", "other")}
    keys |= {f"finding_{code}" for code in get_args(Code)}
    keys |= {f"answer_{code}" for code in get_args(Outcome)}
    keys |= {f"advice_{code}" for code in get_args(AdviceCode)}
    keys |= {f"next_why_{code}" for code in get_args(Why)}
    keys |= {f"cause_{code}" for code in ("frame", "target", "base", "hand", "other")}
    return keys


def test_every_key_that_is_used_is_there():
    assert len(used_keys()) > 100
    assert used_keys() | made_keys() <= set(languages()[DEFAULT].texts)


def test_no_key_is_there_in_vain():
    begun = ("field_", "help_", "option_", "file_", "doubt_", "nav_", "theme_", "rows_", "robot_")
    begun += ("stage_", "cancelled_", "interrupted_", "check_matters_")
    left = set(languages()[DEFAULT].texts) - used_keys() - made_keys()
    assert {key for key in left if not key.startswith(begun)} == {
        "language",
        "verdict_none",
        "what_nothing",
    }


def test_which_language_is_taken():
    assert sentences_for(None, "de", "en").language == "de"
    assert sentences_for("tlh", None).language == "en"
    assert list(accepted("de;q=0.5, en-GB;q=0.9, fr, x;q=y")) == ["fr", "en", "de"]
    assert list(accepted("")) == [""]
