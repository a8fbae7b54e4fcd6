"""Results on disk: read back as they were, refused where they are of another run."""

import csv
import math

import pytest
from measured import row

from uuv_optical_array.studies.shared.results import Results, read
from uuv_optical_array.studies.shared.tradeoff_measurement import Measurement

ORIGIN = {"scene": "sea", "fingerprint": "f" * 64, "machine": "a, b: 2 cores"}
ORIGIN |= {"mode": "quick", "frames": 7, "seed": 1}
COLUMNS = ["scene", "fingerprint", "machine", "mode", "frames", "seed", "method", "shape"]


def test_a_file_of_rows_reads_back_and_is_plain_csv(tmp_path):
    rows = [row(position=0.1 + 0.2, bound_position_m=math.inf), row("moments", angle=math.nan)]
    path = tmp_path / "t.csv"
    results = Results(path, Measurement, ORIGIN)
    results.append(rows[:1])
    Results(path, Measurement, ORIGIN).append(rows[1:])
    origin, found = read(path, Measurement)
    assert origin == {name: str(value) for name, value in ORIGIN.items()}
    assert [str(vars(a)) for a in found] == [str(vars(b)) for b in rows]
    with path.open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert list(lines[0])[:8] == COLUMNS
    assert (lines[0]["machine"], lines[0]["position_m"]) == ("a, b: 2 cores", repr(0.1 + 0.2))
    assert len(path.read_text().splitlines()) == 3
    assert [file.name for file in tmp_path.iterdir()] == ["t.csv"]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("fingerprint", "0" * 64),
        ("machine", "abacus"),
        ("mode", "full"),
        ("frames", 8),
        ("seed", 2),
    ],
)
def test_rows_of_another_run_are_refused_by_name(tmp_path, field, value):
    path = tmp_path / "t.csv"
    Results(path, Measurement, ORIGIN).append([row()])
    before = path.read_bytes()
    with pytest.raises(ValueError, match=f"another run: {field} .*name another"):
        Results(path, Measurement, {**ORIGIN, field: value})
    assert path.read_bytes() == before


def test_a_scene_by_another_name_is_the_same_run(tmp_path):
    Results(tmp_path / "t.csv", Measurement, ORIGIN).append([row()])
    other = {**ORIGIN, "scene": "b"}
    assert Results(tmp_path / "t.csv", Measurement, other).lines == [row()]


@pytest.mark.parametrize(
    "spoil",
    [
        lambda text: text[:-30],
        lambda text: text.replace("curved,5", "curved,five"),
        lambda text: "a,b\n1,2\n",
        lambda text: text + text.splitlines()[1].replace(",quick,7,1,", ",quick,7,2,") + "\n",
        lambda text: text.replace("reference", "\0"),
    ],
)
def test_damaged_files_are_refused_in_one_line(tmp_path, spoil):
    path = tmp_path / "t.csv"
    Results(path, Measurement, ORIGIN).append([row()])
    spoilt = spoil(path.read_text())
    if spoilt == path.read_text():
        spoilt = "\0" + spoilt
    path.write_text(spoilt)
    with pytest.raises(ValueError, match=r"t\.csv: .*; remove the file or name another"):
        read(path, Measurement)
