"""Tables of text as spreadsheets and programs save them."""

import pytest

from orbitfb.core.errors import ExchangeError
from orbitfb.core.files.bounded import read_text
from orbitfb.core.files.delimited import read_cells


def cells(text, **how):
    return [row.cells for row in read_cells(text, "a.csv", ExchangeError, **how).lines]


PLAIN = [("a", "b"), ("1", ""), ("2", "3")]


@pytest.mark.parametrize(
    "text",
    [
        "a,b\n1,\n2,3\n",
        "a,b\r\n1,\r\n2,3\r\n",
        "a,b\r1,\r2,3",
        "# one\na,b\n  % two\n1,\n\n#three\n2,3\n",
        "a,b,\n1,,\n2,3,\n",
        "a,b\n1,,\n2,3,\n",
        "a,b,,\n1,,,\n2,3,,\n,,,\n",
        "sep=;\na;b\n1;\n2;3\n",
        "a\tb\n1\t\n2\t3\n",
        'a,"b"\n1,""\n2, 3\n',
    ],
)
def test_what_programs_add_is_no_cell(text):
    assert cells(text) == PLAIN


def test_blanks_part_cells_where_nothing_else_does():
    assert cells("# made by savetxt\n1.0 2.0\n3.0  4.0\n") == [("1.0", "2.0"), ("3.0", "4.0")]


def test_the_last_comment_above_the_rows_is_kept():
    table = read_cells("% made by X\n% Time, A\n1, 2\n# end, x\n", "a.csv", ExchangeError)
    assert table.comment == ("Time", "A")
    assert table.lines[0].number == 3


def test_a_table_that_is_none():
    assert cells("\n# nothing\n") == []
    with pytest.raises(ExchangeError, match=r"a.csv: no table .*quote texts"):
        cells('a,"b\n')


def test_a_byte_order_mark_is_no_text(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(b"\xef\xbb\xbfname,kind\n")
    assert read_text(path, 100, ExchangeError, "") == "name,kind\n"
