"""The film of the first page is one, and is drawn by its command from the closed loop."""

from dataclasses import replace

import film
import numpy as np
from pages import ROOT
from PIL import Image

from uuv_optical_array.control.follow_states import COLOURS
from uuv_optical_array.studies.closed_loops.kinds import kinds_named


def test_the_film_that_is_shown_is_short_and_below_a_megabyte():
    path = ROOT / "docs" / "pictures" / "film.gif"
    assert path.stat().st_size < 1e6
    with Image.open(path) as picture:
        assert 50 < picture.n_frames < 200
        lasts = 0
        for number in range(picture.n_frames):
            picture.seek(number)
            lasts += picture.info["duration"]
    assert 5e3 < lasts < 20e3


def test_a_film_shows_the_lamp_off_and_the_state_in_its_colour(
    compiled_fit, tmp_path, monkeypatch, capsys
):
    (kind,) = kinds_named("dark_5_straight")
    kind = replace(kind, since_s=6.0, until_s=10.0, dark_s=(6.0, 10.0))
    monkeypatch.setattr(film, "kinds_named", {"a darkness": [kind]}.get)
    monkeypatch.setattr(film, "STEPS", 10)  # a frame a second
    monkeypatch.setattr(film, "BEFORE_S", 3.0)
    monkeypatch.setattr(film, "AFTER_S", 2.0)
    film.main("a darkness", "1", str(tmp_path / "film.gif"))
    told = capsys.readouterr().out
    with Image.open(tmp_path / "film.gif") as picture:
        assert picture.n_frames == 3 + 4 + 2
        assert f"{picture.n_frames} frames" in told
        lit, named = [], []
        for number in range(picture.n_frames):
            picture.seek(number)
            pixels = np.asarray(picture.convert("RGB"))[32:].reshape(-1, 3).astype(float)
            # The beam is yellow: much more red than blue; the title, above, may be nearly so.
            pale = (pixels[:, 0] - pixels[:, 2] > 30) & (pixels[:, 1] > 60) & (pixels[:, 0] < 200)
            lit.append(int(pale.sum()))
            wanted = {
                name: np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])
                for name, colour in COLOURS.items()
            }
            title = np.asarray(picture.convert("RGB"))[:24].reshape(-1, 3).astype(float)
            off = {name: np.abs(title - wanted[name]).sum(axis=1) for name in wanted}
            named.append(max(off, key=lambda name: (off[name] < 60).sum()))
    dark = [kind.dark(1, 3.0 + number) for number in range(len(lit))]
    assert min(count for count, off in zip(lit, dark, strict=True) if not off) > 4 * max(
        count for count, off in zip(lit, dark, strict=True) if off
    )
    assert named[0] == "locked"
    assert "coasting" in named
