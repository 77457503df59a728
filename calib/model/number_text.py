"""How a number is written in the files of robots: digits of ASCII, at most one point, at most one exponent."""

from __future__ import annotations

import re

__all__ = ["NUMBER"]

#: Whole words that are numbers; neither nan nor inf, and in time proportional to the length of the word.
NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
