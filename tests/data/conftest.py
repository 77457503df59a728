"""Files of a table and of a list of points."""

import functools

import pytest

from tests.data.tables import write_lines


@pytest.fixture
def table(tmp_path):
    """Writes a table's lines to a file and gives its path."""
    return functools.partial(write_lines, tmp_path)


@pytest.fixture
def listed(table):
    """Writes a list of points to a file and gives its path."""

    def write(*lines, **more):
        return table(*lines, name="tracker.txt", **more)

    return write
