"""Pages read back: tables by their captions, forms, texts; with the parser of Python's own library."""

from __future__ import annotations

from html.parser import HTMLParser

from calib.data.record import LONGEST, LONGEST_NOTE, TEXTS, Record

#: Elements of HTML that have no end tag.
EMPTY = {"meta", "img"}


#: A record whose entries are as long as they may be, of words and of a single one.
FULL_RECORD = Record(
    **{name: "word " * (LONGEST // 5) if k % 2 else "x" * LONGEST for k, name in enumerate(TEXTS)}
    | {"note": "note " * (LONGEST_NOTE // 5), "country": "DE"},
    temperature_C=(-10.04, 30.0),
    humidity_percent=(0.5, 100.0),
)


class Page(HTMLParser):
    """The texts, attributes and tables of a page; every element is closed."""

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.texts: list[str] = []
        #: Of each table its caption, and the cells of its rows, heads included
        self.tables: list[tuple[str, list[list[str]]]] = []
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs
        if tag == "table":
            self.tables.append(("", []))
        elif tag == "tr":
            self.tables[-1][1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][1][-1].append("")
        if tag not in EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if data.strip() and self.open[-1] != "style":
            self.texts.append(" ".join(data.split()))
        if "caption" in self.open:
            caption, rows = self.tables[-1]
            self.tables[-1] = (caption + data, rows)
        elif "td" in self.open or "th" in self.open:
            self.tables[-1][1][-1][-1] += data

    @property
    def text(self) -> str:
        return " ".join(self.texts)

    @property
    def forms(self) -> dict[str, str]:
        """Values by their labels, of tables of two columns without a caption; the first of several counts."""
        found: dict[str, str] = {}
        for caption, rows in self.tables:
            if not caption:
                for label, value in rows:
                    found.setdefault(label.strip(), value.strip())
        return found

    def table(self, title: str) -> list[list[str]]:
        """The rows of the first table whose caption holds a text, heads first."""
        return next(rows for caption, rows in self.tables if title in caption)
