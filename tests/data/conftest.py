"""Files of a table and of a list of points."""

import pytest


@pytest.fixture
def table(tmp_path):
    """Writes a table's lines to a file and gives its path."""

    def write(*lines, encoding="utf-8", name="data.csv"):
        path = tmp_path / name
        path.write_bytes("\n".join([*lines, ""]).encode(encoding))
        return path

    return write


@pytest.fixture
def listed(table):
    """Writes a list of points to a file and gives its path."""

    def write(*lines, **more):
        return table(*lines, name="tracker.txt", **more)

    return write
