"""Values in one line, as Python shows them."""

from __future__ import annotations

#: Characters of a line, at most.
_MOST = 120


def one_line(kind: str, *parts: str) -> str:
    """Return a value in one line of at most 120 characters.

    Args:
        kind: Name of its class.
        parts: What is worth knowing of it; empty ones are left out.

    Example:
        >>> one_line("Plan", "'ur3'", "", "30 poses")
        "Plan('ur3', 30 poses)"
    """
    text = " ".join(", ".join(part for part in parts if part).split())
    room = _MOST - len(kind) - len("()")
    if len(text) > room:
        text = text[: room - len("...")] + "..."
    return f"{kind}({text})"
