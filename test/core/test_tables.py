"""Tables as editors and spreadsheets write them, and what is refused of them by line."""

import pytest

from uuv_optical_array.core.storage import tables

WRITTEN = {
    "by hand": "# of June\nx_m,y_m\n1,2\n\n3,4\n",
    "with a byte order mark": "\ufeffx_m,y_m\n1,2\n3,4\n",
    "of another system": "x_m,y_m\r\n1,2\r\n3,4\r\n",
    "with quotes": '"# lamp, bow"\n"x_m","y_m"\n"1","2"\n# 9\n3,4',
    "with empty rows and columns": "x_m,y_m,,\n,,,\n1,2,,\n3,4\n,\n,,,,\n\n",
    "with spaces": "x_m, y_m\n 1 , 2\n3,\t4\n",
}


@pytest.mark.parametrize("text", WRITTEN.values(), ids=WRITTEN)
def test_a_table_is_read_however_it_was_written(text, tmp_path):
    path = tmp_path / "table.csv"
    path.write_bytes(text.encode())
    columns, rows = tables.read(path)
    rows = list(rows)
    assert columns == ["x_m", "y_m"]
    assert [row for _, row in rows] == [{"x_m": "1", "y_m": "2"}, {"x_m": "3", "y_m": "4"}]
    lines = text.splitlines()
    assert [lines[line - 1].strip(' ",')[0] for line, _ in rows] == ["1", "3"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"x_m,y_m,x_m\n1,2,3\n", "columns x_m more than once"),
        (b"# x_m,y_m\n1,2e-3\n3,4\n", "columns 1, 2e-3; the first row, which is no comment, names"),
        (b"x_m;y_m\n1;2\n", "separate cells by commas"),
        (b"x_m,y_m\n\n1,2,3\n", "line 3: 3 cells; give 2"),
        (b"x_m,y_m\n1\n", "line 2: 1 cells; give 2"),
        (b'x_m,y_m\n1,"2\n', "line 2: "),
        ("x_m,y_m\n# caf\xe9\n".encode("latin-1"), "give a table as CSV in UTF-8"),
    ],
)
def test_what_is_no_such_table_is_refused_by_file_and_line(content, words, tmp_path):
    path = tmp_path / "table.csv"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=words) as told:
        list(tables.read(path)[1])
    assert str(path) in str(told.value)


@pytest.mark.parametrize("content", [b"", b"\xef\xbb\xbf", b"# nothing\n"])
def test_an_empty_table_has_no_columns(content, tmp_path):
    path = tmp_path / "table.csv"
    path.write_bytes(content)
    columns, rows = tables.read(path)
    assert (columns, list(rows)) == ([], [])
