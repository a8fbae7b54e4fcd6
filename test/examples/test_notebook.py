"""The notebook runs as it stands, and shows what it prints."""

import json
import re
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

NOTEBOOK = Path(__file__).parents[2] / "examples" / "light_to_pose.ipynb"


def test_the_notebook_runs_and_shows_what_it_prints(compiled_fit, capsys, monkeypatch):
    monkeypatch.setattr(plt, "show", lambda: plt.close("all"))
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    names, shown = {}, ""
    for cell in cells:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
            outputs = [out for out in cell["outputs"] if out["output_type"] == "stream"]
            shown += "".join(line for out in outputs for line in out["text"])
    numbers = [
        [float(number) for number in re.findall(r"-?\d+\.\d+", text)]
        for text in (capsys.readouterr().out, shown)
    ]
    assert len(numbers[0]) == 3 * 5 + 2
    np.testing.assert_allclose(*numbers, atol=0.0101)  # one in the last place
    off = names["estimate"].pose - names["truth"]
    assert (np.abs(off) < 5 * names["std"]).all()
    assert names["scatter"]["track"] < names["scatter"]["frames"] / 2
    # Aligned, and farther than where readings are full, more light is less doubt.
    assert (np.diff(names["bounds"][8:, 0]) > 0).all()
